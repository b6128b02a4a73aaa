"""Wrappers for frameworks that need another space for the same action or observation."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from usnet_env.arrays import Indices, Mask


class BoxMasks(gym.ObservationWrapper[Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Declare the masks in the observation as ``Box``: TorchRL doesn't support a two-dimensional ``MultiBinary``."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        parts: dict[str, Any] = dict(env.observation_space.spaces)  # type: ignore[attr-defined]  # it is a Dict
        for name, part in parts.items():
            if isinstance(part, spaces.MultiBinary):
                parts[name] = spaces.Box(0, 1, part.shape, np.int8)
        self.observation_space = spaces.Dict(parts)

    def observation(self, observation: Any) -> Any:
        """The observation, unchanged."""
        return observation


class MultiDiscreteCandidates(gym.ActionWrapper[Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Declare the action as ``MultiDiscrete([2] * N)`` for agents without ``MultiBinary(N)``, such as RLlib's.

    >>> MultiDiscreteCandidates(gym.make("USNET/SingleCluster-Tiny-v0")).action_space
    MultiDiscrete([2 2 2 2 2 2 2 2])
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self.action_space = spaces.MultiDiscrete([2] * env.action_space.shape[0])  # type: ignore[index]  # has a shape

    def action(self, action: Any) -> Any:
        """The action, unchanged."""
        return action

    def action_masks(self) -> Mask:
        """The masks of the wrapped environment: MultiBinary and MultiDiscrete masks have the same form."""
        masks: Mask = self.env.get_wrapper_attr("action_masks")()
        return masks


def number_actions(space: Any, legal: int) -> tuple[NDArray[Any], Indices]:
    """The action ``(A, ...)`` of each number, and the places ``(A, K)`` of ``legal`` and a last 1 that must be 1."""
    if isinstance(space, spaces.MultiDiscrete):
        choices = np.indices(tuple(space.nvec)).reshape(len(space.nvec), -1).T
        return choices, choices + np.cumsum(space.nvec) - space.nvec
    choices = np.eye(legal + 1, *space.shape)
    choices[-1] = 0  # none; a message is 0
    return choices, np.arange(legal + 1)[:, None]

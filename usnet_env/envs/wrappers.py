"""Wrappers for frameworks that need another space for the same action or observation."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from usnet_env.arrays import Mask
from usnet_env.config import ArgumentError, quote


def box_masks(space: spaces.Space[Any]) -> spaces.Dict:
    """The observation space with ``Box(0, 1, …, int8)`` in place of ``MultiBinary``; the same values are valid in both.

    Raises:
        ArgumentError: the space is not a ``Dict``.
    """
    if not isinstance(space, spaces.Dict):
        raise ArgumentError(f"env must have a Dict observation space, got {quote(space)}.")
    parts = space.spaces.items()
    return spaces.Dict(
        {
            name: spaces.Box(0, 1, part.shape, np.int8) if isinstance(part, spaces.MultiBinary) else part
            for name, part in parts
        }
    )


def _check_environment(env: Any) -> gym.Env[Any, Any]:
    """Return ``env`` if it is an environment."""
    if not isinstance(env, gym.Env):
        raise ArgumentError(f"env must be a Gymnasium environment, got {quote(env)}.")
    return env


class BoxMasks(gym.ObservationWrapper[Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Declare the masks in the observation as ``Box``: TorchRL doesn't support a two-dimensional ``MultiBinary``.

    The observation itself is unchanged. :class:`usnet_env.multiagent.wrappers.ParallelBoxMasks` does the same for the
    multi-agent games.

    Raises:
        ArgumentError: the environment's observation space is not a ``Dict``.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        super().__init__(_check_environment(env))
        self.observation_space = box_masks(env.observation_space)

    def observation(self, observation: Any) -> Any:
        """Return the observation unchanged."""
        return observation


class MultiDiscreteCandidates(gym.ActionWrapper[Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Declare the action as ``MultiDiscrete([2] * N)`` for agents without ``MultiBinary(N)``, such as RLlib's.

    Raises:
        ArgumentError: the environment's action space is not ``MultiBinary``.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        _check_environment(env)
        if not isinstance(env.action_space, spaces.MultiBinary):
            raise ArgumentError(f"env must have a MultiBinary action space, got {quote(env.action_space)}.")
        gym.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self.action_space = spaces.MultiDiscrete(np.full(env.action_space.shape, 2))

    def action(self, action: NDArray[Any]) -> NDArray[Any]:
        """Return the action unchanged."""
        return action

    def action_masks(self) -> Mask:
        """The masks of the wrapped environment: MultiBinary and MultiDiscrete masks have the same form."""
        masks: Mask = self.env.get_wrapper_attr("action_masks")()
        return masks

"""Wrappers for frameworks that need another form of the same action or observation."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, quote

__all__ = ["BoxMasks", "MultiDiscreteCandidates", "box_masks"]


def box_masks(space: spaces.Space[Any]) -> spaces.Dict:
    """An observation space whose masks are ``Box(0, 1, …, int8)`` instead of ``MultiBinary``; the values fit both.

    Raises:
        ArgumentError: a space that is no ``Dict``.
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


class BoxMasks(gym.ObservationWrapper[Any, Any, Any]):
    """The masks in the observation as ``Box``: TorchRL can't read a ``MultiBinary`` of two dimensions.

    The observation itself is unchanged; :class:`usnet_env.multiagent.wrappers.ParallelBoxMasks` does the same for the
    games of several agents.

    Raises:
        ArgumentError: an env whose observation is no ``Dict``.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self.observation_space = box_masks(env.observation_space)

    def observation(self, observation: Any) -> Any:
        """The same arrays."""
        return observation


class MultiDiscreteCandidates(gym.ActionWrapper[Any, Any, Any]):
    """The action as ``MultiDiscrete([2] * N)``, which recurrent and RLlib agents want for ``MultiBinary(N)``."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        if not isinstance(env.action_space, spaces.MultiBinary):
            raise ArgumentError(f"env must have a MultiBinary action space, got {quote(env.action_space)}.")
        super().__init__(env)
        self.action_space = spaces.MultiDiscrete(np.full(env.action_space.shape, 2))

    def action(self, action: NDArray[Any]) -> NDArray[Any]:
        """The same bits."""
        return action

    def action_masks(self) -> NDArray[np.bool_]:
        """Those of the wrapped env: MultiBinary and MultiDiscrete masks have the same form."""
        masks: NDArray[np.bool_] = self.env.get_wrapper_attr("action_masks")()
        return masks

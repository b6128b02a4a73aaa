"""Wrappers for frameworks that need another form of the same action."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from usnet_env.config import InvalidArgument, shown

__all__ = ["MultiDiscreteCandidates"]


class MultiDiscreteCandidates(gym.ActionWrapper[Any, Any, Any]):
    """The action as ``MultiDiscrete([2] * N)``, which recurrent and RLlib agents want for ``MultiBinary(N)``."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        if not isinstance(env.action_space, spaces.MultiBinary):
            raise InvalidArgument(f"env must have a MultiBinary action space, got {shown(env.action_space)}.")
        super().__init__(env)
        self.action_space = spaces.MultiDiscrete(np.full(env.action_space.shape, 2))

    def action(self, action: NDArray[Any]) -> NDArray[Any]:
        """The same bits."""
        return action

    def action_masks(self) -> NDArray[np.bool_]:
        """Those of the wrapped env: MultiBinary and MultiDiscrete masks have the same form."""
        masks: NDArray[np.bool_] = self.env.get_wrapper_attr("action_masks")()
        return masks

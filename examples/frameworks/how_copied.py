"""What the examples' agents look at: for every UAV, how much of the swarm copies it.

Raw windows hold thousands of numbers, of which a small network learns little in a minute. Each example therefore
trains on one number a UAV, or builds the same number into its network.
"""

from typing import Any

import gymnasium as gym
import numpy as np

from usnet_env import Window


def how_copied(window: Window) -> np.ndarray:
    """``(N,)`` float32: the share of the UAVs in sight whose velocity repeats this one's best, one step later."""
    here = window.alive & window.seen.any(axis=0)
    velocity = np.where(window.velocity_seen[..., None], window.velocity, 0.0)
    agreement = np.einsum("tic,tjc->ij", velocity[1:], velocity[:-1])  # row i repeats column j
    np.fill_diagonal(agreement, -np.inf)
    agreement[:, ~here] = -np.inf
    votes = np.bincount(agreement[here].argmax(axis=1), minlength=window.uavs)
    return (votes / max(1, here.sum())).astype(np.float32)


class HowCopied(gym.ObservationWrapper):
    """An environment that shows :func:`how_copied` of the window instead of the window."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        self.observation_space = gym.spaces.Box(0.0, 1.0, env.action_space.shape, np.float32)

    def observation(self, observation: dict[str, Any]) -> np.ndarray:
        """One number a UAV."""
        return how_copied(Window.from_observation(observation))

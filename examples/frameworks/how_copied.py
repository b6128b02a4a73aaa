"""The input of the examples' agents: for each UAV, the share of the swarm that copies it.

A raw window has thousands of numbers, too many for a small network to learn from in a minute. Each example therefore
uses one number per UAV, or computes the same number inside its network.
"""

from typing import Any

import gymnasium as gym
import numpy as np

from usnet_env import Window


def how_copied(window: Window) -> np.ndarray:
    """``(N,)`` float32: the share of the observed UAVs that copy this UAV best, one step later."""
    here = window.alive & window.seen.any(axis=0)
    velocity = np.where(window.velocity_seen[..., None], window.velocity, 0.0)
    agreement = np.einsum("tic,tjc->ij", velocity[1:], velocity[:-1])  # row i: how well i copies each j
    np.fill_diagonal(agreement, -np.inf)
    agreement[:, ~here] = -np.inf
    votes = np.bincount(agreement[here].argmax(axis=1), minlength=window.uavs)
    return (votes / max(1, here.sum())).astype(np.float32)


class HowCopied(gym.ObservationWrapper):
    """Replaces the window in the observation by :func:`how_copied` of the window."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        self.observation_space = gym.spaces.Box(0.0, 1.0, env.action_space.shape, np.float32)

    def observation(self, observation: dict[str, Any]) -> np.ndarray:
        """One number per UAV."""
        return how_copied(Window.from_observation(observation))

"""The arrays of one window in the making, shared by the parts that fly it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Flight"]


@dataclass(frozen=True)
class Flight:
    """B swarms that fly S steps, after a past of L steps; the parts write ``position`` and ``velocity`` in place.

    Args:
        position: ``(B, L + S + 1, N, 3)`` float32, metres; the first L + 1 instants are given.
        velocity: ``(B, L + S, N, 3)`` float32, metres per step; the first L, and those of free UAVs, are given.
        noise: ``(B, S, N, 3)`` float32, the followers' n ~ N(0, I), not yet scaled by kappa_n.
        kind: ``(B, N)`` int8, what moves each UAV (``kernels.DESTROYED``, ``FREE`` or ``FOLLOWS``).
        leader: ``(B, N)`` int64, the head of each follower.
        parameters: ``(B, P)`` float32, the follow strategy's parameters of each episode.
    """

    position: NDArray[np.float32]
    velocity: NDArray[np.float32]
    noise: NDArray[np.float32]
    kind: NDArray[np.int8]
    leader: NDArray[np.int64]
    parameters: NDArray[np.float32]

    @property
    def episodes(self) -> int:
        """B."""
        return int(self.noise.shape[0])

    @property
    def steps(self) -> int:
        """S, steps to fly."""
        return int(self.noise.shape[1])

    @property
    def start(self) -> int:
        """L, index of the first step to fly in ``velocity``."""
        return int(self.velocity.shape[1] - self.steps)

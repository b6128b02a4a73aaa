"""The arrays that one call of the simulator fills: past and present motion of a batch of swarms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import AxisLength, Indices, Singles

__all__ = ["TrajectoryBatch"]


@dataclass(frozen=True)
class TrajectoryBatch:
    """B swarms with a past of L steps and S steps to simulate; ``position`` and ``velocity`` are filled in place.

    Args:
        position: ``(B, L + S + 1, N, 3)`` float32, metres; the first L + 1 instants are given.
        velocity: ``(B, L + S, N, 3)`` float32, metres per step; the first L steps are given, and all steps of the free
            UAVs (heads and decoys).
        noise: ``(B, S, N, 3)`` float32, the followers' n ~ N(0, I), before the scaling by kappa_n.
        motion: ``(B, N)`` int8, how each UAV moves: ``kernels.DESTROYED``, ``FREE`` or ``FOLLOWS``.
        leader: ``(B, N)`` int64, the head of each follower.
        parameters: ``(B, P)`` float32, the follow strategy's parameters of each episode.
    """

    position: Singles
    velocity: Singles
    noise: Singles
    motion: NDArray[np.int8]
    leader: Indices
    parameters: Singles

    @property
    def flight(self) -> tuple[NDArray[np.int8], Indices, int, Singles]:
        """Who flies how, behind which head, from which step on, and with which noise: for the compiled loops."""
        return self.motion, self.leader, self.start, self.noise

    episodes = AxisLength("noise", 0)  #: B
    steps = AxisLength("noise", 1)  #: S, the number of steps to simulate

    @property
    def start(self) -> int:
        """L, the index in ``velocity`` of the first step to simulate."""
        return int(self.velocity.shape[1] - self.steps)

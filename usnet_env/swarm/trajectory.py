"""The arrays that one call of the simulator fills: past and present motion of a batch of swarms."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import AxisLength, Indices, Mask, Singles

__all__ = ["TrajectoryBatch"]


@dataclass(frozen=True)
class TrajectoryBatch:
    """B swarms with a past of L steps and S steps to simulate; ``position`` and ``velocity`` are filled in place.

    Behind the N UAVs of a swarm stand its R references, points that fly like heads and that no sensor sees. Only field
    models have them; otherwise R is 0.

    Args:
        position: ``(B, L + S + 1, N + R, 3)`` float32, metres; the first L + 1 instants are given.
        velocity: ``(B, L + S, N + R, 3)`` float32, metres per step; the first L steps are given, and all
            steps of the free UAVs.
        noise: ``(B, S, N + R, 3)`` float32, the followers' n ~ N(0, I), before the scaling by kappa_n.
        motion: ``(B, N + R)`` int8, how each UAV moves: ``kernels.DESTROYED``, ``FREE`` or ``FOLLOWS``.
        root: ``(B, N)`` int64, the head of each follower.
        parameters: ``(B, P)`` float32, the follow strategy's parameters of each episode.
        source: ``(B, N)`` int64, the UAV or reference (from N on) that each UAV copies; for f1 to f7 its head.
        bystander: ``(B, N)`` bool, the UAVs that no head leads, decoys excluded.
        clock: ``(B,)`` int64, number of steps that each swarm has flown before step L.
    """

    position: Singles
    velocity: Singles
    noise: Singles
    motion: NDArray[np.int8]
    root: Indices
    parameters: Singles
    source: Indices = field(default_factory=lambda: np.empty((0, 0), np.int64))
    bystander: Mask = field(default_factory=lambda: np.empty((0, 0), bool))
    clock: Indices = field(default_factory=lambda: np.empty(0, np.int64))

    @property
    def flown(self) -> tuple[NDArray[np.int8], int, Singles, Singles, Singles]:
        """Who flies, from which step on, with which noise, and what is filled: for the compiled loops."""
        return self.motion, self.start, self.noise, self.position, self.velocity

    episodes = AxisLength("noise", 0)  #: B
    steps = AxisLength("noise", 1)  #: S, the number of steps to simulate

    @property
    def start(self) -> int:
        """L, the index in ``velocity`` of the first step to simulate."""
        return int(self.velocity.shape[1] - self.steps)

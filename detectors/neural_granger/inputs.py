"""Inputs and targets of the networks: lagged velocities and positions for a batch of windows of equal size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from detectors.series.gaps import fill_with_nearest
from usnet_env.window import Window

__all__ = ["Samples", "build_samples"]


@dataclass(frozen=True)
class Samples:
    """Inputs and targets of E windows with n UAVs each, at R = T_ob - T_0 times t.

    Args:
        velocity: ``(E, n, R, T_0, 3)`` metres per step, V_{i,t}: v_{i,t}, ..., v_{i,t-T_0+1}; 0 where unseen.
        position: ``(E, n, R, 3)`` metres, p_{i,t-T_0+1}; where unseen, the seen position that is nearest in time.
        position_now: ``(E, n, R, 3)`` metres, p_{i,t}, filled in the same way.
        target: ``(E, n, R, 3)`` metres per step, v_{i,t+1}; 0 where unseen.
        weight: ``(E, n, R)``, 1 where the target was seen.
    """

    velocity: Tensor
    position: Tensor
    position_now: Tensor
    target: Tensor
    weight: Tensor

    @property
    def windows(self) -> int:
        """E."""
        return int(self.target.shape[0])

    @property
    def uavs(self) -> int:
        """n, living UAVs."""
        return int(self.target.shape[1])

    @property
    def times(self) -> int:
        """R."""
        return int(self.target.shape[2])


def build_samples(
    windows: Sequence[Window], members: Sequence[NDArray[np.intp]], memory: int, device: torch.device
) -> Samples:
    """Build the samples of some UAVs of each window.

    Args:
        windows: E windows of one T_ob.
        members: for each window the indices of the UAVs to use, n of them.
        memory: T_0.
        device: of the tensors.
    """
    stacked: list[list[NDArray[np.float32]]] = []
    for window, index in zip(windows, members, strict=True):
        there = window.velocity_seen[:, index]
        velocity = np.where(there[..., None], window.velocity[:, index], np.float32(0))
        position = fill_with_nearest(window.position[:, index], window.seen[:, index])
        steps = len(velocity)
        rows = steps - memory
        lagged = np.stack([velocity[memory - 1 - lag : steps - 1 - lag] for lag in range(memory)], axis=2)
        stacked.append(
            [
                lagged.swapaxes(0, 1),
                position[:rows].swapaxes(0, 1),
                position[memory - 1 : steps - 1].swapaxes(0, 1),
                velocity[memory:].swapaxes(0, 1),
                there[memory:].T.astype(np.float32),
            ]
        )
    tensors = (torch.from_numpy(np.ascontiguousarray(np.stack(part))).to(device) for part in zip(*stacked, strict=True))
    return Samples(*tensors)

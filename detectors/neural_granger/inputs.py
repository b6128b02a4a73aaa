"""Inputs and targets of the networks: lagged velocities and positions for a batch of windows of equal size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from detectors.series.designs import stack_past
from detectors.series.gaps import fill_gaps
from usnet_env.arrays import AxisLength, Singles
from usnet_env.window import Window


@dataclass(frozen=True)
class Samples:
    """Inputs and targets of E windows with n UAVs each, at R = T_ob - T_0 times t.

    Args:
        velocity: ``(E, n, R, T_0, 3)`` metres per step, V_{i,t}: v_{i,t}, ..., v_{i,t-T_0+1}.
        position: ``(E, n, R, 3)`` metres, p_{i,t}.
        target: ``(E, n, R, 3)`` metres per step, v_{i,t+1}; 0 where unseen.
        weight: ``(E, n, R)``, 1 where the target was seen.

    What was not seen is filled in by :func:`detectors.series.gaps.fill_gaps`, except for the target.
    """

    velocity: Tensor
    position: Tensor
    target: Tensor
    weight: Tensor

    windows = AxisLength("target", 0)  #: E
    uavs = AxisLength("target", 1)  #: n, living UAVs
    times = AxisLength("target", 2)  #: R


def build_samples(
    windows: Sequence[Window], members: Sequence[NDArray[np.intp]], memory: int, device: torch.device
) -> Samples:
    """Build the samples of E windows of one T_ob, each of the n UAVs with the indices in ``members``."""
    stacked: list[tuple[Singles, ...]] = []
    for window, index in zip(windows, members, strict=True):
        whole = fill_gaps(window)
        velocity, seen = whole.velocity[:, index], window.velocity_seen[memory:, index]
        parts = (
            stack_past(velocity, memory),
            whole.position[memory - 1 : -2, index].swapaxes(0, 1),
            np.where(seen[..., None], velocity[memory:], np.float32(0)).swapaxes(0, 1),
            seen.T.astype(np.float32),
        )
        stacked.append(parts)
    tensors = (torch.from_numpy(np.ascontiguousarray(np.stack(part))).to(device) for part in zip(*stacked, strict=True))
    return Samples(*tensors)

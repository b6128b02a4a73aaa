"""The batch of all time series topology matrices X, equation (5), that a window holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.series.designs import stack_past
from detectors.series.gaps import fill_gaps
from usnet_env.arrays import AxisLength, Singles
from usnet_env.window import Window


@dataclass(frozen=True, eq=False)
class Batch:
    """The matrices X_t of n UAVs at all R = T_ob - T_0 times t that have a next velocity to predict.

    X_t has three rows for each UAV, and the head is a UAV of its cluster (decision (e)).

    Args:
        position: ``(R, n, 3)`` metres, p_{i,t-T_0+1}, the first column of X_t.
        velocity: ``(R, n, T_0, 3)`` metres per step, v_{i,t-T_0+1}, ..., v_{i,t}, the other columns, oldest first.
        own: ``(R, n, T_0 + 1, 3)`` metres, p_{i,t-T_0+1}, ..., p_{i,t+1}: P_{i,t+1} of equation (1), decision (r).
        target: ``(R, n, 3)`` metres per step, v_{i,t+1}.
        weight: ``(R, n)``, 1 where the target was seen, else 0.

    What was not seen is filled in (:func:`detectors.series.gaps.fill_gaps`, decision (y)), but a target is 0 then.
    """

    position: Singles
    velocity: Singles
    own: Singles
    target: Singles
    weight: Singles

    times = AxisLength("position", 0)  #: R
    uavs = AxisLength("position", 1)  #: n
    memory = AxisLength("velocity", 2)  #: T_0


def build_batch(window: Window, members: NDArray[np.intp] | None = None, memory: int = 4) -> Batch:
    """The batch of Algorithm 1, line 2, of the ``members`` ``(n,)`` of a cluster, by default all living UAVs.

    The window holds more than T_0 velocities, see :func:`detectors.series.designs.check_window`.
    """
    index = np.flatnonzero(window.alive) if members is None else np.asarray(members)
    whole = fill_gaps(window)
    position, velocity, seen = whole.position[:, index], whole.velocity[:, index], window.velocity_seen[memory:, index]
    return Batch(
        position=position[: -memory - 1],
        velocity=_stack_columns(velocity, memory),
        own=_stack_columns(position, memory + 1),
        target=np.where(seen[..., None], velocity[memory:], np.float32(0)),
        weight=seen.astype(np.float32),
    )


def _stack_columns(values: Singles, columns: int) -> Singles:
    """``(R, n, columns, 3)``, oldest first, of ``values`` ``(R + columns, n, 3)``."""
    return np.ascontiguousarray(stack_past(values, columns)[:, :, ::-1].transpose(1, 2, 0, 3)).swapaxes(1, 2)

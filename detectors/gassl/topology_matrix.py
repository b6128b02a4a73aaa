"""The batch of all time series topology matrices X, equation (5), that a window holds, as the networks read it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.series.designs import stack_past
from detectors.series.gaps import fill_gaps
from usnet_env.arrays import Singles
from usnet_env.window import Window


@dataclass(frozen=True, eq=False)
class Inputs:
    """The matrices X_t of n UAVs at all R = T_ob - T_0 times t that have a next velocity to predict.

    X_t has the columns p_{i,t-T_0+1}, v_{i,t-T_0+1}, ..., v_{i,t}, three rows for each UAV; the head is a UAV of its
    cluster (decision (e)). Raw metres would saturate L and the softmax; so all velocities are standardised by one
    scale, and positions by one an axis (decision (s)). What was not seen is filled in
    (:func:`detectors.series.gaps.fill_gaps`, decision (y)), but a target is 0 then.

    Args:
        history: ``(n, R, 3 (T_0 + 1))`` each UAV's standardised v_{i,t}, ..., v_{i,t-T_0+1} and p_{i,t-T_0+1}.
        value: ``(T_0 + 1, 3, n, R)`` the same of all UAVs, by attention head.
        own: ``(n, R, 3 (T_0 + 1))`` metres, p_{i,t-T_0+1}, ..., p_{i,t+1}, which is P_{i,t+1} of equation (1), decision
            (r), less its mean over the times.
        target: ``(n, R, 3)`` metres per step, v_{i,t+1}.
        weight: ``(n, R)``, 1 where the target was seen, else 0.
    """

    history: Singles
    value: Singles
    own: Singles
    target: Singles
    weight: Singles

    def of(self, uav: int) -> tuple[Singles, Singles, Singles, Singles, Singles]:
        """All arrays in this order for one UAV; ``value`` is that of all."""
        return self.history[uav], self.value, self.own[uav], self.target[uav], self.weight[uav]

    @property
    def entries(self) -> int:
        """Entries of the IFSN's input, 6 (T_0 + 1)."""
        return self.own.shape[2] + 3 * len(self.value)


def build_batch(window: Window, members: NDArray[np.intp], memory: int = 4) -> Inputs:
    """The batch of Algorithm 1, line 2, of the ``members`` ``(n,)`` of a cluster, T_0 being the ``memory``."""
    full = fill_gaps(window)
    positions, steps = full.position[:, members], full.velocity[:, members]
    seen, velocity = window.velocity_seen[memory:, members], _stack_columns(steps, memory).astype(np.float64)
    velocity = (velocity - velocity.mean()) / max(velocity.std(), 1e-6)
    position = positions[: -memory - 1].astype(np.float64)
    position = (position - position.mean((0, 1))) / np.maximum(position.std((0, 1)), 1e-6)
    by_head = [*(velocity[:, :, lag] for lag in range(memory - 1, -1, -1)), position]  # (R, n, 3), newest first
    own = _stack_columns(positions, memory + 1).astype(np.float64)
    own = (own - own.mean(axis=(0, 2), keepdims=True)).reshape(*position.shape[:2], -1)
    arrays = (
        np.concatenate(by_head, axis=2).swapaxes(0, 1),
        np.stack(by_head).transpose(0, 3, 2, 1),
        own.swapaxes(0, 1),
        np.where(seen[..., None], steps[memory:], np.float32(0)).swapaxes(0, 1),
        seen.T,
    )
    return Inputs(*(np.ascontiguousarray(array, np.float32) for array in arrays))


def _stack_columns(values: Singles, columns: int) -> Singles:
    """``(R, n, columns, 3)``, oldest first, of ``values`` ``(R + columns, n, 3)``."""
    return np.ascontiguousarray(stack_past(values, columns)[:, :, ::-1].transpose(1, 2, 0, 3)).swapaxes(1, 2)

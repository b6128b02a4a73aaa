"""Designs of lagged regressions: which rows and columns they have, and in which units."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Mask
from usnet_env.config import ArgumentError
from usnet_env.series import RealT, centre_columns
from usnet_env.window import Window

AnyT = TypeVar("AnyT", bound=np.generic)


def check_steps(window: Window, memory: int) -> None:
    """Refuse a window that has no velocity after the first ``memory``, T_0."""
    if window.observation_steps <= memory:
        raise ArgumentError(f"window must hold more than {memory} velocities, got {window.observation_steps}.")


def count_lags(steps: int, most: int, width: int, rows_per_feature: float) -> int:
    """The largest number of lags L, from 0 to ``most``, that leaves enough rows for a regression.

    A window of ``steps`` samples has ``steps`` - L rows, of which there must be ``rows_per_feature`` for each of the
    L ``width`` features.
    """
    return max(0, min(most, int(steps / (1.0 + rows_per_feature * width))))


def shift_in_time(values: NDArray[AnyT], axis: int = 0) -> NDArray[AnyT]:
    """Shift series circularly by half their length: a surrogate, related to unshifted UAVs by chance only.

    The shift keeps the statistics of each UAV, such as its autocorrelation, without a model of the motion.
    """
    return np.roll(values, values.shape[axis] // 2, axis=axis)


def compute_chance(surrogate: NDArray[np.floating]) -> float:
    """Compute how high the best entry of a row rises by chance: the median of the row maxima of surrogate evidence."""
    return float(np.median(surrogate.max(axis=1)))


def stack_past(values: NDArray[AnyT], lags: int) -> NDArray[AnyT]:
    """Stack the samples before each row, ``(n, T - lags, lags, d)``, of ``values`` ``(T, n, d)``.

    Row r belongs to time t = ``lags`` + r, whose sample is the target. Entry (i, r, l) is UAV i's sample at t - 1 - l,
    so the newest is first.
    """
    rows = np.arange(max(0, len(values) - lags))[:, None] + lags - 1 - np.arange(lags)
    return values[rows].transpose(2, 0, 1, 3)


def centre_past(values: NDArray[RealT], seen: Mask, lags: int) -> NDArray[RealT]:
    """Stack the past of ``values`` ``(T, n, d)``, each column centred over its seen rows, ``(n, T - lags, lags d)``.

    A sample that was not ``seen`` ``(T, n)`` is replaced by the mean of its column, which is 0 here.
    """
    past = centre_columns(
        stack_past(values, lags).swapaxes(0, 1), stack_past(seen[..., None], lags)[..., 0].swapaxes(0, 1)
    )
    return past.swapaxes(0, 1).reshape(past.shape[1], len(past), lags * values.shape[2])

"""Surrogates: series that keep what each UAV does by itself, but in which no UAV follows another one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detectors.series.designs import AnyT


def shift_in_time(values: NDArray[AnyT], axis: int = 0) -> NDArray[AnyT]:
    """Shift series circularly by half their length; a shifted and an unshifted UAV are related by chance only.

    The shift keeps the statistics of each UAV, such as its autocorrelation, without a model of the motion.
    """
    return np.roll(values, values.shape[axis] // 2, axis=axis)


def compute_chance(surrogate: NDArray[np.floating]) -> float:
    """Compute how high the best entry of a row rises by chance: the median of the row maxima of surrogate evidence."""
    return float(np.median(surrogate.max(axis=1)))

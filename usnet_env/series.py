"""Lagged series: centring, correlations, and what chance brings forth, for recorded tracks and for detectors.

Series of n UAVs are ``(T, n, d)``, such as velocities, where d = 3.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask

LEAST_MOTION = 1e-9  # squared sum of a centred velocity, in (metres per step)²; less is rounding
_MAD_TO_SPREAD = 1.4826  # median absolute deviation to standard deviation, for a normal variable

RealT = TypeVar("RealT", np.float32, np.float64)


def centre_columns(values: NDArray[RealT], seen: Mask) -> NDArray[RealT]:
    """Subtract the mean over the ``seen`` rows ``(R, ...)`` from ``values`` ``(R, ..., d)``; unseen rows become 0."""
    weight = seen[..., None].astype(np.float64)
    mean = (values * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), 1.0)
    return np.asarray((values - mean) * weight, values.dtype)


def scale_to_unit(values: NDArray[RealT], least: float = LEAST_MOTION) -> NDArray[RealT]:
    """Scale centred ``values`` ``(T, n, d)`` to a squared sum of 1 per UAV; 0 where that is at most ``least``."""
    total = (values**2).sum(axis=(0, 2))
    return np.asarray(values / np.sqrt(np.where(total > least, total, np.inf))[:, None], values.dtype)


def correlate_at_lag(later: NDArray[RealT], earlier: NDArray[RealT], lag: int) -> NDArray[RealT]:
    """``(n, m)``; entry (i, j) is Σ_t later_i(t + lag) · earlier_j(t); a negative lag delays ``earlier``.

    The series are ``(T, n, d)`` and ``(T, m, d)``, and the lag is from -(T - 1) to T - 1.
    """
    return _correlate_rows(_list_rows(later), _list_rows(earlier), lag * later.shape[2])


def correlate_over_lags(later: NDArray[RealT], earlier: NDArray[RealT], most: int, *, least: int = 1) -> NDArray[RealT]:
    """``(n, m)``; the largest result of :func:`correlate_at_lag` for ``least`` to ``most`` lags; -inf without a lag."""
    later_rows, earlier_rows, width = _list_rows(later), _list_rows(earlier), later.shape[2]
    best = np.full((len(later_rows), len(earlier_rows)), -np.inf, later.dtype)
    for lag in range(least, most + 1):
        np.maximum(best, _correlate_rows(later_rows, earlier_rows, lag * width), out=best)
    return best


def _list_rows(series: NDArray[RealT]) -> NDArray[RealT]:
    return series.transpose(1, 0, 2).reshape(series.shape[1], -1)


def _correlate_rows(later: NDArray[RealT], earlier: NDArray[RealT], shift: int) -> NDArray[RealT]:
    length = later.shape[1]
    return later[:, max(0, shift) : length + min(0, shift)] @ earlier[:, max(0, -shift) : length - max(0, shift)].T


def reverse_blocks(steps: int, blocks: Mask) -> tuple[Indices, Floats]:
    """The order ``(..., T)`` of the steps with time reversed in the marked ones of B equal ``blocks`` ``(..., B)``.

    Also returns ``(..., T)``: -1 in these blocks, 1 in others. Velocities in this order, times these signs, keep what
    UAVs do at the same time, and cancel who does it first.
    """
    parts = np.array_split(np.arange(steps), blocks.shape[-1])
    mirror, block = np.concatenate([part[::-1] for part in parts]), np.repeat(np.arange(len(parts)), [*map(len, parts)])
    is_reversed = blocks[..., block]
    return np.where(is_reversed, mirror, np.arange(steps)), np.where(is_reversed, -1.0, 1.0)


def bound_maximum(maxima: Floats, level: Floats | float) -> Floats:
    """What the next maximum exceeds with probability ``level``, after ``maxima`` ``(S, ...)``.

    It has the Gumbel distribution, that of maxima, with their mean and standard deviation.
    """
    scale = np.sqrt(6) / np.pi * maxima.std(axis=0)
    return np.asarray(maxima.mean(axis=0) - scale * (np.euler_gamma + np.log(-np.log1p(-np.asarray(level)))))


def find_middle(values: Floats) -> tuple[float, float]:
    """The median, and a standard deviation that outliers don't change: that of a normal variable with their MAD."""
    median = float(np.median(values))
    return median, _MAD_TO_SPREAD * float(np.median(np.abs(values - median)))

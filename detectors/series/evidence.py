"""Pairwise evidence: how well UAV j's past predicts UAV i's velocity, and how well it does by chance.

Three measures of one form: entry (i, j) is the evidence that i follows j. Each is computed a second time for a
surrogate, in which UAV i is shifted in time by half a window against all other UAVs
(:func:`detectors.series.designs.shift_in_time`). The surrogate's row maxima estimate, without a model of the motion,
how high the best of N entries rises by chance.

All three take velocities ``(T_ob, n, 3)`` in metres per step and whether they were ``seen``, ``(T_ob, n)``: an unseen
feature is replaced by its mean, an unseen target is left out. They return ``None`` for fewer than 2 UAVs or too short a
window.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.series.designs import (
    centre_columns,
    centre_past,
    compute_chance,
    count_lags,
    scale_to_unit,
    shift_in_time,
)
from detectors.series.regressions import correlate_over_lags, explain_beyond_own_past, explain_pairs, whiten
from usnet_env.arrays import Floats, Mask

LEAST_ROWS = 6
ROWS_PER_FEATURE = 1.5  # measured: down to this ratio, more lags help more than more samples per feature
_ROWS_PER_FEATURE_BEYOND = 2.5  # of a regression that also has the own past
_SIGNIFICANT_SPREADS = 3.0  # robust standard deviations between the surrogate's median row maximum and the threshold
_MAD_TO_SPREAD = 1.4826  # median absolute deviation to standard deviation, for a normal variable


@dataclass(frozen=True, eq=False)
class Evidence:
    """Pairwise evidence among the n living UAVs.

    Entry (i, j) of ``pairs`` ``(n, n)`` is the evidence that i follows j, about 0 or below if not; -inf for i = j.
    ``surrogate`` ``(n, n)`` is the same with the voters (rows) shifted in time, and ``spread`` a lower bound of the
    standard deviation of an entry by chance, for very few UAVs.
    """

    pairs: Floats
    surrogate: Floats
    spread: float

    def __post_init__(self) -> None:
        np.fill_diagonal(self.pairs, -np.inf)
        np.fill_diagonal(self.surrogate, -np.inf)

    @property
    def chance(self) -> float:
        """Expected row maximum of a UAV that follows no UAV."""
        return compute_chance(self.surrogate)

    @property
    def threshold(self) -> float:
        """A voter is significant if its row maximum is above this value."""
        best = self.surrogate.max(axis=1)
        spread = _MAD_TO_SPREAD * float(np.median(np.abs(best - self.chance)))
        return self.chance + _SIGNIFICANT_SPREADS * max(spread, self.spread)


def regression_evidence(
    velocity: NDArray[np.floating], seen: Mask, lags: int, squares: bool, ridge: float
) -> Evidence | None:
    """Compute the adjusted R² of a ridge regression of i's velocity on j's past, for every pair.

    Short windows have fewer ``lags``, and no ``squares``; for ``ridge`` see
    :func:`detectors.series.regressions.whiten`.
    """
    steps, uavs = velocity.shape[:2]
    rich = count_lags(steps, lags, 6, ROWS_PER_FEATURE) if squares else 0
    lags = rich or max(1, count_lags(steps, lags, 3, ROWS_PER_FEATURE))
    rows = steps - lags
    if uavs < 2 or rows < LEAST_ROWS:
        return None
    values = velocity.astype(np.float64)
    target = centre_columns(values[lags:], seen[lags:])
    past = centre_past(np.concatenate([values, values**2], axis=2) if rich else values, seen, lags)
    shares, freedom = explain_pairs(past, (target, shift_in_time(target)), ridge, fitted=True)
    return _adjust_shares(shares, rows, freedom)


def granger_evidence(velocity: NDArray[np.floating], seen: Mask, lags: int, own_lags: int) -> Evidence | None:
    """Compute Granger causality: the adjusted share of i's residual on its own past that j's past explains.

    There are ``lags`` past velocities of j, fewer in short windows, and ``own_lags`` of i, at most as many.
    """
    steps, uavs = velocity.shape[:2]
    lags = max(1, count_lags(steps, lags, 3, _ROWS_PER_FEATURE_BEYOND))
    own_lags = min(own_lags, lags)
    rows = steps - lags
    if uavs < 2 or rows < LEAST_ROWS:
        return None
    values = velocity.astype(np.float64)
    target = centre_columns(values[lags:], seen[lags:]).transpose(1, 0, 2)
    past = centre_past(values, seen, lags)
    theirs, _ = whiten(past)
    own = whiten(past[:, :, : 3 * own_lags])[0] if own_lags else past[:, :, :0]
    shares = [
        explain_beyond_own_past(target, own, theirs),
        explain_beyond_own_past(shift_in_time(target, axis=1), shift_in_time(own, axis=1), theirs),
    ]
    return _adjust_shares(np.array(shares), rows, np.full(uavs, 3.0 * lags), 3.0 * own_lags)


def _adjust_shares(shares: Floats, rows: int, freedom: Floats, own: float = 0.0) -> Evidence:
    """Adjust the shares ``(2, n, n)``, of the pairs and of their surrogate, for the number of parameters.

    ``freedom`` ``(n,)`` are the degrees of freedom of j's features, ``own`` those of i's own past.
    """
    pairs, surrogate = 1.0 - (1.0 - shares) * (rows - 1) / np.maximum(rows - 1 - freedom - own, 1.0)
    # The standard deviation of R² over three axes for independent samples of which nothing is explained.
    return Evidence(pairs, surrogate, float(np.sqrt(2.0 * max(freedom.mean(), 1.0) / 3.0) / rows))


def correlation_evidence(velocity: NDArray[np.floating], seen: Mask, max_lag: int) -> Evidence | None:
    """Compute the net lead of j over i: max_τ C_ij(τ) - max_τ C_ji(τ) for every pair.

    C_ij(τ) = mean_t v_i(t + τ) · v_j(t) with centred and normalised velocities (Nagy et al., Nature 464, 2010);
    τ is at least 1 and at most ``max_lag`` samples, fewer in short windows.
    """
    steps, uavs = velocity.shape[:2]
    max_lag = min(max_lag, steps - LEAST_ROWS)
    if uavs < 2 or max_lag < 1:
        return None
    flight = scale_to_unit(centre_columns(velocity.astype(np.float64), seen))
    pairs, surrogate = (
        correlate_over_lags(voter, flight, max_lag) - correlate_over_lags(flight, voter, max_lag).T
        for voter in (flight, shift_in_time(flight))
    )
    return Evidence(pairs, surrogate, 1.0 / float(np.sqrt(3.0 * steps)))

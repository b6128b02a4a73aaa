"""Lagged directional correlation: which UAV leads another one in time (Nagy et al., Nature 464, 2010)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.lagged.selection import Evidence, Floats, LaggedArguments, LaggedDetector, centre_columns

__all__ = ["LaggedCorrelation", "correlation_evidence", "lagged_correlation"]

LEAST_ROWS = 6


class _Arguments(LaggedArguments):
    max_lag: Annotated[int, Field(ge=1, le=1000)]


class LaggedCorrelation(LaggedDetector):
    """Votes for heads by net lead in lagged velocity correlation, for strategies that copy the head's direction.

    The lagged correlation is C_ij(τ) = mean_t v_i(t + τ) · v_j(t), with centred and normalised velocities. The net lead
    of UAV j over UAV i is max_τ C_ij(τ) - max_τ C_ji(τ) over τ = 1, ..., ``max_lag``. Each UAV votes for the UAV with
    the highest net lead over it. The score of a UAV is the sum of its net leads over its voters, each less the value
    expected by chance.

    The method suits f1, f2, f3 and f6. It can't work on f4 and f5: a follower's velocity is an even function of its
    head's velocity there, so the two are uncorrelated. It isn't expected to work on f7.

    Args:
        clusters: M, the number of heads at the start of the episode, or ``None`` if it is unknown; as in
            :class:`detectors.lagged.LaggedRegression`.
        max_lag: the largest lag in samples, at least 1; smaller in windows of fewer than ``max_lag`` + 6 velocities.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`, if an argument is refused.
    """

    def __init__(self, clusters: int | None = None, max_lag: int = 4) -> None:
        self.clusters = clusters
        self.max_lag = max_lag

    def check_arguments(self) -> _Arguments:
        """Return the checked arguments; raises ``ArgumentError``."""
        return _Arguments(clusters=self.clusters, max_lag=self.max_lag)

    def evidence(self, velocity: NDArray[np.floating], seen: NDArray[np.bool_]) -> Evidence | None:
        """Compute the net lead of every pair, see :func:`correlation_evidence`."""
        return correlation_evidence(velocity, seen, self.max_lag)


def correlation_evidence(velocity: NDArray[np.floating], seen: NDArray[np.bool_], max_lag: int) -> Evidence | None:
    """Compute the net lead of j over i for every pair (i, j), and for the time-shift surrogate.

    Args:
        velocity: ``(T_ob, n, 3)``, metres per step.
        seen: ``(T_ob, n)`` bool.
        max_lag: the largest lag, in samples.

    Returns:
        The evidence; ``None`` for fewer than 2 UAVs or too short a window.
    """
    steps, uavs = velocity.shape[:2]
    max_lag = min(max_lag, steps - LEAST_ROWS)
    if uavs < 2 or max_lag < 1:
        return None
    flight = centre_columns(velocity.astype(np.float64), seen)
    length = np.sqrt((flight**2).sum(axis=(0, 2)))
    flight /= np.where(length > 1e-6, length, np.inf)[:, None]
    shifted = np.roll(flight, steps // 2, axis=0)
    pairs, surrogate = (
        lagged_correlation(follower, flight, max_lag) - lagged_correlation(flight, follower, max_lag).T
        for follower in (flight, shifted)
    )
    np.fill_diagonal(pairs, -np.inf)
    np.fill_diagonal(surrogate, -np.inf)
    return Evidence(pairs, surrogate, spread=1.0 / float(np.sqrt(3.0 * steps)))


def lagged_correlation(later: Floats, earlier: Floats, max_lag: int) -> Floats:
    """``(n, n)``; entry (i, j) is max_τ Σ_t later_i(t + τ) · earlier_j(t) over τ = 1..max_lag; inputs ``(T, n, 3)``."""
    steps, uavs = later.shape[:2]
    after = later.transpose(1, 0, 2)
    before = earlier.transpose(1, 0, 2)
    best = np.full((uavs, uavs), -np.inf)
    for lag in range(1, max_lag + 1):
        product = after[:, lag:].reshape(uavs, -1) @ before[:, : steps - lag].reshape(uavs, -1).T
        np.maximum(best, product, out=best)
    return best

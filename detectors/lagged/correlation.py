"""Lagged directional correlation: who is ahead of whom in time (Nagy et al., Nature 464, 2010)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.lagged.selection import Evidence, Floats, LaggedArguments, LaggedDetector, centre_columns

__all__ = ["LaggedCorrelation", "correlation_evidence", "lagged_correlation"]

LEAST_ROWS = 6


class _Arguments(LaggedArguments):
    max_lag: Annotated[int, Field(ge=1)]


class LaggedCorrelation(LaggedDetector):
    """Net lead by lagged velocity correlation, for strategies that copy the head's direction.

    C_ij(τ) = mean_t v_i(t + τ) · v_j(t) of the centred, normalised velocities; j's net lead over i is
    max_τ C_ij(τ) - max_τ C_ji(τ) over τ = 1, ..., ``max_lag``. Every UAV votes for the one with the highest net lead
    over it; a UAV's score is the summed net lead over those who voted for it, less what chance gives.

    It finds the heads of f1, f2, f3 and f6 by design. It can't work on f4 and f5, where a follower's velocity is even
    in its head's and so uncorrelated with it, and has no reason to on f7.

    Args:
        clusters: M, the number of heads at the start of the episode, or ``None`` where it is not known; as in
            :class:`detectors.lagged.LaggedRegression`.
        max_lag: the longest delay in samples, at least 1; shortened in windows of fewer than
            ``max_lag`` + 6 velocities.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`, if an argument is refused.
    """

    def __init__(self, clusters: int | None = None, max_lag: int = 4) -> None:
        self.clusters = clusters
        self.max_lag = max_lag

    def check_arguments(self) -> _Arguments:
        """The arguments, or ``ArgumentError``."""
        return _Arguments(clusters=self.clusters, max_lag=self.max_lag)

    def evidence(self, velocity: NDArray[np.floating], seen: NDArray[np.bool_]) -> Evidence | None:
        """Net lead of every pair, see :func:`correlation_evidence`."""
        return correlation_evidence(velocity, seen, self.max_lag)


def correlation_evidence(velocity: NDArray[np.floating], seen: NDArray[np.bool_], max_lag: int) -> Evidence | None:
    """Net lead of j over i for every pair (i, j), and of its time-shift surrogate.

    Args:
        velocity: ``(T_ob, n, 3)``, metres per step.
        seen: ``(T_ob, n)`` bool.
        max_lag: the longest delay, in samples.

    Returns:
        The evidence, or ``None`` for fewer than 2 UAVs or too short a window.
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
    """``(n, n)``, entry (i, j): max over τ = 1..max_lag of Σ_t later_i(t + τ) · earlier_j(t), both ``(T, n, 3)``."""
    steps, uavs = later.shape[:2]
    after = later.transpose(1, 0, 2)
    before = earlier.transpose(1, 0, 2)
    best = np.full((uavs, uavs), -np.inf)
    for lag in range(1, max_lag + 1):
        product = after[:, lag:].reshape(uavs, -1) @ before[:, : steps - lag].reshape(uavs, -1).T
        np.maximum(best, product, out=best)
    return best

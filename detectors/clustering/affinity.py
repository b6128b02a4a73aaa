"""How much two UAVs belong together, from 0 to 1, from their features."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detectors.lagged.correlation import lagged_correlation
from detectors.lagged.selection import centre_columns
from usnet_env.config import ArgumentError
from usnet_env.window import frozen_array

__all__ = ["AFFINITIES", "affinity_of", "cosine", "lag", "lag_correlation", "rbf"]

Floats = NDArray[np.float64]
_NEIGHBOURS = 7
#: From features ``(n, d)`` or ``(n, T, d)`` to ``(n, n)``.
Affinity = Callable[[Floats], ArrayLike]


def lag_correlation(series: Floats, max_lag: int, surrogate: bool = False) -> Floats:
    """The highest correlation of any two series over all lags from -L to L.

    Args:
        series: ``(n, T, d)``; the correlation is that of d coordinates taken together, each less its mean.
        max_lag: L, in samples, at least 0; at most T - 1 are used.
        surrogate: correlate each series with the others shifted circularly by T/2: what chance alone gives.

    Returns:
        ``(n, n)`` symmetric, from -1 to 1; 1 on the diagonal if it is no surrogate. A series that never changes
        correlates with none.
    """
    flight = centre_columns(series.swapaxes(0, 1), np.ones(series.shape[1::-1], bool))
    length = np.sqrt((flight**2).sum(axis=(0, 2)))
    flight /= np.where(length > 1e-9, length, np.inf)[:, None]
    steps, uavs = flight.shape[:2]
    other = np.roll(flight, steps // 2, axis=0) if surrogate else flight
    best: Floats = flight.transpose(1, 0, 2).reshape(uavs, -1) @ other.transpose(1, 0, 2).reshape(uavs, -1).T
    if lags := min(max_lag, steps - 1):
        np.maximum(best, lagged_correlation(flight, other, lags), out=best)
        np.maximum(best, lagged_correlation(other, flight, lags).T, out=best)
    best = np.maximum(best, best.T)
    if not surrogate:
        np.fill_diagonal(best, 1.0)
    return np.clip(best, -1.0, 1.0)


def lag(features: Floats, max_lag: int) -> Floats:
    """:func:`lag_correlation` above what chance gives, ``(n, n)``.

    Chance is the median, over the UAVs, of a UAV's highest correlation with a time-shifted other. It is 0 here, so
    that many small correlations by chance do not tie a large swarm together, and full correlation is 1.
    """
    if features.ndim != 3:
        raise ArgumentError(
            f"affinity must be 'rbf', 'cosine' or None for features without a time axis {features.shape}, got 'lag'."
        )
    by_chance = lag_correlation(features, max_lag, surrogate=True)
    np.fill_diagonal(by_chance, -1.0)
    chance = float(np.clip(np.median(by_chance.max(axis=1)), 0.0, 0.99))
    return np.clip((lag_correlation(features, max_lag) - chance) / (1.0 - chance), 0.0, 1.0)


def _in_a_row(features: Floats) -> Floats:
    return features.reshape(len(features), -1)


def rbf(features: Floats, max_lag: int) -> Floats:
    """exp(-|x_i - x_j|² / (s_i s_j)), where s_i is the distance of i to its 7th neighbour; ``(n, n)``.

    The local scaling of Zelnik-Manor and Perona (NIPS 2004): no width fits all windows, and one that is taken from all
    distances is that between clusters.
    """
    flat = _in_a_row(features)
    flat = flat - flat.mean(axis=0)
    length = (flat**2).sum(axis=1)
    squared = np.maximum(length[:, None] + length - 2.0 * flat @ flat.T, 0.0)
    np.fill_diagonal(squared, 0.0)
    seventh = min(_NEIGHBOURS, len(flat) - 1)
    width = np.sqrt(np.partition(squared, seventh, axis=1)[:, seventh])
    return np.asarray(np.exp(-squared / np.maximum(width * width[:, None], 1e-12)))


def cosine(features: Floats, max_lag: int) -> Floats:
    """The cosine between features less their mean over the UAVs, at least 0; ``(n, n)``."""
    flat = _in_a_row(features)
    flat = flat - flat.mean(axis=0)
    length = np.sqrt((flat**2).sum(axis=1))
    flat /= np.where(length > 1e-9, length, np.inf)[:, None]
    affinity = np.clip(flat @ flat.T, 0.0, 1.0)
    np.fill_diagonal(affinity, 1.0)
    return affinity


#: the affinities that have a name
AFFINITIES: dict[str, Callable[[Floats, int], Floats]] = {"lag": lag, "rbf": rbf, "cosine": cosine}


def affinity_of(affinity: str | Affinity | None, features: Floats, max_lag: int) -> Floats:
    """Affinity of n UAVs by name or callable; ``None``: ``lag`` for a series, else ``rbf``.

    Args:
        affinity: a name of :data:`AFFINITIES`, or a callable.
        features: ``(n, d)`` or ``(n, T, d)``.
        max_lag: for ``lag``.

    Returns:
        ``(n, n)``, symmetric, from 0 to 1, 1 on the diagonal.

    Raises:
        ArgumentError: ``lag`` of features without a time axis; or a callable gave another shape, what is not finite
            or not symmetric, or values outside 0 to 1.
    """
    if affinity is None:
        affinity = "lag" if features.ndim == 3 else "rbf"
    if isinstance(affinity, str):
        return AFFINITIES[affinity](features, max_lag)
    values = frozen_array("affinity", affinity(features), np.float64, (len(features), len(features))).copy()
    if values.min() < 0.0 or values.max() > 1.0 or not np.allclose(values, values.T):
        raise ArgumentError(
            "affinity must give a symmetric array with values from 0 to 1, "
            f"got values from {values.min():.3g} to {values.max():.3g}."
        )
    np.fill_diagonal(values, 1.0)
    return values

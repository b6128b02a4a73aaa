"""Features of every UAV, computed from a window, and the affinity of every two UAVs, computed from their features.

Missing samples are filled in by :func:`detectors.series.gaps.fill_gaps`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from detectors.series.designs import compute_chance, shift_in_time
from detectors.series.gaps import fill_gaps
from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError
from usnet_env.series import centre_columns, correlate_over_lags, scale_to_unit
from usnet_env.window import Window

#: A function from a window to features ``(N, d)`` or a time series ``(N, T, d)``; rows of destroyed UAVs are ignored.
Features = Callable[[Window], ArrayLike]
#: A function from features ``(n, d)`` or ``(n, T, d)`` to an affinity ``(n, n)``, symmetric, from 0 to 1.
Affinity = Callable[[Floats], ArrayLike]
_NEIGHBOURS = 7
_REGULARISATION = 0.25  # sum of the weights that regularisation adds to each UAV


def compute_raw_features(window: Window, memory: int) -> Floats:
    """Return the paper's window: the last T_0 velocities and the positions where they start, ``(N, 6 T_0)``.

    Metres and metres per step, sample by sample: x, y, z of the position, then of the velocity. T_0, the ``memory``, is
    lowered to T_ob.
    """
    filled = fill_gaps(window)
    samples = np.concatenate([filled.position[:-1][-memory:], filled.velocity[-memory:]], axis=2, dtype=np.float64)
    return samples.swapaxes(0, 1).reshape(window.uavs, -1)


def compute_scaled_features(window: Window, memory: int) -> Floats:
    """Return :func:`compute_raw_features` with each of the six coordinates standardised over living UAVs and times."""
    samples = compute_raw_features(window, memory).reshape(window.uavs, -1, 6)
    living = samples[window.alive].reshape(-1, 6)
    spread = living.std(axis=0)
    return ((samples - living.mean(axis=0)) / np.where(spread > 1e-12, spread, 1.0)).reshape(window.uavs, -1)


#: The built-in features by name: functions of a window and T_0. ``"velocities"`` are those of the whole window,
#: ``(N, T_ob, 3)`` in metres per step.
FEATURES: dict[str, Callable[[Window, int], Floats]] = {
    "raw": compute_raw_features,
    "scaled": compute_scaled_features,
    "velocities": lambda window, _: fill_gaps(window).velocity.swapaxes(0, 1).astype(np.float64),
}


def correlate_both_ways(series: Floats, max_lag: int, surrogate: bool = False) -> Floats:
    """Compute the highest correlation of every two series ``(n, T, d)`` over the lags -L to L, ``(n, n)``.

    Each coordinate is centred; the sums run over time and coordinates. That with a constant series is 0. With
    ``surrogate``, the second series is shifted circularly by T/2, which leaves only correlation by chance.
    """
    unit = scale_to_unit(centre_columns(series.swapaxes(0, 1), np.ones(series.shape[1::-1], bool)))
    second = shift_in_time(unit) if surrogate else unit
    lags = min(max_lag, len(unit) - 1)
    correlation = correlate_over_lags(unit, second, lags, least=-lags)
    correlation = np.maximum(correlation, correlation.T)
    if not surrogate:
        np.fill_diagonal(correlation, 1.0)
    return np.clip(correlation, -1.0, 1.0)


def compute_lag_affinity(features: Floats, max_lag: int) -> Floats:
    """Compute max(0, (ρ - c) / (1 - c)), ``(n, n)``, where ρ is the result of :func:`correlate_both_ways`.

    c is the level of chance: the median over the UAVs of the highest correlation of a UAV with another one that is
    shifted in time. Without it the sum of many small correlations by chance would connect the clusters of a large
    swarm. ``features`` are ``(n, T, d)``, and ``max_lag`` is L, in samples.
    """
    if features.ndim != 3:
        raise ArgumentError("affinity must be 'rbf' or None for features without a time axis, got 'lag'.")
    by_chance = correlate_both_ways(features, max_lag, surrogate=True)
    np.fill_diagonal(by_chance, -1.0)
    chance = float(np.clip(compute_chance(by_chance), 0.0, 0.99))
    return np.clip((correlate_both_ways(features, max_lag) - chance) / (1.0 - chance), 0.0, 1.0)


def compute_rbf_affinity(features: Floats, max_lag: int) -> Floats:
    """Compute exp(-|x_i - x_j|² / (σ_i σ_j)), ``(n, n)``, where σ_i is the distance of i to its 7th neighbour.

    This is the local scaling of Zelnik-Manor and Perona (NIPS 2004). A fixed width does not fit all windows, and a
    width from all distances is dominated by the distances between clusters. ``max_lag`` is not used.
    """
    flat = features.reshape(len(features), -1)
    flat = flat - flat.mean(axis=0)
    length = (flat**2).sum(axis=1)
    squared = np.maximum(length[:, None] + length - 2.0 * flat @ flat.T, 0.0)
    np.fill_diagonal(squared, 0.0)
    seventh = min(_NEIGHBOURS, len(flat) - 1)
    width = np.sqrt(np.partition(squared, seventh, axis=1)[:, seventh])
    return np.asarray(np.exp(-squared / np.maximum(width * width[:, None], 1e-12)))


#: The built-in affinities by name: functions of features and L.
AFFINITIES: dict[str, Callable[[Floats, int], Floats]] = {"lag": compute_lag_affinity, "rbf": compute_rbf_affinity}


def regularise_affinity(affinity: Floats) -> Floats:
    """Set the diagonal of an affinity to 0 and add the same small weight, 0.25 / n, to all entries, ``(n, n)``.

    It keeps a UAV that is like no other one from being a cluster (Amini, Chen, Bickel and Levina, Ann. Stat. 41, 2013).
    """
    weight = affinity + _REGULARISATION / len(affinity)
    np.fill_diagonal(weight, _REGULARISATION / len(affinity))
    return weight


def normalise_affinity(affinity: Floats) -> Floats:
    """Compute D^-1/2 A D^-1/2, ``(n, n)``, of the regularised affinity A with its diagonal matrix of row sums D."""
    weight = regularise_affinity(affinity)
    root = np.sqrt(weight.sum(axis=1))
    return np.asarray(weight / root / root[:, None])

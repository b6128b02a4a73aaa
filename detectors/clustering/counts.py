r"""The number of clusters: from the features by the gap statistic, from the affinity by the eigengap.

The gap statistic: R. Tibshirani, G. Walther and T. Hastie, "Estimating the number of clusters in a data set via the
gap statistic", J. R. Stat. Soc. B 63(2), pp. 411-423, 2001. In their notation, for n rows x_i that K-Means puts into
the clusters C_1, ..., C_k of n_1, ..., n_k rows:

    W_k     = Σ_r Σ_{i ∈ C_r} |x_i - mean of C_r|²,  the within-cluster dispersion
    Gap(k)  = (1/B) Σ_b log W*_kb - log W_k,  where W*_kb is W_k of the b-th of B reference sets
    s_k     = sqrt(1 + 1/B) times the standard deviation of the B values log W*_kb
    M̂       = the smallest k with Gap(k) ≥ Gap(k + 1) - s_{k+1},  the one-standard-error rule

A reference set has n rows that are uniform in the box around the data along its principal axes (their choice b).

The eigengap: U. von Luxburg, "A tutorial on spectral clustering", Stat. Comput. 17, 2007.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from detectors.clustering.features import normalise_affinity
from usnet_env.arrays import Floats, Singles

REFERENCES = 15  # B
_LEAST_DISPERSION = 1e-6  # W_k counts as at least this share of W_1: the logarithm of rounding errors means nothing
_CHAINS = 3  # independent sequences of K-Means for each data set; the lowest W_k of them is used
_TRIALS = 2  # points that are tried as an additional centre
_MAX_STEPS = 100  # of K-Means with one number of clusters
_TOLERANCE = 3e-4  # K-Means has converged when no W_k falls by more than this share in a step: far below s_k


def compute_max_count(uavs: int) -> int:
    """Return K_max for n UAVs: 1.5 sqrt(n) rounded up, but at most n / 2 and at least 1."""
    return max(1, min(uavs // 2, int(np.ceil(1.5 * np.sqrt(uavs)))))


def estimate_count_by_gap(features: Floats, rng: np.random.Generator) -> int:
    """Estimate the number of clusters of ``features`` ``(n, d)`` by the gap statistic.

    ``rng`` draws the reference sets and the starts of K-Means. M̂ is K_max (:func:`compute_max_count`) if no k satisfies
    the rule, and at most the number of different rows.
    """
    distinct = len(np.unique(features, axis=0))
    max_count = min(compute_max_count(len(features)), distinct)
    data = _rotate_to_principal_axes(features)
    low, high = data.min(axis=0), data.max(axis=0)
    sets = np.concatenate([data[None], low + (high - low) * rng.random((REFERENCES, *data.shape))])
    floor = _LEAST_DISPERSION * float((data**2).sum())
    last_gap = -np.inf
    for k, dispersion in enumerate(_compute_dispersions(sets, rng), start=1):
        if k == distinct:  # W_k is 0: its logarithm is not finite
            break
        log_w = np.log(np.maximum(dispersion, floor))
        gap = float(log_w[1:].mean() - log_w[0])
        deviation = float(log_w[1:].std() * np.sqrt(1.0 + 1.0 / REFERENCES))
        if last_gap >= gap - deviation:
            return k - 1
        if k > max_count:
            break
        last_gap = gap
    return max_count


def _rotate_to_principal_axes(features: Floats) -> Floats:
    """The centred rows ``(n, min(n, d))`` in the coordinates of their principal axes."""
    centred = features - features.mean(axis=0)
    if centred.shape[1] > centred.shape[0]:
        values, vectors = np.linalg.eigh(centred @ centred.T)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
    return np.asarray(centred @ np.linalg.eigh(centred.T @ centred)[1])


def _compute_dispersions(sets: Floats, rng: np.random.Generator) -> Iterator[Floats]:
    """Yield the within-cluster dispersions W_k ``(S,)`` of data ``sets`` ``(S, n, d)`` for k = 1, ..., n clusters.

    K-Means with k + 1 clusters starts from the centres that it found with k and one new centre (Likas, Vlassis and
    Verbeek, Pattern Recognit. 36, 2003): the best of a few points that are drawn in proportion to their squared
    distance to the nearest centre. All sets are clustered at once, which scikit-learn can't do.
    """
    yield ((sets - sets.mean(axis=1, keepdims=True)) ** 2).sum(axis=(1, 2))
    chains: Singles = np.repeat(sets.astype(np.float32), _CHAINS, axis=0)  # log W_k needs no more digits
    squared_norm: Singles = (chains**2).sum(axis=2)
    centres: Singles = chains[np.arange(len(chains)), rng.integers(sets.shape[1], size=len(chains))][:, None]
    distance, nearest = _find_nearest_centre(chains, squared_norm, centres)
    for k in range(2, sets.shape[1] + 1):
        centres = np.concatenate([centres, _draw_centre(chains, squared_norm, distance, rng)], axis=1)
        distance, nearest = _find_nearest_centre(chains, squared_norm, centres)
        for _ in range(_MAX_STEPS):
            members = (nearest[:, :, None] == np.arange(k)).astype(np.float32).swapaxes(1, 2)
            size = members.sum(axis=2, keepdims=True)
            centres = np.where(size > 0, members @ chains / np.maximum(size, 1.0), centres)
            last_distance = distance.sum(axis=1)
            distance, nearest = _find_nearest_centre(chains, squared_norm, centres)
            if (distance.sum(axis=1) >= (1.0 - _TOLERANCE) * last_distance).all():
                break
        yield distance.sum(axis=1, dtype=np.float64).reshape(-1, _CHAINS).min(axis=1)


def _find_nearest_centre(sets: Singles, squared_norm: Singles, centres: Singles) -> tuple[Singles, NDArray[np.intp]]:
    """The squared distance to the nearest centre and the index of that centre, each ``(S, n)``."""
    squared = (centres**2).sum(axis=2)[:, None] - 2.0 * sets @ centres.swapaxes(1, 2)
    nearest = squared.argmin(axis=2)
    distance = np.take_along_axis(squared, nearest[:, :, None], axis=2)[:, :, 0] + squared_norm
    return np.maximum(distance, 0.0), nearest


def _draw_centre(sets: Singles, squared_norm: Singles, distance: Singles, rng: np.random.Generator) -> Singles:
    """The drawn point of each set, ``(S, 1, d)``, that reduces the sum of ``distance`` ``(S, n)`` most."""
    share = np.cumsum(distance, axis=1, dtype=np.float64)
    drawn = rng.random((len(sets), _TRIALS)) * share[:, -1:]
    index = np.stack([np.searchsorted(row, values) for row, values in zip(share, drawn, strict=True)])
    trials = np.take_along_axis(sets, np.minimum(index, sets.shape[1] - 1)[:, :, None], axis=1)
    squared = (trials**2).sum(axis=2)[:, None] - 2.0 * sets @ trials.swapaxes(1, 2) + squared_norm[:, :, None]
    best = np.minimum(squared, distance[:, :, None]).sum(axis=1).argmin(axis=1)
    return np.take_along_axis(trials, best[:, None, None], axis=1)


def estimate_count_by_eigengap(affinity: Floats) -> int:
    """Estimate the number of clusters by the largest gap between neighbouring eigenvalues.

    Let λ_1 ≥ λ_2 ≥ ... be the eigenvalues of the ``affinity`` ``(n, n)`` after
    :func:`detectors.clustering.features.normalise_affinity`, with negative ones replaced by 0. Then M̂ is the smallest k
    of 1 to K_max with the largest λ_k - λ_{k+1}.
    """
    values = np.maximum(np.linalg.eigvalsh(normalise_affinity(affinity))[::-1], 0.0)
    gaps = values - np.append(values[1:], 0.0)
    return int(gaps[: compute_max_count(len(affinity))].argmax()) + 1

"""K-Means: of one data set by scikit-learn, and of many data sets with k = 1, 2, ... clusters side by side."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans as SklearnKMeans

from usnet_env.arrays import Floats, Indices, Singles

STARTS = 10  # of scikit-learn's K-Means; the start with the lowest W_k is used
CHAINS = 3  # independent sequences of K-Means for each data set; the lowest W_k of them is used
_TRIALS = 2  # points that are tried as an additional centre
_MAX_STEPS = 100  # of K-Means with one number of clusters
_TOLERANCE = 3e-4  # K-Means has converged when no W_k falls by more than this share in a step: far below s_k


def assign_k_means_labels(features: Floats, count: int, rng: np.random.Generator) -> Indices:
    """Labels ``(n,)`` from 0 of the rows ``(n, d)`` of one data set, by K-Means with K-Means++ and ten starts.

    ``count`` is lowered to the number of distinct rows. ``rng`` draws the seed of scikit-learn.
    """
    count = min(count, len(np.unique(features, axis=0)))
    labels: Indices = SklearnKMeans(count, n_init=STARTS, random_state=int(rng.integers(2**31))).fit_predict(features)
    return labels


def compute_dispersions(sets: Floats, rng: np.random.Generator) -> Iterator[Floats]:
    """Yield the within-cluster dispersions W_k ``(S,)`` of S data sets for k = 1, ..., n clusters.

    K-Means with k + 1 clusters starts from the centres that it found with k and one new centre (Likas, Vlassis and
    Verbeek, Pattern Recognit. 36, 2003). The new centre is the best of a few points that are drawn in proportion to
    their squared distance to the nearest centre (greedy K-Means++, Arthur and Vassilvitskii, SODA 2007). Each data set
    has ``CHAINS`` such sequences, which start at random points.

    Args:
        sets: ``(S, n, d)``. Centred values lose the least by the single precision that is used inside.
        rng: generator of the points.
    """
    yield ((sets - sets.mean(axis=1, keepdims=True)) ** 2).sum(axis=(1, 2))
    chains: Singles = np.repeat(sets.astype(np.float32), CHAINS, axis=0)  # log W_k needs no more digits
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
            before = distance.sum(axis=1)
            distance, nearest = _find_nearest_centre(chains, squared_norm, centres)
            if (distance.sum(axis=1) >= (1.0 - _TOLERANCE) * before).all():
                break
        yield distance.sum(axis=1, dtype=np.float64).reshape(-1, CHAINS).min(axis=1)


def _find_nearest_centre(sets: Singles, squared_norm: Singles, centres: Singles) -> tuple[Singles, NDArray[np.intp]]:
    """Return the squared distance to the nearest centre and the index of that centre, each ``(S, n)``."""
    squared = (centres**2).sum(axis=2)[:, None] - 2.0 * sets @ centres.swapaxes(1, 2)
    nearest = squared.argmin(axis=2)
    least = np.take_along_axis(squared, nearest[:, :, None], axis=2)[:, :, 0] + squared_norm
    return np.maximum(least, 0.0), nearest


def _draw_centre(sets: Singles, squared_norm: Singles, distance: Singles, rng: np.random.Generator) -> Singles:
    """Return the drawn point of each set, ``(S, 1, d)``, that reduces the sum of ``distance`` ``(S, n)`` most."""
    share = np.cumsum(distance, axis=1, dtype=np.float64)
    drawn = rng.random((len(sets), _TRIALS)) * share[:, -1:]
    index = np.stack([np.searchsorted(row, at) for row, at in zip(share, drawn, strict=True)])
    trials = np.take_along_axis(sets, np.minimum(index, sets.shape[1] - 1)[:, :, None], axis=1)
    squared = (trials**2).sum(axis=2)[:, None] - 2.0 * sets @ trials.swapaxes(1, 2) + squared_norm[:, :, None]
    best = np.minimum(squared, distance[:, :, None]).sum(axis=1).argmin(axis=1)
    return np.take_along_axis(trials, best[:, None, None], axis=1)

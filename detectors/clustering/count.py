"""How many clusters there are: the gap statistic of the features, or the eigengap of the affinity."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh

__all__ = ["COUNTS", "Gap", "eigengap", "eigenvalues", "gap", "most_clusters", "normalised", "regularised", "within_of"]

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

COUNTS = ("gap", "gap-one-se", "eigengap")
REFERENCES = 15  # B, uniform data sets that the gap is measured against
STARTS = 3  # chains of K-Means for every data set, of which the best counts
CLEAR = 10.0  # s by which a later gap is clearly higher: measured 40 and more on blobs, 8 at most on uniform clouds
_TRIALS = 2  # places that are tried for one more centre
_MOST_STEPS = 100  # of K-Means with one number of clusters
_TOLERANCE = 3e-4  # K-Means has converged when a step lowers no W by more than this share: far below s_k
TIE = 0.25  # the affinity that a UAV has to all others together, so that nobody is alone
_FIRST_EIGENVALUES = 16  # that are looked at; more only where the largest gap may lie beyond
_DENSE = 200  # up to here all eigenvalues are cheaper than some


def most_clusters(uavs: int) -> int:
    """K_max, the highest number of clusters to consider among n UAVs: 1.5 sqrt(n), and two UAVs each at least."""
    return max(1, min(uavs // 2, int(np.ceil(1.5 * np.sqrt(uavs)))))


@dataclass(frozen=True, eq=False)
class Gap:
    """The gap statistic.

    Args:
        count: M̂.
        gap: ``(K,)``, Gap(k) of k = 1, ..., K, as far as was needed.
        deviation: ``(K,)``, s_k.
    """

    count: int
    gap: Floats
    deviation: Floats


def gap(
    features: Floats,
    rng: np.random.Generator,
    most: int | None = None,
    references: int = REFERENCES,
    clear: float = CLEAR,
) -> Gap:
    """M̂ by the gap statistic of Tibshirani, Walther and Hastie (J. R. Stat. Soc. B 63, 2001).

    Gap(k) = E*[log W_k] - log W_k, where W_k is the squared distance to the centres of K-Means with k clusters, and E*
    the mean over B uniform data sets in the box around the data along its principal axes (their choice b). M̂ is the
    smallest k with Gap(k) >= Gap(k + 1) - s_{k+1}, s_k = sd_k sqrt(1 + 1/B) (the one-standard-error rule).

    That rule alone stops too early where the first few cuts part no more of many clusters than of a uniform cloud. So a
    k is passed over if one of the next, up to 2k + 8, has a gap that is higher by more than ``clear`` of its s.

    Args:
        features: ``(n, d)`` with n of at least 1.
        rng: draws the references and the starts of K-Means.
        most: K_max; ``None``: :func:`most_clusters`. It is never more than the number of different rows.
        references: B.
        clear: how clear a later peak must be, in s; infinity: the one-standard-error rule alone.

    Returns:
        M̂ and the gaps. M̂ is K_max where no k satisfies the rule, and 1 where all rows are the same.
    """
    distinct = len(np.unique(features, axis=0))
    most = min(most_clusters(len(features)) if most is None else most, distinct)
    data = _along_principal_axes(features)
    low, high = data.min(axis=0), data.max(axis=0)
    sets = np.concatenate([data[None], low + (high - low) * rng.random((references, *data.shape))])
    total = float((data**2).sum())
    gaps: list[float] = []
    deviations: list[float] = []
    found: int | None = None
    for k, within in enumerate(within_of(sets, rng), start=1):
        if k >= distinct:
            if distinct <= most:  # k points explain everything, and log W_k would not be finite
                return Gap(k, np.array([*gaps, np.inf]), np.array([*deviations, 0.0]))
            break
        logs = np.log(np.maximum(within, 1e-6 * total))
        gaps.append(float(logs[1:].mean() - logs[0]))
        deviations.append(float(logs[1:].std() * np.sqrt(1.0 + 1.0 / references)))
        found = _smallest(gaps, deviations, clear)
        if k > most or (found is not None and k >= _horizon(found, clear)):
            break
    return Gap(min(found or most, most), np.array(gaps), np.array(deviations))


def _horizon(k: int, clear: float) -> int:
    """The last of the gaps that k is held against."""
    return k + 1 if np.isinf(clear) else 2 * k + 8


def _smallest(gaps: list[float], deviations: list[float], clear: float) -> int | None:
    """The smallest k that satisfies the rule, as far as the gaps of 1, 2, ... are known."""
    for k in range(1, len(gaps)):
        later = range(k + 1, min(_horizon(k, clear), len(gaps)))
        if gaps[k - 1] >= gaps[k] - deviations[k] and not any(
            gaps[j] - clear * deviations[j] > gaps[k - 1] for j in later
        ):
            return k
    return None


def _along_principal_axes(features: Floats) -> Floats:
    """The centred rows in the coordinates of their principal axes, of which there are at most n."""
    moved = features - features.mean(axis=0)
    if moved.shape[1] > moved.shape[0]:
        values, vectors = np.linalg.eigh(moved @ moved.T)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
    return np.asarray(moved @ np.linalg.eigh(moved.T @ moved)[1])


def within_of(sets: Floats, rng: np.random.Generator) -> Iterator[Floats]:
    """W_k ``(S,)`` of K-Means with k = 1, ..., n clusters, on S data sets side by side.

    K-Means with k + 1 clusters starts from the centres of k and one point more: of some drawn by their squared distance
    to the nearest centre, the one that lowers W most (greedy K-Means++; the incremental way is that of Likas, Vlassis
    and Verbeek, Pattern Recognit. 36, 2003). ``STARTS`` such chains begin at random points; the best W_k of them
    counts, for data and references alike.

    Args:
        sets: ``(S, n, d)``, whose values are best centred.
        rng: draws the points.
    """
    yield ((sets - sets.mean(axis=1, keepdims=True)) ** 2).sum(axis=(1, 2))
    chains: Singles = np.repeat(sets.astype(np.float32), STARTS, axis=0)  # log W needs no more digits
    length: Singles = (chains**2).sum(axis=2)
    centres: Singles = chains[np.arange(len(chains)), rng.integers(sets.shape[1], size=len(chains))][:, None]
    near, nearest = _nearest(chains, length, centres)
    for k in range(2, sets.shape[1] + 1):
        centres = np.concatenate([centres, _one_more(chains, length, near, rng)], axis=1)
        near, nearest = _nearest(chains, length, centres)
        for _ in range(_MOST_STEPS):
            members = (nearest[:, :, None] == np.arange(k)).astype(np.float32).swapaxes(1, 2)
            size = members.sum(axis=2, keepdims=True)
            centres = np.where(size > 0, members @ chains / np.maximum(size, 1.0), centres)
            before = near.sum(axis=1)
            near, nearest = _nearest(chains, length, centres)
            if (near.sum(axis=1) >= (1.0 - _TOLERANCE) * before).all():
                break
        yield near.sum(axis=1, dtype=np.float64).reshape(-1, STARTS).min(axis=1)


def _nearest(sets: Singles, length: Singles, centres: Singles) -> tuple[Singles, NDArray[np.intp]]:
    """Squared distance to the nearest centre, and which it is, each ``(S, n)``."""
    squared = (centres**2).sum(axis=2)[:, None] - 2.0 * sets @ centres.swapaxes(1, 2)
    nearest = squared.argmin(axis=2)
    least = np.take_along_axis(squared, nearest[:, :, None], axis=2)[:, :, 0] + length
    return np.maximum(least, 0.0), nearest


def _one_more(sets: Singles, length: Singles, near: Singles, rng: np.random.Generator) -> Singles:
    """The point of each set ``(S, 1, d)`` that lowers the sum of ``near`` most, of ``_TRIALS`` that are drawn."""
    share = np.cumsum(near, axis=1, dtype=np.float64)
    drawn = rng.random((len(sets), _TRIALS)) * share[:, -1:]
    index = np.stack([np.searchsorted(row, at) for row, at in zip(share, drawn, strict=True)])
    trials = np.take_along_axis(sets, np.minimum(index, sets.shape[1] - 1)[:, :, None], axis=1)
    squared = (trials**2).sum(axis=2)[:, None] - 2.0 * sets @ trials.swapaxes(1, 2) + length[:, :, None]
    best = np.minimum(squared, near[:, :, None]).sum(axis=1).argmin(axis=1)
    return np.take_along_axis(trials, best[:, None, None], axis=1)


def regularised(affinity: Floats) -> Floats:
    """The affinity ``(n, n)`` without its diagonal and with ``TIE`` / n everywhere.

    A small tie to all keeps UAVs that resemble nobody from counting as clusters of their own, and the graph connected
    (Amini, Chen, Bickel and Levina, Ann. Stat. 41, 2013).
    """
    tied = affinity + TIE / len(affinity)
    np.fill_diagonal(tied, TIE / len(affinity))
    return tied


def normalised(affinity: Floats) -> Floats:
    """D^-1/2 A D^-1/2 of the :func:`regularised` affinity: the identity less its normalised Laplacian."""
    tied = regularised(affinity)
    root = np.sqrt(tied.sum(axis=1))
    return np.asarray(tied / root / root[:, None])


def eigenvalues(matrix: Floats, most: int, rng: np.random.Generator) -> Floats:
    """The ``most`` highest eigenvalues, descending, of a symmetric matrix; ``rng`` starts the search."""
    if len(matrix) <= _DENSE or most >= len(matrix) - 1:
        return np.asarray(np.linalg.eigvalsh(matrix)[::-1][:most], np.float64)
    found = eigsh(matrix, most, which="LA", v0=rng.standard_normal(len(matrix)), return_eigenvectors=False, tol=1e-4)
    return np.sort(np.asarray(found, np.float64))[::-1]


def eigengap(affinity: Floats, rng: np.random.Generator, most: int | None = None) -> int:
    """M̂ by the largest gap between neighbouring eigenvalues (von Luxburg, Stat. Comput. 17, 2007).

    Args:
        affinity: ``(n, n)`` symmetric, from 0 to 1.
        rng: starts the search for eigenvalues of large matrices.
        most: K_max; ``None``: :func:`most_clusters`.

    Returns:
        The k of 1 to K_max with the largest gap between the k-th eigenvalue of the :func:`normalised` affinity and the
        next (negative ones taken as 0); the smallest such k. 1 where all UAVs are equally akin, or nobody to anybody.
    """
    most = min(most_clusters(len(affinity)) if most is None else most, len(affinity))
    matrix = normalised(affinity)
    known = min(_FIRST_EIGENVALUES, most + 1)
    while True:
        values = np.maximum(eigenvalues(matrix, known, rng), 0.0)
        if len(values) <= most:
            values = np.append(values, 0.0 if known >= len(matrix) else values[-1])
        gaps = (values[:-1] - values[1:])[:most]
        # No later gap can be larger than the last eigenvalue.
        if known > most or gaps.max() > values[-1]:
            return int(gaps.argmax()) + 1
        known = min(2 * known, most + 1)

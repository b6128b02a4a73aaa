"""The eigengap: the number of clusters from the affinity (von Luxburg, Stat. Comput. 17, 2007)."""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import eigsh

from detectors.clustering.affinity import normalise_affinity
from detectors.clustering.gap_statistic import compute_max_count
from usnet_env.arrays import Floats

_FIRST_EIGENVALUES = 16  # computed at first; more are computed only if the largest gap may be among later ones
_DENSE = 200  # up to this size all eigenvalues take less time than a few of them by Lanczos iterations


def estimate_count_by_eigengap(affinity: Floats, rng: np.random.Generator, max_count: int | None = None) -> int:
    """Estimate the number of clusters by the largest gap between neighbouring eigenvalues.

    Let λ_1 ≥ λ_2 ≥ ... be the eigenvalues of the affinity after
    :func:`detectors.clustering.affinity.normalise_affinity`, with negative ones replaced by 0. Then M̂ is the k of 1 to
    K_max with the largest λ_k - λ_{k+1}; the smallest such k if there are several. These are the gaps between the
    lowest eigenvalues 1 - λ_k of the normalised graph Laplacian.

    Args:
        affinity: ``(n, n)`` symmetric, from 0 to 1.
        rng: generator of the start vector of the Lanczos iterations (large matrices only).
        max_count: K_max; ``None``: :func:`detectors.clustering.gap_statistic.compute_max_count`.

    Returns:
        M̂. It is 1 if all affinities between different UAVs are equal.
    """
    max_count = min(compute_max_count(len(affinity)) if max_count is None else max_count, len(affinity))
    matrix = normalise_affinity(affinity)
    known = min(_FIRST_EIGENVALUES, max_count + 1)
    while True:
        values = np.maximum(compute_largest_eigenvalues(matrix, known, rng), 0.0)
        if len(values) <= max_count:
            values = np.append(values, 0.0 if known >= len(matrix) else values[-1])
        gaps = (values[:-1] - values[1:])[:max_count]
        # No later gap can be larger than the last eigenvalue.
        if known > max_count or gaps.max() > values[-1]:
            return int(gaps.argmax()) + 1
        known = min(2 * known, max_count + 1)


def compute_largest_eigenvalues(matrix: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Return the ``count`` largest eigenvalues, at most n, of a symmetric matrix ``(n, n)`` in descending order."""
    if len(matrix) <= _DENSE or count >= len(matrix) - 1:
        return np.asarray(np.linalg.eigvalsh(matrix)[::-1][:count], np.float64)
    found = eigsh(matrix, count, which="LA", v0=rng.standard_normal(len(matrix)), return_eigenvectors=False, tol=1e-4)
    return np.sort(np.asarray(found, np.float64))[::-1]

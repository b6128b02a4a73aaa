r"""The gap statistic of Tibshirani, Walther and Hastie: the number of clusters from the features.

R. Tibshirani, G. Walther and T. Hastie, "Estimating the number of clusters in a data set via the gap statistic",
J. R. Stat. Soc. B 63(2), pp. 411-423, 2001. In their notation, for n rows x_i that K-Means puts into the clusters
C_1, ..., C_k of n_1, ..., n_k rows:

    W_k     = Σ_r D_r / (2 n_r),  D_r = Σ_{i, i' ∈ C_r} |x_i - x_i'|²
            = Σ_r Σ_{i ∈ C_r} |x_i - mean of C_r|²,  the within-cluster dispersion
    Gap(k)  = (1/B) Σ_b log W*_kb - log W_k,  where W*_kb is W_k of the b-th of B reference sets
    sd_k    = sqrt((1/B) Σ_b (log W*_kb - (1/B) Σ_b log W*_kb)²)
    s_k     = sd_k sqrt(1 + 1/B)
    M̂       = the smallest k with Gap(k) ≥ Gap(k + 1) - s_{k+1},  the one-standard-error rule

A reference set has n rows that are uniform in the box around the data along its principal axes (their choice b).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.clustering.k_means import compute_dispersions
from usnet_env.arrays import Floats

REFERENCES = 15  # B
# Margin, in s, by which a later gap must be higher. Measured: at least 40 on blobs, at most 8 on uniform clouds.
MARGIN = 10.0
_LEAST_DISPERSION = 1e-6  # W_k counts as at least this share of W_1: the logarithm of rounding errors means nothing


def compute_max_count(uavs: int) -> int:
    """Return K_max for n UAVs: 1.5 sqrt(n) rounded up, but at most n / 2 and at least 1."""
    return max(1, min(uavs // 2, int(np.ceil(1.5 * np.sqrt(uavs)))))


@dataclass(frozen=True, eq=False)
class GapStatistic:
    """The estimated number of clusters and the values that it was chosen by.

    Args:
        count: M̂.
        gap: ``(K,)``, Gap(k) for k = 1, ..., K. K is the last k that the rule had to look at.
        deviation: ``(K,)``, s_k.
    """

    count: int
    gap: Floats
    deviation: Floats


def compute_gap_statistic(
    features: Floats,
    rng: np.random.Generator,
    max_count: int | None = None,
    references: int = REFERENCES,
    margin: float = MARGIN,
) -> GapStatistic:
    """Estimate the number of clusters by the gap statistic.

    The formulas are in the docstring of this module. The one-standard-error rule stops too early on data with many
    clusters, where the first splits reduce W_k no more than they do on a uniform cloud. So there is one addition: a k
    that satisfies the rule is skipped if Gap(j) - ``margin`` s_j > Gap(k) for a j from k + 2 to 2k + 8.
    ``margin=math.inf`` is the rule of the paper by Tibshirani et al., without the addition.

    Args:
        features: ``(n, d)``, n of at least 1.
        rng: generator of the reference sets and of the starts of K-Means.
        max_count: K_max, the largest M̂; ``None``: :func:`compute_max_count`. It is
            lowered to the number of distinct rows.
        references: B, the number of reference sets.
        margin: how much higher a later gap must be, in units of its s.

    Returns:
        M̂, Gap(k) and s_k. M̂ is K_max if no k satisfies the rule, and 1 if all rows are equal.
    """
    distinct = len(np.unique(features, axis=0))
    max_count = min(compute_max_count(len(features)) if max_count is None else max_count, distinct)
    data = _rotate_to_principal_axes(features)
    sets = np.concatenate([data[None], _draw_references(data, references, rng)])
    total = float((data**2).sum())
    gaps: list[float] = []
    deviations: list[float] = []
    chosen: int | None = None
    for k, dispersion in enumerate(compute_dispersions(sets, rng), start=1):
        if k >= distinct:
            if distinct <= max_count:  # W_k is 0: its logarithm is not finite
                return GapStatistic(k, np.array([*gaps, np.inf]), np.array([*deviations, 0.0]))
            break
        log_w = np.log(np.maximum(dispersion, _LEAST_DISPERSION * total))
        gaps.append(float(log_w[1:].mean() - log_w[0]))
        deviations.append(float(log_w[1:].std() * np.sqrt(1.0 + 1.0 / references)))
        chosen = _choose_count(gaps, deviations, margin)
        if k > max_count or (chosen is not None and k >= _last_compared(chosen, margin)):
            break
    return GapStatistic(min(chosen or max_count, max_count), np.array(gaps), np.array(deviations))


def _last_compared(k: int, margin: float) -> int:
    """Return the number of gaps that must be known before k can be chosen."""
    return k + 1 if np.isinf(margin) else 2 * k + 8


def _choose_count(gaps: list[float], deviations: list[float], margin: float) -> int | None:
    """Return the smallest k that satisfies the rule, or ``None``, by Gap(1), ... and s_1, ... that are known."""
    for k in range(1, len(gaps)):
        later = range(k + 1, min(_last_compared(k, margin), len(gaps)))  # index j is Gap(j + 1)
        if gaps[k - 1] >= gaps[k] - deviations[k] and not any(
            gaps[j] - margin * deviations[j] > gaps[k - 1] for j in later
        ):
            return k
    return None


def _rotate_to_principal_axes(features: Floats) -> Floats:
    """Return the centred rows ``(n, min(n, d))`` in the coordinates of their principal axes."""
    centred = features - features.mean(axis=0)
    if centred.shape[1] > centred.shape[0]:
        values, vectors = np.linalg.eigh(centred @ centred.T)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
    return np.asarray(centred @ np.linalg.eigh(centred.T @ centred)[1])


def _draw_references(data: Floats, references: int, rng: np.random.Generator) -> Floats:
    """Draw B sets ``(B, n, d)`` that are uniform in the box around ``data`` ``(n, d)``."""
    low, high = data.min(axis=0), data.max(axis=0)
    return low + (high - low) * rng.random((references, *data.shape))

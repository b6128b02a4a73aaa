"""The gap statistic as Tibshirani, Walther and Hastie (2001) print it: slow, for tests only."""

from __future__ import annotations

import itertools

import numpy as np


def pooled_within_sum(rows, labels):
    """W_k = Σ_r D_r / (2 n_r), where D_r sums the squared distances over all ordered pairs in cluster r."""
    total = 0.0
    for label in np.unique(labels):
        members = rows[labels == label]
        pairs = sum(((a - b) ** 2).sum() for a in members for b in members)
        total += pairs / (2 * len(members))
    return total


def lowest_within_sum(values, k):
    """The lowest W_k of values on a line: the best of all ways to cut the sorted values into k intervals."""
    ordered = np.sort(values.ravel())
    best = np.inf
    for cuts in itertools.combinations(range(1, len(ordered)), k - 1):
        labels = np.searchsorted(np.array(cuts), np.arange(len(ordered)), side="right")
        best = min(best, pooled_within_sum(ordered[:, None], labels))
    return best


def gap_and_deviation(log_within, log_within_references):
    """Gap(k) and s_k from log W_k and the B values log W*_kb (their steps 2 and 3)."""
    references = len(log_within_references)
    mean = sum(log_within_references) / references
    sd = (sum((value - mean) ** 2 for value in log_within_references) / references) ** 0.5
    return mean - log_within, sd * (1 + 1 / references) ** 0.5


def one_standard_error_count(gap, deviation):
    """The smallest k with Gap(k) >= Gap(k + 1) - s_{k+1} (their step 3); lists start at k = 1."""
    for k in range(1, len(gap)):
        if gap[k - 1] >= gap[k] - deviation[k]:
            return k
    return None


def references_along_principal_axes(rows, references, rng):
    """Their choice (b): X' = X V of the centred X = U D Vᵀ, uniform over the ranges of X', back by Z = Z' Vᵀ."""
    mean = rows.mean(axis=0)
    axes = np.linalg.svd(rows - mean, full_matrices=False)[2]
    turned = (rows - mean) @ axes.T
    uniform = rng.uniform(turned.min(axis=0), turned.max(axis=0), (references, *turned.shape))
    return uniform @ axes + mean


def references_in_the_range(rows, references, rng):
    """Their choice (a), which is not what the detector uses: uniform over the range of each feature."""
    return rng.uniform(rows.min(axis=0), rows.max(axis=0), (references, *rows.shape))

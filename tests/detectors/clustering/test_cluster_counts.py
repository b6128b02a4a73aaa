"""The gap statistic against its paper, and the eigengap on block affinities."""

import itertools

import numpy as np
import pytest

from detectors.clustering.counts import (
    REFERENCES,
    _compute_dispersions,
    compute_gap_statistic,
    compute_max_count,
    estimate_count_by_eigengap,
)


def blobs(rng, clusters, dimensions=2, apart=10.0, each=20):
    """Gaussian blobs of unit width whose random centres are at least ``apart``."""
    while True:
        centres = rng.uniform(-1, 1, (clusters, dimensions)) * apart * clusters ** (1 / dimensions)
        distance = np.linalg.norm(centres[:, None] - centres, axis=2) + 1e9 * np.eye(clusters)
        if distance.min() > apart:
            return np.repeat(centres, each, axis=0) + rng.standard_normal((clusters * each, dimensions))


def lowest_within_sum(values, k):
    """The lowest W_k of values on a line: the best of all ways to cut the sorted values into k intervals."""
    ordered, best = np.sort(values.ravel()), np.inf
    for cuts in itertools.combinations(range(1, len(ordered)), k - 1):
        parts = np.split(ordered, cuts)
        best = min(best, sum(((part[:, None] - part) ** 2).sum() / (2 * len(part)) for part in parts))
    return best


def one_standard_error_count(gap, deviation):
    """The smallest k with Gap(k) >= Gap(k + 1) - s_{k+1}; lists start at k = 1."""
    return next((k for k in range(1, len(gap)) if gap[k - 1] >= gap[k] - deviation[k]), None)


@pytest.mark.parametrize(("clusters", "dimensions"), [(1, 2), (2, 2), (1, 8), (3, 8), (4, 8)])
def test_the_gap_statistic_counts_separated_blobs(clusters, dimensions):
    for seed in range(2):
        rng = np.random.default_rng(seed)
        assert compute_gap_statistic(blobs(rng, clusters, dimensions), rng).count == clusters


@pytest.mark.parametrize("dimensions", [3, 24])
def test_a_uniform_cloud_is_one_cluster(dimensions):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        assert compute_gap_statistic(rng.random((82, dimensions)), rng).count == 1


@pytest.mark.parametrize("seed", range(3))
def test_gap_and_deviation_are_those_of_the_paper(seed):
    """On a line the axis needs no rotation, and the best clusters are intervals: the lowest W_k is known exactly."""
    rng = np.random.default_rng(seed)
    rows = np.concatenate([rng.normal(0, 1, 5), rng.normal(9, 1, 4)])[:, None]
    found = compute_gap_statistic(rows, np.random.default_rng(seed))
    again = np.random.default_rng(seed)  # the references are the first numbers that are drawn
    centred = rows - rows.mean()
    uniform = centred.min() + (centred.max() - centred.min()) * again.random((REFERENCES, *rows.shape))
    sets = np.concatenate([centred[None], uniform])
    for k, within in zip(range(1, len(found.gap) + 1), _compute_dispersions(sets, again), strict=False):
        lowest = np.array([lowest_within_sum(values, k) for values in sets])
        assert (within >= lowest * (1 - 1e-5)).all()
        assert (within <= lowest * (1.5 if k > 1 else 1 + 1e-9)).all()  # K-Means may stop at a local minimum
        logs = np.log(within)
        assert found.gap[k - 1] == pytest.approx(logs[1:].mean() - logs[0])
        assert found.deviation[k - 1] == pytest.approx(logs[1:].std() * (1 + 1 / REFERENCES) ** 0.5)
    assert found.count == (one_standard_error_count(found.gap, found.deviation) or compute_max_count(9))


def test_references_lie_along_the_principal_axes():
    """With references in the box of the features, a stick along the diagonal looks like two clusters or more."""
    along, across = np.linspace(-10, 10, 60), np.random.default_rng(0).uniform(-0.3, 0.3, 60)
    stick = np.stack([along - across, along + across], axis=1) / np.sqrt(2)
    assert compute_gap_statistic(stick, np.random.default_rng(1)).count == 1


def test_gap_of_few_and_of_equal_rows():
    rng = np.random.default_rng(3)
    assert compute_gap_statistic(np.ones((1, 4)), rng).count == 1
    assert compute_gap_statistic(np.ones((9, 4)), rng).count == 1
    assert compute_gap_statistic(np.repeat(rng.random((3, 4)), 5, axis=0), rng).count <= 3
    assert [compute_max_count(n) for n in (1, 2, 6, 82, 500, 2000)] == [1, 1, 3, 14, 34, 68]


@pytest.mark.parametrize("clusters", [1, 2, 5, 10])
def test_the_eigengap_counts_blocks_and_no_isolated_uavs(clusters):
    for seed, alone in ((0, 0), (1, 0), (2, 4)):
        rng = np.random.default_rng(seed)
        owner = np.repeat(np.arange(clusters + alone), [*rng.integers(5, 20, clusters), *[1] * alone])
        noise = rng.uniform(0, 0.02, (len(owner), len(owner)))
        affinity = np.where(owner[:, None] == owner, 0.8, 0.0 if alone else 0.02) + (0.0 if alone else noise + noise.T)
        np.fill_diagonal(affinity, 1.0)
        assert estimate_count_by_eigengap(np.clip(affinity, 0, 1)) == clusters

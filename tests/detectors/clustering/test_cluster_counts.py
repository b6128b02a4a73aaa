"""The gap statistic on blobs and clouds, and the eigengap on block affinities."""

import numpy as np
import pytest

from detectors.clustering.counts import compute_max_count, estimate_count_by_eigengap, estimate_count_by_gap


def blobs(rng, clusters, dimensions=2, apart=10.0, each=20):
    """Gaussian blobs of unit width whose random centres are at least ``apart``."""
    while True:
        centres = rng.uniform(-1, 1, (clusters, dimensions)) * apart * clusters ** (1 / dimensions)
        distance = np.linalg.norm(centres[:, None] - centres, axis=2) + 1e9 * np.eye(clusters)
        if distance.min() > apart:
            return np.repeat(centres, each, axis=0) + rng.standard_normal((clusters * each, dimensions))


@pytest.mark.parametrize(("clusters", "dimensions"), [(1, 2), (2, 2), (1, 8), (3, 8), (4, 8)])
def test_the_gap_statistic_counts_separated_blobs(clusters, dimensions):
    for seed in range(2):
        rng = np.random.default_rng(seed)
        assert estimate_count_by_gap(blobs(rng, clusters, dimensions), rng) == clusters


@pytest.mark.parametrize("dimensions", [3, 24])
def test_a_uniform_cloud_is_one_cluster(dimensions):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        assert estimate_count_by_gap(rng.random((82, dimensions)), rng) == 1


def test_references_lie_along_the_principal_axes():
    """With references in the box of the features, a stick along the diagonal looks like two clusters or more."""
    along, across = np.linspace(-10, 10, 60), np.random.default_rng(0).uniform(-0.3, 0.3, 60)
    stick = np.stack([along - across, along + across], axis=1) / np.sqrt(2)
    assert estimate_count_by_gap(stick, np.random.default_rng(1)) == 1


def test_gap_of_few_and_of_equal_rows():
    rng = np.random.default_rng(3)
    assert estimate_count_by_gap(np.ones((1, 4)), rng) == 1
    assert estimate_count_by_gap(np.ones((9, 4)), rng) == 1
    assert estimate_count_by_gap(np.repeat(rng.random((3, 4)), 5, axis=0), rng) <= 3
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

"""The gap statistic and the eigengap on blobs, uniform clouds and block affinities."""

import numpy as np
import pytest
from gaussian_blobs import blobs

from detectors.clustering import compute_gap_statistic, counts, estimate_count_by_eigengap
from detectors.clustering.affinity import normalise_affinity
from detectors.clustering.counts import compute_dispersions, compute_largest_eigenvalues, compute_max_count

SLOW = pytest.mark.slow


def count_of(features, seed):
    return compute_gap_statistic(features, np.random.default_rng(seed)).count


@pytest.mark.parametrize(
    ("clusters", "dimensions", "seeds", "least"),
    [
        *((clusters, dimensions, range(2), 2) for clusters in (1, 3, 6) for dimensions in (2, 8)),
        *(
            pytest.param(m, dimensions, range(1000, 1100), 95, marks=SLOW)
            for m in range(1, 11)
            for dimensions in (2, 3, 8)
        ),
    ],
)
def test_the_gap_statistic_counts_separated_blobs(clusters, dimensions, seeds, least):
    counts = [count_of(blobs(np.random.default_rng(seed), clusters, dimensions), seed) for seed in seeds]
    assert counts.count(clusters) >= least


@pytest.mark.parametrize(
    ("uavs", "dimensions", "seeds", "least"),
    [
        (82, 3, range(8), 8),
        (82, 24, range(4), 4),
        *(
            pytest.param(uavs, dimensions, range(1000, 1200), 190, marks=SLOW)
            for uavs, dimensions in [(82, 2), (82, 3), (82, 24), (200, 3), (200, 8)]
        ),
    ],
)
def test_a_uniform_cloud_is_one_cluster(uavs, dimensions, seeds, least):
    counts = [count_of(np.random.default_rng(seed).random((uavs, dimensions)), seed + 9) for seed in seeds]
    assert counts.count(1) >= least


def test_a_later_peak_finds_more_blobs_in_the_plane_than_the_rule_alone():
    right = {"margin": 0, "alone": 0}
    for seed in range(8):
        data = blobs(np.random.default_rng(seed), 10)
        right["margin"] += count_of(data, seed) == 10
        right["alone"] += compute_gap_statistic(data, np.random.default_rng(seed), margin=np.inf).count == 10
    assert right["margin"] >= 7
    assert right["margin"] > right["alone"]


def test_the_rule():
    # 1: Gap(2) is more than s_2 higher; 2: Gap(3) is higher, but by less than s_3
    assert counts._choose_count([0.0, 1.0, 1.05], [0.1, 0.1, 0.1], np.inf) == 2
    assert counts._choose_count([0.0, 1.0], [0.1, 0.1], np.inf) is None
    # a later peak that is clearly higher passes 1 over
    assert counts._choose_count([0.0, -0.1, 0.5, 2.0, 1.9], [0.1] * 5, 10.0) == 4
    assert counts._choose_count([0.0, -0.1, 0.5, 0.4], [0.1] * 4, 10.0) == 1
    assert counts._choose_count([0.0, -0.1, 0.5, 2.0, 1.9], [0.1] * 5, np.inf) == 1


def test_the_gap_is_its_definition():
    rng = np.random.default_rng(1)
    data = blobs(rng, 3)
    found = compute_gap_statistic(data, np.random.default_rng(2))
    # one cluster: W_1 in closed form, and the reference's variance is that of a uniform box along the principal axes
    axes = np.linalg.svd(data - data.mean(axis=0), full_matrices=False)[2]
    side = np.ptp((data - data.mean(axis=0)) @ axes.T, axis=0)
    expected = np.log((side**2 / 12).sum() * (len(data) - 1)) - np.log(((data - data.mean(axis=0)) ** 2).sum())
    assert found.gap[0] == pytest.approx(expected, abs=4 * found.deviation[0])
    assert len(found.gap) == len(found.deviation) > found.count == 3


def test_within_agrees_with_k_means():
    from sklearn.cluster import KMeans

    sets = np.stack([blobs(np.random.default_rng(seed), 5, 3) for seed in range(4)])
    sets -= sets.mean(axis=1, keepdims=True)
    ours = compute_dispersions(sets, np.random.default_rng(0))
    for k, within in zip(range(1, 9), ours, strict=False):
        best = [KMeans(k, n_init=20, random_state=0).fit(data).inertia_ for data in sets]
        assert (within <= np.array(best) * (1.10 if k not in (1, 5) else 1.0005)).all()
        assert (within >= np.array(best) * 0.98).all()


def test_gap_of_few_and_of_equal_rows():
    rng = np.random.default_rng(3)
    assert compute_gap_statistic(np.ones((1, 4)), rng).count == 1
    assert compute_gap_statistic(np.ones((9, 4)), rng).count == 1
    assert compute_gap_statistic(rng.random((2, 4)), rng).count == 1
    assert compute_gap_statistic(np.repeat(rng.random((3, 4)), 5, axis=0), rng).count == 3
    assert compute_gap_statistic(blobs(rng, 6), rng, max_count=4).count <= 4


def test_the_largest_count_grows_with_the_swarm():
    assert [compute_max_count(n) for n in (1, 2, 6, 82, 500, 2000)] == [1, 1, 3, 14, 34, 68]


def blocks(sizes, inside=0.8, outside=0.0):
    owner = np.repeat(np.arange(len(sizes)), sizes)
    affinity = np.where(owner[:, None] == owner, inside, outside)
    np.fill_diagonal(affinity, 1.0)
    return affinity


@pytest.mark.parametrize("clusters", range(1, 11))
def test_the_eigengap_counts_blocks(clusters):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        affinity = blocks(rng.integers(4, 20, clusters), outside=0.02)
        noise = rng.uniform(0, 0.02, affinity.shape)
        assert estimate_count_by_eigengap(np.clip(affinity + noise + noise.T, 0, 1), rng) == clusters


def test_isolated_uavs_are_no_clusters():
    affinity = blocks([8, 6, 5, 1, 1, 1, 1])
    assert estimate_count_by_eigengap(affinity, np.random.default_rng(0)) == 3


def test_the_eigengap_of_no_structure_is_one():
    rng = np.random.default_rng(0)
    for n in (2, 3, 20, 300):
        assert estimate_count_by_eigengap(np.eye(n), rng) == 1
        assert estimate_count_by_eigengap(np.ones((n, n)), rng) == 1
        noise = rng.uniform(0, 0.01, (n, n))
        assert estimate_count_by_eigengap(np.clip(np.eye(n) + noise + noise.T, 0, 1), rng) == 1


@pytest.mark.parametrize("clusters", [3, 25])
def test_partial_eigenvalues_agree_with_all_of_them(clusters):
    rng = np.random.default_rng(4)
    affinity = blocks(np.full(clusters, 600 // clusters))
    noise = rng.uniform(0, 0.02, affinity.shape)
    affinity = np.clip(affinity + noise + noise.T, 0, 1)
    matrix = normalise_affinity(affinity)
    np.testing.assert_allclose(matrix, matrix.T)
    whole = np.linalg.eigvalsh(matrix)[::-1]
    np.testing.assert_allclose(compute_largest_eigenvalues(matrix, 30, rng), whole[:30], atol=1e-3)
    assert whole[0] == pytest.approx(1.0)
    assert estimate_count_by_eigengap(affinity, rng) == clusters

"""What holds for every clusterer, the numbers of clusters, features and affinities, each against a slow reference."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone
from synthetic_windows import swarm_window

from detectors.clustering import CLUSTERERS, make_clusterer
from detectors.clustering.clusterers import factorise_affinity
from detectors.clustering.counts import compute_max_count, estimate_count_by_eigengap, estimate_count_by_gap
from detectors.clustering.features import compute_raw_features, compute_scaled_features, correlate_both_ways
from usnet_env import ArgumentError, Window
from usnet_env.objectives import head_in_cluster, purity

NAMES = ["kmeans", "snmf", "spectral"]


def cluster(name, window, seed=0, **arguments):
    return make_clusterer(name, **arguments).cluster(window, np.random.default_rng(seed))


def test_all_are_registered_and_store_their_arguments():
    assert sorted(CLUSTERERS) == NAMES
    for name in NAMES:
        clusterer = clone(make_clusterer(name))
        assert vars(clusterer) == clusterer.get_params()


@pytest.mark.parametrize("name", ["snmf", "spectral"])
def test_clusters_of_linear_followers_are_found_and_counted(name):
    for seed in range(2):
        window, truth = swarm_window(seed, follow="f1", uavs=60, clusters=5, cluster_sizes=(11,) * 5)
        clustering = cluster(name, window)
        assert (clustering.count, purity(truth.root, clustering.labels)) == (5, 1.0)
        assert head_in_cluster(truth.head, truth.root, clustering.labels) == 1.0


@pytest.mark.parametrize("name", ["spectral", "snmf"])
def test_clusters_of_any_followers_are_found(name):
    for follow in ("f4", "f5", "f6", "f7"):
        window, truth = swarm_window(3, follow=follow, uavs=82, clusters=5)
        assert purity(truth.root, cluster(name, window, count=5).labels) >= 0.93


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=8)
@given(
    uavs=st.integers(0, 9),
    count=st.sampled_from([1, 3, 30, "gap", "eigengap"]),
    still=st.booleans(),
    seed=st.integers(0, 99),
)
def test_any_window_gets_labels_from_0(name, uavs, count, still, seed):
    rng = np.random.default_rng(seed)
    velocity = np.zeros((12, 10, 3)) if still else rng.standard_normal((12, 10, 3))
    alive, seen = np.arange(10) < uavs, rng.random((13, 10)) < 0.8
    seen &= alive
    velocity *= (seen[1:] & seen[:-1])[..., None]
    window = Window(np.zeros((13, 10, 3)), velocity, seen, alive)
    clustering = cluster(name, window, seed, count=count)
    assert clustering.count <= uavs
    assert np.array_equal(np.unique(clustering.labels[alive]), np.arange(clustering.count))
    assert (clustering.labels[~alive] == -1).all()


def test_features_and_affinity_may_be_functions():
    window, truth = swarm_window(2, follow="f1", uavs=45, cluster_sizes=(14,) * 3)
    leader, label = truth.root, np.unique(truth.root, return_inverse=True)[1]
    clustering = cluster("spectral", window, count=3, features=lambda _: np.eye(3)[label])
    assert purity(leader, clustering.labels) == 1.0
    assert clustering.features.shape == (45, 3)
    same = leader[:, None] == leader
    clustering = cluster("spectral", window, count=3, affinity=lambda _: same.astype(float))
    assert purity(leader, clustering.labels) == 1.0


@pytest.mark.parametrize(
    ("name", "arguments", "argument"),
    [
        ("kmeans", {"count": "most"}, "count"),
        ("kmeans", {"count": 0}, "count"),
        ("kmeans", {"count": "own"}, "count"),
        ("spectral", {"features": "gru"}, "features"),
        ("spectral", {"affinity": "cosine"}, "affinity"),
        ("spectral", {"affinity": "lag", "features": "raw"}, "affinity"),
    ],
)
def test_a_bad_argument_is_named(name, arguments, argument):
    window, _ = swarm_window(0, clusters=2, uavs=12)
    with pytest.raises(ArgumentError, match=f"^{argument} must be"):
        cluster(name, window, **arguments)


def slow_lag_correlation(series, max_lag, shift=0):
    n, steps, _ = series.shape
    moved = series - series.mean(axis=1, keepdims=True)
    moved = moved / np.sqrt((moved**2).sum(axis=(1, 2), keepdims=True))
    other = np.roll(moved, shift, axis=1)
    result = np.full((n, n), -np.inf)
    for i, j, tau in np.ndindex(n, n, 2 * max_lag + 1):
        lag = tau - max_lag
        total = sum(moved[i, t + lag] @ other[j, t] for t in range(steps) if 0 <= t + lag < steps)
        result[i, j] = max(result[i, j], total)
    return np.maximum(result, result.T)


@pytest.mark.parametrize("max_lag", [0, 3])
def test_lag_correlation_is_the_best_over_lags_in_both_directions(max_lag):
    series = np.random.default_rng(0).standard_normal((4, 12, 3)) + 4.0
    for surrogate, shift in ((False, 0), (True, 6)):
        found = correlate_both_ways(series, max_lag, surrogate=surrogate)
        np.testing.assert_allclose(found, slow_lag_correlation(series, max_lag, shift), atol=1e-12)


def test_features_are_the_last_samples_of_the_window():
    window, _ = swarm_window(0, clusters=2, uavs=9)
    values = compute_raw_features(window, 3).reshape(9, 3, 6)
    np.testing.assert_array_equal(values[..., :3], window.position[-4:-1].swapaxes(0, 1))
    np.testing.assert_array_equal(values[..., 3:], window.velocity[-3:].swapaxes(0, 1))
    standard = compute_scaled_features(window, 3).reshape(-1, 6)
    np.testing.assert_allclose(standard.mean(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(standard.std(axis=0), 1)


@settings(max_examples=20)
@given(st.integers(2, 12), st.integers(1, 5), st.integers(0, 2**31), st.booleans())
def test_the_loss_of_the_factorisation_never_rises_and_is_what_it_says(n, rank, seed, definite):
    rng = np.random.default_rng(seed)
    half = rng.random((n, n)) * (rng.random((n, n)) > 0.3)
    affinity = half @ half.T / n if definite else np.maximum(half, half.T)
    factor, losses = factorise_affinity(affinity, rank, rng, steps=60)
    assert factor.shape == (n, rank)
    assert (factor >= 0).all()
    assert (np.diff(losses) <= 0).all()
    slow = ((affinity - factor @ factor.T) ** 2).sum()
    np.testing.assert_allclose(losses[-1], slow, rtol=1e-6, atol=1e-9 * (1 + (affinity**2).sum()))


def blobs(rng, clusters, dimensions=2, apart=10.0, each=20):
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

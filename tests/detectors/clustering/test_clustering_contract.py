"""What holds for every clusterer: labels, counts, masks, odd swarms, bad arguments, and purity on simulated swarms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone
from swarm_windows import swarm_window, without

from detectors.clustering import (
    Clusterer,
    Clustering,
    KMeans,
    clusterers,
    make_clusterer,
    register_clusterer,
)
from detectors.clustering.registry import CLUSTERERS
from usnet_env import ArgumentError, Window
from usnet_env.objectives import head_in_cluster, purity

NAMES = ["agglomerative", "hdbscan", "kmeans", "lead-votes", "snmf", "spectral"]
COUNTING = [name for name in NAMES if name != "hdbscan"]


def cluster(name, window, seed=0, **arguments):
    return make_clusterer(name, **arguments).cluster(window, np.random.default_rng(seed))


def check(clustering, window):
    living = clustering.labels[window.alive]
    assert clustering.labels.shape == (window.uavs,)
    assert (clustering.labels[~window.alive] == -1).all()
    assert np.array_equal(np.unique(living), np.arange(clustering.count))
    assert not clustering.labels.flags.writeable


def still(uavs, steps=20):
    return Window(
        np.zeros((steps + 1, uavs, 3)), np.zeros((steps, uavs, 3)), np.ones((steps + 1, uavs)), np.ones(uavs, bool)
    )


def test_all_are_registered():
    assert sorted(clusterers()) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_the_constructor_only_stores(name):
    clusterer = clone(make_clusterer(name))
    assert vars(clusterer) == clusterer.get_params()


@pytest.mark.parametrize("name", ["agglomerative", "hdbscan", "snmf", "spectral", "lead-votes"])
def test_clusters_of_linear_followers_are_found_and_counted(name):
    for seed in range(4):
        window, head, leader = swarm_window(seed, follow="f1", uavs=60, cluster_sizes=(11,) * 5)
        clustering = cluster(name, window)
        assert clustering.count == 5
        assert purity(leader, clustering.labels) == 1.0
        assert head_in_cluster(head, leader, clustering.labels) == 1.0


@pytest.mark.parametrize(("name", "least"), [("spectral", 0.93), ("snmf", 0.93), ("lead-votes", 0.99)])
def test_clusters_of_any_followers_are_found(name, least):
    for follow in ("f4", "f5", "f6", "f7"):
        window, _, leader = swarm_window(3, follow=follow)
        assert purity(leader, cluster(name, window, count=5).labels) >= least


def test_votes_put_heads_into_their_clusters_more_often_than_correlation():
    found = {"spectral": [], "lead-votes": []}
    for seed in range(4):
        window, head, leader = swarm_window(seed, follow="f4")
        for name, shares in found.items():
            shares.append(head_in_cluster(head, leader, cluster(name, window, count=5).labels))
    assert np.mean(found["lead-votes"]) == 1.0 >= np.mean(found["spectral"])


def test_raw_metres_hide_the_clusters():
    window, _, leader = swarm_window(1, follow="f1")
    shares = [purity(leader, cluster("kmeans", window, features=f, count=5).labels) for f in ("raw", "scaled")]
    assert shares[0] < 0.5 < shares[1]


@pytest.mark.parametrize("name", NAMES)
def test_the_same_generator_gives_the_same_answer_and_no_global_one_is_used(name):
    window, _, _ = swarm_window(4, follow="f3", uavs=30, clusters=3)
    state = np.random.get_state()[1].copy()  # noqa: NPY002  # the point is that it stays untouched
    one, two = cluster(name, window, 7), cluster(name, window, 7)
    assert np.array_equal(one.labels, two.labels)
    assert np.array_equal(state, np.random.get_state()[1])  # noqa: NPY002


@pytest.mark.parametrize("name", NAMES)
def test_destroyed_uavs_get_no_label_and_do_not_matter(name):
    window, _, leader = swarm_window(5, follow="f2", clusters=3, uavs=45, cluster_sizes=(14,) * 3)
    gone = leader == leader[0]
    clustering = cluster(name, without(window, gone))
    check(clustering, without(window, gone))
    rest = ~gone
    apart = Window(window.position[:, rest], window.velocity[:, rest], window.seen[:, rest], window.alive[rest], 2)
    assert clustering.count == 2
    assert np.array_equal(clustering.labels[rest], cluster(name, apart).labels)


@pytest.mark.parametrize("name", NAMES)
def test_missing_samples_do_little_harm(name):
    for seed in range(3):
        window, _, leader = swarm_window(seed, follow="f1", clusters=3, uavs=45, miss_rate=0.1)
        assert purity(leader, cluster(name, window).labels) >= 0.95


@pytest.mark.parametrize("name", NAMES)
def test_a_uav_that_was_never_seen_has_a_label(name):
    window, _, _ = swarm_window(6, clusters=2, uavs=20)
    seen = window.seen.copy()
    seen[:, 3] = False
    hidden = Window(
        np.where(seen[..., None], window.position, 0),
        np.where((seen[1:] & seen[:-1])[..., None], window.velocity, 0),
        seen,
        window.alive,
    )
    clustering = cluster(name, hidden)
    check(clustering, hidden)
    assert clustering.labels[3] >= 0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("features", ["raw", "scaled", "velocities"])
def test_odd_swarms_are_answered(name, features):
    window, _, _ = swarm_window(7, clusters=1, uavs=6)
    counts = ["own"] if name == "hdbscan" else [1, 2, 50, "gap", "gap-one-se", "eigengap"]
    for alive in (0, 1, 2, 3, 6):
        part = without(window, np.arange(6) >= alive)
        for count in counts:
            clustering = cluster(name, part, count=count, features=features)
            check(clustering, part)
            assert clustering.count >= min(alive, 1)
            if isinstance(count, int):
                assert clustering.count <= count


@pytest.mark.parametrize("name", COUNTING)
def test_a_count_is_kept(name):
    window, _, _ = swarm_window(8, clusters=3, uavs=30)
    for count in (1, 2, 3, 6, 30):
        clustering = cluster(name, window, count=count)
        assert clustering.extras["estimate"] == count
        if name != "snmf":  # a column of H may hold no row's largest entry
            assert clustering.count == count


@pytest.mark.parametrize("name", NAMES)
def test_identical_uavs_do_not_fail(name):
    for uavs in (2, 3, 12):
        for count in ["own"] if name == "hdbscan" else [1, 2, "gap", "eigengap"]:
            check(cluster(name, still(uavs), count=count), still(uavs))
    if name != "lead-votes":
        counts = {} if name == "hdbscan" else {"count": "gap"}
        assert cluster(name, still(12), **counts).count == 1


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(NAMES),
    st.integers(1, 14),
    st.integers(1, 12),
    st.integers(0, 2**31),
    st.sampled_from(["raw", "scaled", "velocities"]),
    st.sampled_from([None, "rbf", "cosine"]),
    st.sampled_from([1, 3, "gap", "eigengap"]),
)
def test_any_window_is_answered(name, uavs, steps, seed, features, affinity, count):
    rng = np.random.default_rng(seed)
    alive = rng.random(uavs) > 0.2
    seen = (rng.random((steps + 1, uavs)) > 0.2) & alive
    velocity = rng.standard_normal((steps, uavs, 3)) * (seen[1:] & seen[:-1])[..., None]
    window = Window(rng.standard_normal((steps + 1, uavs, 3)) * 100 * seen[..., None], velocity, seen, alive)
    count = "own" if name == "hdbscan" else count
    clustering = cluster(name, window, seed, count=count, features=features, affinity=affinity)
    check(clustering, window)
    for explained in (clustering.features, clustering.affinity):
        assert explained is None or not explained[~alive].any()


@pytest.mark.parametrize("name", COUNTING)
@pytest.mark.parametrize("count", [2, "gap", "eigengap"])
def test_features_from_a_callable(name, count):
    window, _, _ = swarm_window(9, clusters=2, uavs=24)
    side = np.arange(24) % 2
    apart = side[:, None] * np.array([30.0, 5.0]) + np.random.default_rng(0).standard_normal((24, 2))
    clustering = cluster(name, window, features=lambda _: apart, count=count)
    assert np.array_equal(clustering.features, apart)
    assert clustering.extras["estimate"] == 2
    if name != "lead-votes":  # which looks at velocities
        assert purity(side, clustering.labels) == 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"count": 0}, "count must be greater than or equal to 1, got 0"),
        ({"count": 2.5}, "count must be"),
        ({"count": True}, "count must be"),
        ({"count": "eigengaps"}, r"count must be one of .*did you mean 'eigengap'"),
        ({"count": "own"}, "count must be one of"),
        ({"features": "velocity"}, r"features must be one of .*did you mean 'velocities'"),
        ({"features": 3}, "features must be"),
        ({"affinity": "lags"}, r"affinity must be one of .*did you mean 'lag'"),
        ({"affinity": "lag", "features": "raw"}, "affinity must be 'rbf'"),
        ({"max_lag": -1}, "max_lag must be"),
        ({"memory": 0}, "memory must be"),
        ({"features": lambda window: np.zeros((3, 2))}, "features must have shape"),
        ({"features": lambda window: np.zeros(20)}, "features must return an array"),
        ({"features": lambda window: np.full((20, 2), np.nan)}, "features must be finite"),
        ({"affinity": lambda features: np.zeros((2, 2))}, "affinity must have shape"),
        ({"affinity": lambda features: np.full((20, 20), 2.0)}, "affinity must return a symmetric"),
    ],
)
def test_a_bad_argument_is_refused_in_one_sentence(arguments, message):
    window, _, _ = swarm_window(10, clusters=2, uavs=20)
    with pytest.raises(ArgumentError, match=message) as refusal:
        cluster("spectral", window, **arguments)
    assert str(refusal.value).count("\n") == 0
    assert str(refusal.value).endswith((".", "?)."))


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("hdbscan", {"count": 3}, "count must be 'own'"),
        ("hdbscan", {"least": 1}, "least must be"),
        ("agglomerative", {"linkage": "ward"}, "linkage must be one of"),
        ("snmf", {"starts": 0}, "starts must be"),
        ("lead-votes", {"lags": 0}, "lags must be"),
    ],
)
def test_arguments_of_single_clusterers_are_checked(name, arguments, message):
    window, _, _ = swarm_window(10, clusters=2, uavs=20)
    with pytest.raises(ArgumentError, match=message):
        cluster(name, window, **arguments)


def test_names():
    with pytest.raises(ArgumentError, match="did you mean 'spectral'"):
        make_clusterer("spectrall")
    with pytest.raises(ArgumentError, match="has no argument 'clusters'; it takes count"):
        make_clusterer("spectral", clusters=5)
    with pytest.raises(ArgumentError, match="name must be a new one, got 'kmeans', which is a name of this package"):
        register_clusterer("kmeans", lambda: None)
    with pytest.raises(ArgumentError, match="factory must be"):
        register_clusterer("mine", 5)
    register_clusterer("kmeans", KMeans)  # the same once more


def test_a_custom_clusterer():
    class Halves(Clusterer):
        def partition(self, living, count, rng):
            return living.window.position[0, living.index, 0] > np.median(living.window.position[0, living.index, 0])

    window, _, _ = swarm_window(11, clusters=2, uavs=20)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CLUSTERERS, "_registered", {})
        register_clusterer("halves", Halves)
        clustering = cluster("halves", window, count=2)
    assert clustering.count == 2
    assert np.bincount(clustering.labels).tolist() == [10, 10]


def test_a_clustering_refuses_labels_that_skip_a_number():
    with pytest.raises(ArgumentError, match="labels must use every number from 0 to count - 1 = 1"):
        Clustering(np.array([0, 2]), 2)
    assert Clustering(np.array([-1, -1]), 0).count == 0

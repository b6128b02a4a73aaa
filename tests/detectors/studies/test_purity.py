"""The figure of purity: every clusterer meets the same windows, with M given and estimated."""

from dataclasses import asdict, replace

import pytest

from detectors.clustering import clusterers
from detectors.studies import purity
from detectors.studies.purity import CLUSTERERS, FEATURES, Cell, Method, Row, cluster_windows, list_methods, reproduce
from usnet_env import ArgumentError
from usnet_env.evaluation.suite import read_rows

PLAIN = FEATURES[:3]


def row(method, follow="f1", episode=0, **more):
    values = {"found": 5, "purity": 0.5, "head_in_cluster": 0.25, "seconds": 0.1} | more
    return Row(**vars(method), follow=follow, episode=episode, **values)


def cluster(method, episodes, **swarm):
    return cluster_windows([(Cell(**vars(method), **swarm), episode) for episode in range(episodes)], 7)


def test_every_clusterer_takes_part():
    assert set(CLUSTERERS) == set(clusterers())
    methods = list_methods(features=PLAIN)
    assert len(methods) == len(set(methods)) == (4 * 3 + 1) * 2 + 3 + 3
    assert Method("hdbscan", "raw", "given") not in methods
    assert {method.features for method in methods if method.clusterer == "lead-votes"} == {"velocities"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"clusterers": ["k-means"]}, "clusterer"),
        ({"features": ["rawest"]}, "features"),
        ({"counts": ["own"]}, "count"),
    ],
)
def test_unknown_names_are_refused(arguments, said):
    with pytest.raises(ArgumentError, match=said):
        list_methods(**arguments)


def test_features_of_a_network_that_is_not_there_are_refused(monkeypatch):
    monkeypatch.setattr(purity, "_has_gru", lambda: False)
    assert {method.features for method in list_methods()} == set(PLAIN)
    with pytest.raises(ArgumentError, match="without PyTorch, got 'gru-mean'"):
        list_methods(features=["gru-mean"])


@pytest.mark.skipif(not purity._has_gru(), reason="needs PyTorch")
def test_features_of_the_network_are_clustered_as_others_are():
    for features in FEATURES[3:]:
        (made,) = cluster(Method("kmeans", features, "given"), 1, clusters=3, uavs=30)
        assert made.found == 3
        assert 1 / 3 < made.purity <= 1.0


@pytest.mark.parametrize("method", list_methods(features=PLAIN), ids=lambda method: "-".join(asdict(method).values()))
def test_every_method_clusters_a_small_swarm(method):
    for made in cluster(method, 2, clusters=3, uavs=30):
        assert made.method == method
        assert (made.follow, made.clusters, made.uavs) == ("f1", 3, 30)
        assert 0 < made.purity <= 1
        assert 0 <= made.head_in_cluster <= 1
        if method.count == "given":
            assert made.found <= 3


def test_known_cases_differ():
    """Lagged votes place all UAVs; a correlation without lags places more UAVs than metres alone do."""
    rows = {
        name: cluster(Method(*name.split("/")), 3)
        for name in ("lead-votes/velocities/given", "kmeans/raw/given", "kmeans/velocities/given")
    }
    lead, metres, unlagged = rows.values()
    assert all(made.purity == made.head_in_cluster == 1.0 for made in lead)
    assert min(made.purity for made in unlagged) > max(0.85, *(made.purity for made in metres))


def test_a_measurement_goes_on_and_makes_tables_and_a_picture(tmp_path, monkeypatch):
    methods = list_methods(["kmeans", "lead-votes"], ["scaled"])
    small = {"methods": methods, "clusters": 2, "uavs": 14, "seed": 5}
    reproduce(tmp_path, follow=["f1"], episodes=5, **small)
    path, played, seen = tmp_path / "purity-M2N14-seed5.csv", [], []
    monkeypatch.setattr(
        purity, "cluster_windows", lambda games, seed: played.extend(games) or cluster_windows(games, seed)
    )
    rows = reproduce(
        tmp_path, follow=["f1", "f4"], episodes=5, progress=lambda *count: seen.append(count), **small
    ).rows
    assert {cell.follow for cell, _ in played} == {"f4"}
    assert seen[0] == (25, 50)
    assert seen[-1] == (50, 50)
    assert len(rows) == len(read_rows(path, Row)) == 50
    table = path.with_suffix(".md").read_text(encoding="utf-8")
    for name, own in {"kmeans": ("given", "gap-one-se", "gap"), "lead-votes": ("given", "own")}.items():
        features = "scaled" if name == "kmeans" else "velocities"
        assert all(table.count(f"| {name} | {count} | {features} | 10 |") == 2 for count in own)
    assert path.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_rows_are_the_same_on_two_processes(tmp_path):
    arguments = {"follow": ["f1"], "methods": list_methods(["kmeans"], ["raw"]), "episodes": 12}
    one, two = (reproduce(tmp_path / str(workers), workers=workers, **arguments).rows for workers in (1, 2))
    assert [replace(made, seconds=0) for made in one] == [replace(made, seconds=0) for made in two]
    assert len({made.purity for made in one}) > 5


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"follow": ["f9"]}, "f9"),
        ({"mobility": "iids"}, "mobility"),
        ({"episodes": 0}, "episodes"),
        ({"methods": []}, "methods"),
        ({"clusters": 40}, "uavs|clusters"),
    ],
)
def test_bad_arguments_leave_nothing_behind(tmp_path, arguments, said):
    with pytest.raises(ArgumentError, match=said):
        reproduce(tmp_path, **{"episodes": 1} | arguments)
    assert not list(tmp_path.iterdir())


def test_tables_hold_means_and_leave_out_missing_rows():
    good, part = Method("spectral", "raw", "given"), Method("kmeans", "raw", "given")
    rows = [row(good, "f1", purity=1.0), row(good, "f2", purity=0.0), row(part, "f2")]
    table = purity.report_methods(rows, "title")
    assert "| spectral | given | raw | 2 | 0.50 (0.50–0.50) | 1.00 (1.00–1.00) | 0.00 (0.00–0.00) |" in table
    assert "| kmeans | given | raw | 1 | 0.50 (0.50–0.50) |  | 0.50 (0.50–0.50) |" in table
    assert "estimated" not in table.partition("## ")[2]
    assert len(purity.draw_methods(rows, "title").axes) == 2

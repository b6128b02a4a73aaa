"""The example that tracks a simulated swarm with Stone Soup; skipped without this package."""

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stonesoup")


@pytest.fixture(scope="module")
def example():
    path = Path(__file__).parents[2] / "examples" / "stone_soup_tracks.py"
    spec = importlib.util.spec_from_file_location("stone_soup_tracks", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_points_become_tracks_with_gaps_near_the_true_places(example):
    rng = np.random.default_rng(0)
    velocity = rng.normal(0, 0.5, (60, 6, 3)) + rng.normal(0, 1, (6, 3))
    places = (rng.uniform(-50, 50, (6, 3)) + np.cumsum(velocity, axis=0)).astype(np.float32)
    scans = example.scan(places, rng)
    assert sum(len(points) for _, points in scans) < 6 * 60 + 200
    made = example.track(scans)
    assert {max(set(uavs), key=uavs.count) for uavs in map(example.true_uavs, made)} >= set(range(6))
    tracks = example.to_tracks(made)
    assert len(tracks.ids) == len(made)
    assert "uneven" in str(tracks.report()) or "gaps" in str(tracks.report())
    for k, one in enumerate(made):
        part = slice(*tracks.offsets[[tracks.ids.index(f"T{k}"), tracks.ids.index(f"T{k}") + 1]])
        when = tracks.time[part].astype(int)
        gap = (tracks.position + tracks.origin)[part][:, None] - places[when + round(first_time(example, made))]
        assert np.median(np.linalg.norm(gap, axis=2).min(axis=1)) < 1.5, example.true_uavs(one)


def first_time(example, made):
    """Seconds of the earliest point of all tracks, from which ``Tracks`` count."""
    return min((one[0].timestamp - example.BEGIN).total_seconds() for one in made)


def test_the_leaders_are_named(example, capsys):
    example.main(seed=0)
    lines = capsys.readouterr().out.splitlines()
    assert re.search(r"20 UAVs gave 2\d tracks", lines[0])
    heads = lines[-1].partition("[")[2].rstrip("]").split(", ")
    for line in lines[-3:-1]:
        assert all(f"(UAV {head})" in line for head in heads), line

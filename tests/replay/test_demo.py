"""The demo: an episode in the terminal and in four files."""

from __future__ import annotations

import sys

import pytest

from usnet_env.replay import EpisodeRecord, demo
from usnet_env.replay.demo import run_demo
from usnet_env.replay.story import describe_round

pytest.importorskip("matplotlib")
SMALL = {"clusters": 2, "uavs": 14, "detector": "one-per-round", "observation_steps": 30}


@pytest.fixture
def quick(monkeypatch):
    """The demo without its pictures, which take long."""
    for name in ("write_recording", "write_picture", "write_page"):
        monkeypatch.setattr(demo, name, lambda record, path: path)


def test_the_demo_plays_prints_and_keeps_an_episode(tmp_path, quick, capsys):
    files = run_demo(tmp_path / "demo", seed=4, **SMALL)
    text = capsys.readouterr().out
    assert {name: path.name for name, path in files.items()} == {
        "episode": "episode.npz",
        "replay": "replay.rrd",
        "picture": "episode.png",
        "page": "report.html",
    }
    record = EpisodeRecord.load(files["episode"])
    assert (record.uavs, record.head.sum(), record.seed) == (14, 2, 4)
    assert f"round 1: {describe_round(record, 1)}; " in text
    assert f"J = {record.objective[-1]:.3f}" in text
    assert f"rerun {files['replay']}" in text


def test_the_game_of_the_demo_has_an_error_and_a_recovery(tmp_path, quick):
    """Without arguments: three to five rounds, a redundant candidate or a missed head, and all heads in the end."""
    record = EpisodeRecord.load(run_demo(tmp_path)["episode"])
    assert 3 <= record.rounds <= 5
    assert record.redundant.sum() > 0
    assert record.heads_left[0] > 0 == record.heads_left[-1]
    assert record.config["mobility"] == "gauss_markov"
    assert record.detector_seed != record.seed


def test_without_an_extra_the_rest_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    files = run_demo(tmp_path, **SMALL)
    assert set(files) == {"episode"}
    assert {path.name for path in tmp_path.iterdir()} == {"episode.npz"}
    text = capsys.readouterr().out
    assert "pip install 'usnet[replay]'" in text
    assert "pip install 'usnet[render]'" in text

"""The demo: an episode in the terminal and in three files."""

from __future__ import annotations

import io
import sys

import pytest
from rich.console import Console

from usnet_env import ArgumentError
from usnet_env.replay import EpisodeRecord, demo
from usnet_env.replay.demo import run_demo

pytest.importorskip("matplotlib")


def run(folder, **arguments):
    text = io.StringIO()
    small = {"clusters": 2, "uavs": 14, "detector": "one-per-round", "observation_steps": 30}
    files = run_demo(folder, console=Console(file=text, width=200), **small | arguments)
    return files, text.getvalue()


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    pytest.importorskip("rerun")
    return run(tmp_path_factory.mktemp("played") / "demo", seed=4)


def test_the_demo_plays_prints_and_keeps_an_episode(played):
    files, text = played
    assert {name: path.name for name, path in files.items()} == {
        "episode": "episode.npz",
        "replay": "replay.rrd",
        "picture": "episode.png",
        "page": "report.html",
    }
    assert all(path.stat().st_size > 1000 for path in files.values())
    record = EpisodeRecord.load(files["episode"])
    assert (record.uavs, record.head.sum(), record.seed) == (14, 2, 4)
    lines = text.splitlines()
    first = next(i for i, line in enumerate(lines) if line.split()[:2] == ["round", "candidates"]) + 1
    rows = [[float(word) for word in line.split()] for line in lines[first : first + record.rounds]]
    for r, (number, candidates, hits, redundant, left, seconds) in enumerate(rows):
        assert (number, candidates, hits) == (r + 1, record.candidates[r].sum(), record.hits[r])
        assert (redundant, left) == (record.redundant[r], record.heads_left[r])
        assert seconds == pytest.approx(record.seconds[r], abs=0.006)
    assert f"J = {record.objective[-1]:.3f}" in text
    assert f"rerun {files['replay']}" in text
    assert str(files["picture"]) in text


@pytest.mark.slow
def test_the_same_seed_plays_the_same_episode(played, tmp_path):
    one, two = (EpisodeRecord.load(files["episode"]) for files, _ in (played, run(tmp_path, seed=4)))
    assert one.position.tobytes() == two.position.tobytes()
    assert one.candidates.tolist() == two.candidates.tolist()
    assert one.detector_seed == two.detector_seed != one.seed


def test_without_rerun_the_rest_is_written(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    files, text = run(tmp_path)
    assert set(files) == {"episode", "picture", "page"}
    assert {path.name for path in tmp_path.iterdir()} == {"episode.npz", "episode.png", "report.html"}
    assert "pip install 'usnet[replay]'" in text


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"detector": "nothing-of-that-name"}, "detector"),
        ({"clusters": 0}, "clusters"),
        ({"follow": "f0"}, "follow"),
        ({"seed": -1}, "seed"),
    ],
)
def test_refuses_in_one_sentence_and_writes_nothing(tmp_path, arguments, name):
    with pytest.raises(ArgumentError, match=rf"^{name} must"):
        run(tmp_path / "demo", **arguments)
    assert not (tmp_path / "demo").exists()


def test_a_folder_that_cannot_be_written_is_refused_before_the_game(tmp_path, monkeypatch):
    monkeypatch.setattr(demo, "record_episode", None)  # a game would be an error
    (tmp_path / "file").write_text("mine")
    for place in (tmp_path / "file", tmp_path / "file" / "demo"):
        with pytest.raises(ArgumentError, match=r"^out must be a folder that can be written, got '.*: [\w ]+\.$"):
            run(place)
    assert (tmp_path / "file").read_text() == "mine"


def test_the_game_of_the_demo_has_an_error_and_a_recovery(tmp_path, monkeypatch):
    """Without arguments: three to five rounds, a redundant candidate or a missed head, and all heads in the end."""
    for name in ("write_recording", "write_picture", "write_episode_page"):
        monkeypatch.setattr(demo, name, lambda record, path: path)
    files = run_demo(tmp_path, console=Console(file=io.StringIO()))
    record = EpisodeRecord.load(files["episode"])
    assert 3 <= record.rounds <= 5
    assert record.redundant.sum() > 0
    assert record.heads_left[0] > 0 == record.heads_left[-1]
    assert record.config["mobility"] == "gauss_markov"

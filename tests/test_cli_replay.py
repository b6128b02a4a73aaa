"""``usnet demo`` and ``usnet replay``: from episode files to lists, replays and pages."""

import subprocess

import gymnasium as gym
import pytest

import usnet_env.envs  # noqa: F401  # registers the environments
from usnet_env import make_detector
from usnet_env.replay import EpisodeRecord, record_episode


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The folder of a run with two episodes of each of two detectors."""
    folder = tmp_path_factory.mktemp("recorded") / "run"
    env = gym.make("USNET/MultiCluster-v0", clusters=2, uavs=12, observation_steps=20, max_rounds=3)
    record_episode(gym.make(env.spec, max_rounds=1), make_detector("none"), 0, 1).save(folder.with_name("short.npz"))
    for name in ("one-per-round", "random(count=2)"):
        for number in (0, 12):
            record = record_episode(env, make_detector(name), number, 1)
            record.save(folder / "episodes" / f"{name.replace('(', '_').rstrip(')')}-{number}.npz")
    return folder


def test_the_episodes_of_a_run_are_listed(run, recorded):
    status, out, _ = run("replay", recorded)
    assert status == 0
    assert all(name in out for name in ("one-per-round-12.npz", "random(count=2)", "heads left"))
    names = [line.split()[0].rpartition("-")[2] for line in out.splitlines() if ".npz" in line]
    assert names == ["0.npz", "0.npz", "12.npz", "12.npz"]


def test_one_episode_is_told_and_opened(run, recorded, tmp_path, monkeypatch):
    pytest.importorskip("rerun")
    opened = []
    monkeypatch.setattr(subprocess, "Popen", lambda words, **_: opened.append(words))
    path = recorded / "episodes" / "one-per-round-0.npz"
    status, out, err = run("replay", path, "--open", "--rrd", tmp_path / "e.rrd")
    assert (status, err) == (0, "")
    assert "one-per-round on USNET/MultiCluster-v0, seed 0" in out
    assert "  1: 1 candidate" in out
    assert [words[1:] for words in opened] == [[str(tmp_path / "e.rrd")]]
    assert (tmp_path / "e.rrd").stat().st_size > 1000


def test_other_files_are_written_in_place_of_the_replay(run, recorded, tmp_path):
    pytest.importorskip("matplotlib")
    files = ["--animation", tmp_path / "game.gif", "--page", tmp_path / "game.html", "--figure", tmp_path / "game.pdf"]
    path = tmp_path / "e.npz"
    EpisodeRecord.load(recorded.with_name("short.npz")).save(path)
    status, out, err = run("replay", path, *files)
    assert (status, err) == (0, "")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["e.npz", "game.gif", "game.html", "game.pdf"]
    assert [line.split()[0] for line in out.splitlines()[-3:]] == ["animation", "page", "figure"]
    assert (tmp_path / "game.gif").read_bytes().startswith(b"GIF89a")


def test_labels_cannot_change_the_terminal(run, recorded, tmp_path):
    """Markup of rich and escapes in the label of a file are printed as they are, or left out."""
    pytest.importorskip("rerun")
    record = EpisodeRecord.load(recorded / "episodes" / "one-per-round-0.npz")
    for number in (0, 1):
        values = {name: getattr(record, name) for name in vars(record)}
        EpisodeRecord(**values | {"detector": "[/red]\x1b[31m\x07x"}).save(tmp_path / f"e-{number}.npz")
    for words in (["replay", tmp_path], ["replay", tmp_path / "e-0.npz", "--rrd", tmp_path / "e.rrd"]):
        status, out, err = run(*words)
        assert (status, err) == (0, "")
        assert "[/red][31mx" in out
        assert not {"\x1b", "\x07"} & set(out)


def test_refusals_are_one_sentence_and_leave_nothing(refused, recorded, tmp_path):
    assert "got '" in refused("replay", tmp_path)
    assert "number 1" in refused("replay", recorded, "--episode", "1")
    assert "--episode" in refused("replay", recorded, "--episode", "x")
    assert "unexpected extra argument" in refused("replay", recorded, recorded)
    assert "PATH" in refused("replay")
    (tmp_path / "broken.npz").write_bytes(b"PK")
    assert "intact episode file" in refused("replay", tmp_path / "broken.npz")
    assert "clusters must" in refused("demo", "--clusters", "0", "--out", tmp_path / "demo")
    assert [path.name for path in tmp_path.iterdir()] == ["broken.npz"]

"""The commands that show episodes: from a run with recorded failures to a replay and a page."""

from __future__ import annotations

import html
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from usnet_env.cli import main
from usnet_env.evaluation import EvaluationResult
from usnet_env.replay import EpisodeRecord

COUNTS = """
import numpy as np
from usnet_env import Detection

CALLS = []


class Counts:
    def reset(self, seed=None):
        pass

    def detect(self, window):
        CALLS.append(window)
        candidates = np.arange(window.uavs) < len(CALLS) // 2  # another number in each round that is ever played
        return Detection(candidates & window.alive, candidates)
"""
ALL_OR_NONE = """
from usnet_env import Detection


class AllOrNone:
    def reset(self, seed=None):
        self.all = seed % 2 == 0

    def detect(self, window):
        return Detection(window.alive & self.all, window.alive)
"""
STOPS = """
from pathlib import Path
from usnet_env import Detection


class Stops:
    def __init__(self):
        made = Path(__file__).with_name("made")
        self.again = made.exists()
        made.touch()

    def reset(self, seed=None):
        pass

    def detect(self, window):
        if self.again:
            raise RuntimeError("made twice")
        return Detection(window.alive, window.alive)
"""
CHEATS = [Path(__file__).parent / "evaluation", Path(__file__).parent / "detectors" / "checks"]  # one imports the other
SMALL = ["--set", "clusters=2", "uavs=12", "observation_steps=20", "max_rounds=3"]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A run of two detectors with the episodes 0 and 2 of each."""
    out = tmp_path_factory.mktemp("recorded") / "run"
    detectors = ["--detector", "one-per-round", "--detector", "random(count=2)"]
    words = ["evaluate", *detectors, "--episodes", "3", "--backend", "serial", *SMALL]
    assert main([*words, "--out", str(out), "--record", "every=2"]) == 0
    return out


def test_every_second_episode_is_recorded_as_it_was_played(run, recorded):
    names = sorted(path.name for path in (recorded / "episodes").iterdir())
    assert names == [f"{detector}-{k}.npz" for detector in ("one-per-round", "random_count=2") for k in (0, 2)]
    status, out, _ = run("replay", recorded)
    assert status == 0
    assert all(name in out for name in ("one-per-round-2.npz", "random(count=2)", "heads left"))
    (row,) = [
        line for line in (recorded / "episodes.csv").read_text().splitlines() if line.startswith("one-per-round,2,")
    ]
    record = EpisodeRecord.load(recorded / "episodes" / "one-per-round-2.npz")
    assert f",{record.seed}," in row
    assert record.detector == "one-per-round"


def test_failures_are_recorded_and_shown_in_three_commands(run, tmp_path, monkeypatch):
    pytest.importorskip("rerun")
    monkeypatch.chdir(tmp_path)
    play = ["evaluate", "--detector", "random(count=1)", "--episodes", "2", "--backend", "serial", *SMALL]
    status, _, err = run(*play, "--out", "runs/mine", "--record", "worst")
    assert status == 0, err
    assert "2 episode files are in runs/mine/episodes; `usnet replay runs/mine` lists them." in err
    assert run("replay", "runs/mine")[0] == 0
    opened = []
    monkeypatch.setattr(subprocess, "Popen", lambda words, **_: opened.append(words))
    status, out, err = run("replay", "runs/mine", "--episode", "1", "--open")
    assert status == 0, err
    assert "random(count=1) on USNET/MultiCluster-v0" in out
    assert "  1: 1 candidate" in out
    assert [words[1:] for words in opened] == [["runs/mine/episodes/random_count=1-1.rrd"]]


@pytest.mark.skipif(sys.platform == "win32", reason="needs Linux or macOS")
def test_an_isolated_detector_is_recorded_in_its_own_process(run, tmp_path, monkeypatch):
    for folder in CHEATS:
        monkeypatch.syspath_prepend(folder)
    sys.modules.pop("guessing_cheats", None)
    words = ["--detector", "guessing_cheats:PeeksIntoFrames", "--isolate", "--episodes", "1", *SMALL]
    status, _, err = run("evaluate", *words, "--out", tmp_path, "--record", "every=1")
    assert status == 0, err
    assert "differently" not in err
    assert "guessing_cheats" not in sys.modules
    (row,) = EvaluationResult.load(tmp_path).rows
    (path,) = (tmp_path / "episodes").iterdir()
    record = EpisodeRecord.load(path)
    assert (record.seed, record.rounds, record.objective[-1]) == (row["swarm_seed"], row["rounds"], row["J"])
    assert (record.hits[0] == record.head.sum()) == bool(row["exact"])


def test_an_episode_that_differs_from_its_row_is_not_kept_and_said_once(run, tmp_path, monkeypatch):
    (tmp_path / "counts_calls.py").write_text(COUNTS)
    monkeypatch.syspath_prepend(tmp_path)
    words = [
        "--detector",
        "counts_calls:Counts",
        "--detector",
        "none",
        "--episodes",
        "2",
        "--backend",
        "serial",
        *SMALL,
    ]
    status, _, err = run("evaluate", *words, "--out", tmp_path / "run", "--record", "every=1")
    assert status == 0
    assert err.count("differently") == 1
    assert "counts_calls:Counts answered 2 episodes, such as 0, differently when played again: it is not det" in err
    assert sorted(path.name for path in (tmp_path / "run" / "episodes").iterdir()) == ["none-0.npz", "none-1.npz"]


def test_an_episode_in_which_an_isolated_detector_fails_when_played_again_says_why(run, tmp_path, monkeypatch):
    (tmp_path / "stops_later.py").write_text(STOPS)
    monkeypatch.syspath_prepend(tmp_path)
    words = ["--detector", "stops_later:Stops", "--episodes", "1", "--isolate", *SMALL]
    status, _, err = run("evaluate", *words, "--out", tmp_path / "run", "--record", "every=1")
    assert status == 0, err
    assert (
        "usnet: stops_later:Stops failed in episode 0 when played again, but not in the run: "
        "RuntimeError: made twice. No file of such an episode was written.\n"
    ) in err
    assert "differently" not in err
    assert not (tmp_path / "run" / "episodes").exists()


def test_detectors_of_a_run_are_compared_on_its_page_and_on_standard_output(run, recorded, tmp_path):
    pytest.importorskip("matplotlib")
    run_alone = tmp_path / "run"  # without its recorded episodes, whose pictures take long
    shutil.copytree(recorded, run_alone, ignore=shutil.ignore_patterns("episodes"))
    one, other = "one-per-round", "random(count=2)"
    expected = str(EvaluationResult.load(run_alone).compare(one, other, "rounds"))
    words = ("report", run_alone, "--compare", one, "--metric", "rounds")
    for named in ([], ["--compare", other]):  # alone: with all others
        status, out, err = run(*words, *named)
        assert (status, err) == (0, "")
        assert out == f"{expected}.\npage  {run_alone / 'report.html'}\n"
    text = (run_alone / "report.html").read_text()
    assert f"<p>{html.escape(expected)}.</p>" in text
    assert f"J of {other} minus {one}: " in run("report", run_alone, "--compare", other)[1]


def test_comparisons_that_cannot_be_made_are_refused(run, recorded, tmp_path):
    episode = recorded / "episodes" / "one-per-round-0.npz"
    for words, refused in (
        ((episode, "--compare", "none"), "--compare must be given with the folder of a run or a suite, got "),
        ((recorded, "--metric", "J"), "--metric must be given together with --compare, got no --compare."),
        ((recorded, "--compare", "gone"), "detector must be one of one-per-round, random(count=2), got 'gone'."),
        ((recorded, *["--compare", "one-per-round"] * 2), "--compare must name each detector once, got one-per-"),
        ((recorded, "--compare", "one-per-round", "--metric", "K"), "metric must be one of J, "),
    ):
        assert refused in refusal(run, "report", *words)
    assert not (recorded / "report.html").exists()
    words = ["evaluate", "--detector", "none", "--episodes", "1", "--backend", "serial", *SMALL]
    assert run(*words, "--out", tmp_path)[0] == 0
    assert "--compare must find another detector there, got 'none' alone." in refusal(
        run, "report", tmp_path, "--compare", "none"
    )


@pytest.mark.slow
def test_an_animation_and_a_comparison(run, recorded, tmp_path):
    pytest.importorskip("rerun")
    one, other = (recorded / "episodes" / f"{name}-0.npz" for name in ("one-per-round", "random_count=2"))
    status, out, _ = run("replay", one, "--animation", tmp_path / "game.gif")
    assert status == 0
    assert (tmp_path / "game.gif").read_bytes().startswith(b"GIF89a")
    assert not one.with_suffix(".rrd").exists()
    status, out, _ = run("compare", one, other, "--rrd", tmp_path / "both.rrd")
    assert status == 0
    assert (tmp_path / "both.rrd").stat().st_size > 1000
    assert "one-per-round: " in out


@pytest.mark.slow
def test_the_page_of_a_run_has_the_ranking_and_links_to_its_episodes(run, recorded, tmp_path):
    pytest.importorskip("matplotlib")
    status, _, _ = run("report", recorded, "--html", tmp_path / "page.html")
    assert status == 0
    text = (tmp_path / "page.html").read_text()
    assert text.count("<section>") == 4
    assert "one-per-round-2.npz" in text
    assert "has the lowest J" in text or "have the lowest" in text


def test_the_worst_windows_of_recorded_tracks_have_the_lowest_f1(run, tmp_path, monkeypatch):
    """Their J is best where no id is named."""
    pytest.importorskip("rerun")
    monkeypatch.setattr(sys.modules["usnet_env.cli.replay"], "_MOST_FAILURES", 1)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "all_or_none.py").write_text(ALL_OR_NONE)
    lines = (f"{i},{t},{t * (1 + i)},{i},0" for i in range(4) for t in range(100))
    (tmp_path / "tracks.csv").write_text("\n".join(["id,t,x,y,leader", *lines]))
    where = ["--set", f"path={tmp_path / 'tracks.csv'}", "step=1", "window=20"]
    words = ["evaluate", "--env", "USNET/Tracks-v0", *where, "--detector", "all_or_none:AllOrNone", "--episodes", "6"]
    assert run(*words, "--backend", "serial", "--out", tmp_path / "run", "--record", "worst")[0] == 0
    assert {row["recall_first"] for row in EvaluationResult.load(tmp_path / "run").rows} == {0.0, 1.0}
    (path,) = (tmp_path / "run" / "episodes").iterdir()
    assert not EpisodeRecord.load(path).candidates.any()
    status, out, _ = run("replay", tmp_path / "run")
    assert status == 0
    assert "0 of 1 head found in 1 window with 0 redundant candidates: F1 = 0.000 (1 is best)" in out


def test_a_screenshot_alone_leaves_no_replay(run, recorded, tmp_path, monkeypatch):
    pytest.importorskip("rerun")
    opened = []

    def take(recordings, path, seconds):  # in place of the viewer, which needs a graphics driver
        opened.append([(each, each.stat().st_size) for each in recordings])
        return path

    monkeypatch.setattr("usnet_env.replay.viewer.take_screenshot", take)
    shutil.copy(recorded / "episodes" / "one-per-round-0.npz", tmp_path / "episode.npz")
    words = ("replay", tmp_path, "--screenshot", tmp_path / "a.png")
    status, out, err = run(*words)
    assert (status, err) == (0, "")
    assert "replay  " not in out
    assert out.endswith(f"screenshot {tmp_path / 'a.png'}\n")
    assert [path.name for path in tmp_path.iterdir()] == ["episode.npz"]
    ((written, size),) = opened.pop()
    assert size > 1000
    assert not written.exists()
    assert run(*words, "--rrd", tmp_path / "kept.rrd")[0] == 0
    assert {path.name for path in tmp_path.iterdir()} == {"episode.npz", "kept.rrd"}
    assert opened == [[(tmp_path / "kept.rrd", (tmp_path / "kept.rrd").stat().st_size)]]


def refusal(run, *words):
    status, out, err = run(*words)
    assert (status, out) == (2, "")
    assert err.startswith("usnet: ")
    assert err.count("\n") == 1
    return err


def test_refusals_are_one_sentence(run, recorded, tmp_path, monkeypatch):
    assert "--record must be every=NUMBER or worst, got 'all'" in refusal(
        run, "evaluate", "--detector", "none", "--out", tmp_path / "x", "--record", "all"
    )
    assert "got no --out" in refusal(run, "evaluate", "--detector", "none", "--record", "worst")
    assert "--episode must be the number of a recorded episode, got 1" in refusal(
        run, "replay", recorded, "--episode", "1"
    )
    assert "path must be an episode file or a folder with some" in refusal(run, "replay", tmp_path)
    assert "got no --screenshot" in refusal(run, "replay", recorded, "--round", "1")
    one = recorded / "episodes" / "one-per-round-0.npz"
    before = sorted(path.name for path in tmp_path.iterdir()), sorted(path.name for path in one.parent.iterdir())
    assert "screenshot must end in .png, got " in refusal(run, "replay", one, "--screenshot", tmp_path / "a.jpg")
    words = ("replay", one, "--screenshot", tmp_path / "a.png", "--round", "9")
    assert "round must be a whole number from 1 to " in refusal(run, *words)
    assert before == (sorted(p.name for p in tmp_path.iterdir()), sorted(p.name for p in one.parent.iterdir()))
    (tmp_path / "broken.npz").write_bytes(b"PK")
    monkeypatch.chdir(tmp_path)  # a message cuts a long path
    assert "broken.npz" in refusal(run, "replay", "broken.npz")
    (tmp_path / "run").mkdir()
    assert "got no --screenshot" in refusal(run, "compare", one, one, "--step", "1")
    refused = refusal(run, "compare", "run", one)
    assert refused == "usnet: path must be an episode file, got the folder 'run'.\n"

"""Frozen suites: their files do not change without a new version, and detectors are compared on all cells."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from usnet_env import ArgumentError, Detection
from usnet_env.evaluation import SuiteResult, evaluate_suite, list_suites, load_suite
from usnet_env.evaluation.environments import make_environment

HASHES = json.loads((Path(__file__).parent / "data" / "suite_hashes.json").read_text())
SUITE = """
version: 2
purpose: A test.
episodes: 2
seed: 4711
tuning_seed: 7
arguments: {clusters: 2, uavs: 12, observation_steps: 20, max_rounds: 3}
cells:
  plain:
  other: {follow: f4}
"""


class Raising:
    def reset(self, seed=None):
        pass

    def detect(self, window):
        raise RuntimeError("no answer today")


class Sure:
    """Names the first UAV, which leads."""

    def reset(self, seed=None):
        pass

    def detect(self, window):
        first = np.arange(window.uavs) == 0
        return Detection(first, first * 1.0)


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(SUITE)
    return path


def test_no_file_changed_without_a_new_version():
    """A changed file needs a new version, and a line of its own in tests/evaluation/data/suite_hashes.json."""
    for name, suite in list_suites().items():
        assert HASHES[name][str(suite.version)] == suite.digest
        assert suite.version == max(map(int, HASHES[name]))


def test_every_cell_can_be_made():
    for suite in list_suites().values():
        for cell in suite.cells.values():
            make_environment(cell.env, cell.arguments).close()


def test_seeds_of_suites_differ():
    suites = list_suites().values()
    seeds = [seed for suite in suites for seed in (suite.seed, suite.tuning_seed)]
    assert len(set(seeds)) == len(seeds)


def test_a_suite_of_ones_own_is_played_kept_and_read(path, tmp_path):
    played = evaluate_suite(path, ["lagged-regression", "none"], isolate=False, out=tmp_path / "run")
    assert played.suite.label == "own (version 2)"
    assert list(played.results) == ["plain", "other"]
    assert {entry["episodes"] for entry in played.summary} == {4}
    assert played.results["other"].config["seed"] == 4711
    lines = played.to_markdown().splitlines()
    assert lines[0] == "| own, exact, n = 2 a cell | lagged-regression | none |"
    assert len(lines) == 5
    assert played.cell("plain", "none", "J").mean == 3.0
    read = SuiteResult.load(tmp_path / "run", path)
    assert read.to_markdown("J") == played.to_markdown("J")
    more = evaluate_suite(path, "none", cells=["other"], episodes=3, isolate=False, out=tmp_path / "run")
    assert more.cell("other", "none", "rounds").mean == 3.0


def test_a_suite_of_tracks_has_their_metrics_and_ranks_by_f1_as_its_cells_do(path, tmp_path):
    rng = np.random.default_rng(1)
    place = np.cumsum(np.cumsum(rng.normal(0, 0.1, (400, 2)), axis=0), axis=0)
    rows = [f"b{i},{t},{place[t - 2 * i, 0]},{place[t - 2 * i, 1] + i},b0" for i in range(4) for t in range(10, 400)]
    (tmp_path / "tracks.csv").write_text("\n".join(["id,t,x,y,leader", *rows]))
    tracks = f"{{env: USNET/Tracks-v0, path: {tmp_path / 'tracks.csv'}, step: 1.0"
    text = SUITE.replace("arguments: {clusters: 2, uavs: 12, observation_steps: 20, max_rounds: 3}\n", "")
    path.write_text(text.replace("plain:", f"plain: {tracks}}}").replace("{follow: f4}", f"{tracks}, window: 60}}"))
    played = evaluate_suite(path, ["none", "destroy-all", Sure()], isolate=False)
    one = played.results["plain"]
    assert played.cell("plain", "none", "J").mean < played.cell("plain", "destroy-all", "J").mean
    for result in (played, one):
        assert str(result.ranking().columns[1].header).startswith("F1↑")
        names = [str(column.header).partition("↑")[0] for column in result.ranking().columns]
        assert names == ["detector", "F1", "redundancy↓", "exact", "group leaders", "s↓"]
        assert result._repr_html_().count("<th>F1↑") == 1
        assert list(result.ranking().columns[0].cells)[-1].plain == "none"
    assert played.to_markdown("group_leader_first").splitlines()[-1] == "| all cells | 0.25 | 0.25 | 1.00 |"
    path.write_text(path.read_text() + "  simulated: {env: USNET/SingleCluster-v0}\n")
    mixed = evaluate_suite(path, "none", isolate=False, episodes=1).to_markdown("group_leader_first").splitlines()
    assert mixed[-2:] == ["| simulated | – |", "| all cells | 0.25 |"]
    (tmp_path / "unknown.csv").write_text("\n".join(["id,t,x,y", *(row.rpartition(",")[0] for row in rows)]))
    last = f"  last: {{env: USNET/Tracks-v0, step: 1.0, path: {tmp_path / 'unknown.csv'}}}\n"
    path.write_text(path.read_text() + last)
    with pytest.raises(ArgumentError, match=r"^env must know the leaders .*, in the cell 'last' of the suite own\.$"):
        evaluate_suite(path, "none", isolate=False, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_detector_that_fails_in_a_cell_does_not_stop_the_others(path):
    played = evaluate_suite(path, [Raising(), "none"], isolate=False)
    assert set(played.failures) == {"plain", "other"}
    assert played.failures["plain"].keys() == {"Raising"}
    assert "no answer today" in played.failures["plain"]["Raising"]
    assert [entry["detector"] for entry in played.summary] == ["none"]


def test_the_progress_bar_names_the_cell_and_how_many_there_are(path, monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    evaluate_suite(path, "none", isolate=False, episodes=1, progress=True)
    shown = capsys.readouterr().err
    assert "cell 1 of 2: plain, episodes" in shown
    assert "cell 2 of 2: other, episodes" in shown


def test_a_folder_of_a_suite_says_which_suite_it_is(path, tmp_path):
    out = tmp_path / "own"
    evaluate_suite(path, "none", isolate=False, out=out)
    read = SuiteResult.load(out)
    assert read.suite == load_suite(path)
    assert list(read.results) == ["plain", "other"]
    described = (out / "suite.json").read_text()
    (out / "suite.json").write_text("{}")
    with pytest.raises(ArgumentError, match=r"^folder must hold a suite\.json of a suite, got another one in '"):
        SuiteResult.load(out)
    other = described.replace('"f4"', '"f5"')  # with another suite, the folder does not say what all runs are
    for text in (other, None):  # an earlier version wrote none
        (out / "suite.json").unlink() if text is None else (out / "suite.json").write_text(text)
        read = SuiteResult.load(out)
        assert read.suite is None
        assert list(read.results) == ["other", "plain"]  # by name
        assert read.cell("plain", "none", "J").mean == 3.0
    evaluate_suite(path, "none", isolate=False, out=out)  # resumes
    assert (out / "suite.json").read_text() == described
    played = evaluate_suite(
        "controls", "none", cells=["decoys", "independent"], episodes=1, isolate=False, out=tmp_path / "controls"
    )
    read = SuiteResult.load(tmp_path / "controls")
    assert read.suite == load_suite("controls")
    assert read.to_markdown() == played.to_markdown()
    (tmp_path / "controls" / "suite.json").unlink()
    assert SuiteResult.load(tmp_path / "controls").suite == load_suite("controls")
    with pytest.raises(ArgumentError, match=r"^folder must hold runs of a suite, got "):
        SuiteResult.load(tmp_path / "controls" / "decoys")


def test_a_suite_has_a_page_of_its_tables(run, path, tmp_path):
    evaluate_suite(path, ["none", Raising()], isolate=False, out=tmp_path / "own")
    status, out, err = run("report", tmp_path / "own")
    assert (status, err) == (0, "")
    assert out == f"page  {tmp_path / 'own' / 'report.html'}\n"
    text = (tmp_path / "own" / "report.html").read_text()
    assert "<title>Detectors on own (version 2)</title>" in text
    assert "own (version 2), 2 cells</caption>" in text
    assert "not been played" not in text
    assert "none has a J_m of 3.000 in every episode." in text
    assert "<td>plain</td><td>0 (0–66) %</td>" in text
    assert "no answer today" in text
    assert "recorded episode" not in text
    status, _, err = run("replay", tmp_path / "own")
    assert status == 2
    assert "the folder of a suite, which has none; `usnet report` writes a page of its tables." in err


class Stopped(Sure):
    """Is interrupted in one of its episodes."""

    def __init__(self, episode):
        self.episode, self.begun = episode, 0

    def reset(self, seed=None):
        self.begun += 1
        if self.begun == self.episode:
            raise KeyboardInterrupt


def test_an_interrupted_suite_says_what_has_not_been_played(run, path, tmp_path):
    out = tmp_path / "runs"
    with pytest.raises(KeyboardInterrupt):
        evaluate_suite(path, {"none": "none", "x": Stopped(3)}, isolate=False, episodes=4, out=out)
    assert run("report", out)[0] == 0
    text = (out / "report.html").read_text()
    assert "Detectors on own (version 2)" in text
    assert "own (version 2), 1 of 2 cells" in text
    assert "<p>1 of 2 cells has not been played: other.</p>" in text
    assert "<p>plain: Episodes are missing: none has 3 and x has 2 of 4.</p>" in text
    assert repr(SuiteResult.load(out)) == "<SuiteResult of own (version 2), 1 of 2 cells, 2 detectors>"
    again = Stopped(3)
    again.begun = 3  # plays to the end
    evaluate_suite(path, {"none": "none", "x": again}, isolate=False, episodes=4, out=out)
    assert run("report", out)[0] == 0
    assert "missing" not in (out / "report.html").read_text()


def test_one_cell_is_a_cell(path):
    played = evaluate_suite("controls", "none", cells=["decoys"], episodes=1, isolate=False)
    total = len(played.suite.cells)
    assert str(played.ranking().title).startswith(f"controls (version 2), 1 of {total} cells, 1 episode of each")
    path.write_text(SUITE.partition("  other:")[0])
    assert (
        evaluate_suite(path, "none", isolate=False)
        ._repr_html_()
        .startswith("<table><caption>own (version 2), 1 cell</caption>")
    )


def test_a_suite_in_which_all_fail_has_an_empty_ranking_and_no_status_0(run, path, tmp_path, monkeypatch):
    found = evaluate_suite(path, Raising(), isolate=False)
    assert found.ranking().row_count == 0
    (tmp_path / "raises_in_all_cells.py").write_text("class Raises:\n    reset = detect = lambda *_: 1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    status, out, err = run("evaluate", "--suite", path, "--detector", "raises_in_all_cells:Raises", "--episodes", "1")
    assert status == 2
    assert "plain: detector 'raises_in_all_cells:Raises' failed" in err
    assert err.endswith("usnet: no detector has a result in any cell.\n")
    assert "Traceback" not in out + err


class Sometimes(Raising):
    def __init__(self, fails=True):
        self.fails = fails

    def detect(self, window):
        return super().detect(window) if self.fails else Detection(window.alive, window.alive)


def test_failures_stay_until_the_detector_has_played(path, tmp_path):
    out = tmp_path / "run"
    how = {"isolate": False, "out": out}
    evaluate_suite(path, {"x": Sometimes(), "y": Raising()}, **how)
    assert evaluate_suite(path, "none", cells=["plain"], **how).failures.keys() == {
        "plain"
    }  # of the cells of this call
    read = SuiteResult.load(out, path).failures
    assert read.keys() == {"plain", "other"}
    assert read["plain"].keys() == {"x", "y"}
    assert "'x' failed" in read["plain"]["x"]
    shutil.rmtree(out / "other", ignore_errors=True)
    evaluate_suite(path, {"x": Sometimes(fails=False)}, cells=["other"], **how)
    left = SuiteResult.load(out, path).failures
    assert left["plain"] == read["plain"]
    assert left["other"].keys() == {"y"}


class InEpisode(Sometimes):
    """Fails in one of its episodes."""

    def __init__(self, episode):
        self.episode, self.begun = episode, 0

    def reset(self, seed=None):
        self.begun += 1

    def detect(self, window):
        self.fails = self.begun == self.episode
        return super().detect(window)


def test_a_cell_in_which_all_fail_is_missing_for_all_of_them_when_it_is_played_and_when_it_is_read(path, tmp_path):
    """Its first episode is in the folder, and doesn't count."""
    out = tmp_path / "run"
    evaluate_suite(path, {"x": InEpisode(9)}, isolate=False, out=out, cells=["other"])
    played = evaluate_suite(path, {"x": InEpisode(2)}, isolate=False, out=out, cells=["plain"])
    assert played.failures.keys() == {"plain"}
    assert played.summary == []
    read = SuiteResult.load(out, path)
    assert read.failures == played.failures
    assert read.summary == []  # it has no result in the cell in which it failed
    assert [line.split("|")[1:3] for line in read.to_markdown().splitlines()[2:]] == [
        [" plain ", " – "],
        [" other ", " 0 (0–66) % "],
        [" all cells ", " – "],
    ]
    (out / "failures.yaml").unlink()
    assert SuiteResult.load(out, path).failures == played.failures


def test_detectors_are_compared_over_cells_by_groups_of_a_swarm(path):
    played = evaluate_suite(path, ["destroy-all", "none", "one-per-round"], isolate=False, episodes=3)
    found = played.compare("destroy-all", "one-per-round")
    frame = played.to_frame()
    assert list(frame["cell"].unique()) == ["plain", "other"]
    wide = frame.pivot(index=["cell", "episode"], columns="detector", values="J")
    assert found.episodes == 6
    assert found.difference == pytest.approx((wide["destroy-all"] - wide["one-per-round"]).mean())
    assert found.p * 2**3 == round(found.p * 2**3)  # three groups, not six episodes
    assert [each.b for each in played.compare("none")] == ["destroy-all", "one-per-round"]
    assert played.to_latex("J").splitlines()[2].startswith(r"own, J\_m, n = 3 a cell & destroy-all & none")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda result: result.cell("f3", "none"), r"name must be one of other, plain, got 'f3'"),
        (lambda result: result.cell("plain", "none", "zz"), r"metric must be one of .*got 'zz'"),
        (lambda result: result.to_markdown("zz"), r"metric must be one of .*got 'zz'"),
        (lambda result: result.compare("none", 3), r"b must be a label, a list of labels or None, got 3\."),
        (lambda result: result.compare("none", "zz"), r"detector must be one of none, got 'zz'"),
    ],
)
def test_what_a_result_does_not_have_is_refused(path, call, message):
    result = evaluate_suite(path, "none", isolate=False, episodes=1)
    with pytest.raises(ArgumentError, match=f"^{message}"):
        call(result)
    assert "| – |" in result.to_markdown("purity_first")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cells": "plain"}, r"cells must be a list of at least one name, or None for all, got 'plain'\."),
        ({"cells": []}, r"cells must be a list of at least one name, or None for all, got \[\]\."),
        ({"env_kwargs": {}}, r"env_kwargs must not be given, because the suite gives it, got \{\}\."),
        ({"out": ""}, r"out must be a path, got ''\."),
    ],
)
def test_arguments_that_a_suite_does_not_take_are_refused(path, changes, message):
    with pytest.raises(ArgumentError, match=f"^{message}$"):
        evaluate_suite(path, "none", **changes)


@pytest.mark.parametrize("name", ["../../esc", "a/b", "..", ".hidden", "failures.yaml", "suite.json", "'1'", "3"])
def test_a_cell_cannot_be_a_path(path, tmp_path, name):
    path.write_text(SUITE.replace("plain:", f"{name}:"))
    if name == "'1'":
        assert "1" in load_suite(path).cells
        return
    with pytest.raises(ArgumentError, match=r"^cells must have names of letters, "):
        evaluate_suite(path, "none", out=tmp_path / "run")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1", "suite must be a YAML file that can be read"),
        ("a: 1", "suite must be a YAML file with a mapping of cells"),
        (SUITE + "  last: {follow: f99}\n", "follow must be one of .*, in the cell 'last' of the suite own."),
        (
            SUITE + "  last: {env: USNET/Multi}\n",
            "env must be a registered id, .*, in the cell 'last' of the suite own.",
        ),
        (SUITE + "  last: {env: 3}\n", "env must be a name, got 3, in the cell 'last' of own.yaml."),
        (SUITE.replace("seed: 4711", "seed: 4"), "seed must be greater than or equal to 1000, got 4."),
        (SUITE.replace("purpose: A test.", ""), "suite must have purpose, got none in own.yaml."),
        (SUITE + "extra: 3\n", "extra is not an argument of FrozenSuite"),
        (SUITE.replace("plain:", "plain: 3"), "plain must map names to arguments, got 3 in own.yaml."),
    ],
)
def test_a_wrong_file_is_refused_in_one_sentence_before_anything_is_played(path, tmp_path, text, message):
    path.write_text(text)
    with pytest.raises(ArgumentError) as refused:
        evaluate_suite(path, "none", out=tmp_path / "run")
    assert re.match(message, str(refused.value))
    assert not (tmp_path / "run").exists()


def test_an_unknown_name_is_refused():
    with pytest.raises(ArgumentError, match=r"suite must be one of .*paper.*\(did you mean 'paper'\?\)"):
        load_suite("papr")
    with pytest.raises(ArgumentError, match="cells must be one of"):
        evaluate_suite("paper", "none", cells=["f9"])

"""The folder of a run: it resumes, is extended, and survives what ends a run."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pandas.testing import assert_frame_equal
from sample_detectors import Followed, RandomThird, untimed

from usnet_env import ArgumentError, evaluate
from usnet_env.evaluation import EvaluationResult, folder
from usnet_env.evaluation.folder import COLUMNS, RunFolder, read_run

MULTI = "USNET/MultiCluster-v0"
SMALL = {"clusters": 3, "uavs": 20, "observation_steps": 20, "max_rounds": 5}
DETECTORS = {"third": RandomThird(), "followed": Followed(2)}


def play(folder=None, detectors=DETECTORS, **how):
    return evaluate(MULTI, detectors, out=folder, **{"episodes": 4, "seed": 5, "env_kwargs": SMALL} | how)


@pytest.fixture(scope="module")
def whole():
    return play()


class Stopped(RandomThird):
    episodes = 0

    def reset(self, seed=None):
        super().reset(seed)
        self.episodes += 1
        if self.episodes == 3:
            raise KeyboardInterrupt


def test_a_run_leaves_its_arguments_and_rows_and_is_not_repeated(tmp_path, whole):
    result = play(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"run.json", "rows.csv"}
    about = json.loads((tmp_path / "run.json").read_text())
    assert set(about) == {"arguments", "builds"}
    assert [set(build) for build in about["builds"]] == [{"commit", "versions", "machine"}]
    assert about["arguments"] == {
        "suite": None,
        "unit": "swarm",
        "cells": {MULTI: {"env": MULTI, "arguments": SMALL}},
        "detectors": ["third", "followed"],
        "episodes": 4,
        "seed": 5,
    }
    assert_frame_equal(untimed(result), untimed(whole))
    text = (tmp_path / "rows.csv").read_text()
    assert_frame_equal(play(tmp_path).rows, result.rows)  # seconds and all
    loaded = EvaluationResult.load(tmp_path)
    assert_frame_equal(loaded.rows, result.rows)
    assert (loaded.summary, (tmp_path / "rows.csv").read_text()) == (result.summary, text)


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_an_interrupted_run_resumes_to_the_rows_of_an_undisturbed_one(tmp_path, whole, workers):
    with pytest.raises(KeyboardInterrupt):
        play(tmp_path, DETECTORS | {"third": Stopped()})
    kept = EvaluationResult.load(tmp_path)
    assert list(kept.rows["episode"]) == [0, 1]
    assert "2 of 4 episodes" in repr(kept)
    result = play(tmp_path, workers=workers)
    assert_frame_equal(untimed(result), untimed(whole))
    assert_frame_equal(result.rows[:2], kept.rows)


def test_a_line_that_was_torn_anywhere_is_played_again(tmp_path, whole):
    play(tmp_path)
    data = (tmp_path / "rows.csv").read_bytes()
    last = data[:-1].rfind(b"\n") + 1
    for end in (last, last + 1, last + 30, len(data) - 1):
        (tmp_path / "rows.csv").write_bytes(data[:end])
        assert len(EvaluationResult.load(tmp_path).rows) == 7
        assert_frame_equal(untimed(play(tmp_path)), untimed(whole))
    (tmp_path / "rows.csv").write_bytes(b"cell,detec")
    assert_frame_equal(untimed(play(tmp_path)), untimed(whole))
    (tmp_path / "rows.csv").unlink()
    assert_frame_equal(untimed(play(tmp_path)), untimed(whole))


def test_more_episodes_and_detectors_extend_a_run_and_its_rows_stay(tmp_path, whole):
    first = play(tmp_path, {"third": RandomThird()}, episodes=2)
    joined = play(tmp_path, {"followed": Followed(2)})
    assert (joined.detectors, joined.config["episodes"]) == (["third", "followed"], 4)
    result = play(tmp_path)
    assert_frame_equal(untimed(result), untimed(whole))
    assert_frame_equal(result.rows[:2], first.rows)


@pytest.mark.parametrize(
    ("changes", "word"),
    [({"seed": 6}, "seed"), ({"env_kwargs": SMALL | {"follow": "f2"}}, MULTI), ({"env_kwargs": {}}, MULTI)],
)
def test_the_folder_of_another_run_is_refused(tmp_path, changes, word):
    play(tmp_path, "none", episodes=1)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(ArgumentError, match=rf"^out must .*{word}"):
        play(tmp_path, "none", **changes)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_what_is_no_folder_of_a_run_is_refused(tmp_path):
    for name, text in (("run.json", "{"), ("run.json", "[]"), ("rows.csv", "a,b\n1,2\n")):
        folder = tmp_path / "run"
        play(folder, "none", episodes=1)
        (folder / name).write_text(text)
        for call in (lambda folder=folder: play(folder, "none"), lambda folder=folder: EvaluationResult.load(folder)):
            with pytest.raises(ArgumentError, match=r"^folder must"):
                call()
        for path in folder.iterdir():
            path.unlink()
    with pytest.raises(ArgumentError, match=r"^folder must"):
        EvaluationResult.load(tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match=r"^out must .*written"):
        play(tmp_path / "file", "none")


def test_a_folder_that_another_run_writes_is_refused(tmp_path, whole):
    pytest.importorskip("fcntl")
    config = whole.config | {"detectors": ["third"]}
    first = RunFolder(tmp_path, config, COLUMNS)
    with pytest.raises(ArgumentError, match=r"^out must .*writes"):
        play(tmp_path)
    first.append(whole.rows.iloc[0].dropna().to_dict())
    first.close()
    result = play(tmp_path)
    assert_frame_equal(untimed(result), untimed(whole))
    assert_frame_equal(result.rows[:1], whole.rows[:1])


def test_a_run_names_every_build_that_has_added_rows(tmp_path, monkeypatch):
    play(tmp_path, "none", episodes=1)
    first = json.loads((tmp_path / "run.json").read_text())["builds"]
    monkeypatch.setattr(folder, "versions", lambda: {"usnet": "0.0.1"})
    for episodes in (2, 3):
        play(tmp_path, "none", episodes=episodes)
    builds = json.loads((tmp_path / "run.json").read_text())["builds"]
    assert builds == [*first, first[0] | {"versions": {"usnet": "0.0.1"}}]


LABELS = st.text(st.characters(exclude_categories=["C", "Zl", "Zp"]), min_size=1)


@given(st.lists(st.tuples(LABELS, st.floats(allow_nan=False), st.integers(0, 2**63 - 1), st.text()), max_size=5))
def test_any_rows_survive_the_file(tmp_path_factory, values):
    folder = tmp_path_factory.mktemp("run")
    config = {"cells": {}, "detectors": [], "episodes": 1, "seed": 0}
    kept = RunFolder(folder, config, COLUMNS)
    rows = []
    for episode, (label, number, seed, error) in enumerate(values):
        row = dict.fromkeys(COLUMNS, 0) | {"cell": label, "detector": label, "episode": episode, "swarm_seed": seed}
        rows.append(row | {"J": number, "purity_first": None, "error": " ".join(error.split())})
        kept.append(rows[-1] | {"J": np.float64(number)})
    kept.close()
    _, frame = read_run(folder)
    assert len(frame) == len(rows)
    for row, read in zip(rows, frame.to_dict("records"), strict=True):
        assert np.isnan(read["purity_first"])
        assert row == {**read, "purity_first": None, "error": row["error"]}

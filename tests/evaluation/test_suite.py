"""Suites: rows read back as written, made once, on any number of processes."""

import os
import shutil
import sys
import time
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import parent_process
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from usnet_env import ArgumentError, evaluate, register_follow_strategy
from usnet_env.envs import MultiClusterEnv
from usnet_env.evaluation import EvaluationError
from usnet_env.evaluation.report import episode_means, format_interval, format_latex, format_markdown, group_rows
from usnet_env.evaluation.statistics import Interval
from usnet_env.evaluation.store import RowFile
from usnet_env.evaluation.suite import Place, Suite, list_games, play_detector, read_rows, split_games
from usnet_env.evaluation.table import columns_of


@dataclass(frozen=True)
class Cell:
    name: str


@dataclass(frozen=True, kw_only=True)
class Square(Cell):
    episode: int
    square: float
    even: bool


def play(games, power):
    return [Square(cell.name, episode=n, square=float(n**power), even=n % 2 == 0) for cell, n in games]


def make_suite(played=play, **more):
    return Suite(Cell, Square, partial(played, power=2), **more)


def pair(name, first):
    return [(Cell(name), first), (Cell(name), first + 1)]


TASKS = [pair("b", 2), pair("a", 0), pair("a", 4)]


def keys(rows):
    return [(row.name, row.episode) for row in rows]


def test_rows_come_in_the_order_of_the_tasks_and_lie_sorted(tmp_path):
    path = tmp_path / "rows.csv"
    rows = make_suite(order=("name", "episode")).run(TASKS, path)
    assert keys(rows) == [("b", 2), ("b", 3), ("a", 0), ("a", 1), ("a", 4), ("a", 5)]
    assert keys(read_rows(path, Square)) == sorted(keys(rows))
    assert keys(make_suite().run(TASKS, tmp_path / "played.csv")) == keys(read_rows(tmp_path / "played.csv", Square))


def test_what_is_kept_is_not_made_again(tmp_path):
    path, made, counts = tmp_path / "rows.csv", [], []

    def counting(games, power):
        made.append(games)
        return play(games, power)

    make_suite(counting).run(TASKS[:1], path)
    make_suite(counting).run(TASKS, path, progress=lambda *count: counts.append(count))
    assert made == TASKS
    assert counts == [(2, 6), (4, 6), (6, 6)]


def test_a_suite_that_is_running_is_not_joined_by_a_second_one(tmp_path):
    path = tmp_path / "rows.csv"

    def nested(games, power):
        return make_suite().run(TASKS, path)

    with pytest.raises(ArgumentError, match=r"^out must be a folder that no other run uses"):
        make_suite(nested).run(TASKS, path)
    assert list(tmp_path.iterdir()) == []  # neither rows nor a lock


def test_a_folder_that_is_removed_during_the_run_is_an_error(tmp_path):
    path = tmp_path / "run" / "rows.csv"

    def removing(games, power):
        shutil.rmtree(path.parent)
        return play(games, power)

    with pytest.raises(ArgumentError, match=r"^out must stay as it is during a run, .* was removed"):
        make_suite(removing).run(TASKS[:1], path)


def leave(games, power):
    """Play; the second task ends its process."""
    if games == TASKS[1]:
        if parent_process() is None:
            sys.exit(0)
        time.sleep(1)  # the first task ends before
        os._exit(0)
    return play(games, power)


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_game_that_ends_its_process_is_named(tmp_path, workers):
    reason = r"^Game 0 of Cell\(name='a'\) failed: (SystemExit: 0|it ended its process with status 0)"
    with pytest.raises(EvaluationError, match=reason):
        make_suite(leave).run(TASKS, tmp_path / "rows.csv", workers=workers)
    assert set(play(TASKS[0], 2)) <= set(read_rows(tmp_path / "rows.csv", Square))


@pytest.mark.parametrize("backend", ["processes", pytest.param("ray", marks=pytest.mark.slow)])
def test_every_backend_plays_the_same_rows(tmp_path, backend, monkeypatch):
    if backend == "ray":
        pytest.importorskip("ray")
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, (Path(__file__).parent, *sys.path))))
    there = make_suite().run(TASKS, tmp_path / "there.csv", workers=Place(backend, 2))
    assert there == make_suite().run(TASKS, tmp_path / "here.csv")
    assert set(read_rows(tmp_path / "there.csv", Square)) == set(there)


def test_what_a_program_has_registered_and_a_local_function_reach_other_processes(tmp_path):
    register_follow_strategy("suite-turn", lambda inputs: -inputs.head_velocity[:, 0], lags=1, replace=True)

    def fly(games):
        env = MultiClusterEnv(clusters=2, uavs=8, observation_steps=20, follow="suite-turn")
        env.reset(seed=0)
        return [Square(cell.name, episode=n, square=float(env.swarm.head.sum()), even=True) for cell, n in games]

    rows = Suite(Cell, Square, fly).run(TASKS, tmp_path / "rows.csv", workers=Place("processes", 2))
    assert [row.square for row in rows] == [2.0] * 6


def test_a_function_that_cannot_be_sent_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match=r"^workers must be 1 for a detector or argument that cannot be sent"):
        make_suite(partial(play, tool=(n for n in range(3)))).run(TASKS, tmp_path / "rows.csv", workers=2)


def test_rows_of_finished_tasks_survive_a_failure(tmp_path):
    path = tmp_path / "rows.csv"

    def fail(games, power):
        if games == TASKS[1]:
            raise KeyboardInterrupt
        return play(games, power)

    with pytest.raises(KeyboardInterrupt):
        make_suite(fail).run(TASKS, path)
    assert read_rows(path, Square) == play(TASKS[0], 2)


@given(
    st.lists(
        st.builds(
            Square,
            st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), max_size=8),
            episode=st.integers(-9, 10**9),
            square=st.integers(-(10**6), 10**6).map(lambda value: value / 16),
            even=st.booleans(),
        ),
        unique_by=lambda row: (row.name, row.episode),
    )
)
def test_any_rows_survive_the_file(tmp_path_factory, rows):
    path: Path = tmp_path_factory.mktemp("rows") / "rows.csv"
    with RowFile(path, columns_of(Square), digits=4) as file:
        file.append(map(vars, rows))
    assert read_rows(path, Square) == rows


@pytest.mark.parametrize(
    "text", ["name\na\n", "name,episode,square,even\na,1,x,True\n", "name,episode,square,even\na\n"]
)
def test_other_files_are_refused(tmp_path, text):
    (tmp_path / "rows.csv").write_text(text, encoding="utf-8")
    refused = pytest.raises(ArgumentError, match=r"out must hold rows of this measurement, got something else in 'rows")
    with refused:
        read_rows(tmp_path / "rows.csv", Square)
    with refused:
        make_suite().run(TASKS, tmp_path / "rows.csv")


def test_games_are_listed_cell_by_cell_or_split_so_that_cells_fill_equally():
    a, b = Cell("a"), Cell("b")
    assert list_games([a, b], lambda cell: 2 if cell == a else 1, 7) == [[(a, 7)], [(a, 8)], [(b, 7)]]
    assert list_games([a], 1) == [[(a, 0)]]
    assert split_games([a, b], 3, 2) == [[(a, 0), (a, 1)], [(b, 0), (b, 1)], [(a, 2)], [(b, 2)]]


@pytest.mark.parametrize("isolate", [True, False])
def test_a_detector_plays_the_episodes_of_evaluate(isolate):
    env = MultiClusterEnv(clusters=2, uavs=8, observation_steps=20)
    swarm = {"clusters": 2, "uavs": 8, "observation_steps": 20}
    theirs = evaluate("USNET/MultiCluster-v0", "random(count=2)", episodes=3, seed=5, env_kwargs=swarm)
    ours = [play_detector(env, "random(count=2)", 5, episode, isolate) for episode in range(3)]
    assert [len(rounds) for rounds in ours] == [row["rounds"] for row in theirs.rows]


def test_the_rows_of_an_episode_count_once():
    rows = [*play(pair("a", 0), 2), *play(pair("b", 0), 1), Square("c", episode=1, square=np.nan, even=True)]
    assert episode_means(rows, "square") == [0.0, 1.0]
    texts = [{name: str(value) for name, value in asdict(row).items()} for row in rows]
    assert episode_means(texts, "square") == [0.0, 1.0]
    assert episode_means([], "square") == []
    assert {name: len(own) for name, own in group_rows(rows, lambda row: row.name).items()} == {"a": 2, "b": 2, "c": 1}


def test_tables_are_markdown_or_latex():
    lines = [("a_1", format_interval(Interval(0.5, 0.25, 0.75))), ("b", format_interval(Interval(1, 1, 1), short=True))]
    assert format_markdown(("name", "J"), lines) == [
        "| name | J |",
        "|---|---|",
        "| a_1 | 0.50 (0.25–0.75) |",
        "| b | 1.00 |",
    ]
    assert format_markdown((None, ""), []) == ["| |  |", "|---|---|"]
    assert format_latex(("name", "J"), lines) == [
        r"\begin{tabular}{lr}",
        r"\toprule",
        r"name & J \\",
        r"\midrule",
        r"a\_1 & 0.50 (0.25--0.75) \\",
        r"b & 1.00 \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]

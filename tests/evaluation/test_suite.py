"""Rows of any measurement: read back as written, made once, on any number of processes."""

import os
import shutil
import sys
from dataclasses import dataclass
from functools import partial
from multiprocessing import parent_process
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from usnet_env import ArgumentError
from usnet_env.evaluation import EvaluationError
from usnet_env.evaluation.suite import Measurement, counter, episode_means, measure, read_rows, write_rows


@dataclass(frozen=True)
class Square:
    name: str
    episode: int
    square: float
    even: "bool"


# As in modules with ``from __future__ import annotations``, where the types of fields are text.
Square.__dataclass_fields__["name"].type = "str"
Square.__dataclass_fields__["episode"].type = "int"
Square.__dataclass_fields__["square"].type = "float"


def play(task: tuple[str, int], power: int) -> list[Square]:
    name, first = task
    return [Square(name, number, float(number**power), number % 2 == 0) for number in (first, first + 1)]


def square_measurement(played=play):
    return Measurement(
        Square,
        partial(played, power=2),
        lambda task: [(task[0], task[1]), (task[0], task[1] + 1)],
        lambda row: (row.name, row.episode),
        lambda row: (row.name, row.episode),
    )


TASKS = [("b", 2), ("a", 0), ("a", 4)]


def test_rows_come_in_the_order_of_the_tasks_and_lie_sorted(tmp_path):
    path = tmp_path / "rows.csv"
    rows = measure(square_measurement(), TASKS, path, 1)
    assert [(row.name, row.episode) for row in rows] == [("b", 2), ("b", 3), ("a", 0), ("a", 1), ("a", 4), ("a", 5)]
    assert [(row.name, row.episode) for row in read_rows(path, Square)] == sorted((r.name, r.episode) for r in rows)


def test_what_is_kept_is_not_made_again(tmp_path):
    path, made, counts = tmp_path / "rows.csv", [], []

    def counting(task, power):
        made.append(task)
        return play(task, power)

    measure(square_measurement(counting), TASKS[:1], path, 1)
    measure(square_measurement(counting), TASKS, path, 1, counts.append)
    assert made == TASKS
    assert counts == [2, 2, 2]


def test_a_measurement_that_is_running_is_not_joined_by_a_second_one(tmp_path):
    path = tmp_path / "rows.csv"

    def nested(task, power):
        return measure(square_measurement(), TASKS, path, 1)

    with pytest.raises(ArgumentError, match=r"^out must be a folder that no other run uses"):
        measure(square_measurement(nested), TASKS, path, 1)
    assert list(tmp_path.iterdir()) == []  # neither rows nor a lock


def test_a_folder_that_is_removed_during_the_measurement_is_an_error(tmp_path):
    path = tmp_path / "run" / "rows.csv"

    def removing(task, power):
        shutil.rmtree(path.parent)
        return play(task, power)

    with pytest.raises(ArgumentError, match=r"^out must stay as it is during a run, .* was removed"):
        measure(square_measurement(removing), TASKS[:1], path, 1)


def leaves(task, power):
    """Play; the second task ends its process."""
    if task == TASKS[1]:
        os._exit(0) if parent_process() is not None else sys.exit(0)
    return play(task, power)


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_task_that_ends_its_process_is_named(tmp_path, workers):
    with pytest.raises(
        EvaluationError, match=r"^\('a', 0\) failed: (SystemExit: 0|it ended its process with status 0)"
    ):
        measure(square_measurement(leaves), TASKS, tmp_path / "rows.csv", workers)
    assert set(play(TASKS[0], 2)) <= set(read_rows(tmp_path / "rows.csv", Square))


def test_rows_of_finished_tasks_survive_a_failure(tmp_path):
    path = tmp_path / "rows.csv"

    def fails(task, power):
        if task == TASKS[1]:
            raise KeyboardInterrupt
        return play(task, power)

    with pytest.raises(KeyboardInterrupt):
        measure(square_measurement(fails), TASKS, path, 1)
    assert read_rows(path, Square) == play(TASKS[0], 2)


@given(
    st.lists(
        st.builds(
            Square,
            st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), max_size=8),
            st.integers(-9, 10**9),
            st.integers(-(10**6), 10**6).map(lambda value: value / 16),
            st.booleans(),
        ),
        unique_by=lambda row: (row.name, row.episode),
    )
)
def test_any_rows_survive_the_file(tmp_path_factory, rows):
    path: Path = tmp_path_factory.mktemp("rows") / "rows.csv"
    write_rows(path, rows, Square, lambda row: (row.name, row.episode))
    assert read_rows(path, Square) == sorted(rows, key=lambda row: (row.name, row.episode))


@pytest.mark.parametrize(
    "text", ["name\na\n", "name,episode,square,even\na,1,x,True\n", "name,episode,square,even\na\n"]
)
def test_other_files_are_refused(tmp_path, text):
    (tmp_path / "rows.csv").write_text(text, encoding="utf-8")
    with pytest.raises(ArgumentError, match=r"out must hold rows of this measurement, got something else in 'rows"):
        read_rows(tmp_path / "rows.csv", Square)


def test_progress_is_a_running_count():
    seen = []
    advance = counter(5, lambda done, total: seen.append((done, total)))
    for more in (2, 0, 3):
        advance(more)
    assert seen == [(2, 5), (2, 5), (5, 5)]


def test_the_rows_of_an_episode_count_once():
    rows = [
        Square("a", 0, 1.0, True),
        Square("b", 0, 3.0, True),
        Square("a", 1, 5.0, True),
        Square("b", 1, np.nan, True),
    ]
    assert episode_means(rows, "square") == [2.0, 5.0]
    assert episode_means([], "square") == []

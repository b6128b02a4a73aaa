"""Child processes: whatever ends one is the outcome of its task, and nothing stays behind."""

from __future__ import annotations

import sys
from functools import partial

import pytest
from sample_tasks import play

from usnet_env import ArgumentError
from usnet_env.processes import Limits, ProcessDied, ProcessPool, SendError

LINUX = sys.platform.startswith("linux")


@pytest.mark.slow
@pytest.mark.skipif(not LINUX, reason="memory is limited on Linux only")
def test_a_task_that_ends_hangs_or_eats_memory_fails_with_its_reason_and_the_others_go_on():
    tasks = ["first", "exit", "memory", "little memory", "raise", "fork", "hang", "last"]
    with ProcessPool(play, 2, Limits(seconds=1, megabytes=200)) as pool:
        outcomes = {outcome.task: outcome for outcome in pool.run(tasks)}
    assert set(outcomes) == set(tasks)
    results = {task: outcome.result for task, outcome in outcomes.items() if outcome.error is None}
    assert results == {"first": "first", "little memory": 20_000_000, "fork": "fork", "last": "last"}
    assert isinstance(outcomes["exit"].error, ProcessDied)
    assert str(outcomes["exit"].error) == "it ended its process with status 0, in part exit"
    assert str(outcomes["hang"].error) == "it took longer than 1 seconds, the time limit, in part hang"
    assert str(outcomes["memory"].error) == "it needed more than 200 MB, the memory limit"
    assert isinstance(outcomes["raise"].error, KeyError)


@pytest.mark.slow
def test_threads_that_stay_are_named_and_do_not_stop_the_program():
    with ProcessPool(play, 1) as pool:
        outcomes = list(pool.run(["thread", "kill", "thread", "sys.exit"]))
    assert [type(outcome.error) for outcome in outcomes] == [type(None), ProcessDied, type(None), SystemExit]
    assert "SIGKILL" in str(outcomes[1].error)
    assert pool.left_threads == [("sleeper", "thread")]


def test_a_function_that_cannot_be_sent_is_refused_at_once():
    with pytest.raises(SendError, match="lambda"):
        ProcessPool(partial(play, lambda: None), 1)


@pytest.mark.parametrize(("name", "value"), [("seconds", 0), ("seconds", float("nan")), ("megabytes", -1)])
def test_limits_are_positive_numbers(name, value):
    with pytest.raises(ArgumentError, match=name):
        Limits(**{name: value})

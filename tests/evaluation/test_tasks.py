"""Tasks run in this process, in others and on a cluster."""

import os
import signal
import subprocess
import sys
import time

import pytest

from usnet_env.config import MissingExtraError
from usnet_env.evaluation import EvaluationError
from usnet_env.evaluation.tasks import map_tasks


class Counting:
    """A function with a state, and one that can only be sent by value."""

    def __init__(self):
        self.calls = 0
        self.square = lambda number: number**2

    def __call__(self, number):
        self.calls += 1
        time.sleep(0.02 * (number % 3))
        return number, self.square(number), self.calls, os.getpid()


def count_calls(workers):
    """Results come in order, and the state of a worker stays."""
    found = list(map_tasks(Counting(), range(12), workers=workers))
    assert [each[:2] for each in found] == [(number, number**2) for number in range(12)]
    processes = {each[3] for each in found}
    assert (processes == {os.getpid()}) == (workers == 1)
    assert sum(max(each[2] for each in found if each[3] == process) for process in processes) == 12


def fail(number):
    if number == 2:
        raise LookupError("no task 2")
    return number


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_what_the_function_raises_reaches_the_caller(workers):
    with pytest.raises(LookupError, match="no task 2"):
        list(map_tasks(fail, range(4), workers=workers))


def end(number):
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_a_worker_that_is_killed_ends_the_call_in_one_sentence_and_the_next_one_works():
    with pytest.raises(EvaluationError, match=r"^a worker process was ended"):
        list(map_tasks(end, range(6), workers=2))
    count_calls(workers=2)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows keeps the number of a parent that has ended")
def test_workers_end_whose_parent_ended_while_they_started(fresh_process):
    """What they hold of the standard output would keep the call waiting."""
    fresh_process.run(
        """
import os
from usnet_env.evaluation.tasks import map_tasks

def tasks():
    yield from range(2)
    os._exit(0)  # when both are sent, to workers that don't run yet

list(map_tasks(abs, tasks(), workers=2))
"""
    )


def test_there_are_no_more_workers_than_tasks():
    ((_, _, _, process),) = map_tasks(Counting(), [1], workers=1_000)
    assert process == os.getpid()
    assert list(map_tasks(Counting(), [], workers=1_000)) == []
    count_calls(workers=1)


SCRIPT = """
from usnet_env import Detection, evaluate, register_detector, register_follow_strategy

class All:
    def reset(self, seed=None):
        pass

    def detect(self, window):
        return Detection(window.alive, window.alive)

register_detector("all-of-this-script", All)
register_follow_strategy("test-mirror", lambda inputs: -inputs.head_velocity[:, 0], lags=1)
settings = {"follow": "test-mirror", "clusters": 2, "uavs": 10, "observation_steps": 10}
for how in ({}, {"workers": 2}, {"isolate": True}):
    result = evaluate("USNET/MultiCluster-v0", "all-of-this-script", episodes=3, env_kwargs=settings, **how)
    print([entry["metrics"]["J"]["mean"] for entry in result.summary], result.failures)
"""


def test_what_a_script_registers_works_in_its_workers(tmp_path):
    """Without a guard: no worker imports the script."""
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["[1.8] {}"] * 3


def test_without_ray_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.setitem(sys.modules, "ray.util.joblib", None)
    with pytest.raises(MissingExtraError, match=r"`pip install 'usnet\[ray\]'`"):
        list(map_tasks(fail, [0, 1], workers=2, backend="ray"))
    assert list(map_tasks(fail, [0, 1], workers=2, backend="serial")) == [0, 1]


RAY = """
import os
from usnet_env import evaluate
from usnet_env.evaluation import EvaluationError
from usnet_env.evaluation.tasks import map_tasks
from pandas.testing import assert_frame_equal
from sample_detectors import RandomThird, untimed

settings = {"clusters": 3, "uavs": 20, "observation_steps": 20, "max_rounds": 5}
here, there = (
    evaluate("USNET/MultiCluster-v0", [RandomThird(), "none"], episodes=40, env_kwargs=settings, **how)
    for how in ({}, {"workers": 2, "backend": "ray"})
)
assert_frame_equal(untimed(here), untimed(there))
try:
    print(list(map_tasks(lambda number: os._exit(1), range(2), workers=2, backend="ray")))
except EvaluationError as error:
    print(error)
"""


@pytest.mark.slow
def test_on_a_ray_cluster_the_rows_are_the_same(fresh_process, monkeypatch):
    pytest.importorskip("ray")
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([os.path.dirname(__file__), os.environ.get("PYTHONPATH", "")]))
    assert "a worker process was ended" in fresh_process.run(RAY)

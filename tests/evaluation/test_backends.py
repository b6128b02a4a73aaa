"""Where episodes are played changes no row; a Ray worker or node that ends loses none and doubles none."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import ray_cluster
from sample_detectors import AllAlive, Followed, NoUav, Policy, RandomThird

from usnet_env import ArgumentError, evaluate
from usnet_env.processes import ray_pool

MULTI = "USNET/MultiCluster-v0"
SMALL = {"clusters": 3, "uavs": 20, "observation_steps": 20, "max_rounds": 5}
HERE = Path(__file__).parent


def untimed(rows):
    return [{name: value for name, value in row.items() if name != "seconds_per_round"} for row in rows]


def test_child_processes_play_the_same_rows_as_this_one():
    asked = {"episodes": 3, "seed": 1, "env_kwargs": SMALL}
    detectors = [RandomThird(), Followed(2), Policy()]
    here, there = (evaluate(MULTI, detectors, backend=name, **asked) for name in ("serial", "processes"))
    assert untimed(here.rows) == untimed(there.rows)


SCRIPT = """
import usnet_env
from usnet_env import Detection, evaluate

if {guard}:
    # As in a notebook: nothing that is made here can be imported in a worker process.
    class Mine:
        def reset(self, seed=None): ...
        def detect(self, window):
            return Detection(window.alive, window.alive)

    usnet_env.register_follow_strategy("mirrored", lambda inputs: -inputs.head_velocity[:, 0], lags=1)
    usnet_env.register_detector("mine", Mine)
    arguments = dict(clusters=3, uavs=20, observation_steps=20, max_rounds=5, follow="mirrored")
    result = evaluate("USNET/MultiCluster-v0", ["mine", Mine()], episodes=2, workers=2, env_kwargs=arguments)
    print([(entry["detector"], entry["episodes"]) for entry in result.summary])
"""


@pytest.mark.slow
@pytest.mark.parametrize("guard", ["__name__ == '__main__'", "True"])
def test_a_script_s_own_parts_reach_the_workers_and_a_missing_guard_is_named(tmp_path, guard):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(guard=guard))
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    if guard == "True":
        assert done.returncode == 1
        last = done.stderr.strip().splitlines()[-1]
        assert last.startswith("usnet_env.evaluation.errors.EvaluationError: a worker process ")
        assert 'if __name__ == "__main__":' in last
    else:
        assert (done.returncode, done.stdout) == (0, "[('mine', 2), ('mine #2', 2)]\n"), done.stderr


def test_a_detector_that_cannot_be_pickled_needs_one_worker():
    detector = AllAlive()
    detector.tool = (number for number in range(3))
    with pytest.raises(ArgumentError, match=r"^workers must be 1"):
        evaluate(MULTI, detector, episodes=2, env_kwargs=SMALL, workers=2)
    assert len(evaluate(MULTI, detector, episodes=2, env_kwargs=SMALL).rows) == 2


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"backend": "dask"}, ["backend must be None or one of serial, processes, ray", "'dask'"]),
        ({"backend": 3}, ["backend", "3"]),
        ({"address": "auto"}, ["address must be None unless backend is 'ray'"]),
        ({"backend": "ray", "address": 7}, ["address", "7"]),
        ({"backend": "serial", "workers": 2}, ["workers must be 1 if backend is 'serial'"]),
        ({"backend": "serial", "time_limit": 1}, ["time_limit and memory_limit must be None if backend is 'serial'"]),
    ],
)
def test_bad_arguments_are_one_sentence(changes, words):
    with pytest.raises(ArgumentError) as refused:
        evaluate(MULTI, NoUav(), episodes=1, env_kwargs=SMALL, **changes)
    assert all(word in str(refused.value) for word in words), refused.value


def test_without_ray_the_extra_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ArgumentError, match=r"^backend must be another one .* `pip install 'usnet\[ray\]'`"):
        evaluate(MULTI, NoUav(), episodes=1, env_kwargs=SMALL, backend="ray", out=tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


class FakeRay:
    """A cluster in this process; the actors of the numbers in ``dying`` end with their first task."""

    def __init__(self, dying, starts=True):
        self.dying, self.starts, self.actors = dying, starts, 0

    class exceptions:
        class RayError(Exception):
            pass

    def is_initialized(self):
        return True

    def remote(self, **_):
        return lambda kind: FakeActorClass(self)

    def put(self, data):
        return data

    def wait(self, refs, num_returns=1, timeout=None):
        return refs, []

    def get(self, ref):
        return ref[0]()

    def kill(self, actor):
        actor.dead = True


class FakeActorClass:
    def __init__(self, ray):
        self.ray = ray

    def remote(self, function, limits):
        self.ray.actors += 1
        return FakeActor(self.ray, self.ray.actors)


class FakeActor:
    def __init__(self, ray, number):
        self.ray, self.number, self.dead = ray, number, False

    def __getattr__(self, name):
        return FakeMethod(self, name)


class FakeMethod:
    def __init__(self, actor, name):
        self.actor, self.name = actor, name

    def remote(self, *arguments):
        def call():
            actor = self.actor
            starting = self.name == "wait_until_made"
            if (actor.number in actor.ray.dying and not starting) or (starting and not actor.ray.starts):
                raise FakeRay.exceptions.RayError(f"actor {actor.number} died")
            return ray_pool.Outcome(arguments[0], arguments[0] * 10) if self.name == "run" else []

        return (call, self)


def run_fake(monkeypatch, fake, tasks, workers=2):
    monkeypatch.setitem(sys.modules, "ray", fake)
    pool = ray_pool.RayPool(abs, workers)
    return list(pool.run(tasks))


def test_tasks_of_workers_that_end_are_run_again_once_each(monkeypatch):
    outcomes = run_fake(monkeypatch, FakeRay(dying={1, 3}), range(20))
    assert sorted(outcome.task for outcome in outcomes) == list(range(20))
    assert all(outcome.result == 10 * outcome.task for outcome in outcomes)


def test_a_task_during_which_three_workers_end_has_failed_and_the_others_go_on(monkeypatch):
    outcomes = run_fake(monkeypatch, FakeRay(dying={1, 2, 3}), range(6), workers=1)
    failed = [outcome for outcome in outcomes if outcome.error is not None]
    assert sorted(outcome.task for outcome in outcomes) == list(range(6))
    assert [str(outcome.error) for outcome in failed] == ["3 Ray workers ended during it: actor 3 died"]


def test_workers_that_never_start_are_an_error(monkeypatch):
    with pytest.raises(ray_pool.SendError, match="a Ray worker did not start: actor"):
        run_fake(monkeypatch, FakeRay(dying=set(), starts=False), range(6))


def run_on_cluster(folder, what):
    """Evaluate on a local cluster in a process of its own; returns what it prints."""
    path = os.pathsep.join([str(HERE), str(HERE.parents[1]), os.environ.get("PYTHONPATH", "")])
    settings = {"PYTHONPATH": path, "RAY_USAGE_STATS_ENABLED": "0", "RAY_worker_niceness": "0"}
    done = subprocess.run(
        [sys.executable, HERE / "ray_cluster.py", folder, what],
        env=os.environ | settings,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
@pytest.mark.parametrize("what", ["nothing", "worker", "node"])
def test_on_a_ray_cluster_nothing_is_lost_or_doubled(tmp_path, what):
    pytest.importorskip("ray")
    found = run_on_cluster(tmp_path / "run", what)
    undisturbed = evaluate(MULTI, ray_cluster.DETECTORS, **ray_cluster.ASKED)
    assert untimed(found["rows"]) == untimed(undisturbed.rows)
    assert found["in_file"] == len(undisturbed.rows)
    assert 4 <= found["kept"][0] < len(undisturbed.rows)  # it was disturbed in mid-run

"""Isolated detectors: cheats find nothing, failures end nothing else, and the rows are those of their seeds."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from sample_detectors import AllAlive, Ending, Followed, Policy, RandomThird

from usnet_env import ArgumentError, Detection, Window, evaluate
from usnet_env.evaluation import EvaluationError, runner
from usnet_env.evaluation.agents import as_agent
from usnet_env.evaluation.episode import episode_seeds, play_episode
from usnet_env.evaluation.isolation import IsolatedAgent
from usnet_env.evaluation.store import RunStore
from usnet_env.processes import Limits

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs Linux or macOS")
MULTI = "USNET/MultiCluster-v0"
SMALL = {"clusters": 3, "uavs": 20, "observation_steps": 20, "max_rounds": 5}
CHEATED = {"clusters": 4, "uavs": 20, "observation_steps": 20, "max_rounds": 5, "follow": "f3"}
CHEATS = Path(__file__).parents[1] / "detectors" / "checks"
SECRET = "00112233445566778899aabbccddeeff"


def untimed(rows, *more):
    left_out = ("seconds_per_round", *more)
    return [{name: value for name, value in row.items() if name not in left_out} for row in rows]


HONEST = "random(count=2)"


def play_cheats(monkeypatch, names, **more):
    monkeypatch.syspath_prepend(CHEATS)
    detectors = {name: f"guessing_cheats:{name}" for name in names} | {HONEST: HONEST}
    return evaluate(MULTI, detectors, episodes=2, env_kwargs=CHEATED, **more)


def check_isolated(monkeypatch, names):
    """Isolated cheats have the rows of `random`."""
    isolated = play_cheats(monkeypatch, names, isolate=True)
    rows = {label: [row for row in isolated.rows if row["detector"] == label] for label in (*names, HONEST)}
    for name in names:
        assert untimed(rows[name], "detector") == untimed(rows[HONEST], "detector"), name


def check_cheats(monkeypatch, names):
    """Cheats that name all heads in the process of the environment score like `random` once they are isolated."""
    found = play_cheats(monkeypatch, names)
    assert {label: found[label]["exact"]["mean"] for label in (*names, HONEST)} == dict.fromkeys(names, 1.0) | {
        HONEST: 0.0
    }
    check_isolated(monkeypatch, names)


def test_peeking_and_searching_finds_nothing_in_isolation(monkeypatch):
    check_cheats(monkeypatch, ["PeeksIntoFrames", "SearchesSwarms"])


@pytest.mark.slow
def test_more_cheats_find_nothing_in_isolation(monkeypatch):
    # One of these cheats hides where the checks are loaded, and another test of this process may have loaded them.
    monkeypatch.delitem(sys.modules, "detectors.checks", raising=False)
    check_cheats(monkeypatch, ["PeeksIntoMemory", "PeeksWhereNothingIsChecked", "SearchesItsSeed"])


@pytest.mark.slow
def test_an_environment_in_a_variable_of_a_module_is_not_found_in_isolation(monkeypatch):
    make = runner.make_environment

    def keep(*arguments):
        made = make(*arguments)
        for module in (runner, sys.modules["__main__"]):
            monkeypatch.setattr(module, "environment_of_this_test", made, raising=False)
        return made

    monkeypatch.setattr(runner, "make_environment", keep)
    check_cheats(monkeypatch, ["PeeksIntoModules", "PeeksIntoTheMainModule"])


@pytest.mark.slow
def test_what_changes_the_referee_changes_nothing_in_isolation(monkeypatch):
    check_isolated(
        monkeypatch, ["PatchesTheScore", "PatchesCode", "PatchesAnEnvironment", "PatchesARival", "PatchesNumPy"]
    )


def test_a_detector_s_code_is_loaded_in_its_own_process_only(tmp_path, monkeypatch):
    (tmp_path / "loads_here.py").write_text("from sample_detectors import AllAlive as Loaded\n")
    monkeypatch.syspath_prepend(tmp_path)
    result = evaluate(MULTI, "loads_here:Loaded", episodes=1, env_kwargs=SMALL, isolate=True)
    assert result["loads_here:Loaded"]["J"]["mean"] == 1 + 17 / 20
    assert "loads_here" not in sys.modules


def test_rows_are_those_of_their_seeds_and_can_be_played_again(tmp_path):
    detectors = [RandomThird(), Followed(2), Policy()]
    first = evaluate(MULTI, detectors, episodes=3, seed=4, env_kwargs=SMALL, isolate=True, out=tmp_path)
    secret = first.config["secret"]
    assert json.loads((tmp_path / "run.json").read_text())["secrets"] == [secret]
    env = gym.make(MULTI, **SMALL)
    for row in first.rows:
        seeds = row["swarm_seed"], row["detector_seed"]
        assert seeds == episode_seeds(4, row["episode"], secret)
        assert seeds[0] != episode_seeds(4, row["episode"])[0]
        (detector,) = (each for each in detectors if row["detector"].startswith(type(each).__name__))
        here = play_episode(env, as_agent(detector), row["detector"], row["episode"], seeds)
        assert untimed([here]) == untimed([row])
    again = evaluate(env, detectors, episodes=3, seed=4, isolate=True, secret=secret, time_limit=60)
    assert untimed(again.rows) == untimed(first.rows)


def test_a_whole_detection_comes_from_the_process_as_an_episode_file_keeps_it():
    (window,) = (Window.from_observation(gym.make(MULTI, **SMALL).reset(seed=seed)[0]) for seed in [3])
    agent = IsolatedAgent(Telling(), Limits())
    try:
        agent.reset(5)
        there, here = agent.detect(window), Telling().detect(window)
    finally:
        agent.close()
    for name in ("candidates", "scores", "clusters", "leader", "attention"):
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name))
    assert there.extras.keys() == here.extras.keys() - {"secret"}
    for name in ("probability", "heads"):
        np.testing.assert_array_equal(there.extras[name], here.extras[name])
    assert there.extras["reasons"] == ["because"]


@pytest.mark.parametrize(
    "call",
    [
        "evaluation.evaluate('USNET/MultiCluster-v0', 'none', episodes=1, isolate=True)",
        "evaluation.evaluate_suite('controls', 'none', cells=['decoys'], episodes=1)",
        pytest.param(
            "evaluation.evaluate_suite('controls', 'none', cells=['decoys'], episodes=2, workers=2, isolate=False)",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_script_without_a_guard_is_told_so(tmp_path, call):
    (tmp_path / "script.py").write_text(f"from usnet_env import evaluation\n{call}\n")
    done = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert "a worker process did not start: it ended its process with status 1. A worker process imports the" in last
    assert last.endswith('in a block that begins with `if __name__ == "__main__":`.')


@pytest.mark.slow
def test_workers_change_nothing():
    asked = {"episodes": 3, "env_kwargs": SMALL, "isolate": True, "secret": SECRET}
    one, two = (evaluate(MULTI, [RandomThird(), Followed(2)], workers=workers, **asked) for workers in (1, 2))
    assert untimed(one.rows) == untimed(two.rows)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is limited on Linux only")
def test_detectors_that_end_hang_or_eat_memory_fail_and_the_others_play_on(tmp_path):
    detectors = [Ending("hang"), Ending(), Ending("memory"), AllAlive()]
    limits = {"time_limit": 2, "memory_limit": 1000}
    with pytest.raises(EvaluationError) as failed:
        evaluate(MULTI, detectors, episodes=2, env_kwargs=SMALL, isolate=True, out=tmp_path, **limits)
    assert str(failed.value) == (
        "detector \"Ending(how='hang')\" failed in episode 0, round 2: it took longer than 2 seconds, the time limit. "
        "detector 'Ending' failed in episode 0, round 2: it ended its process with status 0. "
        "detector \"Ending(how='memory')\" failed in episode 0, round 2: MemoryError: it needed more than 1000 MB, the "
        "memory limit."
    )
    assert [row["detector"] for row in failed.value.result.rows] == ["AllAlive"] * 2
    rows = (tmp_path / "episodes.csv").read_text().splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == ["AllAlive"] * 2


class Telling:
    """Fills every part of a detection."""

    def reset(self, seed=None):
        pass

    def detect(self, window):
        each = np.arange(window.uavs)
        extras = {"probability": each / 20, "heads": np.array([2]), "reasons": ["because"], "secret": object()}
        return Detection(each == 2, each, each % 3, np.full(window.uavs, 2), np.eye(window.uavs), extras)


class Interrupting(IsolatedAgent):
    """Interrupts the program in the episode of a given number, counted over all detectors."""

    left = 10**9
    agents = []

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.agents.append(self)

    def reset(self, seed):
        Interrupting.left -= 1
        if Interrupting.left == 0:
            raise KeyboardInterrupt
        super().reset(seed)


def test_an_interrupted_run_writes_its_secret_and_resumes_with_another(tmp_path, monkeypatch):
    import usnet_env.evaluation.workers as workers

    def add_secret(store, secret):
        assert all(agent._process._process.exitcode is not None for agent in Interrupting.agents)
        return write(store, secret)

    write = RunStore.add_secret
    monkeypatch.setattr(RunStore, "add_secret", add_secret)
    monkeypatch.setattr(workers, "IsolatedAgent", Interrupting)
    asked = {"episodes": 3, "env_kwargs": SMALL, "isolate": True, "out": tmp_path}
    detectors = [RandomThird(), AllAlive()]
    Interrupting.left = 4  # the second detector's second episode
    with pytest.raises(KeyboardInterrupt):
        evaluate(MULTI, detectors, **asked)
    assert len((tmp_path / "episodes.csv").read_text().splitlines()) == 1 + 3
    result = evaluate(MULTI, detectors, **asked)
    secrets = json.loads((tmp_path / "run.json").read_text())["secrets"]
    assert len(set(secrets)) == 2
    swarms = [
        [row["swarm_seed"] for row in result.rows if row["detector"] == name] for name in ("RandomThird", "AllAlive")
    ]
    assert swarms[0] == swarms[1]
    first, last = (episode_seeds(0, episode, secrets[part])[0] for episode, part in ((1, 0), (2, 1)))
    assert swarms[0][1:] == [first, last]
    with pytest.raises(ArgumentError, match="rows of another seed"):
        evaluate(MULTI, detectors, **asked, secret=SECRET)


def test_no_row_on_disk_has_the_swarm_of_an_episode_that_others_have_still_to_play(tmp_path, monkeypatch):
    import usnet_env.evaluation.workers as workers

    kept = []

    class Looking(IsolatedAgent):
        def reset(self, seed):
            path = tmp_path / "episodes.csv"
            kept.append(len(path.read_text().splitlines()) - 1 if path.exists() else 0)
            super().reset(seed)

    monkeypatch.setattr(workers, "IsolatedAgent", Looking)
    evaluate(MULTI, [RandomThird(), AllAlive()], episodes=2, env_kwargs=SMALL, isolate=True, out=tmp_path)
    assert kept == [0, 0, 2, 2]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"isolate": "yes"}, ["isolate", "'yes'"]),
        ({"secret": "xyz"}, ["secret", "32 hexadecimal digits", "'xyz'"]),
        ({"secret": SECRET, "isolate": False}, ["secret must be None unless isolate"]),
    ],
)
def test_bad_arguments_are_one_sentence(changes, words):
    with pytest.raises(ArgumentError) as refused:
        evaluate(**({"env": MULTI, "detector": "none", "episodes": 1, "isolate": True} | changes))
    assert all(word in str(refused.value) for word in words)


def test_the_command_says_which_options_go_with_a_secret(run):
    words = ["evaluate", "--detector", "none", "--episodes", "1"]
    status, out, err = run(*words, "--secret", "zz")
    assert (status, out) == (2, "")
    assert err == "usnet: --secret gives the seeds of an isolated run: it needs --isolate or --suite.\n"
    refused = "usnet: secret must be None or 32 hexadecimal digits (0 to 9, a to f), got 'zz'.\n"
    for isolated in (["--isolate"], ["--suite", "paper"]):
        assert run(*words, "--secret", "zz", *isolated) == (2, "", refused)


def test_a_wrong_name_or_what_cannot_be_sent_is_refused_and_leaves_nothing(tmp_path):
    with pytest.raises(ArgumentError, match=r"^detector must be one of .*'lagged-regresion'"):
        evaluate(MULTI, "lagged-regresion", episodes=1, env_kwargs=SMALL, isolate=True, out=tmp_path / "run")
    detector = AllAlive()
    detector.tool = (number for number in range(3))
    with pytest.raises(ArgumentError, match=r"^isolate must be false for a detector that cannot be sent"):
        evaluate(MULTI, detector, episodes=1, env_kwargs=SMALL, isolate=True, out=tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_an_answer_that_is_none_is_the_detector_s_failure():
    agent = IsolatedAgent(AllAlive(), Limits())
    agent._process.close()
    agent._process.call = lambda values, arrays: ({}, {"candidates": arrays["alive"]})
    observation, _ = gym.make(MULTI, **SMALL).reset(seed=0)
    with pytest.raises(ArgumentError, match=r"^an answer must hold candidates and scores"):
        agent.answer(observation)


def test_a_run_that_was_killed_before_it_wrote_its_secret_can_be_read_and_resumed(tmp_path):
    asked = {"episodes": 2, "env_kwargs": SMALL, "isolate": True, "out": tmp_path}
    whole = evaluate(MULTI, "none", **asked, secret=SECRET)
    description = json.loads((tmp_path / "run.json").read_text())
    assert description.pop("secrets") == [SECRET]
    (tmp_path / "run.json").write_text(json.dumps(description))
    without = evaluate(MULTI, "none", **asked)
    assert "secret" not in without.config
    again = evaluate(MULTI, "none", **asked, secret=SECRET)
    assert again.config["secret"] == SECRET
    assert list(again.rows) == list(whole.rows)
    assert json.loads((tmp_path / "run.json").read_text())["secrets"] == [SECRET]

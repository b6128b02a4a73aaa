"""A detector that fails is a row with its reason; the other episodes and detectors go on."""

import sys
from pathlib import Path

import numpy as np
import pytest
from pandas.testing import assert_frame_equal
from sample_detectors import AllAlive, Answering, Ending, FailingWithOne, untimed

from usnet_env import ArgumentError, Detection, evaluate
from usnet_env.evaluation import METRICS, EvaluationResult

MULTI = "USNET/MultiCluster-v0"
on_linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is limited on Linux only")
SMALL = {"clusters": 3, "uavs": 20, "observation_steps": 20, "max_rounds": 5}


def play(detector, **how):
    return evaluate(MULTI, detector, **{"episodes": 2, "env_kwargs": SMALL} | how)


@pytest.mark.parametrize(
    ("detector", "how"),
    [
        (FailingWithOne(), {}),
        ("sample_detectors:FailingWithOne", {}),
        (FailingWithOne(), {"isolate": True}),
        pytest.param("sample_detectors:FailingWithOne", {"workers": 2}, marks=pytest.mark.slow),
        pytest.param("sample_detectors:FailingWithOne", {"isolate": True}, marks=pytest.mark.slow),
    ],
)
def test_a_failure_names_the_line_of_the_detector_and_no_folder(detector, how):
    result = play([detector, AllAlive()], **how)
    source = Path(__file__).with_name("sample_detectors.py").read_text().splitlines()
    (line,) = (number for number, text in enumerate(source, 1) if "no luck" in text)
    failed = result.rows[result.rows["error"] != ""]
    (error,) = failed["error"].unique()
    assert error == f"its warm-up: ZeroDivisionError: no luck (sample_detectors.py, line {line}, in detect)"
    assert failed[list(METRICS)].isna().all(axis=None)
    assert list(failed["heads"]) == [3, 3]
    label, _ = result.detectors
    assert [(entry["episodes"], entry["failed"]) for entry in result.summary] == [(0, 2), (2, 0)]
    assert result[label] == {}
    assert list(result.failures) == [label]
    assert f"{label!r} failed in 2 of 2 episodes" in result.failures[label]


@pytest.mark.parametrize(
    ("detector", "word"),
    [
        (Answering(Detection(np.zeros(19), np.zeros(19))), "all 20 UAVs"),
        (Answering(np.ones(20)), "usnet_env.Detection"),
        (Answering(SystemExit(0)), "SystemExit: 0"),
        (Answering(ArgumentError("clusters must be 3.")), "its warm-up: clusters must be 3 ("),
        (Answering(IndexError("a\nb")), "its warm-up: IndexError: a b ("),
        ("sample_detectors:Answering(answer=3)", "usnet_env.Detection"),
    ],
)
def test_whatever_a_detector_does_is_one_line(detector, word):
    (error,) = play({"x": detector}).rows["error"].unique()
    assert word in error
    assert len(error.splitlines()) == 1


class Unmakable(AllAlive):
    def __init__(self, size=1):
        raise OSError("no model file " + "x" * 1000)


@pytest.mark.parametrize("how", [{}, pytest.param({"isolate": True}, marks=pytest.mark.slow)])
def test_a_constructor_that_raises_is_a_failure_of_that_detector_only(how):
    result = play(["test_failures:Unmakable", "none"], **how)
    (sentence,) = result.failures.values()
    assert "its constructor: " in sentence
    assert "OSError: no model file xxx" in sentence
    assert len(sentence) <= 302
    assert result["none"]["J"]["mean"] == 5


class FailingOnce(AllAlive):
    episodes = 0

    def reset(self, seed=None):
        self.episodes += 1

    def detect(self, window):
        if self.episodes == 3:
            raise ZeroDivisionError("nothing\nto divide by")
        return super().detect(window)


def test_an_episode_in_the_middle_fails_alone_and_is_played_again(tmp_path):
    detectors = {"none": "none", "all": FailingOnce()}
    result = play(detectors, episodes=5, out=tmp_path)
    failed = result.rows[result.rows["error"] != ""]
    assert list(failed["episode"]) == [2]
    assert failed["error"].item().startswith("round 1: ZeroDivisionError: nothing to divide by (test_")
    assert [(entry["episodes"], entry["failed"]) for entry in result.summary] == [(5, 0), (4, 1)]
    assert result["all"]["redundancy"]["mean"] == 17 / 20  # of the other four
    assert EvaluationResult.load(tmp_path).summary == result.summary
    again = play(detectors, episodes=5, out=tmp_path)  # its fourth episode
    assert not again.failures
    assert_frame_equal(untimed(again), untimed(play(detectors | {"all": AllAlive()}, episodes=5)))


@on_linux
def test_detectors_that_end_hang_or_eat_memory_fail_and_the_others_play_on():
    reasons = {
        "hang": "round 2: it took longer than 3 seconds, the time limit",
        "os._exit": "round 2: its process ended itself with status 0",
        "kill": "round 2: its process was ended by SIGKILL",
        "memory": "round 2: MemoryError: it needed more than 1000 MB, the memory limit",
    }
    detectors = {how: Ending(how) for how in reasons} | {"good": AllAlive()}
    result = play(detectors, episodes=1, time_limit=3, memory_limit=1000)
    assert dict(zip(result.rows["detector"], result.rows["error"], strict=True)) == reasons | {"good": ""}


@on_linux
def test_a_hard_limit_that_is_there_already_is_respected(fresh_process):
    program = """
import resource
from usnet_env.evaluation.child import limit_memory
hard = 20_000_000_000
resource.setrlimit(resource.RLIMIT_DATA, (hard, hard))
with limit_memory(10_000_000):
    print(resource.getrlimit(resource.RLIMIT_DATA) == (hard, hard))
with limit_memory(100):
    print(resource.getrlimit(resource.RLIMIT_DATA)[0] < hard)
print(resource.getrlimit(resource.RLIMIT_DATA) == (hard, hard))
"""
    assert fresh_process.run(program).split() == ["True"] * 3

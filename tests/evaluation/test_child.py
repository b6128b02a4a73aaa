"""A detector in a child process: the same answers, and the reason when it ends."""

from __future__ import annotations

import gymnasium as gym
import pytest
from sample_detectors import Ending

from usnet_env.evaluation import EvaluationError
from usnet_env.evaluation.child import ChildDetector, limit_memory

MULTI = "USNET/MultiCluster-v0"
SMALL = {"clusters": 3, "uavs": 20, "observation_steps": 20}
resource = pytest.importorskip("resource")


@pytest.fixture(scope="module")
def observation():
    return gym.make(MULTI, **SMALL).reset(seed=3)[0]


@pytest.fixture
def start():
    """Start detectors in child processes, which end with the test."""
    children = []

    def make(*arguments):
        children.append(ChildDetector(*arguments))
        return children[-1]

    yield make
    for child in children:
        child.close()


def test_a_child_that_ended_says_why(start, observation):
    child = start(Ending("os._exit", first=True))
    child.reset(0)
    assert child.running
    with pytest.raises(EvaluationError, match=r"^its process ended itself with status 0$"):
        child.answer(observation)
    assert not child.running


def test_an_exception_keeps_the_child_alive(start, observation):
    child = start(Ending("raise", first=True))
    for _ in range(2):
        with pytest.raises(
            EvaluationError, match=r"ZeroDivisionError: .* \(sample_detectors\.py, line \d+, in <lambda>\)"
        ):
            child.answer(observation)
        assert child.running
    with pytest.raises(EvaluationError, match="no_such_module"):
        start("no_such_module:Class")


def test_memory_is_limited_in_the_block_and_a_hard_limit_stays():
    with pytest.raises(MemoryError, match="more than 100 MB, the memory limit"), limit_memory(100):
        bytearray(1_000_000_000)
    with limit_memory(100):
        bytearray(50_000_000)
    bytearray(200_000_000)


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

"""A detector in a child process: the same answers, and the reason when it ends."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from sample_detectors import Ending, Followed, Policy

from usnet_env import Window
from usnet_env.evaluation.child import ChildDetector
from usnet_env.evaluation.errors import ChildError
from usnet_env.evaluation.play import as_agent
from usnet_env.evaluation.tasks import limit_memory, pack, unpack

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


def test_answers_are_those_of_the_detector_in_this_process(start, observation):
    child, here = start(Followed(2)), Followed(2)
    window = Window.from_observation(observation)
    for detector in (child, here):
        detector.reset(5)
    there, expected = child.detect(window), here.detect(window)
    for name in ("candidates", "scores", "clusters"):
        np.testing.assert_array_equal(getattr(there, name), getattr(expected, name))
    answer = child.answer(observation)
    np.testing.assert_array_equal(answer.scores, expected.scores)
    assert answer.seconds > 0
    policy, agent = start(Policy()), as_agent(Policy())
    for player in (policy, agent):
        player.reset(0)
    for _ in range(2):
        np.testing.assert_array_equal(policy.answer(observation).candidates, agent.answer(observation).candidates)


def test_a_child_that_ended_says_why_and_starts_again(start, observation):
    child = start(Ending(first=True), 1.0)
    for how, reason in (("os._exit", "ended itself with status 0"), ("kill", "was ended by SIGKILL")):
        child = start(Ending(how, first=True))
        child.reset(0)
        assert child.running
        with pytest.raises(ChildError, match=reason):
            child.answer(observation)
        assert not child.running
        child.reset(0)
        assert child.running
    child = start(Ending("hang", first=True), 0.5)
    with pytest.raises(ChildError, match=r"it took longer than 0\.5 seconds, the time limit"):
        child.answer(observation)
    assert not child.running


def test_an_exception_keeps_the_child_alive(start, observation):
    child = start(Ending("raise", first=True))
    for _ in range(2):
        with pytest.raises(ChildError, match=r"ZeroDivisionError: .* \(sample_detectors\.py, line \d+, in <lambda>\)"):
            child.answer(observation)
        assert child.running
    with pytest.raises(ChildError, match="no_such_module"):
        start("no_such_module:Class").reset(0)


NUMBERS = st.one_of(
    arrays(np.float64, array_shapes()), arrays(np.int64, array_shapes()), arrays(np.bool_, array_shapes(min_dims=0))
)


@given(
    st.dictionaries(st.text(), st.integers() | st.text() | st.none()), st.dictionaries(st.sampled_from("abc"), NUMBERS)
)
def test_any_plain_data_come_back(values, parts):
    found, back = unpack(pack(values, parts))
    assert found == values
    assert back.keys() == parts.keys()
    for name, part in parts.items():
        np.testing.assert_array_equal(back[name], part)
        assert np.asarray(back[name]).dtype == part.dtype


def test_objects_are_not_unpickled():
    with pytest.raises(ValueError, match="allow_pickle"):
        unpack(pack({}, {"x": np.array([object()])}))


def test_memory_is_limited_in_the_block_and_a_hard_limit_stays():
    with pytest.raises(MemoryError, match="more than 100 MB, the memory limit"), limit_memory(100):
        bytearray(1_000_000_000)
    with limit_memory(100):
        bytearray(50_000_000)
    bytearray(200_000_000)


def test_a_hard_limit_that_is_there_already_is_respected(fresh_process):
    program = """
import resource
from usnet_env.evaluation.tasks import limit_memory
hard = 20_000_000_000
resource.setrlimit(resource.RLIMIT_DATA, (hard, hard))
with limit_memory(10_000_000):
    print(resource.getrlimit(resource.RLIMIT_DATA) == (hard, hard))
with limit_memory(100):
    print(resource.getrlimit(resource.RLIMIT_DATA)[0] < hard)
print(resource.getrlimit(resource.RLIMIT_DATA) == (hard, hard))
"""
    assert fresh_process.run(program).split() == ["True"] * 3

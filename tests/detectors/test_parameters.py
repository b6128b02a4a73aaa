"""Constructors from declared arguments, and the interface of detectors."""

from typing import Annotated, Any, ClassVar

import numpy as np
import pytest
from pydantic import Field
from sklearn.base import clone
from threadpoolctl import threadpool_info, threadpool_limits

from detectors import Detector
from usnet_env import ArgumentError, Detection, Window


class First(Detector):
    count: Annotated[int, Field(ge=1)] = 2
    shown: ClassVar[str] = "no argument"

    def detect(self, window):
        return Detection(np.arange(window.uavs) < self.count, self.rng.random(window.uavs))


class Second(First):
    name: Any = None


class Written(First):
    def __init__(self, share=0.5):
        self.share = share


class Inherits(Written):
    unused: int = 3


def test_arguments_are_those_of_the_base_class_and_of_the_class():
    assert Second().get_params() == {"count": 2, "name": None}
    made = Second(3, name="x")
    assert repr(made) == "Second(count=3, name='x')"
    assert clone(made).get_params() == made.get_params()
    assert made.set_params(count=1) is made
    assert made.count == 1
    for refused in (lambda: Second(size=1), lambda: made.set_params(size=1)):
        with pytest.raises((TypeError, ValueError), match="size"):
            refused()
    with pytest.raises(ArgumentError, match="count must be"):
        Second(count=0).reset()
    made.set_params(count=np.uint8(3)).reset()
    assert -made.count == -3


def test_a_constructor_of_its_own_is_kept_and_inherited_and_detect_is_defined():
    for kind in (Written, Inherits):
        assert clone(kind(share=0.2)).get_params() == {"share": 0.2}
        kind(share="anything").reset(0)  # nothing is checked
    with pytest.raises(NotImplementedError, match="Detector must define detect"):
        Detector().detect(window())


def window():
    return Window(np.zeros((3, 4, 3)), np.zeros((2, 4, 3)), np.ones((3, 4)), np.ones(4))


def test_reset_starts_an_episode_and_its_seed_decides():
    detector = First()
    scores = []
    for seed in (5, 5, 6):
        detector.reset(seed)
        scores.append(detector.detect(window()).scores)
    assert np.array_equal(scores[0], scores[1])
    assert not np.array_equal(scores[0], scores[2])
    with pytest.raises(ArgumentError, match="seed must be"):
        detector.reset(-1)


class CountThreads(Detector):
    def detect(self, window):
        self.pools = threadpool_info()
        return Detection(window.alive, np.zeros(window.uavs))


def test_libraries_have_one_thread_while_a_detector_answers():
    detector = CountThreads()
    with threadpool_limits(2):
        before = threadpool_info()
        detector.detect(window())
        assert threadpool_info() == before
    assert {pool["num_threads"] for pool in before} == {2}
    assert {pool["num_threads"] for pool in detector.pools} == {1}

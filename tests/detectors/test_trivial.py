"""The trivial policies."""

import numpy as np
import pytest
from synthetic_windows import flight, window_of

from detectors.baselines.trivial import DestroyAll, NoCandidates, RandomDetector


@pytest.fixture
def window():
    velocity, _ = flight(np.random.default_rng(0), steps=5)
    alive = np.ones(velocity.shape[1], bool)
    alive[[1, 4]] = False
    return window_of(velocity, alive=alive)


@pytest.mark.parametrize("count", [1, 3, 16, 400])
def test_random_names_as_many_living_uavs_as_asked_for(window, count):
    detector = RandomDetector(count=count)
    detector.reset(3)
    for _ in range(20):
        detection = detector.detect(window)
        assert detection.candidates.sum() == min(count, window.alive.sum())
        assert not (detection.candidates & ~window.alive).any()
        assert detection.scores[detection.candidates].min() >= detection.scores[~detection.candidates].max(initial=0)


def test_random_names_all_uavs_equally_often(window):
    detector = RandomDetector()
    detector.reset(0)
    named = sum(detector.detect(window).candidates.astype(int) for _ in range(3000))
    expected = 3000 / window.alive.sum()
    assert np.abs(named[window.alive] - expected).max() < 5 * np.sqrt(expected)


def test_destroy_all_names_the_living_and_none_no_uav(window):
    assert np.array_equal(DestroyAll().detect(window).candidates, window.alive)
    assert not NoCandidates().detect(window).candidates.any()

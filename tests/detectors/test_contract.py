"""Every detector that ships, found by its entry point, keeps the contract of ``detectors.Detector``."""

from importlib.metadata import distribution

import numpy as np
import pytest
from sklearn.base import clone
from synthetic_windows import flight, window_of

from detectors import Detector
from usnet_env import Detection, make_detector

NAMES = sorted(point.name for point in distribution("usnet").entry_points if point.group == "usnet.detectors")
FIELDS = ("candidates", "scores", "clusters", "leader", "attention")


def a_window():
    """14 UAVs in 3 clusters; two are destroyed, and one sample in ten is missing."""
    rng = np.random.default_rng(0)
    velocity, _ = flight(rng, sizes=(5, 3, 3), steps=60)
    alive = np.ones(14, bool)
    alive[[3, 8]] = False
    return window_of(velocity, seen=rng.random((61, 14)) > 0.1, alive=alive, round=2)


def test_all_of_them_are_here():
    assert {"random", "destroy-all", "none", "lagged-correlation", "lagged-regression", "one-per-round"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_detector_keeps_the_contract(name):
    detector, window = make_detector(name), a_window()
    assert isinstance(detector, Detector)
    assert vars(detector) == detector.get_params(), "the constructor stores its arguments and nothing else"
    twin = clone(detector)
    assert twin.get_params() == detector.get_params()

    detector.reset(seed=5)
    twin.reset(seed=5)
    answer, same = detector.detect(window), twin.detect(window)
    assert isinstance(answer, Detection)
    assert len(answer.candidates) == window.uavs
    assert not (answer.candidates & ~window.alive).any(), "a destroyed UAV is never a candidate"
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(answer, field), getattr(same, field), f"{field}: not from the seed alone")
    assert detector.get_params() == twin.get_params() == make_detector(name).get_params()


@pytest.mark.parametrize("name", NAMES)
def test_an_episode_starts_afresh(name):
    detector, window = make_detector(name), a_window()
    detector.reset(seed=1)
    first = detector.detect(window)
    detector.detect(window)
    detector.reset(seed=1)
    again = detector.detect(window)
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(first, field), getattr(again, field))

"""The reader with its shipped weights: what every published number of it rests on."""

import gymnasium as gym
import numpy as np
import pytest
from synthetic_windows import swarm_window

from detectors.reader import Reader
from usnet_env import Window
from usnet_env.evaluation import load_suite

#: Of windows of suites, in which exactly the heads are named: the confidence, p(nobody leads), and the median delay.
ANSWERS = {
    "paper/f2-gauss_markov": (0.999, 0.000, 0.85),
    "paper/f6-waypoint": (0.997, 0.001, 1.05),
    "paper-hard/f1-course": (0.850, 0.000, 1.32),
    "paper-hard/unequal-one": (0.997, 0.000, 2.03),
    "limit/short": (0.887, 0.000, 3.95),
    "limit/noise": (0.950, 0.000, 4.26),
    "limit/correlated_noise": (0.993, 0.000, 7.30),
    "limit/vicsek": (0.670, 0.000, 3.76),
    "controls-v2/straight": (0.525, 0.015, 1.24),
    "controls-v2/independent": (0.999, 1.000, 0.00),
}


@pytest.fixture(scope="module")
def reader():
    made = Reader(policy="map")
    made.reset(0)
    return made


def test_windows_of_suites_have_the_answers_of_the_published_weights(reader):
    """Other answers need new rows of all tables."""
    for seed, (name, known) in enumerate(ANSWERS.items(), start=200):
        suite, cell = name.split("/")
        setting = load_suite(suite).cells[cell]
        env = gym.make(setting.env, disable_env_checker=True, **setting.arguments)
        answer = reader.detect(Window.from_observation(env.reset(seed=seed)[0]))
        assert np.array_equal(answer.candidates, env.unwrapped.swarm.head), name
        delay = answer.extras["delay"][answer.leader != np.arange(len(answer.leader))]
        found = answer.extras["confidence"], answer.extras["p_no_leader"], np.median(delay) if len(delay) else 0.0
        assert found == pytest.approx(known, abs=0.01), name


def test_a_large_swarm_of_which_a_part_follows_has_its_heads(reader):
    """The swarm is read in neighbourhoods, some of which hold no head."""
    flight = {"mobility": "gauss_markov", "observation_steps": 60}
    led, truth = swarm_window(1, follow="f1", head_jitter=True, uavs=130, **flight)
    free, _ = swarm_window(10, follow="none", uavs=90, **flight)
    both = zip(vars(led).values(), vars(free).values(), [1, 1, 1, 0], strict=False)
    answer = reader.detect(Window(*(np.concatenate(parts, axis) for *parts, axis in both)))
    assert np.array_equal(answer.candidates, np.append(truth.head, np.zeros(90, bool)))
    assert answer.extras["p_no_leader"] < 0.01
    assert answer.attention is None
    assert (answer.leader >= 0).all()


def test_a_head_is_found_in_a_neighbourhood_that_is_not_its_own(reader):
    """Without such heads, 50 of the 60 are named: a short window shows little of who moves alike."""
    flight = {"mobility": "straight", "head_jitter": True, "memory": 12, "observation_steps": 20}
    window, truth = swarm_window(0, follow="f2", clusters=60, uavs=205, **flight)
    named = reader.detect(window).candidates
    assert not named[~truth.head].any()
    assert named.sum() > 50

"""Granger causality and factions."""

import numpy as np
import pytest
from synthetic_windows import answer, swarm_window

from detectors.baselines import Factions, Granger
from usnet_env import Window

BOTH = [Granger, Factions]


@pytest.mark.parametrize("kind", BOTH)
def test_heads_of_a_linear_strategy(kind):
    for seed in range(5):
        window, truth = swarm_window(seed, follow="f1")
        detection = answer(kind(), window)
        assert np.array_equal(detection.candidates, truth.head)
        assert np.array_equal(detection.leader, truth.root)


def test_granger_sees_beyond_the_own_past():
    for seed in range(3):
        window, truth = swarm_window(seed, mobility="gauss_markov", head_jitter=True)
        assert np.array_equal(answer(Granger(), window).candidates, truth.head)


def test_a_chain_has_one_leader():
    rng = np.random.default_rng(0)
    lead = rng.standard_normal((62, 3))
    velocity = np.stack([lead[2:], lead[1:-1], lead[:-2]], axis=1)
    position = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(velocity, axis=0)])
    window = Window(position, velocity, np.ones((61, 3)), np.ones(3))
    detection = answer(Factions(max_lag=1), window)
    assert detection.candidates.tolist() == [True, False, False]
    assert detection.leader.tolist() == [0, 0, 0]

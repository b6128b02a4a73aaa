"""Granger causality and factions."""

import numpy as np
import pytest

from detectors.baselines import Factions, Granger
from detectors.baselines.factions import build_following_network, compute_pagerank
from usnet_env import ArgumentError, Window
from usnet_env.swarm import SwarmConfig, advance, start

BOTH = [Granger, Factions]


def swarm_window(seed, **config):
    settings = SwarmConfig(**{"clusters": 3, "uavs": 30, **config})
    generators = [np.random.default_rng(seed)]
    state, seen = advance(settings, start(settings, generators), generators)
    return Window(seen.position[0], seen.velocity[0], seen.seen[0], seen.alive[0]), state.episode(0)


def answer(detector, window, seed=0):
    detector.reset(seed)
    return detector.detect(window)


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


def test_followings_have_one_direction():
    window, truth = swarm_window(2, follow="f1")
    network = build_following_network(window.velocity, window.velocity_seen, 4, 0.4)
    assert not ((network > 0) & (network.T > 0)).any()
    followers = np.flatnonzero(~truth.head)
    assert (network[followers, truth.root[followers]] > 0.9).all()


def test_pagerank_is_a_distribution_that_favours_the_followed():
    network = np.zeros((5, 5))
    network[[1, 2, 3], 0] = 1.0
    rank = compute_pagerank(network)
    assert rank.sum() == pytest.approx(1.0)
    assert rank.argmax() == 0
    np.testing.assert_allclose(rank[1:], rank[1])


def test_a_chain_has_one_leader():
    rng = np.random.default_rng(0)
    lead = rng.standard_normal((62, 3))
    velocity = np.stack([lead[2:], lead[1:-1], lead[:-2]], axis=1)
    position = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(velocity, axis=0)])
    window = Window(position, velocity, np.ones((61, 3)), np.ones(3))
    detection = answer(Factions(max_lag=1), window)
    assert detection.candidates.tolist() == [True, False, False]
    assert detection.leader.tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("detector", "name"),
    [
        (Granger(lags=0), "lags"),
        (Granger(own_lags=-1), "own_lags"),
        (Granger(clusters=0), "clusters"),
        (Factions(max_lag=0), "max_lag"),
        (Factions(threshold=1.5), "threshold"),
    ],
)
def test_a_bad_argument_is_refused(detector, name):
    with pytest.raises(ArgumentError, match=f"{name} must be"):
        detector.reset(0)

"""What holds for the detectors that measure how well one UAV's past tells another's velocity."""

import numpy as np
import pytest
from synthetic_windows import answer, flight, heads_of, swarm_window, window_of

from detectors.baselines import Factions, Granger
from detectors.lagged import LaggedCorrelation, LaggedRegression, OnePerRound

COUNTED = [LaggedRegression(clusters=3), LaggedCorrelation(clusters=3)]


@pytest.mark.parametrize("detector", [LaggedRegression(), LaggedCorrelation(), *COUNTED, Granger(), Factions()])
def test_finds_heads_and_clusters_of_f1(detector):
    for seed in range(4):
        velocity, leader = flight(np.random.default_rng(seed))
        detection = answer(detector, window_of(velocity))
        assert np.array_equal(detection.candidates, heads_of(leader))
        assert np.array_equal(detection.leader, leader)
        for head in np.flatnonzero(heads_of(leader)):
            assert len(set(detection.clusters[leader == head])) == 1
        assert len(set(detection.clusters)) == 3


def test_granger_sees_beyond_the_own_past():
    for seed in range(3):
        window, truth = swarm_window(seed, mobility="gauss_markov", head_jitter=True)
        assert np.array_equal(answer(Granger(), window).candidates, truth.head)


def test_a_chain_has_one_leader():
    lead = np.random.default_rng(0).standard_normal((62, 3))
    detection = answer(Factions(max_lag=1), window_of(np.stack([lead[2:], lead[1:-1], lead[:-2]], axis=1)))
    assert detection.candidates.tolist() == [True, False, False]
    assert detection.leader.tolist() == [0, 0, 0]


def test_one_per_round_names_one_true_head():
    for seed in range(4):
        velocity, leader = flight(np.random.default_rng(seed), kind="f4")
        detection = answer(OnePerRound(), window_of(velocity))
        assert detection.candidates.sum() == 1
        assert heads_of(leader)[detection.candidates].all()
        assert detection.clusters is None
        assert detection.leader is None


@pytest.mark.parametrize("kind", [LaggedRegression, LaggedCorrelation, OnePerRound])
def test_a_window_too_short_for_evidence_names_one_at_random(kind):
    for steps in (1, 2, 3, 6):
        velocity, leader = flight(np.random.default_rng(9), steps=steps)
        detector, named = kind(), set()
        detector.reset(0)
        for _ in range(60):
            candidates = detector.detect(window_of(velocity)).candidates
            assert candidates.sum() == 1
            named.add(int(candidates.argmax()))
        assert len(named) > len(leader) / 2  # ties don't favour low indices

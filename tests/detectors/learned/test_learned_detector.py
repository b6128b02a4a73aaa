"""The learned detector: equivariance, masks, its choice of candidates, what it refuses, and that it finds heads."""

import numpy as np
import pytest
from synthetic_windows import swarm_window

from detectors.checks.windows import draw_gaps, draw_window, hover
from detectors.learned import Learned
from detectors.learned.detector import MOST_UAVS
from detectors.learned.features import PAIR_FEATURES, make_inputs, pair_features
from usnet_env import ArgumentError, Window
from usnet_env.swarm.random_follow import random_follow_strategy


def answer(window, seed=0, **arguments):
    detector = Learned(**arguments)
    detector.reset(seed)
    return detector.detect(window)


def test_a_pair_of_head_and_follower_stands_out_in_its_row():
    window, state = swarm_window(3, follow="f1", clusters=2, uavs=12, observation_steps=60)
    leader = state.root
    features = pair_features(window, np.arange(12))
    assert features.shape == (12, 12, PAIR_FEATURES)
    assert features.dtype == np.float32
    assert not features[np.arange(12), np.arange(12)].any()
    copied = features[..., 1]  # what a linear map of v_j explains of v_i a step later
    followers = np.flatnonzero(leader != np.arange(12))
    np.testing.assert_array_equal(copied[followers].argmax(axis=1), leader[followers])
    assert copied[followers].max(axis=1).min() > 0.8


def test_same_seed_same_answer_and_ties_are_drawn():
    window = hover(draw_window(None))
    first, again = answer(window, seed=5), answer(window, seed=5)
    np.testing.assert_array_equal(first.candidates, again.candidates)
    np.testing.assert_array_equal(first.scores, again.scores)
    named = {
        tuple(np.flatnonzero(answer(window, seed=seed, policy="threshold", threshold=1.0).candidates))
        for seed in range(20)
    }
    assert len(named) > 3
    assert all(len(one) == 1 for one in named)


def test_the_choice_follows_the_probabilities():
    window = draw_window(None, 14)
    probability = answer(window).extras["probability"]
    for policy in ("threshold", "map"):
        np.testing.assert_array_equal(answer(window, policy=policy).candidates, probability > 0.5)
    none_passes = answer(window, policy="threshold", threshold=1.0)
    assert probability[none_passes.candidates].tolist() == [probability.max()]
    dear, cheap = answer(window, round_price=100.0), answer(window, round_price=0.01)
    assert (dear.candidates >= cheap.candidates).all()


def test_it_beats_chance_by_far_on_fresh_random_strategies():
    hits = named = heads = 0
    for seed in range(12):
        follow = random_follow_strategy(np.random.default_rng([2022, seed]))
        window, state = swarm_window(seed, follow=follow, clusters=3, uavs=24, observation_steps=60)
        candidates = answer(window, policy="map").candidates
        hits += int((candidates & state.head).sum())
        named, heads = named + int(candidates.sum()), heads + 3
    assert hits >= 0.8 * heads  # 3 random candidates of 24 hit one head in eight
    assert hits >= 0.8 * named


def test_it_says_what_it_does_not_take(tmp_path):
    for arguments, text in (
        ({"weights": 3}, "weights must be a name"),
        ({"weights": str(tmp_path / "none.safetensors")}, "path must be a safetensors file"),
    ):
        with pytest.raises(ArgumentError, match=text):
            Learned(**arguments).reset(0)
    many = MOST_UAVS + 1
    ones = np.ones((2, many))
    crowd = Window(np.zeros((2, many, 3)), np.zeros((1, many, 3)), ones, ones[0])
    with pytest.raises(ArgumentError, match=f"window must hold at most {MOST_UAVS} UAVs"):
        answer(crowd)


def test_the_network_is_told_the_size_of_the_window_and_the_share_of_missing_samples():
    window = draw_gaps(None)
    living = np.flatnonzero(window.alive)
    _, context = make_inputs(window, living)
    missing = 1.0 - window.velocity_seen[:, living].sum() / window.velocity_seen[:, living].size
    np.testing.assert_allclose(context, [np.log(len(living) / 50), np.log(30 / 100), missing], atol=1e-6)
    assert 0.4 < missing < 0.8


def test_where_nothing_was_seen_all_living_uavs_are_alike():
    window = draw_window(None, 14, destroyed=4)
    unseen = Window(window.position * 0, window.velocity * 0, window.seen & False, window.alive)
    found = answer(unseen)
    assert len(np.unique(found.scores[window.alive])) == 1
    assert found.scores[window.alive][0] > 0
    assert len({int(answer(unseen, seed, policy="threshold").candidates.argmax()) for seed in range(20)}) > 3

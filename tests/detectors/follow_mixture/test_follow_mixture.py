"""follow-mixture as a detector: the heads that it finds, swarms without following, and the answer."""

import re

import numpy as np
import pytest
from mixture_windows import MAJORITY, OWN_DELAYS, answer
from synthetic_windows import swarm_window

from usnet_env import ArgumentError, Window

F1_TO_F6 = ["f1", "f2", "f3", "f4", "f5", "f6"]


@pytest.mark.parametrize("follow", [*F1_TO_F6, "f7"])
def test_all_heads_and_their_followers_in_one_window(follow):
    for seed in (700,):
        window, truth = swarm_window(seed, follow=follow)
        detection = answer(window)
        assert np.array_equal(detection.candidates, truth.head)
        assert (detection.leader == truth.root).mean() > 0.95
        assert detection.extras["probability"][truth.head].min() > 0.5
        assert detection.scores[truth.head].min() > detection.scores[~truth.head].max()


@pytest.mark.parametrize("follow", F1_TO_F6)
def test_short_windows(follow):
    window, truth = swarm_window(720, follow=follow, observation_steps=20, uavs=82, clusters=5)
    assert np.array_equal(answer(window).candidates, truth.head)


@pytest.mark.parametrize("mobility", ["iid", "gauss_markov", "straight"])
def test_no_head_is_named_if_no_uav_follows(mobility):
    for seed in (750, 751):
        window, _ = swarm_window(seed, follow="none", mobility=mobility)
        detection = answer(window, policy="map")
        assert not detection.candidates.any()
        assert (detection.leader == -1).all()
        assert answer(window).candidates.sum() >= 1  # an episode goes on only while a head is alive


def test_decoys_are_not_named():
    window, truth = swarm_window(770, decoys=5, uavs=35, follow="f4")
    detection = answer(window, policy="map")
    assert np.array_equal(detection.candidates, truth.head)
    assert (detection.leader[truth.decoy] == -1).all()


@pytest.mark.parametrize("follow", [OWN_DELAYS, MAJORITY])
def test_strategies_in_no_class_that_groups_share(follow):
    for seed in (0, 1):
        window, truth = swarm_window(seed, follow=follow, clusters=5, uavs=82)
        assert np.array_equal(answer(window).candidates, truth.head)


def test_heads_are_the_sources_of_chains_and_relays_are_not_named():
    exact, right, relays = 0, 0, 0
    for seed in range(8):
        window, truth = swarm_window(
            seed, follow="chain", mobility="gauss_markov", head_jitter=True, formation="around"
        )
        found = answer(window, policy="map")
        exact += np.array_equal(found.candidates, truth.head)
        relay, root = found.extras["relay"], found.extras["root"]
        assert not (relay & found.candidates).any()
        assert (found.leader[relay] >= 0).all()
        assert (root[found.extras["heads"]] == found.extras["heads"]).all()
        right += int((found.leader == truth.leader)[relay].sum())
        relays += int(relay.sum())
        known = (root >= 0) & ~truth.head
        assert (root == truth.root)[known].mean() > 0.8
    assert exact >= 6
    assert relays > 20
    assert right >= 0.75 * relays


SMOOTH = {"mobility": "gauss_markov", "head_jitter": True, "formation": "around", "memory": 12}


def test_followers_with_delays_of_their_own_lead_to_their_head():
    """Their delays are 1 to 12 steps, so that those with short ones precede those with long ones."""
    exact, short, right = 0, 0, []
    for seed in range(8):
        window, truth = swarm_window(seed, follow="unequal_delays", **SMOOTH)
        found = answer(window, policy="map")
        exact += np.array_equal(found.candidates, truth.head)
        known = (found.extras["root"] >= 0) & ~truth.head
        right.append((found.extras["root"] == truth.root)[known].mean())
        short += np.array_equal(answer(window, policy="map", max_lag=4).candidates, truth.head)
    assert exact >= 5
    assert exact > short  # the longest delay matters
    assert np.mean(right) > 0.85


def test_uavs_with_a_common_cause_do_not_lead():
    """UAVs in formation about a virtual point predict each other, and so do their future and past."""
    exact = {"reference": 0, "f2": 0}
    for follow in exact:
        for seed in range(8):
            window, truth = swarm_window(seed, follow=follow, **SMOOTH)
            exact[follow] += np.array_equal(answer(window, policy="map").candidates, truth.head)
    assert exact["reference"] >= 5
    assert exact["f2"] == 8


def test_the_longest_delay_is_given_in_samples_or_in_seconds():
    velocity = np.random.default_rng(3).normal(size=(100, 12, 3))
    velocity[9:, 1:5] = velocity[:-9, :1] + 0.1 * velocity[9:, 1:5]  # all move alike, nine samples after UAV 0
    position = np.concatenate([np.zeros((1, 12, 3)), np.cumsum(velocity, axis=0)])
    window = Window(position, velocity, np.ones((101, 12), bool), np.ones(12, bool), step=0.5)
    for longest in ({"max_lag": 9}, {"max_delay": 4.5}, {"max_lag": 1, "max_delay": 6.0}):
        found = answer(window, policy="map", **longest)
        assert np.flatnonzero(found.candidates).tolist() == [0]
        assert (found.leader[1:5] == 0).all()
    for short in ({"max_lag": 8}, {"max_delay": 4.0}):
        assert not answer(window, policy="map", **short).candidates[0]
    simulated, _ = swarm_window(0, observation_steps=10)
    with pytest.raises(ArgumentError, match="max_delay must be None in a window that doesn't know its step"):
        answer(simulated, max_delay=1.0)


@pytest.mark.parametrize("most", [1, 2])
def test_relays_bring_no_more_heads_than_allowed_and_leaders_close_no_cycle(most):
    for seed in range(6):
        window, _ = swarm_window(seed, follow="chain" if seed % 2 else "unequal_delays", **SMOOTH)
        found = answer(window, clusters=most)
        assert len(found.extras["heads"]) <= most
        end = np.where(found.leader >= 0, found.leader, np.arange(window.uavs))
        for _ in range(window.uavs):
            end = np.where(found.leader[end] >= 0, found.leader[end], end)
        assert ((found.leader[end] == end) | (found.leader[end] < 0)).all()


def test_the_extras_describe_the_answer():
    window, truth = swarm_window(796, follow="f2")
    extras = answer(window).extras
    assert np.array_equal(extras["heads"], np.flatnonzero(truth.head))
    assert extras["strategy"]["features"] == "v(L)"
    assert extras["strategy"]["noise"] == 0
    newest, next_, *others = extras["strategy"]["law"].reshape(4, 3, 3)  # f2 adds the last two velocities
    scale = np.trace(newest) / 3
    np.testing.assert_allclose(newest / scale, np.eye(3), atol=0.2)
    np.testing.assert_allclose(next_ / scale, np.eye(3), atol=0.2)
    np.testing.assert_allclose(np.array(others) / scale, 0.0, atol=0.2)
    followers = ~truth.head
    assert extras["gain"][followers].min() > 0
    assert not extras["gain"][truth.head].any()
    assert len(extras["reasons"]) == 3
    counts = [int((truth.root[followers] == head).sum()) for head in extras["heads"]]
    for count, reason in zip(counts, extras["reasons"], strict=True):
        assert re.fullmatch(
            rf"Its past predicts {count} followers at lag [12] \(evidence \d+ nats\)\.", reason
        )  # f2 adds both
    assert extras["nats"] > 0


def test_the_same_seed_gives_the_same_answer():
    window, _ = swarm_window(797, follow="none")
    one, two = answer(window, 3), answer(window, 3)
    assert np.array_equal(one.candidates, two.candidates)
    assert np.array_equal(one.scores, two.scores)
    large, truth = swarm_window(797, uavs=310, clusters=2, observation_steps=40)  # grouped in turns, which are drawn
    assert np.array_equal(answer(large, 3).scores, answer(large, 3).scores)
    assert np.array_equal(answer(large, policy="map").candidates, truth.head)

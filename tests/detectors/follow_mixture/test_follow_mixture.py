"""Follow-mixture as a detector: what it finds, what it is silent about, and what it says."""

import numpy as np
import pytest
from mixture_windows import swarm_window
from sklearn.base import clone

from detectors.follow_mixture import FollowMixture
from usnet_env import ArgumentError, Window

F1_TO_F6 = ["f1", "f2", "f3", "f4", "f5", "f6"]


def answer(window, seed=0, **arguments):
    detector = FollowMixture(**arguments)
    detector.reset(seed)
    return detector.detect(window)


@pytest.mark.parametrize("follow", [*F1_TO_F6, "f7"])
def test_all_heads_at_once_and_who_follows_them(follow):
    for seed in (700, 701):
        window, truth = swarm_window(seed, follow=follow)
        detection = answer(window)
        assert np.array_equal(detection.candidates, truth.head)
        assert (detection.leader == truth.leader).mean() > 0.95
        assert detection.extras["probability"][truth.head].min() > 0.5
        assert detection.scores[truth.head].min() > detection.scores[~truth.head].max()


@pytest.mark.parametrize("follow", ["f1", "f4"])
@pytest.mark.parametrize("mobility", ["gauss_markov", "smooth_turn", "straight"])
def test_smooth_heads(follow, mobility):
    window, truth = swarm_window(710, follow=follow, mobility=mobility, head_jitter=True)
    assert np.array_equal(answer(window).candidates, truth.head)


@pytest.mark.parametrize("follow", F1_TO_F6)
def test_short_windows(follow):
    window, truth = swarm_window(720, follow=follow, observation_steps=20, uavs=82, clusters=5)
    assert np.array_equal(answer(window).candidates, truth.head)


@pytest.mark.parametrize("follow", ["f1", "f3"])
def test_behind_noise(follow):
    window, truth = swarm_window(730, follow=follow, position_noise=0.5, uavs=50)
    assert np.array_equal(answer(window).candidates, truth.head)


def test_missed_detections():
    window, truth = swarm_window(740, miss_rate=0.3, uavs=50)
    assert np.array_equal(answer(window).candidates, truth.head)


@pytest.mark.parametrize("mobility", ["iid", "gauss_markov", "straight"])
def test_silence_where_nobody_follows(mobility):
    for seed in (750, 751):
        window, _ = swarm_window(seed, follow="none", mobility=mobility)
        detection = answer(window, policy="map")
        assert not detection.candidates.any()
        assert (detection.leader == -1).all()
        assert answer(window).candidates.sum() >= 1  # in a game a head is left


def test_silence_where_every_track_is_moved_in_time():
    window, _ = swarm_window(760, observation_steps=168, clusters=2, uavs=14)
    velocity = window.velocity.copy()
    for uav, place in enumerate(np.random.default_rng(0).permutation(window.uavs)):
        velocity[:, uav] = np.roll(velocity[:, uav], 12 * place, axis=0)  # fellows apart by more than any memory
    position = np.concatenate([window.position[:1], window.position[:1] + np.cumsum(velocity, axis=0)])
    moved = Window(position, velocity, window.seen, window.alive)
    assert not answer(moved, policy="map").candidates.any()


def test_decoys_are_left_alone():
    window, truth = swarm_window(770, decoys=5, uavs=35, follow="f4")
    detection = answer(window, policy="map")
    assert np.array_equal(detection.candidates, truth.head)
    assert (detection.leader[truth.decoy] == -1).all()


@pytest.mark.parametrize("follow", ["f1", "f5", "f6"])
def test_one_head_two_followers_and_a_decoy(follow):
    for seed in (780, 781, 782):
        window, truth = swarm_window(seed, follow=follow, clusters=1, uavs=4, decoys=1)
        assert np.array_equal(answer(window, objective="P1").candidates, truth.head)


def test_a_permutation_of_the_uavs_permutes_the_answer():
    window, _ = swarm_window(790, follow="f2")
    order = np.random.default_rng(1).permutation(window.uavs)
    moved = Window(window.position[:, order], window.velocity[:, order], window.seen[:, order], window.alive[order])
    assert np.array_equal(answer(moved).candidates, answer(window).candidates[order])


def test_units_of_length_do_not_matter():
    window, truth = swarm_window(791, follow="f3")
    scaled = Window(30 * window.position, 30 * window.velocity, window.seen, window.alive)
    assert np.array_equal(answer(scaled).candidates, truth.head)


def test_destroyed_uavs_are_never_named():
    window, truth = swarm_window(792)
    alive = window.alive.copy()
    gone = int(np.flatnonzero(truth.head)[0])
    alive[gone] = False
    keep = alive[None, :, None]
    detection = answer(Window(window.position * keep, window.velocity * keep, window.seen & alive, alive, 2))
    assert not detection.candidates[gone]
    assert detection.leader[gone] == -1
    assert np.array_equal(np.flatnonzero(detection.candidates), np.flatnonzero(truth.head)[1:])


@pytest.mark.parametrize("steps", [1, 2, 4, 5, 8])
def test_any_window_gets_an_answer(steps):
    window, _ = swarm_window(793, observation_steps=steps)
    detection = answer(window)
    assert detection.candidates.sum() >= 1
    assert np.isfinite(detection.scores).all()


def test_an_empty_sky():
    window, _ = swarm_window(794)
    nothing = np.zeros_like(window.alive)
    assert not answer(Window(window.position * 0, window.velocity * 0, window.seen & nothing, nothing)).candidates.any()
    still = Window(window.position * 0, window.velocity * 0, window.seen, window.alive)
    assert answer(still).candidates.sum() >= 1


def test_a_large_swarm_is_sampled():
    window, truth = swarm_window(795, uavs=700, clusters=4)
    detection = answer(window)
    assert np.array_equal(detection.candidates, truth.head)
    assert (detection.leader == truth.leader).mean() > 0.99
    assert detection.attention is None


def test_it_explains_itself():
    window, truth = swarm_window(796, follow="f2")
    extras = answer(window).extras
    assert np.array_equal(extras["heads"], np.flatnonzero(truth.head))
    assert extras["strategy"]["class"] == "linear+squares(4)"
    assert len(extras["strategy"]["lag_profile"]) == 4
    np.testing.assert_allclose(extras["strategy"]["lag_profile"][2:], 0.0, atol=0.05)
    assert all(sentence.startswith("passed: ") for sentence in extras["gate"])
    followers = ~truth.head
    assert extras["gain"][followers].min() > 0
    assert extras["explained"][followers].mean() > 0.95
    assert not extras["explained"][truth.head].any()


def test_the_same_seed_gives_the_same_answer():
    window, _ = swarm_window(797, follow="none")
    one, two = answer(window, 3), answer(window, 3)
    assert np.array_equal(one.candidates, two.candidates)
    assert np.array_equal(one.scores, two.scores)


def test_a_batch_is_its_windows():
    windows = [swarm_window(seed, follow=follow)[0] for seed, follow in ((798, "f1"), (799, "f6"))]
    detector = FollowMixture()
    detector.reset(0)
    for window, detection in zip(windows, detector.detect_batch(windows), strict=True):
        assert np.array_equal(detection.candidates, answer(window).candidates)


def test_the_constructor_only_stores():
    detector = clone(FollowMixture(policy="map"))
    assert vars(detector) == detector.get_params()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("clusters", 0),
        ("clusters", 2.5),
        ("memory", 0),
        ("policy", "best"),
        ("objective", "P3"),
        ("shot_budget", 0),
        ("redundancy_price", -1.0),
        ("round_price", 0.0),
    ],
)
def test_a_bad_argument_is_refused_when_it_is_used(name, value):
    window, _ = swarm_window(0, observation_steps=10)
    detector = FollowMixture(**{name: value})
    for use in (lambda: detector.reset(0), lambda: detector.detect(window)):
        with pytest.raises(ArgumentError, match=rf"^{name} must be .*, got .*\.$"):
            use()


def test_more_clusters_than_uavs_are_refused():
    window, _ = swarm_window(0, observation_steps=10)
    with pytest.raises(ArgumentError, match="clusters must be at most"):
        answer(window, clusters=31)

"""Confirmed leaders, through ``find_leaders``: a lead counts, and what happens at the same time doesn't."""

import numpy as np
import pytest
from track_files import Sure

from usnet_env.tracks import Tracks, find_leaders

STEPS, UAVS = 200, 6


def wander(rng):
    return np.cumsum(rng.normal(0, 0.3, (STEPS, 2)), axis=0) * 0.2 + rng.normal(0, 1, (STEPS, 2))


def confirmed(velocities, head=0, seen=None, **options):
    """The windows in which ``head`` is named, of two."""
    places = np.cumsum(np.stack(velocities, axis=1), axis=0)
    t, i = np.nonzero(np.ones(places.shape[:2], bool) if seen is None else seen)
    tracks = Tracks.from_samples(i.tolist(), t.tolist(), places[t, i]).resample(1.0)
    found = find_leaders(tracks, Sure(head), length=99, **options)
    assert len(found.windows) == 2
    return sum(bool(window.leaders) for window in found.windows)


def followers_of(rng, leader, delay, gain=1.0, noise=0.3):
    return [gain * np.roll(leader, delay, axis=0) + rng.normal(0, noise, leader.shape) for _ in range(UAVS - 1)]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("delay", [1, 4])
def test_a_leader_is_confirmed_at_every_delay_of_the_test(seed, delay):
    rng = np.random.default_rng(seed)
    leader = wander(rng)
    assert confirmed([leader, *followers_of(rng, leader, delay)]) == 2


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("delay", [0, -2])
def test_one_that_moves_at_the_same_time_or_later_is_not(seed, delay):
    rng = np.random.default_rng(seed)
    leader = wander(rng)
    velocities = [leader, *followers_of(rng, leader, delay)]
    assert confirmed(velocities) == 0
    assert confirmed(velocities, confirm=False) == 2


def test_one_that_others_follow_the_other_way_is_not():
    """Its followers repeat its velocity with the opposite sign."""
    rng = np.random.default_rng(0)
    leader = wander(rng)
    assert confirmed([leader, *followers_of(rng, leader, 2, gain=-1.0)]) == 0


def test_a_relay_is_not():
    """UAV 1 leads all others after it, but follows UAV 0."""
    rng = np.random.default_rng(1)
    leader = wander(rng)
    relay = np.roll(leader, 2, axis=0) + rng.normal(0, 0.1, leader.shape)
    assert confirmed([leader, relay, *followers_of(rng, relay, 1)[1:]], head=1) == 0


def test_independent_tracks_are_rarely_confirmed():
    rng = np.random.default_rng(2)
    assert sum(confirmed([wander(rng) for _ in range(UAVS)], head=k % UAVS) for k in range(20)) <= 4


def test_gaps_and_a_leader_that_comes_late_do_not_matter():
    rng = np.random.default_rng(3)
    leader = wander(rng)
    seen = rng.random((STEPS, UAVS)) > 0.1
    seen[:30, 0] = False
    seen[0] = seen[-1] = True
    assert confirmed([leader, *followers_of(rng, leader, 2)], seen=seen) == 2

"""Followers that do not move like their group are left out, and heads that have a leader keep their followers."""

import numpy as np

from usnet_env import Detection
from usnet_env.tracks import Tracks, find_leaders


class NamesTheFirst:
    """Names the first id, and gives the ``led`` next ones, and perhaps itself, the first or second id as leader."""

    def __init__(self, own: int = 0, led: int | None = None) -> None:
        self.own, self.led = own, led

    def reset(self, seed=None):
        pass

    def detect(self, window):
        leader = np.zeros(window.uavs, np.int64)
        leader[0] = self.own
        if self.led is not None:
            leader[1 + self.led :] = -1
        candidates = np.arange(window.uavs) == 0
        return Detection(candidates, candidates.astype(float), leader=leader)


def walk(rng, steps):
    course = np.cumsum(rng.normal(0, 0.25, steps))
    return np.stack([np.cos(course), np.sin(course)], axis=1)


def herd(seed, followers=4, others=5, steps=402):
    """``followers`` copy id 0 after 1 to 3 steps; ``others`` share a route of their own, 500 m away."""
    rng = np.random.default_rng(seed)
    head, route = walk(rng, steps), walk(rng, steps)
    velocity = [head, *(np.roll(head, 1 + k % 3, axis=0) for k in range(followers)), *[route] * others]
    place = np.cumsum(np.array(velocity) + rng.normal(0, 0.1, (1 + followers + others, steps, 2)), axis=1) / 2
    place[1 + followers :] += (500, 0)
    ids, time = np.repeat(np.arange(len(place)), steps), np.tile(np.arange(steps) / 2, len(place))
    return Tracks.from_samples(ids, time, place.reshape(-1, 2)).resample(0.5)


def crowd(seed, followers=2, others=300, steps=1002):
    """``followers`` copy id 0 after 1 and 2 steps; each of ``others`` has a route for itself."""
    rng = np.random.default_rng(seed)
    head = walk(rng, steps)
    velocity = [
        head,
        *(np.roll(head, 1 + k, axis=0) for k in range(followers)),
        *(walk(rng, steps) for _ in range(others)),
    ]
    place = np.cumsum(np.array(velocity) + rng.normal(0, 0.1, (len(velocity), steps, 2)), axis=1) / 2
    ids, time = np.repeat(np.arange(len(place)), steps), np.tile(np.arange(steps) / 2, len(place))
    return Tracks.from_samples(ids, time, place.reshape(-1, 2)).resample(0.5)


def test_an_independent_group_is_removed_from_the_followers():
    windows = [window for seed in range(4) for window in find_leaders(herd(seed), NamesTheFirst()).windows]
    named = [window.leaders[0].followers for window in windows if window.leaders]
    assert len(named) >= 0.7 * len(windows)
    assert sum(set(range(1, 5)) <= set(led) for led in named) >= 0.8 * len(named)
    assert sum(max(led) > 4 for led in named) <= 0.2 * len(named)
    all_stay = find_leaders(herd(0), NamesTheFirst(), confirm=False).windows
    assert all(len(window.leaders[0].followers) == 9 for window in all_stay)


def test_a_candidate_with_a_leader_keeps_its_followers():
    for own in (0, 1, -1):
        found = find_leaders(herd(0, others=0), NamesTheFirst(own))
        assert found.leaders[0].followers == (1, 2, 3, 4)


def test_a_head_of_a_small_group_does_not_follow_independent_ids():
    """Among many independent ids, some are like the head by chance; a large part of all heads was rejected for them."""
    windows, confirmed = 0, 0
    for seed in range(4):
        found = find_leaders(crowd(seed), NamesTheFirst(led=2)).windows
        windows += len(found)
        confirmed += sum(len(window.leaders) for window in found)
    assert windows == 40
    assert confirmed >= 0.85 * windows

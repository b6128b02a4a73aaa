"""Followers that do not move like their group are left out, and heads that have a leader keep their followers."""

import numpy as np

from usnet_env import Detection
from usnet_env.tracks import Tracks, find_leaders


class NamesTheFirst:
    """Names the first id, and gives all others, and perhaps itself, the first or second id as leader."""

    def __init__(self, own: int = 0) -> None:
        self.own = own

    def reset(self, seed=None):
        pass

    def detect(self, window):
        leader = np.zeros(window.uavs, np.int64)
        leader[0] = self.own
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

"""Large swarms in neighbourhoods: followers are read with their head, whatever the order and the size of clusters."""

import numpy as np
import pytest
from synthetic_windows import swarm_window

from detectors.reader.neighbourhoods import cut_swarm, find_turns

SLOW_TURNS = {"mobility": "gauss_markov", "head_jitter": True, "memory": 12}


def share_with_head(parts, root):
    """The share of followers whose own neighbourhood holds their head."""
    met = np.zeros(len(root), bool)
    for members, own in parts:
        met[members[own]] = np.isin(root[members[own]], members)
    follows = (root >= 0) & (root != np.arange(len(root)))
    return met[follows].mean()


@pytest.mark.parametrize("follow", ["f1", "f4", "pigeons"])
@pytest.mark.parametrize(("clusters", "least"), [(30, 0.97), (4, 0.8)])
def test_followers_are_read_with_their_head(follow, clusters, least):
    window, truth = swarm_window(3, follow=follow, clusters=clusters, uavs=450, **SLOW_TURNS)
    parts = cut_swarm(window.velocity, window.velocity_seen)
    own = np.concatenate([members[mine] for members, mine in parts])
    assert np.array_equal(np.sort(own), np.arange(450))
    assert max(len(members) for members, _ in parts) < 110
    assert len(parts) < 14
    assert share_with_head(parts, truth.root) >= least


def test_the_order_of_the_uavs_does_not_matter():
    window, _ = swarm_window(1, follow="f1", clusters=6, uavs=120, **SLOW_TURNS)
    order = np.random.default_rng(0).permutation(120)
    here = cut_swarm(window.velocity, window.velocity_seen)
    there = cut_swarm(window.velocity[:, order], window.velocity_seen[:, order])
    assert {frozenset(members) for members, _ in here} == {frozenset(order[members]) for members, _ in there}


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_short_still_and_unseen_windows_are_cut(steps):
    still, rng = np.zeros((steps, 200, 3), np.float32), np.random.default_rng(0)
    for seen in (np.ones((steps, 200), bool), np.zeros((steps, 200), bool)):
        for velocity in (still, rng.standard_normal(still.shape, np.float32) * seen[..., None]):
            own = np.concatenate([members[mine] for members, mine in cut_swarm(velocity, seen)])
            assert np.array_equal(np.sort(own), np.arange(200))


def test_turns_are_what_the_own_past_does_not_explain():
    rng = np.random.default_rng(2)
    velocity = np.cumsum(rng.standard_normal((60, 2, 3), np.float32), axis=0) * 0.1
    turns = find_turns(velocity, np.ones((60, 2), bool))
    for uav in range(2):
        centred = velocity[:, uav] - velocity[:, uav].mean(axis=0)
        past = np.stack([centred[1:-1].ravel(), centred[:-2].ravel()], axis=1)
        rest = centred[2:].ravel() - past @ np.linalg.lstsq(past, centred[2:].ravel(), rcond=None)[0]
        assert np.corrcoef(turns[uav, 2:].ravel(), rest)[0, 1] > 0.98
        assert np.linalg.norm(turns[uav]) == pytest.approx(1.0, abs=1e-4)


def test_what_is_not_seen_is_not_used():
    rng = np.random.default_rng(4)
    velocity, seen = rng.standard_normal((50, 3, 3), np.float32), rng.random((50, 3)) < 0.8
    hidden = np.where(seen[..., None], velocity, 9.0).astype(np.float32)
    for block in (1, 4):
        assert np.array_equal(find_turns(velocity * seen[..., None], seen, block), find_turns(hidden, seen, block))

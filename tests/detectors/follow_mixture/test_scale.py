"""Large swarms: dropping candidates against its slow definition, and many heads with few followers each."""

import numpy as np
import pytest
from mixture_windows import swarm_window

from detectors.follow_mixture import FollowMixture
from detectors.follow_mixture.facility import LEAST_VOTERS
from detectors.follow_mixture.scale import pruned


def worth(gain, columns, rows, kept, price):
    """The value of a set of heads, and the followers of each, by definition."""
    heads = columns[kept]
    best = np.array([0.0 if row in heads else gain[k, kept].max(initial=0.0) for k, row in enumerate(rows)])
    followers = [int(((gain[:, kept].argmax(axis=1) == k) & (best > 0)).sum()) for k in range(len(heads))]
    naming = np.log(max(len(heads), 1)) * (best > 0).sum()
    return best.sum() - price * len(heads) - naming, followers


def slowly(gain, columns, rows, price, most):
    """Every drop tried anew."""
    kept = list(range(len(columns)))
    while kept:
        trials = [kept[:k] + kept[k + 1 :] for k in range(len(kept))]
        value, followers = worth(gain, columns, rows, kept, price)
        worths = [worth(gain, columns, rows, trial, price)[0] for trial in trials]
        if max(worths) > value + 1e-9 or (most is not None and len(kept) > most):
            kept = trials[int(np.argmax(worths))]
        elif min(followers) < LEAST_VOTERS:
            kept = trials[int(np.argmin(followers))]
        else:
            break
    return kept


@pytest.mark.parametrize("most", [None, 2])
@pytest.mark.parametrize("seed", range(12))
def test_candidates_are_dropped_as_by_definition(seed, most):
    rng = np.random.default_rng(seed)
    rows = np.sort(rng.choice(60, 30, replace=False))
    columns = rng.choice(60, 9, replace=False)  # some of them vote, some don't
    gain = rng.normal(-1.0 if seed % 2 else 2.0, 6.0, (len(rows), len(columns)))
    gain[rows[:, None] == columns[None]] = 0.0
    found = np.flatnonzero(pruned(gain, columns, rows, 4.0, most))
    assert found.tolist() == slowly(gain, columns, rows, 4.0, most)


def test_nobody_is_kept_where_nobody_votes_or_gains():
    columns, rows = np.arange(3), np.arange(10)
    assert not pruned(np.zeros((0, 3)), columns, np.arange(0), 1.0).any()
    assert not pruned(-np.ones((10, 3)), columns, rows, 1.0).any()
    assert pruned(np.zeros((10, 0)), np.arange(0), rows, 1.0).shape == (0,)


def test_many_heads_of_which_the_voters_know_few():
    window, truth = swarm_window(797, uavs=1500, clusters=100, observation_steps=60)
    detector = FollowMixture()
    detector.reset(0)
    detection = detector.detect(window)
    assert np.array_equal(detection.candidates, truth.head)
    assert (detection.leader == truth.leader).mean() > 0.99


def test_one_head_is_named_where_one_is_asked_for():
    window, truth = swarm_window(798, uavs=600, clusters=1)
    detector = FollowMixture(objective="P1")
    detector.reset(0)
    assert np.array_equal(detector.detect(window).candidates, truth.head)


def test_nobody_is_named_in_a_large_swarm_where_nobody_follows():
    window, _ = swarm_window(799, uavs=600, follow="none", observation_steps=60)
    detector = FollowMixture(policy="map")
    detector.reset(0)
    assert not detector.detect(window).candidates.any()


def test_decoys_in_a_large_swarm_are_left_alone():
    window, truth = swarm_window(800, uavs=700, clusters=14, decoys=70)
    detector = FollowMixture(policy="map")
    detector.reset(0)
    detection = detector.detect(window)
    assert np.array_equal(detection.candidates, truth.head)
    assert (detection.leader[truth.decoy] == -1).all()

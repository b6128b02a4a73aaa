"""The reader's features: what they must not depend on, odd windows; and large swarms in neighbourhoods."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from synthetic_windows import swarm_window

from detectors.reader import features as module
from detectors.reader.features import PAIR_GROUPS, Features, make_features
from detectors.reader.neighbourhoods import cut_swarm

STEPS = 48


def draw_window(uavs=6, steps=STEPS, missed=0.0, seed=0):
    """Random walks of velocity; each odd UAV repeats the one before it 3 steps later."""
    rng = np.random.default_rng(seed)
    velocity = rng.normal(size=(uavs, 3)) + np.cumsum(0.2 * rng.normal(size=(steps, uavs, 3)), 0)
    velocity[3:, 1::2] = velocity[:-3, : uavs - uavs % 2 : 2] + 0.02 * rng.normal(size=velocity[3:, 1::2].shape)
    start = 15 * rng.normal(size=(1, uavs, 3))
    position = np.concatenate([start, start + np.cumsum(velocity, 0)])
    seen = rng.random((steps + 1, uavs)) >= missed
    return hide(position, velocity, seen)


def hide(position, velocity, seen):
    flown = (seen[1:] & seen[:-1])[..., None]
    return np.where(seen[..., None], position, 0).astype("f4"), np.where(flown, velocity, 0).astype("f4"), seen


def group(features, name):
    return features.pair[..., PAIR_GROUPS[name]]


def assert_close(one, other, tolerance=2e-3):
    for x, y in zip(one, other, strict=True):
        np.testing.assert_allclose(x, y, atol=tolerance)


def test_pulls_are_scores_of_the_means_and_the_least_of_parts():
    told = make_features(*draw_window())
    parts = np.where(np.eye(6, dtype=bool)[..., None], np.nan, group(told, "joint")[..., :4])
    expected = np.concatenate([np.nanmean(parts, 0), np.nanmin(parts, 0)], 1)
    expected = (expected - expected.mean(0)) / (expected.std(0) + 1e-2)
    np.testing.assert_allclose(told.uav[:, module.UAV_GROUPS["pulls"]], expected, atol=1e-3)


@pytest.mark.parametrize(("uavs", "steps", "missed"), [(7, 60, 0.0), (12, 30, 0.2), (3, 9, 0.1)])
def test_axes_origin_unit_and_order_do_not_matter(uavs, steps, missed):
    position, velocity, seen = draw_window(uavs, steps, missed)
    told = make_features(position, velocity, seen)
    turn = Rotation.from_rotvec([0.3, 1.0, -2.0]).as_matrix()
    assert_close(told, make_features(*hide(position @ turn.T + [300, -20, 5], velocity @ turn.T, seen)))
    assert_close(told, make_features(8 * position, 8 * velocity, seen), 0)
    order = np.random.default_rng(1).permutation(uavs)
    other = make_features(position[:, order], velocity[:, order], seen[:, order])
    assert_close(Features(told.pair[order][:, order], told.uav[order], told.context), other)


def test_what_is_not_seen_has_no_influence():
    position, velocity, seen = draw_window(9, 50, 0.2)
    told = make_features(position, velocity, seen)
    junk = np.where(seen[..., None], position, 1e5), np.where((seen[1:] & seen[:-1])[..., None], velocity, -77)
    assert_close(told, make_features(junk[0].astype("f4"), junk[1].astype("f4"), seen), 0)
    wider = [np.concatenate([x, np.zeros_like(x[:, :1])], 1) for x in (position, velocity, seen)]
    pair, uav, context = make_features(*wider)
    assert_close(told, (pair[:-1, :-1], uav[:-1], context), 1e-4)
    assert not pair[-1].any()
    assert not pair[:, -1].any()
    assert not uav[-1].any()


def test_bits_do_not_depend_on_where_the_memory_lies():
    window = draw_window(11, 70, 0.1)
    told = make_features(*window)
    for offset in (1, 3, 7):
        copies, kept = [], [np.empty(1000 * offset + 13, np.uint8)]  # moves what is allocated next
        for x in window:
            memory = np.empty(x.nbytes + 128, np.uint8)
            start = -memory.ctypes.data % 64 + offset * x.itemsize
            copies.append(memory[start : start + x.nbytes].view(x.dtype).reshape(x.shape))
            copies[-1][...] = x
            kept.append(memory)
        for x, y in zip(told, make_features(*copies), strict=True):
            np.testing.assert_array_equal(x, y)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    st.integers(1, 4), st.integers(1, 20), st.integers(0, 99), st.sampled_from([0.0, 1e-20, 1.0, 1e5]),
    st.sampled_from([0.0, 0.4, 1.0]), st.booleans(),
)  # fmt: skip
def test_odd_windows_give_finite_numbers(uavs, steps, seed, speed, missed, planar):
    position, velocity, seen = draw_window(uavs, max(steps, 4), missed, seed)
    position, velocity, seen = position[: steps + 1] * speed, velocity[:steps] * speed, seen[: steps + 1]
    if planar:
        position[..., 2], velocity[..., 2] = 0, 0
    told = make_features(position, velocity, seen)
    assert told.pair.shape == (uavs, uavs, module.PAIR_FEATURES)
    assert told.uav.shape == (uavs, module.UAV_FEATURES)
    assert all(np.isfinite(x).all() and x.dtype == np.float32 for x in told)


@pytest.mark.parametrize("kind", ["PAIR", "UAV", "CONTEXT"])
def test_groups_follow_each_other(kind):
    slices = list(getattr(module, kind + "_GROUPS").values())
    assert [0, *(x.stop for x in slices)] == [*(x.start for x in slices), getattr(module, kind + "_FEATURES")]


def test_followers_are_told_from_leaders():
    told = make_features(*draw_window())
    assert (group(told, "ee")[1::2, ::2].argmax(2).diagonal() == 3).all()  # 1 follows 0, 3 follows 2, 5 follows 4
    strongest = group(told, "tops")[..., 0]
    assert (strongest[1::2, ::2] > strongest[::2, 1::2].T + 0.5).diagonal().all()


def test_whom_all_copy_is_told_in_noise():
    rng = np.random.default_rng(2)
    velocity = [1, 0, 0] + 0.1 * rng.normal(size=(100, 8, 3))
    velocity[1:, 1:] += velocity[:-1, :1] - [1, 0, 0]  # all copy the first, and err on their own
    position = np.concatenate([np.zeros((1, 8, 3)), np.cumsum(velocity, 0)]) + 10 * rng.normal(size=(8, 3))
    position += 0.2 * rng.normal(size=position.shape)
    told = make_features(*hide(position, np.diff(position, axis=0), np.ones((101, 8), bool)))
    companions = told.uav[:, module.UAV_GROUPS["companions"]]
    assert companions[:, 13].argmin() == 0  # ways of 16 steps, 1 step later
    assert companions[0, 13] < companions[1:, 13].min() - 1
    assert (group(told, "ee").max(2)[1:].argmax(1) == 0).mean() < 0.6  # single velocities tell less


def test_who_comes_later_to_the_same_places_is_told():
    position, velocity, _ = draw_window(1, 60)
    both = [np.concatenate([x[:-8], x[8:]], 1) for x in (position, velocity)]  # UAV 0 is 8 steps behind UAV 1
    behind = group(make_features(*both, np.ones(both[0].shape[:2], bool)), "places")[0, 1]
    assert behind[3] == behind[:6].min()  # the lag of 8 steps
    assert behind[10] == 1
    assert behind[12] > 0.5


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("delay", [2, 5])
def test_a_uav_that_turns_as_another_turned_answers_it_with_this_delay(sign, delay):
    rng, steps, uavs = np.random.default_rng(4), 100, 6
    spins = 0.25 * rng.standard_normal((steps, uavs, 3))
    for t in range(1, steps):
        spins[t] = 0.5 * spins[t - 1] + 0.8 * spins[t]
    spins[delay:, 1] = sign * spins[:-delay, 0]
    velocity = np.empty((steps, uavs, 3))
    velocity[0] = rng.standard_normal((uavs, 3))
    for t in range(1, steps):
        velocity[t] = Rotation.from_rotvec(spins[t]).apply(velocity[t - 1])
    velocity /= np.linalg.norm(velocity, axis=2, keepdims=True)
    position = np.concatenate([np.zeros((1, uavs, 3)), np.cumsum(velocity, 0)])
    answers = group(make_features(*hide(position, velocity, np.ones((steps + 1, uavs), bool))), "answers")
    lags = (1, 2, 3, 4, 5, 6, 8, 10, 12)
    turns = answers[..., : len(lags)]
    assert np.abs(turns[1]).max(axis=1).argmax() == 0
    best = np.abs(turns[1, 0]).argmax()
    assert delay - 2 <= lags[best] <= delay  # it compares with a turn of three steps
    assert np.sign(turns[1, 0, best]) == sign
    assert np.abs(turns[1, 0]).max() > 2 * np.abs(turns[0, 1]).max()


SLOW_TURNS = {"mobility": "gauss_markov", "head_jitter": True, "memory": 12}


def share_with_head(parts, root):
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

"""Where a swarm starts, the head of each follower, re-merging, and heads that follow unseen UAVs, ``led_by``."""

import numpy as np
import pytest
from flights import fly, generators
from hypothesis import given
from hypothesis import strategies as st

from usnet_env.swarm import SwarmConfig, destroy, start
from usnet_env.swarm.follow import FollowFunction, LaggedSum
from usnet_env.swarm.formation import ARENA, FORMATIONS, register_formation
from usnet_env.swarm.simulator import draw_roles, random_cluster_sizes


def test_given_cluster_sizes_are_kept_and_else_all_splits_are_equally_likely():
    state, _ = fly(clusters=3, uavs=15, cluster_sizes=(2, 7, 3))
    assert sorted(np.bincount(state.root[~state.head], minlength=15)[state.head]) == [2, 3, 7]
    rng = np.random.default_rng(0)
    draws = random_cluster_sizes([rng] * 6000, 3, 10) - 2
    splits, counts = np.unique(draws, axis=0, return_counts=True)
    assert len(splits) == 15  # C(4 + 2, 2)
    expected = 6000 / 15
    assert (((counts - expected) ** 2) / expected).sum() < 36.1  # chi-square, 14 degrees of freedom, 0.1 %


@given(seed=st.integers(0, 2**32), clusters=st.integers(1, 12), rest=st.integers(0, 50), decoys=st.integers(0, 3))
def test_roles_are_consistent(seed, clusters, rest, decoys):
    uavs = 3 * clusters + rest + decoys
    config = SwarmConfig(clusters=clusters, uavs=uavs, decoys=decoys)
    (roles,) = draw_roles([np.random.default_rng(seed)], config).split()
    assert (roles.head.sum(), roles.decoy.sum()) == (clusters, decoys)
    assert not (roles.head & roles.decoy).any()
    alone = roles.head | roles.decoy
    assert (roles.root[alone] == np.flatnonzero(alone)).all()
    assert roles.head[roles.root[~alone]].all()
    assert np.bincount(roles.root[~alone], minlength=uavs)[roles.head].min() >= 2


def first_positions(formation, seeds=200):
    states = [start(SwarmConfig(formation=formation), [np.random.default_rng(s)]).episode() for s in range(seeds)]
    return states, np.array([state.past_position[0] for state in states])


def test_uniform_fills_the_arena():
    _, position = first_positions("uniform")
    points = position.reshape(-1, 3) / ARENA
    assert points.min() >= 0
    assert points.max() <= 1
    np.testing.assert_allclose(points.mean(axis=0), 0.5, atol=0.02)
    np.testing.assert_allclose(points.var(axis=0), 1 / 12, rtol=0.05)


def test_around_keeps_followers_within_60_metres():
    states, position = first_positions("around", 50)
    for state, p in zip(states, position, strict=True):
        distance = np.linalg.norm(p - p[state.root], axis=1)
        assert distance.max() <= 60.0 + 1e-3
        assert np.median(distance[~state.head]) == pytest.approx(60 * 0.5 ** (1 / 3), rel=0.15)


def test_gathered_tells_no_head_from_its_followers_by_place():
    """Heads, followers and lone UAVs are equally far from the middle of their ball; traffic is anywhere."""
    config = SwarmConfig(formation="gathered", clusters=1, uavs=400, decoys=99, bystanders=100, traffic=100)
    middles, far, spread = [], [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        (roles,) = draw_roles([rng], config).split()
        position = FORMATIONS.find("gathered")(rng, roles)
        middle = position[~roles.traffic].mean(axis=0)
        middles.append(middle / ARENA)
        spread.append(position[roles.traffic].std(axis=0) / ARENA)
        distance = np.linalg.norm(position - middle, axis=1)
        far.append([distance[roles.head][0], distance[roles.decoy].mean(), distance[~roles.traffic].mean()])
        assert distance[~roles.traffic].max() < 60 + 10  # the middle is estimated
    np.testing.assert_allclose(np.mean(far, axis=0), 45.0, atol=4.0)  # 3 / 4 of the radius
    np.testing.assert_allclose(np.mean(middles, axis=0), 0.5, atol=0.15)
    np.testing.assert_allclose(np.mean(spread, axis=0), 12**-0.5, rtol=0.05)


@given(seed=st.integers(0, 2**32), uavs=st.integers(3, 40), share=st.floats(0, 1))
def test_orphans_take_the_nearest_remaining_head(seed, uavs, share):
    """Against a literal reading: living followers without a living head look at all remaining heads."""
    rng = np.random.default_rng(seed)
    clusters = int(rng.integers(1, uavs // 3 + 1))
    state = start(SwarmConfig(clusters=clusters, uavs=uavs), [rng])
    before, after = state.episode(), destroy(state, rng.random((1, uavs)) < share).episode()
    alive, leader, position = after.alive, after.root, before.position
    remaining = np.flatnonzero(before.head & alive)
    for i in range(uavs):
        if before.head[i] or not alive[i] or alive[before.root[i]]:
            assert leader[i] == before.root[i]
        elif len(remaining) == 0:
            assert leader[i] == -1
        else:
            distance = np.linalg.norm(position[remaining].astype(float) - position[i], axis=1)
            assert np.linalg.norm(position[leader[i]].astype(float) - position[i]) == pytest.approx(distance.min())
            assert leader[i] in remaining


def test_a_registered_formation_is_used_by_name_and_checked():
    place = np.arange(45.0).reshape(15, 3)
    register_formation("test-line", lambda rng, roles: place, replace=True)
    state = start(SwarmConfig(formation="test-line", clusters=3, uavs=15, traffic=2), [np.random.default_rng(0)])
    assert (state.past_position[0, 0] == place).all(axis=1).sum() == 13  # all but the traffic
    np.testing.assert_array_equal(place, np.arange(45.0).reshape(15, 3))
    register_formation("test-line", lambda rng, roles: place[:-1], replace=True)
    with pytest.raises(ValueError, match="reshape"):
        start(SwarmConfig(formation="test-line", clusters=3, uavs=15), [np.random.default_rng(0)])


COPY = LaggedSum(1, noise=0.0)


def watch_chain(follow, led_by, **arguments):
    """Velocities ``(T_0, N + R, 3)`` at the end of a window, who copies whom ``(N + R,)``, and the state."""
    state, _ = fly(follow, rounds=2, uavs=30, led_by=led_by, **arguments)
    velocity = np.concatenate([state.past_velocity, state.reference_velocity], axis=1)
    return velocity, np.concatenate([state.source, state.reference_source]), state


@pytest.mark.parametrize("led_by", [1, 3, (1, 4)])
def test_heads_and_decoys_copy_unseen_uavs_as_followers_copy_heads(led_by):
    for follow in (COPY, FollowFunction(lambda inputs: inputs.head_velocity[:, 0], noise=0.0)):
        velocity, source, state = watch_chain(follow, led_by, decoys=2)
        led = np.flatnonzero(source != np.arange(len(source)))
        np.testing.assert_allclose(velocity[1:, led], velocity[:-1, source[led]], atol=1e-6)
        assert set(led) >= set(np.flatnonzero(state.head | state.decoy))
        assert (source[: len(state.head)][state.head | state.decoy] >= len(state.head)).all()


def test_the_length_of_each_chain_is_drawn():
    _, source, state = watch_chain(COPY, (1, 4), decoys=6)
    uavs, lengths = len(state.head), []
    for i in np.flatnonzero(state.head | state.decoy):
        above = [source[i]]
        while source[above[-1]] != above[-1]:
            above.append(source[above[-1]])
        assert min(above) >= uavs
        lengths.append(len(above))
    assert set(lengths) <= {1, 2, 3, 4}
    assert len(set(lengths)) > 1


def test_led_swarms_start_where_their_formation_is_and_nothing_changes_where_no_uav_leads():
    config = SwarmConfig(clusters=3, uavs=30, memory=12, formation="gathered", led_by=4)
    led, free = (start(config.model_copy(update=change), generators([3])) for change in ({}, {"led_by": 0}))
    assert np.abs(led.position).max() <= 1072.0
    assert np.linalg.norm(led.position - free.position, axis=2).max() < 30.0  # the flights of the first T_0 steps
    for follow in ("none", "independent", "reference", "shepherd", "shifted"):
        with_it, without = (fly(follow, uavs=30, led_by=led_by)[1] for led_by in (3, 0))
        np.testing.assert_array_equal(with_it.position, without.position)

"""Heads and decoys that follow unseen UAVs, ``led_by``."""

import numpy as np
import pytest
from flights import fly, generators

from usnet_env.swarm import SwarmConfig, advance, destroy, start
from usnet_env.swarm.follow import FollowFunction, LaggedSum

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


@pytest.mark.parametrize("follow", ["f1", "pigeons", "chain-led", "couzin-led", "informed-led", "predator-led"])
def test_the_truth_names_visible_uavs_and_orphans_join_a_head(follow):
    config = SwarmConfig(clusters=3, uavs=30, decoys=2, memory=12, follow=follow, led_by=(1, 4), observation_steps=20)
    rngs = generators([5])
    state, window = advance(config, start(config, rngs), rngs)
    alone, uavs = state.head | state.decoy, np.arange(30)[None]
    assert window.position.shape[2] == 30
    assert (state.leader < 30).all()
    np.testing.assert_array_equal(state.leader[state.head], uavs[state.head])
    np.testing.assert_array_equal(state.root[alone], uavs[alone])
    gone = state.head & (np.arange(30) <= np.flatnonzero(state.head[0])[0])
    after, window = advance(config, destroy(state, gone), rngs)
    followers = after.alive & ~(after.head | after.decoy | after.not_led)
    np.testing.assert_array_equal(after.head[0][after.root[followers]], True)
    assert (after.source[followers] < 30).all()
    assert after.alive[0][after.root[followers]].all()
    assert np.isfinite(window.position).all()


def test_swarms_start_where_their_formation_is():
    config = SwarmConfig(clusters=3, uavs=30, memory=12, formation="gathered", led_by=4)
    led, free = (start(config.model_copy(update=change), generators([3])) for change in ({}, {"led_by": 0}))
    assert np.abs(led.position).max() <= 1072.0
    assert np.linalg.norm(led.position - free.position, axis=2).max() < 30.0  # the flights of the first T_0 steps


def test_where_no_uav_leads_it_changes_nothing():
    for follow in ("none", "independent", "reference", "shepherd", "shifted"):
        with_it, without = (fly(follow, uavs=30, led_by=led_by)[1] for led_by in (3, 0))
        np.testing.assert_array_equal(with_it.position, without.position)


def test_a_single_track_no_longer_tells_a_head():
    """A head that answers in blocks of steps is rougher than one that leads freely, as its followers are."""
    rough = {}
    for led_by in (0, (1, 4)):
        config = SwarmConfig(
            clusters=3, uavs=30, memory=12, follow="part_time", mobility="gauss_markov", head_jitter=True, led_by=led_by
        )
        rngs = generators(range(40))
        _, window = advance(config, state := start(config, rngs), rngs)
        changes = (np.diff(window.velocity.astype(float), axis=1) ** 2).sum(axis=3)
        score, head = np.log(changes).std(axis=1), state.head
        rough[led_by] = np.mean([(score[b][head[b]][:, None] > score[b][~head[b]]).mean() for b in range(40)])
    assert abs(rough[0] - 0.5) > 0.2
    assert abs(rough[1, 4] - 0.5) < 0.1


def test_one_number_and_two_are_taken():
    assert SwarmConfig(led_by=[1, 4]).unseen_levels == (1, 4)
    assert SwarmConfig(led_by=2).unseen_levels == (2, 2)

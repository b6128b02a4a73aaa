"""The simulator: what a window holds, one regime a window, nothing global or given is touched."""

import pickle

import numpy as np
import pytest
from flights import flown, fly, generators, unit

from usnet_env.swarm import SwarmConfig, advance, destroy, start
from usnet_env.swarm.follow import LaggedSum


def test_a_window_holds_one_regime_only():
    """After a re-merge every observed step of an orphan obeys the new head: T_0 steps pass unobserved."""
    config = SwarmConfig(follow=LaggedSum(3, noise=0.0), clusters=3, uavs=20, observation_steps=20)
    rngs = generators([3])
    state, _ = advance(config, start(config, rngs), rngs)
    head = np.flatnonzero(state.head[0])[0]
    orphans = np.flatnonzero((state.root[0] == head) & ~state.head[0])
    gone = np.zeros((1, 20), bool)
    gone[0, [head, orphans[0]]] = True
    state = destroy(state, gone)
    assert state.root[0, orphans[1]] not in (head, -1)
    v, _ = flown(advance(config, state, rngs)[1])
    for i in orphans[1:]:
        past = v[:, state.root[0, i]]
        np.testing.assert_allclose(v[3:, i], unit(past[2:-1] + past[1:-2] + past[:-3]), atol=1e-4)


def test_the_destroyed_are_masked_and_stay_destroyed():
    config, rngs = SwarmConfig(clusters=3, uavs=20, observation_steps=10), generators([0])
    state, _ = advance(config, start(config, rngs), rngs)
    gone = np.zeros((1, 20), bool)
    gone[0, :5] = True
    gone[0, np.flatnonzero(state.head[0])[-1]] = False
    state = destroy(state, gone)
    for _ in range(2):
        state, window = advance(config, state, rngs)
        for array in (window.position, window.velocity, window.seen):
            assert not array[0][:, gone[0]].any()
        np.testing.assert_array_equal(window.alive, ~gone)
        assert window.seen[0][:, ~gone[0]].all()


def test_decoys_fly_like_heads_and_lead_nobody():
    state, window = fly("f1", uavs=14, decoys=4, mobility="gauss_markov", observation_steps=500)
    followers = ~(state.head | state.decoy)
    assert not np.isin(state.root[followers], np.flatnonzero(state.decoy)).any()
    pitch = np.arcsin(window.velocity[0, :, :, 2])
    assert pitch[:, state.decoy].std() == pytest.approx(np.sqrt(0.02), rel=0.3)
    assert window.velocity[0][:, state.decoy].std(axis=1).min() > 0  # each flies its own way


def test_nothing_given_or_global_is_changed():
    config = SwarmConfig(follow="f7", clusters=2, uavs=10, mobility="smooth_turn", observation_steps=10)
    before = np.random.get_state()[1].copy()  # noqa: NPY002  the global generator is what is tested
    rngs = generators([0, 1])
    state = start(config, rngs)
    given = pickle.dumps(state.arrays())
    advance(config, state, rngs)
    left = destroy(state, state.head)
    assert (left.root[~left.head] == -1).all()
    assert pickle.dumps(state.arrays()) == given
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002

"""The simulator: one code path for one and for many, one regime a window, nothing global touched."""

import pickle

import numpy as np
import pytest

from usnet_env import ArgumentError
from usnet_env.swarm import SwarmConfig, SwarmState, advance, destroy, start
from usnet_env.swarm.follow import FollowFunction, Lags
from usnet_env.swarm.mobility import MobilityFunction
from usnet_env.swarm.random_follow import random_follow_strategy


def generators(seeds):
    return [np.random.default_rng(seed) for seed in seeds]


def wander(rng, position, steps, state):
    return rng.standard_normal((steps, len(position), 3))


CASES = [
    *({"follow": f"f{k}"} for k in range(1, 8)),
    {"follow": "none", "mobility": "smooth_turn"},
    {"follow": "f1", "mobility": "gauss_markov", "head_jitter": True},
    {"follow": "f6", "mobility": "waypoint", "formation": "around"},
    {"follow": "f2", "mobility": "local_waypoint", "decoys": 3},
    {"follow": "f5", "mobility": "straight", "position_noise": 1.0, "miss_rate": 0.2, "sample_every": 2},
    {"follow": FollowFunction(lambda inputs: -inputs.head_velocity[:, 1])},
    {"follow": random_follow_strategy(np.random.default_rng(0))},
    {"mobility": MobilityFunction(wander), "head_jitter": True},
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(str(value)[:14] for value in case.values()))
def test_episode_b_of_a_batch_is_the_single_swarm(case):
    """Bit for bit, over rounds with destruction; more episodes than one chunk of noise holds."""
    config = SwarmConfig(clusters=3, uavs=40, observation_steps=30, **case)
    seeds = list(range(70))
    batch_rngs = generators(seeds)
    batch = start(config, batch_rngs)
    alone = {b: (start(config, generators([seeds[b]])), generators([seeds[b]])) for b in (0, 1, 37, 69)}
    for b, (_, rngs) in alone.items():
        alone[b] = (start(config, rngs), rngs)
    shooter = np.random.default_rng(1)
    for _ in range(3):
        batch, windows = advance(config, batch, batch_rngs)
        candidates = shooter.random(batch.alive.shape) < 0.2
        for episode in range(70):  # leave every swarm a head
            heads = np.flatnonzero(batch.head[episode] & batch.alive[episode])
            candidates[episode, heads[0]] = False
        for b, (state, rngs) in alone.items():
            state, window = advance(config, state, rngs)
            for name in ("position", "velocity", "seen", "alive"):
                np.testing.assert_array_equal(getattr(windows, name)[b], getattr(window, name)[0], err_msg=name)
            alone[b] = (destroy(state, candidates[b : b + 1]), rngs)
        batch = destroy(batch, candidates)
    for b, (state, _) in alone.items():
        for name, array in state.arrays().items():
            np.testing.assert_array_equal(batch.arrays()[name][b], array[0], err_msg=name)


def test_positions_integrate_velocities_and_speeds_are_one():
    config = SwarmConfig(clusters=2, uavs=20)
    rngs = generators([0])
    _, window = advance(config, start(config, rngs), rngs)
    assert window.position.shape == (1, 101, 20, 3)
    assert window.velocity.shape == (1, 100, 20, 3)
    np.testing.assert_allclose(np.diff(window.position, axis=1), window.velocity, atol=2e-4)
    np.testing.assert_allclose(np.linalg.norm(window.velocity, axis=-1), 1.0, atol=1e-5)
    assert window.seen.all()


def test_a_window_holds_one_regime_only():
    """After a re-merge every observed step of an orphan obeys the new head: T_0 steps pass unobserved."""
    config = SwarmConfig(follow=Lags(3, noise=0.0), clusters=3, uavs=20, observation_steps=20)
    rngs = generators([3])
    state, _ = advance(config, start(config, rngs), rngs)
    head = np.flatnonzero(state.head[0])[0]
    orphans = np.flatnonzero((state.root[0] == head) & ~state.head[0])
    gone = np.zeros((1, 20), bool)
    gone[0, [head, orphans[0]]] = True
    state = destroy(state, gone)
    assert state.root[0, orphans[1]] not in (head, -1)
    after, window = advance(config, state, rngs)
    v = window.velocity[0].astype(float)
    for i in orphans[1:]:
        new = state.root[0, i]
        past = np.concatenate([after.past_velocity[0, :0], v])[:, new]
        wanted = past[2:-1] + past[1:-2] + past[:-3]
        wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
        np.testing.assert_allclose(v[3:, i], wanted, atol=1e-4)
    # The first observed velocities too: rebuild the unobserved steps from the positions on both sides.
    gap = window.position[0, 0] - state.position[0]
    assert np.linalg.norm(gap[orphans[1]]) > 0
    np.testing.assert_allclose(np.linalg.norm(gap[state.alive[0]], axis=1).max(), 4.0, atol=4.0)


def test_the_destroyed_are_masked_and_stay_destroyed():
    config = SwarmConfig(clusters=3, uavs=20, observation_steps=10)
    rngs = generators([0])
    state, _ = advance(config, start(config, rngs), rngs)
    gone = np.zeros((1, 20), bool)
    gone[0, :5] = True
    gone[0, np.flatnonzero(state.head[0])[-1]] = False
    state = destroy(state, gone)
    for _ in range(2):
        state, window = advance(config, state, rngs)
        assert not window.position[0][:, gone[0]].any()
        assert not window.velocity[0][:, gone[0]].any()
        assert not window.seen[0][:, gone[0]].any()
        np.testing.assert_array_equal(window.alive[0], ~gone[0])
        assert window.seen[0][:, ~gone[0]].all()


def test_decoys_fly_like_heads_and_lead_nobody():
    config = SwarmConfig(clusters=2, uavs=14, decoys=4, mobility="gauss_markov", observation_steps=500)
    rngs = generators([0])
    state = start(config, rngs)
    _, window = advance(config, state, rngs)
    followers = ~(state.head[0] | state.decoy[0])
    assert not np.isin(state.root[0, followers], np.flatnonzero(state.decoy[0])).any()
    pitch = np.arcsin(window.velocity[0, :, :, 2])
    assert pitch[:, state.decoy[0]].std() == pytest.approx(np.sqrt(0.02), rel=0.3)
    assert window.velocity[0][:, state.decoy[0]].std(axis=1).min() > 0  # each flies its own way


def test_advancing_changes_nothing_that_it_was_given():
    config = SwarmConfig(clusters=2, uavs=10, mobility="smooth_turn", observation_steps=10)
    rngs = generators([0, 1])
    state = start(config, rngs)
    before = pickle.dumps(state.arrays())
    advance(config, state, rngs)
    destroy(state, np.ones((2, 10), bool))
    assert pickle.dumps(state.arrays()) == before


def test_the_global_generator_is_left_alone():
    np.random.seed(5)  # noqa: NPY002  the global generator is what is tested
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    config = SwarmConfig(follow="f7", mobility="waypoint", observation_steps=10)
    rngs = generators([0])
    advance(config, start(config, rngs), rngs)
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002


def test_a_swarm_without_heads_does_not_fly_on():
    config = SwarmConfig(clusters=2, uavs=10)
    rngs = generators([0])
    state = start(config, rngs)
    state = destroy(state, state.head)
    assert (state.root[0][~state.head[0]] == -1).all()
    with pytest.raises(ArgumentError, match="state must have a living head"):
        advance(config, state, rngs)
    with pytest.raises(ArgumentError, match="rngs must hold one generator"):
        advance(config, start(config, rngs), generators([0, 1]))


def test_state_travels_as_plain_arrays():
    state = start(SwarmConfig(clusters=2, uavs=10), generators([0, 1]))
    again = SwarmState(**state.arrays())
    for name, array in state.arrays().items():
        np.testing.assert_array_equal(getattr(again, name), array)
    one = state.episode(1)
    np.testing.assert_array_equal(one.head, state.head[1])
    assert one.heads_left == 2

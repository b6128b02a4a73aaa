"""The simulator and the observer: what a window holds, noise, misses, and a batch as its single swarms."""

import pickle

import numpy as np
import pytest
from flights import flown, fly, generators, unit

from usnet_env import ArgumentError
from usnet_env.envs import MultiClusterEnv
from usnet_env.swarm import MOBILITIES, SwarmConfig, advance, destroy, start
from usnet_env.swarm.config import SWAP_RANGE
from usnet_env.swarm.follow import CONTROLS, FIELD_MODELS, LED_MODELS, FollowFunction, LaggedSum
from usnet_env.swarm.mobility import MobilityFunction
from usnet_env.swarm.random_follow import random_follow_strategy


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


def wander(rng, position, steps, state):
    return rng.standard_normal((steps, len(position), 3))


SENSOR = {
    "position_noise": 1.0, "noise_memory": 0.5, "miss_rate": 0.1, "miss_burst": 3.0, "partial_tracks": 0.3,
    "swap_rate": 0.01,
}  # fmt: skip
CASES = [
    *({"follow": f"f{k}"} for k in range(1, 8)),
    *({"follow": "f6", "mobility": name, "head_jitter": True} for name in MOBILITIES),
    *({"follow": name, "kinematics": "limited"} for name in (*FIELD_MODELS, *CONTROLS)),
    *({"follow": "f6", "kinematics": name} for name in ("varied_speed", "lagged", "layered")),
    *({"follow": name, "led_by": (1, 3), "kinematics": "limited"} for name in ("f2", "part_time", *LED_MODELS)),
    {"follow": FollowFunction(lambda inputs: inputs.head_velocity[:, 1]), "led_by": 2, "mobility": "waypoint"},
    {"follow": "none", "mobility": "smooth_turn"},
    {"follow": "f5", "sample_every": 2, "clutter": 4, **SENSOR},
    {"follow": FollowFunction(lambda inputs: -inputs.head_velocity[:, 1])},
    {"follow": random_follow_strategy(np.random.default_rng(0))},
    {"mobility": MobilityFunction(wander), "head_jitter": True},
    {"mobility": MobilityFunction(wander), "kinematics": "lagged"},
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(str(value)[:14] for value in case.values()))
def test_episode_b_of_a_batch_is_the_single_swarm(case):
    """Over rounds with destruction; there are more episodes than one chunk of noise holds."""
    arguments = {"memory": 12, "formation": "around", "decoys": 2, "bystanders": 2, "traffic": 2, **case}
    config = SwarmConfig(clusters=3, uavs=60, observation_steps=24, **arguments)
    rngs, alone = generators(range(45)), generators([40])
    batch, single = start(config, rngs), start(config, alone)
    shooter = np.random.default_rng(1)
    for _ in range(3):
        batch, windows = advance(config, batch, rngs)
        single, window = advance(config, single, alone)
        for name in ("position", "velocity", "seen", "alive"):
            np.testing.assert_array_equal(getattr(windows, name)[40], getattr(window, name)[0], err_msg=name)
        assert np.isfinite(windows.velocity).all()
        for array in (windows.position, windows.velocity, windows.seen):
            assert not array.swapaxes(1, 2)[~windows.alive].any()
        candidates = shooter.random(batch.alive.shape) < 0.2
        for b in range(45):  # leave every swarm a head
            candidates[b, np.flatnonzero(batch.head[b] & batch.alive[b])[:1]] = False
        batch, single = destroy(batch, candidates), destroy(single, candidates[40:41])
    for name, array in single.arrays().items():
        np.testing.assert_array_equal(batch.arrays()[name][40], array[0], err_msg=name)


@pytest.mark.parametrize(
    "arguments",
    [
        *({name: 0} for name in ("clusters", "uavs", "observation_steps", "memory")),
        *({name: value} for name in ("position_noise", "miss_rate") for value in (np.nan, -1.0, 1e9)),
        *({name: value} for name in ("follow", "mobility", "formation", "kinematics") for value in ("", "f8", 3, None)),
        *({"cluster_sizes": value} for value in ("55555", [2, 2], [1, 19, 19, 19, 19], [2, 2, 2, 2, 2])),
        *({"led_by": value} for value in (-1, 9, 1.5, (0, 2), (3, 2), (1, 2, 3), "two")),
        {"sample_every": 10**9},
        {"decoys": -1},
        {"head_jitter": "yes"},
        {"follow_seed": 2**63},
        {"miss_rate": 1.0},
        {"miss_burst": 0.5},
        {"miss_burst": 2.0, "miss_rate": 0.9},
        {"memory": 3, "follow": "f7"},
        {"uavs": 14},
        {"uavs": 16, "decoys": 2},
    ],
)
def test_a_bad_value_and_one_that_contradicts_another_are_named(arguments):
    with pytest.raises(ArgumentError, match=rf"^{next(iter(arguments))}\S* must [^\n]*got [^\n]*\.$"):
        SwarmConfig(**arguments)


def observed(**arguments):
    return fly("f1", **{"memory": 4, "clusters": 5, "uavs": 82, "mobility": "gauss_markov", **arguments})[1]


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_noise_has_its_size_and_memory_and_velocities_are_differences_of_what_is_seen(memory):
    truth, window = observed(), observed(position_noise=2.0, noise_memory=memory)
    noise = (window.position - truth.position)[0].astype(float)
    assert noise.std() == pytest.approx(2.0, rel=0.05)
    assert abs(noise.mean()) < 0.1
    assert np.mean(noise[1:] * noise[:-1]) / noise.var() == pytest.approx(memory, abs=0.03)
    np.testing.assert_allclose(window.velocity, np.diff(window.position, axis=1), atol=1e-6)
    error = (window.velocity - truth.velocity)[0]
    assert error.std() == pytest.approx(2.0 * np.sqrt(2 * (1 - memory)), rel=0.05)


@pytest.mark.parametrize(("burst", "length"), [(0.0, 1 / 0.8), (6.0, 6.0)])
def test_misses_have_their_rate_come_in_bursts_and_are_masked(burst, length):
    truth, window = observed(observation_steps=600), observed(observation_steps=600, miss_rate=0.2, miss_burst=burst)
    assert window.seen.mean() == pytest.approx(0.8, abs=0.02)
    ends = (~window.seen[:, :-1] & window.seen[:, 1:]).sum()
    assert (~window.seen).sum() / ends == pytest.approx(length, rel=0.1)
    assert not window.position[~window.seen].any()
    np.testing.assert_array_equal(window.position[window.seen], truth.position[window.seen])
    both = window.seen[:, 1:] & window.seen[:, :-1]
    assert not window.velocity[~both].any()
    np.testing.assert_array_equal(window.velocity[both], truth.velocity[both])


def test_sampling_every_kth_step_keeps_metres_per_step():
    truth = observed(observation_steps=300)
    window = observed(observation_steps=100, sample_every=3)
    assert window.velocity.shape[1] == 100  # T_ob counts samples
    np.testing.assert_array_equal(window.position, truth.position[:, ::3])
    mean = truth.velocity.reshape(1, 100, 3, 82, 3).mean(axis=2)
    np.testing.assert_allclose(window.velocity, mean, atol=1e-4)


def test_noise_along_the_course_differs_from_that_across_it():
    truth, window = observed(), observed(position_noise=0.5, course_noise=4.0)
    noise = (window.position - truth.position)[0, :-1].astype(float)
    course = truth.velocity[0].astype(float)
    along = (noise * course).sum(axis=-1)
    across = noise - along[..., None] * course
    assert along.std() == pytest.approx(2.0, rel=0.03)
    assert np.sqrt((across**2).sum(axis=-1).mean() / 2) == pytest.approx(0.5, rel=0.03)
    assert abs(along.mean()) < 0.1
    np.testing.assert_allclose(window.velocity, np.diff(window.position, axis=1), atol=1e-6)
    env = MultiClusterEnv(position_noise=3.0, course_noise=10.0)
    assert env.observation_space.contains(env.reset(seed=0)[0])


def test_false_tracks_begin_and_end_and_are_no_uavs():
    settings = {"clutter": 12, "traffic": 3, "bystanders": 4, "decoys": 2, "mobility": "gauss_markov"}
    config = SwarmConfig(clusters=4, uavs=82, **settings)
    rngs = [np.random.default_rng(1)]
    state = start(config, rngs)
    false = state.free[0, -12:]
    assert state.not_led[0, false].all()
    assert not (state.head | state.decoy)[0, false].any()
    np.testing.assert_array_equal(state.root[0, false], false)
    assert not np.isin(np.delete(state.root[0], false), false).any()
    seen = []
    for _ in range(2):
        state, window = advance(config, state, rngs)
        seen.append(window.seen[0, :, false].T)
        assert window.seen[0].sum(axis=0)[np.setdiff1d(np.arange(82), false)].min() == 101
        changes = np.diff(np.pad(seen[-1], ((1, 1), (0, 0))).astype(int), axis=0)
        assert (np.abs(changes).sum(axis=0) == 2).all()  # one beginning, one end
        assert seen[-1].sum(axis=0).min() >= 10
        assert seen[-1].sum(axis=0).max() <= 61
        assert not window.position[~window.seen].any()
        assert not window.velocity[~(window.seen[:, 1:] & window.seen[:, :-1])].any()
    assert (seen[0] != seen[1]).any(axis=0).all()


def test_partial_tracks_begin_late_or_end_early():
    window = observed(partial_tracks=0.5)
    seen = window.seen[0]
    changes = np.abs(np.diff(seen.astype(int), axis=0)).sum(axis=0)
    assert set(changes) == {0, 1}
    assert changes.mean() == pytest.approx(0.5, abs=0.2)
    cut = changes == 1
    assert (seen[0] | seen[-1]).all()
    assert seen[0, cut].any()
    assert seen[-1, cut].any()
    assert not window.position[0][~seen].any()


def test_near_uavs_exchange_their_identities():
    truth, window = observed(formation="around"), observed(formation="around", swap_rate=0.005)
    gap = np.linalg.norm(window.position[0, :, :, None] - truth.position[0, :, None], axis=-1)  # (instants, seen, true)
    shown = gap.argmin(axis=2)
    assert gap.min(axis=2).max() < 1e-3
    for row in shown:
        assert sorted(row) == list(range(82))
    assert (shown[0] == np.arange(82)).mean() > 0.9
    assert (shown[-1] != np.arange(82)).mean() > 0.05
    jumps = np.linalg.norm(window.velocity[0], axis=-1)
    assert jumps.max() <= SWAP_RANGE + 1.001
    np.testing.assert_allclose(window.velocity, np.diff(window.position, axis=1), atol=1e-6)


def test_an_exchange_with_a_false_track_hides_no_uav():
    arguments = {"clutter": 60, "uavs": 400}
    truth, window = observed(**arguments), observed(**arguments, swap_rate=0.05)
    uavs = np.flatnonzero(truth.seen[0].all(axis=0))
    assert len(uavs) == 340
    exchanged = 0
    for uav in uavs:
        shown = (window.position[0] == truth.position[0, :, uav, None]).all(axis=-1) & window.seen[0]
        assert (shown.sum(axis=1) == 1).all()
        exchanged += int(np.isin(shown.argmax(axis=1), uavs, invert=True).sum())
    assert exchanged > 0

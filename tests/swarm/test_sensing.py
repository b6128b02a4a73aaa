"""What the observer sees: noise, misses and sampling."""

import numpy as np
import pytest
from flights import fly

from usnet_env.envs import MultiClusterEnv
from usnet_env.swarm import SwarmConfig, advance, start
from usnet_env.swarm.config import SWAP_RANGE


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


def test_misses_have_their_rate_and_are_masked():
    truth, window = observed(), observed(miss_rate=0.3)
    assert window.seen.mean() == pytest.approx(0.7, abs=0.02)
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


def test_missed_detections_come_in_bursts():
    seen = observed(miss_rate=0.2, miss_burst=6.0, observation_steps=2000).seen[0]
    assert seen.mean() == pytest.approx(0.8, abs=0.02)
    ends = (~seen[:-1] & seen[1:]).sum()
    assert (~seen).sum() / ends == pytest.approx(6.0, rel=0.1)


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

"""What the observer sees: noise, misses and sampling."""

import numpy as np
import pytest

from usnet_env.swarm import SwarmConfig, advance, start


def observed(**arguments):
    config = SwarmConfig(**{"clusters": 5, "uavs": 82, "mobility": "gauss_markov", **arguments})
    rngs = [np.random.default_rng(0)]
    state = start(config, rngs)
    return advance(config, state, rngs)[1]


def test_noise_has_its_size_and_velocities_are_differences_of_what_is_seen():
    truth, window = observed(), observed(position_noise=2.0)
    noise = (window.position - truth.position)[0]
    assert noise.std() == pytest.approx(2.0, rel=0.02)
    assert abs(noise.mean()) < 0.05
    assert abs(np.mean(noise[1:] * noise[:-1])) < 0.1  # fresh at every instant
    np.testing.assert_allclose(window.velocity, np.diff(window.position, axis=1), atol=1e-6)
    error = (window.velocity - truth.velocity)[0]
    assert error.std() == pytest.approx(2.0 * np.sqrt(2), rel=0.02)


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


def test_without_noise_the_observed_velocity_is_the_true_one():
    window = observed()
    np.testing.assert_allclose(np.linalg.norm(window.velocity, axis=-1), 1.0, atol=1e-6)

"""The topology matrix of equation (5), the batch of Algorithm 1, and its standardised form."""

import numpy as np
import pytest
from single_cluster_windows import cluster, without

from detectors.gassl.topology_matrix import build_batch
from detectors.gassl.training import prepare_inputs
from detectors.series.gaps import fill_gaps


def topology_matrix(window, time, members=None, memory=4):
    """X_t as the batch holds it: three rows for each UAV."""
    batch, r = build_batch(window, members, memory), time - memory + 1
    columns = np.concatenate([batch.position[r][:, None], batch.velocity[r]], axis=1)
    return columns.swapaxes(1, 2).reshape(3 * batch.uavs, memory + 1)


@pytest.mark.parametrize(("memory", "time"), [(4, 3), (4, 10), (1, 0), (2, 7)])
def test_the_topology_matrix_is_equation_5(memory, time):
    window, _ = cluster(followers=4, observation_steps=12)
    x = topology_matrix(window, time, memory=memory)
    assert x.shape == (3 * 5, memory + 1)
    assert x.dtype == np.float32
    for i in range(5):
        for axis in range(3):
            printed = [window.position[time - memory + 1, i, axis]]
            printed += [window.velocity[t, i, axis] for t in range(time - memory + 1, time + 1)]
            assert x[3 * i + axis].tolist() == printed


def test_the_topology_matrix_of_a_cluster_has_the_rows_of_its_members():
    window, _ = cluster(followers=4, observation_steps=12)
    part = topology_matrix(window, 8, np.array([4, 1]))
    rows = topology_matrix(window, 8).reshape(5, 3, 5)
    np.testing.assert_array_equal(part.reshape(2, 3, 5), rows[[4, 1]])
    living = topology_matrix(without(window, [2]), 8)
    np.testing.assert_array_equal(living.reshape(4, 3, 5), rows[[0, 1, 3, 4]])


@pytest.mark.parametrize("memory", [4, 2])
def test_a_batch_is_the_matrices_of_all_times_and_the_next_velocities(memory):
    window, _ = cluster(followers=3, miss_rate=0.2, observation_steps=15)
    members = np.array([3, 0, 1])
    batch = build_batch(window, members, memory)
    assert (batch.times, batch.uavs, batch.memory) == (15 - memory, 3, memory)
    filled = fill_gaps(window)
    for r in range(batch.times):
        t = r + memory - 1  # the newest velocity of the matrix, v_t
        past = slice(t - memory + 1, t + 1)
        np.testing.assert_array_equal(batch.position[r], filled.position[past.start, members])
        np.testing.assert_array_equal(batch.velocity[r], filled.velocity[past, members].swapaxes(0, 1))
        for place, i in enumerate(members):
            seen = window.velocity_seen[t + 1, i]
            assert batch.weight[r, place] == seen
            np.testing.assert_array_equal(batch.target[r, place], window.velocity[t + 1, i] * seen)
            instants = [t - memory + 1 + k for k in range(memory + 1)]  # up to t + 1
            np.testing.assert_array_equal(batch.own[r, place], filled.position[instants, i])
    assert 0 < batch.weight.mean() < 1


def test_inputs_are_the_standardised_batch():
    window, _ = cluster(followers=3, observation_steps=15, miss_rate=0.1)
    batch = build_batch(window)
    inputs = prepare_inputs(batch)
    velocity = (batch.velocity - batch.velocity.mean()) / batch.velocity.std()
    position = (batch.position - batch.position.mean(axis=(0, 1))) / batch.position.std(axis=(0, 1))
    assert inputs.entries == 6 * 5
    for t in range(batch.times):
        for i in range(4):
            columns = [*(velocity[t, i, 3 - lag] for lag in range(4)), position[t, i]]  # newest first
            np.testing.assert_allclose(inputs.history[i, t], np.concatenate(columns), atol=1e-4)
            np.testing.assert_allclose(inputs.value[:, :, i, t], columns, atol=1e-4)
            mean = batch.own[:, i].mean(axis=(0, 1))
            np.testing.assert_allclose(inputs.own[i, t], (batch.own[t, i] - mean).ravel(), atol=1e-3)
            np.testing.assert_array_equal(inputs.target[i, t], batch.target[t, i])
            assert inputs.weight[i, t] == batch.weight[t, i]

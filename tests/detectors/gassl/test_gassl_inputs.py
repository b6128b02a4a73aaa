"""The batch of Algorithm 1: the topology matrices of equation (5) and the next velocities, standardised."""

import numpy as np
import pytest
from single_cluster_windows import cluster

from detectors.gassl.topology_matrix import build_batch
from detectors.series.gaps import fill_gaps


@pytest.mark.parametrize(("memory", "members"), [(4, [0, 1, 2, 3]), (2, [3, 0, 1]), (1, [1, 2])])
def test_the_batch_holds_the_columns_of_equation_5_at_all_times(memory, members):
    window, _ = cluster(followers=3, observation_steps=15, miss_rate=0.2)
    inputs, filled = build_batch(window, np.array(members), memory), fill_gaps(window)
    times, position, velocity = 15 - memory, filled.position[:, members], filled.velocity[:, members]
    pasts = np.array([velocity[r : r + memory] for r in range(times)])
    first = position[:times]
    assert inputs.history.shape == (len(members), times, 3 * (memory + 1))
    assert inputs.entries == 6 * (memory + 1)
    for r in range(times):
        for i, uav in enumerate(members):
            columns = [(velocity[r + memory - 1 - lag, i] - pasts.mean()) / pasts.std() for lag in range(memory)]
            columns.append((first[r, i] - first.mean(axis=(0, 1))) / first.std(axis=(0, 1)))
            np.testing.assert_allclose(inputs.history[i, r], np.concatenate(columns), atol=1e-4)
            np.testing.assert_allclose(inputs.value[:, :, i, r], columns, atol=1e-4)
            places = np.array([position[s : s + memory + 1, i] for s in range(times)])  # up to t + 1
            np.testing.assert_allclose(inputs.own[i, r], (places[r] - places.mean(axis=(0, 1))).ravel(), atol=1e-3)
            seen = window.velocity_seen[r + memory, uav]
            assert inputs.weight[i, r] == seen
            np.testing.assert_array_equal(inputs.target[i, r], window.velocity[r + memory, uav] * seen)
    assert 0 < inputs.weight.mean() < 1

"""The samples of neural-granger, against the index convention of the paper."""

import numpy as np
import pytest
import torch
from single_cluster_windows import cluster, samples, without

from detectors.neural_granger.inputs import build_samples
from detectors.series.gaps import fill_gaps


@pytest.mark.parametrize("memory", [2, 4])
def test_samples_follow_the_index_convention(memory):
    window, _ = cluster(followers=3, miss_rate=0.2)
    whole = fill_gaps(window)
    one = samples([window], memory)
    rows = 100 - memory
    assert (one.windows, one.uavs, one.times) == (1, 4, rows)
    assert one.target.shape == (1, 4, rows, 3)
    for i, row in [(0, 0), (2, 41), (3, rows - 1)]:
        t = row + memory - 1  # the newest velocity of the sample, v_t
        np.testing.assert_array_equal(one.target[0, i, row], window.velocity[t + 1, i])
        assert bool(one.weight[0, i, row]) == window.velocity_seen[t + 1, i]
        for lag in range(memory):
            np.testing.assert_array_equal(one.velocity[0, i, row, lag], whole.velocity[t - lag, i])
        np.testing.assert_array_equal(one.position[0, i, row], whole.position[t, i])


def test_samples_of_the_members_only():
    """Every window of a batch has its own members; the samples of the others are absent."""
    first, second = (cluster(seed, followers=4)[0] for seed in (0, 1))
    members = [np.array([0, 2, 3]), np.array([1, 2, 4])]
    batch = build_samples([first, without(second, [0])], members, 4, torch.device("cpu"))
    for e, (window, index) in enumerate(zip((first, second), members, strict=True)):
        whole = samples([window])
        for name in ("velocity", "position", "target", "weight"):
            np.testing.assert_array_equal(getattr(batch, name)[e], getattr(whole, name)[0, index])

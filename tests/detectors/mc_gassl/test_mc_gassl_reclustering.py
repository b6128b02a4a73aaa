"""Equations (37) and (38) against loops over all pairs, and the clusters of the on-line dataset."""

import numpy as np
import pytest
import torch
from synthetic_windows import swarm_window

from detectors.gassl.ifsn import VARIANCE_FLOOR, draw_ifsn
from detectors.gassl.topology_matrix import build_batch
from detectors.mc_gassl.algorithm_2 import find_best_heads, recluster


def inputs_of_swarm(seed=0, **config):
    config = {"uavs": 8, "clusters": 2, "observation_steps": 14, "follow": "f1"} | config
    window, _ = swarm_window(seed, **config)
    return build_batch(window, np.arange(window.uavs))


def draw_gamma(inputs, hidden=8, seed=0):
    return 3.0 * draw_ifsn(inputs.entries, hidden, np.random.default_rng(seed))


def predicted(gamma, hidden, values):
    """The IFSN of standardised concatenations ``(R, d)``, in float64: three hidden layers and a linear output."""
    rest = torch.from_numpy(gamma).double()
    for layer in range(4):
        rows, columns = values.shape[1], hidden if layer < 3 else 3
        matrix, bias, rest = rest.split([rows * columns, columns, len(rest) - (rows + 1) * columns])
        values = values @ matrix.view(rows, columns) + bias
        values = torch.tanh(values) if layer < 3 else values
    return values


def loss_of_pair(inputs, gamma, hidden, i, other):
    """The squared error of UAV i's velocities if ``other`` is its head."""
    columns = [inputs.own[i], *(column[:, other].T for column in inputs.value)]  # P_i; V_{i'}, newest first, and p_{i'}
    rows = torch.from_numpy(np.concatenate(columns, axis=1)).double()
    variance, mean = torch.var_mean(rows, dim=0, correction=0)
    error = predicted(gamma, hidden, (rows - mean) / (variance + VARIANCE_FLOOR) ** 0.5).numpy() - inputs.target[i]
    return (inputs.weight[i] * (error**2).sum(axis=1)).sum()


@pytest.mark.parametrize(("seed", "hidden", "miss_rate"), [(0, 8, 0.0), (1, 5, 0.3), (2, 8, 0.0)])
def test_best_heads_are_equation_37(seed, hidden, miss_rate):
    inputs = inputs_of_swarm(seed, miss_rate=miss_rate)
    gamma = draw_gamma(inputs, hidden, seed)
    kept = [inputs.own.copy(), inputs.value.copy()]
    chosen = find_best_heads(inputs, gamma)
    for i in range(8):
        losses = {other: loss_of_pair(inputs, gamma, hidden, i, other) for other in range(8) if other != i}
        assert chosen[i] == min(losses, key=losses.get)
    assert len(set(chosen.tolist())) > 1
    np.testing.assert_array_equal(inputs.own, kept[0])
    np.testing.assert_array_equal(inputs.value, kept[1])


CHOSEN = np.array([4, 7, 4, 4, 7, 7, 1, 4, 1, 7, 7])  # scores: 2 of UAV 1, 4 of UAV 4, 5 of UAV 7


def test_the_highest_scores_become_heads_of_the_uavs_that_chose_them():
    labels = recluster(CHOSEN, 2, np.random.default_rng(0))
    # 7 is the first head, 4 the second, each of a cluster of its own; 6 and 8 chose UAV 1, which is no head
    assert labels.tolist() == [1, 0, 1, 1, 1, 0, -1, 0, -1, 0, 0]
    three = recluster(CHOSEN, 3, np.random.default_rng(0))
    assert three.tolist() == [1, 2, 1, 1, 1, 0, 2, 0, 2, 0, 0]

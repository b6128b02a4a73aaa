"""Equations (26) to (29) of the GRU, (30) to (32) of its triplets, (37) and (38) of the heads, against loops."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from mc_gassl_inputs import generator, parameters, random_inputs
from synthetic_windows import swarm_window

from detectors.gassl.ifsn import VARIANCE_FLOOR, draw_ifsn
from detectors.gassl.topology_matrix import build_batch
from detectors.mc_gassl.algorithm_2 import find_best_heads, recluster
from detectors.mc_gassl.gru import GruParameters, run_gru
from detectors.mc_gassl.triplet import Metric, compute_batch_loss, compute_triplet_loss, draw_triplets


def literal(weights, h, velocity):
    """The cells of one UAV; ``weights`` are W_r, W_u, W_h."""
    for v in velocity:
        g_r, g_u = (1 / (1 + np.exp(-w @ np.append(h, v))) for w in weights[:2])
        new = np.tanh(weights[2] @ np.append(v, g_r * h))
        h = (1 - g_u) * h + g_u * new
    return h


@settings(max_examples=25, deadline=None)
@given(memory=st.integers(1, 5), seed=st.integers(0, 10_000))
def test_the_network_is_the_equations_one_after_another(memory, seed):
    weights = parameters(seed)
    inputs = random_inputs(times=2, uavs=3, memory=memory, seed=seed)
    features = run_gru(weights, inputs.position, inputs.velocity)
    matrices = [tensor.numpy() for tensor in weights]
    for t in range(2):
        for i in range(3):
            want = literal(matrices, inputs.position[t, i].numpy() / (1000, 1000, 100), inputs.velocity[t, i].numpy())
            np.testing.assert_allclose(features[t, i], want, atol=1e-12)


def rows(triplets):
    columns = (triplets.time, triplets.anchor, triplets.positive, triplets.negative)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def in_input_space(inputs, t, i, j):
    """Equations (30) and (31)'s norm, number by number."""
    one = [*inputs.position[t, i].tolist(), *inputs.velocity[t, i].flatten().tolist()]
    two = [*inputs.position[t, j].tolist(), *inputs.velocity[t, j].flatten().tolist()]
    return sum((a - b) ** 2 for a, b in zip(one, two, strict=True)) ** 0.5


def partners(inputs, labels, t, i):
    there = [j for j in range(len(labels)) if bool(inputs.seen[t, j]) and labels[j] >= 0]
    same = [j for j in there if labels[j] == labels[i] and j != i]
    return same, [j for j in there if labels[j] != labels[i]]


@pytest.mark.parametrize("unseen", [0.0, 0.3])
def test_hard_sampling_is_the_papers(unseen):
    inputs, labels = random_inputs(unseen=unseen), torch.tensor([0, 1, 2, 0, 1, 2, 0, 1, -1])
    triplets = draw_triplets(10_000, inputs, labels, generator())
    found = {(t, a): (p, n) for t, a, p, n in rows(triplets)}
    for t in range(len(inputs.position)):
        for i in range(len(labels)):
            same, other = partners(inputs, labels, t, i)
            if not bool(inputs.seen[t, i]) or labels[i] < 0 or not same or not other:
                assert (t, i) not in found
                continue
            positive = max(same, key=lambda j: in_input_space(inputs, t, i, j))
            negative = min(other, key=lambda j: in_input_space(inputs, t, i, j))
            assert found[t, i] == (positive, negative)


def test_the_batch_loss_is_the_mean_and_its_gradient_that_of_finite_differences():
    inputs, labels = random_inputs(), torch.arange(9) % 3
    metric = Metric(margin=5.0, times=5, anchors=1000)  # no hinge is at its kink

    def loss(reset, update, candidate):
        return compute_batch_loss(GruParameters(reset, update, candidate), inputs, labels, metric, generator())

    arrays = parameters()
    features = run_gru(parameters(), inputs.position, inputs.velocity)
    triplets = draw_triplets(10_000, inputs, labels, generator())
    members = (triplets.anchor, triplets.positive, triplets.negative)
    of_each = compute_triplet_loss(*(features[triplets.time, member] for member in members), 5.0)
    assert loss(*arrays).item() == pytest.approx(of_each.mean().item())
    assert torch.autograd.gradcheck(loss, tuple(tensor.requires_grad_(True) for tensor in arrays))


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
    window, _ = swarm_window(seed, uavs=8, clusters=2, observation_steps=14, miss_rate=miss_rate)
    inputs = build_batch(window, np.arange(8))
    gamma = 3.0 * draw_ifsn(inputs.entries, hidden, np.random.default_rng(seed))
    kept = [inputs.own.copy(), inputs.value.copy()]
    chosen = find_best_heads(inputs, gamma, hidden)
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

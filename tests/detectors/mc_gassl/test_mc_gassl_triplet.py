"""Triplets and their loss, held against loops over all pairs."""

import pytest
import torch
from mc_gassl_inputs import generator, parameters, random_inputs

from detectors.mc_gassl.gru import GruParameters, run_gru
from detectors.mc_gassl.triplet import Metric, compute_batch_loss, compute_triplet_loss, draw_triplets


def loss_of(features, triplets, margin):
    """The loss of each triplet, from the features ``(R, n, 3)`` of all UAVs."""
    members = (triplets.anchor, triplets.positive, triplets.negative)
    return compute_triplet_loss(*(features[triplets.time, member] for member in members), margin)


def rows(triplets):
    columns = (triplets.time, triplets.anchor, triplets.positive, triplets.negative)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def in_input_space(inputs, t, i, j):
    """Equations (30) and (31)'s norm, number by number."""
    one = [*inputs.position[t, i].tolist(), *inputs.velocity[t, i].flatten().tolist()]
    two = [*inputs.position[t, j].tolist(), *inputs.velocity[t, j].flatten().tolist()]
    return sum((a - b) ** 2 for a, b in zip(one, two, strict=True)) ** 0.5


def partners(inputs, labels, t, i):
    """Seen UAVs of the anchor's cluster, and of the others."""
    there = [j for j in range(inputs.uavs) if bool(inputs.seen[t, j]) and labels[j] >= 0]
    same = [j for j in there if labels[j] == labels[i] and j != i]
    return same, [j for j in there if labels[j] != labels[i]]


@pytest.mark.parametrize("unseen", [0.0, 0.3])
def test_hard_sampling_is_the_papers(unseen):
    inputs, labels = random_inputs(unseen=unseen), torch.tensor([0, 1, 2, 0, 1, 2, 0, 1, -1])
    triplets = draw_triplets(10_000, inputs, labels, generator())
    found = {(t, a): (p, n) for t, a, p, n in rows(triplets)}
    for t in range(inputs.times):
        for i in range(inputs.uavs):
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

    arrays = parameters().tensors()
    features = run_gru(parameters(), inputs.position, inputs.velocity)
    triplets = draw_triplets(10_000, inputs, labels, generator())
    assert loss(*arrays).item() == pytest.approx(loss_of(features, triplets, 5.0).mean().item())
    assert torch.autograd.gradcheck(loss, tuple(tensor.requires_grad_(True) for tensor in arrays))

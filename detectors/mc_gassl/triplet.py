"""Metric learning of §IV-A: triplets drawn from known clusters, and the Siamese network's triplet loss."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from detectors.mc_gassl.gru import GruInputs, GruParameters, run_gru
from usnet_env.config import Config


class Metric(Config):
    """What a batch of triplets and its loss are made of: gamma, random times, and B."""

    margin: Annotated[float, Field(gt=0)] = 0.5
    times: Annotated[int, Field(ge=1, le=100_000)] = 8
    anchors: Annotated[int, Field(ge=1, le=100_000)] = 256


class Triplets(NamedTuple):
    """B triplets: ``(B,)`` indices of times, and of the UAVs i_a, i_p of its cluster, and i_n of another one."""

    time: Tensor
    anchor: Tensor
    positive: Tensor
    negative: Tensor


def draw_triplets(anchors: int, inputs: GruInputs, labels: Tensor, generator: torch.Generator) -> Triplets:
    """Draw triplets for random ``anchors``, B of them or as many as are possible, by hard sampling.

    Equations (30) and (31): of the anchor's cluster the farthest in input space, of the others the nearest in input
    space. Inputs are in metres there, so positions decide. UAVs with -1 in ``labels`` ``(n,)`` int64 take no part.
    """
    is_available = inputs.seen & (labels >= 0)
    cluster = torch.from_numpy(np.unique(labels.numpy(), return_inverse=True)[1])
    size = torch.zeros(is_available.shape, dtype=torch.int64).index_add_(1, cluster, is_available.long())[:, cluster]
    is_anchor = is_available & (size > 1) & (size < is_available.sum(dim=1, keepdim=True))
    pairs = is_anchor.nonzero()
    time, anchor = pairs[torch.randperm(len(pairs), generator=generator)[:anchors]].unbind(1)
    if len(anchor) == 0:
        return Triplets(time, anchor, anchor, anchor)

    same_cluster = labels[anchor, None] == labels
    is_candidate, is_other = is_available[time] & same_cluster, is_available[time] & ~same_cluster
    is_candidate[torch.arange(len(anchor)), anchor] = False
    distance = _measure_distances(torch.cat([inputs.position, inputs.velocity.flatten(-2)], dim=-1), time, anchor)
    positive = distance.masked_fill(~is_candidate, -torch.inf).argmax(dim=1)
    return Triplets(time, anchor, positive, distance.masked_fill(~is_other, torch.inf).argmin(dim=1))


def _measure_distances(values: Tensor, time: Tensor, anchor: Tensor) -> Tensor:
    """``(B, n)``: how far ``values`` ``(R, n, d)`` of every UAV are from the anchor's at the same time."""
    distance = values.new_empty(len(anchor), values.shape[1])
    for t, points in enumerate(values):
        rows = time == t
        # Not by way of squares and products: positions of a kilometre would leave centimetres of rounding.
        distance[rows] = torch.cdist(points[anchor[rows]], points, compute_mode="donot_use_mm_for_euclid_dist")
    return distance


def compute_triplet_loss(anchor: Tensor, positive: Tensor, negative: Tensor, margin: float) -> Tensor:
    """Equation (32) of triplets of features ``(B, 3)`` each, ``(B,)``: [|e_p - e_a| - |e_n - e_a| + gamma]_+."""
    positive_distance = torch.linalg.vector_norm(positive - anchor, dim=-1)
    negative_distance = torch.linalg.vector_norm(negative - anchor, dim=-1)
    return torch.relu(positive_distance - negative_distance + margin)


def compute_batch_loss(
    parameters: GruParameters, inputs: GruInputs, labels: Tensor, metric: Metric, generator: torch.Generator
) -> Tensor:
    """Equation (33) of one random batch, as a mean, so that rates do not depend on B; 0 without a triplet."""
    batch = inputs.at(torch.randperm(len(inputs.position), generator=generator)[: metric.times])
    time, *uavs = draw_triplets(metric.anchors, batch, labels, generator)
    # The Siamese network: the same cells for anchors, positives and negatives, and for no other UAV.
    members = torch.stack(uavs)
    features = run_gru(parameters, batch.position[time, members], batch.velocity[time, members])
    losses = compute_triplet_loss(features[0], features[1], features[2], metric.margin)
    return losses.sum() / max(len(losses), 1)

"""On-line training of the GRU network on the re-clustered swarm, equations (34) and (39)."""

from __future__ import annotations

from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor

from detectors.mc_gassl.gru import GruInputs, GruParameters
from detectors.mc_gassl.triplet import Metric, batch_loss
from usnet_env.config import Config


class OnlineTraining(Config):
    """Settings of :func:`train_online`.

    Args:
        steps: gradient steps a round.
        rate: beta'.
        metric: batches and loss.
    """

    steps: Annotated[int, Field(ge=0, le=1_000_000)] = 1
    rate: Annotated[float, Field(gt=0)] = 1.0
    metric: Metric = Metric()


def descend(parameters: GruParameters, loss: Tensor, at: GruParameters, rate: float) -> GruParameters:
    """``parameters`` less ``rate`` times the gradient of ``loss`` with respect to ``at``; no graph is kept."""
    gradients = torch.autograd.grad(loss, at.tensors())
    pairs = zip(parameters.tensors(), gradients, strict=True)
    return GruParameters(*(tensor.detach() - rate * gradient for tensor, gradient in pairs))


def train_online(
    parameters: GruParameters,
    inputs: GruInputs,
    labels: Tensor,
    settings: OnlineTraining,
    generator: torch.Generator,
) -> tuple[GruParameters, list[float]]:
    """Gradient descent from ``parameters`` on the triplet loss of one window of n UAVs whose clusters are known.

    UAVs with -1 in ``labels`` ``(n,)`` int64 take no part.

    Returns:
        The trained parameters, and the loss before each step. Where no triplet can be drawn (one cluster, or
        clusters of one UAV only), the parameters are returned unchanged and the losses are 0.

    Raises:
        ArgumentError: ``labels`` has another length than n.
    """
    losses: list[float] = []
    for _ in range(settings.steps):
        at = parameters.trainable()
        loss = batch_loss(at, inputs, labels, settings.metric, generator)
        parameters = descend(at, loss, at, settings.rate)
        losses.append(float(loss.detach()))
    return parameters, losses

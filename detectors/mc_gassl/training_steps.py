"""Gradient steps of the GRU network: off line over a set of follow strategies, and on line on the re-clustered swarm.

Off line there is first-order meta learning, equations (35) and (36), and joint training. Both read the same tasks, so
that they can be compared: one strategy's support and query swarm. On-line training is that of equations (34) and (39).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from detectors.mc_gassl.gru import GruInputs, GruParameters
from detectors.mc_gassl.triplet import Metric, compute_batch_loss


def descend(parameters: GruParameters, loss: Tensor, at: GruParameters, rate: float) -> GruParameters:
    """``parameters`` less ``rate`` times the gradient of ``loss`` with respect to ``at``; no graph is kept."""
    gradients = torch.autograd.grad(loss, at)
    pairs = zip(parameters, gradients, strict=True)
    return GruParameters(*(tensor.detach() - rate * gradient for tensor, gradient in pairs))


def train_online(
    parameters: GruParameters, inputs: GruInputs, labels: Tensor, metric: Metric, steps: int, rate: float,
    generator: torch.Generator,
) -> tuple[GruParameters, list[float]]:  # fmt: skip
    """Gradient descent on the triplet loss of one window of n UAVs, with the rate beta'; the loss before each step.

    UAVs with -1 in ``labels`` ``(n,)`` int64 take no part. Nothing changes where no triplet can be drawn.
    """
    losses: list[float] = []
    for _ in range(steps):
        trained = parameters.trainable()
        loss = compute_batch_loss(trained, inputs, labels, metric, generator)
        parameters = descend(trained, loss, trained, rate)
        losses.append(float(loss.detach()))
    return parameters, losses


class Clustered(NamedTuple):
    """A swarm of n UAVs whose clusters, the ``labels`` ``(n,)`` int64, are known."""

    inputs: GruInputs
    labels: Tensor


class Task(NamedTuple):
    """Two swarms of one follow strategy: D_S and D_Q."""

    support: Clustered
    query: Clustered


def take_meta_step(
    parameters: GruParameters, task: Task, training: Any, generator: torch.Generator
) -> tuple[GruParameters, float]:
    """One episode, equations (35) and (36), first order; of the ``training`` the metric, alpha and beta are used.

    The temporary parameters are Pi = W - alpha grad L_S(W); then W loses beta grad L_Q(Pi), the gradient with respect
    to Pi. The paper writes one rate for both steps where its text names two. The result is the new W, and L_Q(Pi).
    """
    trained = parameters.trainable()
    support = compute_batch_loss(trained, *task.support, training, generator)
    temporary = descend(trained, support, trained, training.inner_rate).trainable()
    query = compute_batch_loss(temporary, *task.query, training, generator)
    return descend(parameters, query, temporary, training.outer_rate), float(query.detach())


def take_joint_step(
    parameters: GruParameters, task: Task, training: Any, generator: torch.Generator
) -> tuple[GruParameters, float]:
    """One episode of joint training: W less beta times the gradient of the mean of L_S(W) and L_Q(W); and L_Q(W)."""
    trained = parameters.trainable()
    support = compute_batch_loss(trained, *task.support, training, generator)
    query = compute_batch_loss(trained, *task.query, training, generator)
    return descend(parameters, 0.5 * (support + query), trained, training.outer_rate), float(query.detach())

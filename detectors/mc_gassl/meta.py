"""Off-line training of the GRU network over a set of follow strategies: first-order meta learning, and joint training.

Both read the same tasks, so that they can be compared: one strategy's support and query swarm.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from detectors.mc_gassl.gru import GruInputs, GruParameters
from detectors.mc_gassl.online_training import descend
from detectors.mc_gassl.triplet import Metric, batch_loss


class Clustered(NamedTuple):
    """A swarm of n UAVs whose clusters, the ``labels`` ``(n,)`` int64, are known."""

    inputs: GruInputs
    labels: Tensor


class Task(NamedTuple):
    """Two swarms of one follow strategy: D_S and D_Q."""

    support: Clustered
    query: Clustered


def meta_step(
    parameters: GruParameters,
    task: Task,
    metric: Metric,
    inner_rate: float,
    outer_rate: float,
    generator: torch.Generator,
) -> tuple[GruParameters, float]:
    """One episode, equations (35) and (36), first order; the rates are alpha and beta.

    The temporary parameters are Pi = W - alpha grad L_S(W); then W loses beta grad L_Q(Pi), the gradient with respect
    to Pi. The paper writes one rate for both steps where its text names two; here they are two.

    Returns:
        The new W, and L_Q(Pi).
    """
    at = parameters.trainable()
    support = batch_loss(at, *task.support, metric, generator)
    temporary = descend(at, support, at, inner_rate).trainable()
    query = batch_loss(temporary, *task.query, metric, generator)
    return descend(parameters, query, temporary, outer_rate), float(query.detach())


def joint_step(
    parameters: GruParameters, task: Task, metric: Metric, outer_rate: float, generator: torch.Generator
) -> tuple[GruParameters, float]:
    """One episode of joint training: W loses beta times the gradient of the mean of L_S(W) and L_Q(W).

    Returns:
        The new W, and L_Q(W) before the step.
    """
    at = parameters.trainable()
    support = batch_loss(at, *task.support, metric, generator)
    query = batch_loss(at, *task.query, metric, generator)
    return descend(parameters, 0.5 * (support + query), at, outer_rate), float(query.detach())

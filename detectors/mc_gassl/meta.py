"""Off-line training of the GRU network over a set of follow strategies: first-order meta learning, and joint training.

Both read the same tasks, so that they can be compared: one strategy's support and query swarm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor

from detectors.mc_gassl.gru import GruInputs, GruParameters
from detectors.mc_gassl.online_training import descend
from detectors.mc_gassl.triplet import Metric, batch_loss
from usnet_env.config import Config


@dataclass(frozen=True, eq=False)
class Clustered:
    """A swarm whose clusters are known.

    Args:
        inputs: of n UAVs at R times.
        labels: ``(n,)`` int64.
    """

    inputs: GruInputs
    labels: Tensor


@dataclass(frozen=True, eq=False)
class Task:
    """Two swarms of one follow strategy: D_S and D_Q."""

    support: Clustered
    query: Clustered


class OfflineTraining(Config):
    """Settings of :func:`train_offline`.

    Args:
        method: ``"meta"``, or ``"joint"``: plain training on all strategies' swarms, the paper's pre-training.
        inner_rate: alpha, of the step on the support swarm; plays no part in ``"joint"``.
        outer_rate: beta.
        metric: batches and loss.
    """

    method: Literal["meta", "joint"] = "meta"
    inner_rate: Annotated[float, Field(gt=0)] = 0.1
    outer_rate: Annotated[float, Field(gt=0)] = 0.1
    metric: Metric = Metric()


def meta_step(
    parameters: GruParameters, task: Task, settings: OfflineTraining, generator: torch.Generator
) -> tuple[GruParameters, float]:
    """One episode, equations (35) and (36), first order.

    The temporary parameters are Pi = W - alpha grad L_S(W); then W loses beta grad L_Q(Pi), the gradient with respect
    to Pi. The paper writes one rate for both steps where its text names two; here they are two.

    Returns:
        The new W, and L_Q(Pi).
    """
    at = parameters.trainable()
    support = batch_loss(at, task.support.inputs, task.support.labels, settings.metric, generator)
    temporary = descend(at, support, at, settings.inner_rate).trainable()
    query = batch_loss(temporary, task.query.inputs, task.query.labels, settings.metric, generator)
    return descend(parameters, query, temporary, settings.outer_rate), float(query.detach())


def joint_step(
    parameters: GruParameters, task: Task, settings: OfflineTraining, generator: torch.Generator
) -> tuple[GruParameters, float]:
    """One episode of joint training: W loses beta times the gradient of the mean of L_S(W) and L_Q(W).

    Returns:
        The new W, and L_Q(W) before the step.
    """
    at = parameters.trainable()
    support = batch_loss(at, task.support.inputs, task.support.labels, settings.metric, generator)
    query = batch_loss(at, task.query.inputs, task.query.labels, settings.metric, generator)
    return descend(parameters, 0.5 * (support + query), at, settings.outer_rate), float(query.detach())


def train_offline(
    parameters: GruParameters,
    tasks: Sequence[Task],
    episodes: range,
    settings: OfflineTraining,
    generator_of: Callable[[int], torch.Generator],
) -> tuple[GruParameters, list[float]]:
    """Some episodes of training, each on one task at random.

    Args:
        parameters: where to start; left as they are.
        tasks: F of them, one a follow strategy.
        episodes: their numbers.
        settings: method, rates, batches.
        generator_of: the generator of episode e. As each has its own, training can stop and go on at any episode.

    Returns:
        The trained parameters and the query loss of each episode: after the inner step with ``"meta"``, before any
        step with ``"joint"``.
    """
    step = meta_step if settings.method == "meta" else joint_step
    losses: list[float] = []
    for episode in episodes:
        generator = generator_of(episode)
        task = tasks[int(torch.randint(len(tasks), (), generator=generator))]
        parameters, loss = step(parameters, task, settings, generator)
        losses.append(loss)
    return parameters, losses

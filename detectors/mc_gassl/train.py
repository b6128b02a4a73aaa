"""Off-line training from nothing: draws follow strategies and swarms, trains, and writes the weights.

Every draw has a seed of its own, from the training's seed and what is drawn. So training that was interrupted goes on
from its checkpoint to the very result it would have had, and can be prolonged later.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import Field

from detectors.mc_gassl.gru import GruParameters, draw_parameters, make_inputs, read_parameters
from detectors.mc_gassl.training_steps import Clustered, Task, take_joint_step, take_meta_step
from detectors.mc_gassl.triplet import Metric, compute_batch_loss
from detectors.weights import Checkpoint, write_weights
from usnet_env.arrays import Indices
from usnet_env.config import ArgumentError, Positive
from usnet_env.evaluation.run import map_tasks
from usnet_env.files import reserve_folder, write_text
from usnet_env.swarm import SwarmConfig, advance, start
from usnet_env.swarm.random_follow import random_follow_strategy
from usnet_env.window import Window

_START, _TASK, _EPISODE, _HELD_OUT, _MEASURE = range(5)  # what a seed is for
_HELD_OUT_TASKS = 20

Count = Annotated[int, Field(ge=1, le=10_000_000)]


class MetaTraining(Metric):
    """Everything that decides the weights.

    Args:
        method: ``"meta"``, or ``"joint"``, the paper's pre-training.
        strategies: F, random follow strategies, none of f1 to f7.
        episodes: E.
        seed: of all draws.
        inner_rate: alpha, of the step on the support swarm; plays no part in ``"joint"``.
        outer_rate: beta.
        margin, times, anchors: of a batch, as in :class:`detectors.mc_gassl.triplet.Metric`.
        clusters, uavs, observation_steps, memory, mobility, head_jitter: of the swarms, see
            :class:`usnet_env.swarm.SwarmConfig`.
    """

    method: Literal["meta", "joint"] = "meta"
    strategies: Count = 100
    episodes: Count = 10_000
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    inner_rate: Positive = 0.1
    outer_rate: Positive = 0.3
    clusters: Count = 5
    uavs: Count = 82
    observation_steps: Count = 100
    memory: Count = 4
    mobility: str = "iid"
    head_jitter: bool = False


def _make_rng(training: MetaTraining, purpose: int, number: int = 0) -> np.random.Generator:
    return np.random.default_rng([training.seed, purpose, number])


def _make_generator(training: MetaTraining, purpose: int, number: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(int(_make_rng(training, purpose, number).integers(2**63)))


def draw_task(training: MetaTraining, number: int, purpose: int = _TASK) -> Task:
    """A random follow strategy, and a support and a query swarm that obey it, in their first round."""
    return _make_task(training, _draw_windows(training, number, purpose))


def _make_task(training: MetaTraining, drawn: list[tuple[Window, Indices]]) -> Task:
    swarms = ((make_inputs(window, training.memory), torch.from_numpy(labels)) for window, labels in drawn)
    return Task(*(Clustered(*swarm) for swarm in swarms))


def _draw_windows(training: MetaTraining, number: int, purpose: int = _TASK) -> list[tuple[Window, Indices]]:
    """The windows of the support and the query swarm, each with the cluster of each UAV, ``(n,)``."""
    rng = _make_rng(training, purpose, number)
    swarm = training.part(SwarmConfig, follow=random_follow_strategy(rng))
    rngs = rng.spawn(2)
    state, sighting = advance(swarm, start(swarm, rngs), rngs)
    drawn = []
    for b in range(2):
        window = Window(sighting.position[b], sighting.velocity[b], sighting.seen[b], sighting.alive[b])
        drawn.append((window, np.unique(state.leader[b], return_inverse=True)[1].astype(np.int64)))
    return drawn


def _draw_start(training: MetaTraining) -> GruParameters:
    return draw_parameters(_make_generator(training, _START))


def train_meta(
    out: str | os.PathLike[str],
    training: MetaTraining | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    resume: bool = True,
    checkpoint_every: int = 500,
    *,
    workers: int = 1,
    backend: str | None = None,
) -> Path:
    """Train the GRU network off-line and write its weights.

    Files in ``out``: ``meta.safetensors`` and ``meta.json`` (``joint.…`` with that method), see
    :mod:`detectors.weights`; ``losses.csv``, the query loss of every episode; ``checkpoint.safetensors``, from which it
    goes on if ``resume``. The defaults of ``training`` make the weights that the package ships. ``progress`` is called
    with the number of strategies drawn and episodes done, and of all. The result does not depend on ``workers`` and
    ``backend``, see :func:`usnet_env.evaluation.run.map_tasks`.

    Raises:
        ArgumentError: ``out`` can't be written to, or its checkpoint is of another training or of more episodes.
    """
    training = MetaTraining() if training is None else training
    folder = reserve_folder(Path(out))
    checkpoint = Checkpoint(folder, training.model_dump(mode="json", exclude={"episodes"}))  # it may be prolonged
    total = training.strategies + training.episodes
    arrays, losses = checkpoint.read() if resume else ({}, [])
    if len(losses) > training.episodes:
        raise ArgumentError(
            f"episodes must be at least the {len(losses)} of the checkpoint in out, got {training.episodes}."
        )
    parameters = read_parameters(arrays) if arrays else _draw_start(training)
    take_step = take_meta_step if training.method == "meta" else take_joint_step
    tasks, strategies = [], range(training.strategies)
    for windows in map_tasks(partial(_draw_windows, training), strategies, workers=workers, backend=backend):
        tasks.append(_make_task(training, windows))
        progress(len(tasks), total)
    while len(losses) < training.episodes:
        generator = _make_generator(training, _EPISODE, len(losses))  # of this episode
        task = tasks[int(torch.randint(len(tasks), (), generator=generator))]
        parameters, loss = take_step(parameters, task, training, generator)
        losses.append(loss)
        if len(losses) % checkpoint_every == 0 or len(losses) == training.episodes:
            checkpoint.write(parameters._asdict(), losses)
            progress(training.strategies + len(losses), total)
    lines = [f"{number},{loss}\n" for number, loss in enumerate(losses, start=1)]
    write_text(folder / "losses.csv", "episode,loss\n" + "".join(lines))
    path, metrics = folder / f"{training.method}.safetensors", _measure_losses(training, parameters, losses)
    return write_weights(path, parameters._asdict(), training.model_dump(mode="json"), metrics)


def _measure_losses(training: MetaTraining, parameters: GruParameters, losses: list[float]) -> dict[str, Any]:
    """The loss at the beginning and end, and on strategies that were not trained on, beside the random start's."""
    count = max(1, min(500, len(losses) // 2))
    swarms = [draw_task(training, number, _HELD_OUT).query for number in range(_HELD_OUT_TASKS)]

    def measure(weights: GruParameters) -> float:
        generators = (_make_generator(training, _MEASURE, number) for number in range(_HELD_OUT_TASKS))
        with torch.no_grad():
            pairs = zip(swarms, generators, strict=True)
            return float(np.mean([float(compute_batch_loss(weights, *swarm, training, rng)) for swarm, rng in pairs]))

    return {
        "episodes_averaged": count,
        "first_loss": float(np.mean(losses[:count])),
        "last_loss": float(np.mean(losses[-count:])),
        "held_out_strategies": _HELD_OUT_TASKS,
        "held_out_loss": measure(parameters),
        "held_out_loss_of_random_start": measure(_draw_start(training)),
    }

"""Trains the network from random weights on simulated swarms with random follow strategies.

The seed of each swarm follows from the seed of the training and the number of the swarm, and each swarm is used once.
So a training that is resumed from its checkpoint gives exactly the result of an uninterrupted one.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from detectors.learned.features import make_inputs
from detectors.learned.network import Answer, HeadNetwork, NetworkSizes, draw_network
from detectors.random_swarms import draw_training_swarm, observe
from detectors.weights import Checkpoint, write_losses, write_weights
from usnet_env.arrays import Mask
from usnet_env.evaluation.run import map_tasks
from usnet_env.files import reserve_folder

_START, _STEP, _HELD_OUT = range(3)  # purpose of a seed
_HELD_OUT_SWARMS = 200

Count = Annotated[int, Field(ge=1, le=10_000_000)]
Positive = Annotated[float, Field(gt=0)]


class HeadTraining(NetworkSizes):
    """Settings of the training; together they determine the weights.

    Args:
        steps: the number of steps of the optimiser.
        swarms: the number of swarms per step, each with its own follow strategy.
        seed: seed of all random draws.
        width, attn_heads, blocks: see :class:`detectors.learned.network.NetworkSizes`.
        rate, warm, decay: of AdamW: the largest learning rate, which falls along a cosine; warm-up steps; weight decay.
        leader_weight: weight of the loss of the leaders, relative to the loss of the heads.
        most_uavs, most_clusters: N is drawn between 10 and the one, M between 1 and the other.
    """

    steps: Count = 4000
    swarms: Count = 8
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    rate: Positive = 2e-3
    warm: Count = 100
    decay: Annotated[float, Field(ge=0)] = 0.01
    leader_weight: Annotated[float, Field(ge=0)] = 0.5
    most_uavs: Annotated[int, Field(ge=10, le=1000)] = 120
    most_clusters: Annotated[int, Field(ge=1, le=100)] = 10


class Example(NamedTuple):
    """A labelled window of n living UAVs: inputs of :func:`detectors.learned.features.make_inputs`, and the truth.

    ``head`` ``(n,)`` float32 is 1 for a head with at least one follower, and ``leader`` ``(n,)`` int64 the UAV that
    each UAV follows; its own index for heads and decoys.
    """

    features: Tensor
    context: Tensor
    head: Tensor
    leader: Tensor


def _make_rng(training: HeadTraining, *purpose: int) -> np.random.Generator:
    return np.random.default_rng([training.seed, *purpose])


def draw_example(training: HeadTraining, rng: np.random.Generator) -> Example:
    """Draw one labelled window of a swarm, in its first round or after some UAVs were destroyed."""
    config = draw_training_swarm(training.most_uavs, training.most_clusters, rng)

    def lose(head: Mask) -> Mask:
        return np.asarray(rng.random(head.shape) < rng.uniform(0.0, 0.5))

    window, state = observe(config, rng, 0.25, lose)
    follows = config.follow != "none"
    living = np.flatnonzero(window.alive)
    place = np.zeros(config.uavs, np.int64)
    place[living] = np.arange(len(living))
    alone = state.head[0] | state.decoy[0] if follows else np.ones(config.uavs, bool)
    leader = np.where(alone, np.arange(config.uavs), state.leader[0])[living]
    led = np.bincount(leader[~alone[living]], minlength=config.uavs) > 0
    head = led[living].astype(np.float32)
    return Example(*make_inputs(window, living), torch.from_numpy(head), torch.from_numpy(place[leader]))


def compute_loss(answer: Answer, example: Example, leader_weight: float) -> Tensor:
    """Cross entropy of the heads plus ``leader_weight`` times that of the leaders, each averaged over the UAVs."""
    head = torch.nn.functional.binary_cross_entropy_with_logits(answer.head, example.head)
    return head + leader_weight * torch.nn.functional.cross_entropy(answer.leader, example.leader)


def train_heads(
    out: str | os.PathLike[str],
    training: HeadTraining | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    resume: bool = True,
    checkpoint_every: int = 100,
    *,
    workers: int = 1,
    backend: str | None = None,
) -> Path:
    """Train the network and write its weights.

    Files in ``out``: ``learned.safetensors`` and ``learned.json``, see :mod:`detectors.weights`; ``losses.csv``, the
    mean loss of each step; ``checkpoint.safetensors``. The defaults of ``training`` give the shipped weights.
    ``progress`` is called with the number of finished steps and of all; the other arguments are those of
    :func:`detectors.mc_gassl.train.train_meta`.

    Raises:
        ArgumentError: ``out`` can't be written, or it holds a checkpoint with other settings.
    """
    training = HeadTraining() if training is None else training
    folder = reserve_folder(Path(out))
    checkpoint = Checkpoint(folder, training.model_dump(mode="json"))
    network = draw_network(training.part(NetworkSizes), int(_make_rng(training, _START).integers(2**63)))
    optimiser = torch.optim.AdamW(network.parameters(), lr=training.rate, weight_decay=training.decay)
    losses = _read_checkpoint(checkpoint, network, optimiser) if resume else []
    steps = range(len(losses), training.steps)
    drawn = map_tasks(partial(_draw_step, training), steps, workers=workers, backend=backend)
    for step, arrays in zip(steps, drawn, strict=True):
        # Sums depend on the order and alignment of numbers in memory, which other processes do not keep.
        examples = [Example(*(torch.tensor(np.ascontiguousarray(array)) for array in each)) for each in arrays]
        losses.append(_run_step(training, step, examples, network, optimiser))
        progress(len(losses), training.steps)
        if len(losses) % checkpoint_every == 0 or len(losses) == training.steps:
            saved = {f"network.{name}": value for name, value in network.state_dict().items()}
            for number, state in optimiser.state_dict()["state"].items():
                saved |= {f"optimiser.{number}.{name}": value for name, value in state.items()}
            checkpoint.write(saved, losses)
    write_losses(folder, "step", [round(loss, 6) for loss in losses])
    path, metrics = folder / "learned.safetensors", _evaluate_network(training, network, losses)
    return write_weights(path, network.state_dict(), training.model_dump(mode="json"), metrics)


def _draw_step(training: HeadTraining, step: int) -> list[tuple[NDArray[Any], ...]]:
    drawn = [draw_example(training, _make_rng(training, _STEP, step, number)) for number in range(training.swarms)]
    return [tuple(tensor.numpy() for tensor in example) for example in drawn]


def _run_step(
    training: HeadTraining, step: int, examples: list[Example], network: HeadNetwork, optimiser: torch.optim.Optimizer
) -> float:
    rise = min(1.0, (step + 1) / training.warm)
    for group in optimiser.param_groups:
        group["lr"] = training.rate * rise * 0.5 * (1.0 + math.cos(math.pi * step / training.steps))
    optimiser.zero_grad()
    total = 0.0
    for example in examples:
        answer = network(example.features, example.context)
        loss = compute_loss(answer, example, training.leader_weight) / training.swarms
        loss.backward()  # type: ignore[no-untyped-call]  # torch leaves it untyped
        total += float(loss.detach())
    torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
    optimiser.step()
    return total


def _evaluate_network(training: HeadTraining, network: HeadNetwork, losses: list[float]) -> dict[str, Any]:
    """The loss at the start and the end of training, and the accuracy on held-out swarms."""
    few, swarms = max(1, min(100, len(losses) // 2)), min(_HELD_OUT_SWARMS, training.steps)
    held_out, exact, right = [], [], []
    network.eval()
    for number in range(swarms):
        example = draw_example(training, _make_rng(training, _HELD_OUT, number))
        with torch.no_grad():
            answer = network(example.features, example.context)
        held_out.append(float(compute_loss(answer, example, training.leader_weight)))
        exact.append(torch.equal(answer.head > 0, example.head > 0))
        right += (answer.leader.argmax(dim=1) == example.leader).tolist()
    return {
        "steps_averaged": few,
        "first_loss": float(np.mean(losses[:few])),
        "last_loss": float(np.mean(losses[-few:])),
        "held_out_swarms": swarms,
        "held_out_loss": float(np.mean(held_out)),
        "held_out_share_exact": float(np.mean(exact)),
        "held_out_share_of_leaders_right": float(np.mean(right)),
    }


def _read_checkpoint(checkpoint: Checkpoint, network: HeadNetwork, optimiser: torch.optim.Optimizer) -> list[float]:
    """Set the network and the optimiser to the checkpoint's, if there is one, and return the losses so far."""
    read, losses = checkpoint.read()
    arrays = {name: torch.as_tensor(array) for name, array in read.items()}
    if losses:
        network.load_state_dict({name: arrays[f"network.{name}"] for name in network.state_dict()})
        names, count = ("step", "exp_avg", "exp_avg_sq"), len(list(network.parameters()))
        state = {k: {name: arrays[f"optimiser.{k}.{name}"] for name in names} for k in range(count)}
        optimiser.load_state_dict({**optimiser.state_dict(), "state": state})
    return losses

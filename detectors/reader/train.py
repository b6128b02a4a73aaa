"""Trains the reader on windows that the prior draws.

Shard k of windows follows from the seed and k alone; it is used for a few passes and forgotten. So a training that is
resumed from its checkpoint, written after each shard, gives exactly the result of an uninterrupted one on a CPU.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy, huber_loss

from detectors.reader.draws import Batch, draw_ahead, draw_shard
from detectors.reader.features import CONTEXT_GROUPS, PAIR_GROUPS, UAV_GROUPS
from detectors.reader.forward import Answer
from detectors.reader.network import NetworkSizes, draw_network
from detectors.reader.prior import FAMILIES, PRIOR_VERSION
from detectors.weights import Checkpoint, read_arrays, write_weights
from usnet_env.config import ArgumentError, quote, unknown_name
from usnet_env.evaluation.run import map_tasks
from usnet_env.evaluation.tasks import become_worker
from usnet_env.files import reserve_folder, write_text

_START, _SHARD, _ORDER = range(3)  # purpose of a seed
_PRESETS = {"minutes": 25, "hours": 300}  # shards
_PASSES, _GROUPED = 2, 3  # how often a shard is used, and the groups of batches in a step
_WARM, _MOST_DECAY = 100, 0.999  # steps until the largest rate; decay of the average of the weights
_DROPPED = 0.15  # share of batches in which one group of features is hidden
_STATE = ("step", "exp_avg", "exp_avg_sq")  # of the optimiser, for each parameter
_INPUTS = {"pair": PAIR_GROUPS, "uav": UAV_GROUPS, "context": CONTEXT_GROUPS}
_GROUPS = [(name, part) for name, groups in _INPUTS.items() for part in groups.values()]
_COMPARED = ("companions", "pulls")  # features of a UAV that are made of pairs

Count = Annotated[int, Field(ge=1, le=10_000_000)]


class ReaderTraining(NetworkSizes):
    """Settings of the training; together they determine the weights.

    Args:
        preset: ``"minutes"`` or ``"hours"``, which have 25 and 300 shards.
        seed: seed of all random draws.
        without: names of the families of the prior that are left out.
        start: a weights file to begin with, also one of fewer features of pairs; ``None``: random weights.
        blind: every feature that compares a UAV with another at two times is hidden: those of pairs, and what pairs
            say of a UAV. What such a network finds, it reads from single tracks and from where UAVs are.
        device: where the network learns.
        width, attn_heads, blocks: see :class:`detectors.reader.network.NetworkSizes`.
        shards: their number; ``None``: the preset's.
        batches, windows, most_uavs: batches in a shard, windows in a batch, and the largest N.
        together: batches with the same N that the network reads at once, at most; several keep a GPU busy.
        rate: the largest learning rate; a quarter of it keeps most of what ``start`` knows.
    """

    preset: Literal["minutes", "hours"] = "minutes"
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    without: tuple[str, ...] = ()
    start: str | None = None
    blind: bool = False
    device: Literal["cpu", "cuda"] = "cpu"
    shards: Count | None = None
    batches: Count = 120
    windows: Count = 4
    most_uavs: Annotated[int, Field(ge=6, le=300)] = 82
    together: Count = 1
    rate: Annotated[float, Field(gt=0, le=0.1)] = 2e-3


def compute_loss(
    answer: Answer[Tensor], head: Tensor, leader: Tensor, root: Tensor, link: Tensor, delay: Tensor
) -> Tensor:
    """Loss of a batch: of heads, and with smaller weights of leaders, roots, links, silence and delays (NaN: none)."""
    truth = head.float()
    heads = binary_cross_entropy_with_logits(answer.head, truth, reduction="none").sum(dim=1).mean()
    leaders = cross_entropy(answer.leader.flatten(0, 1), leader.flatten())
    roots = cross_entropy(answer.root.flatten(0, 1), root.flatten())
    no_leader = binary_cross_entropy_with_logits(answer.silent, 1.0 - truth.amax(dim=1))
    delayed = delay.isfinite()
    delays = huber_loss(answer.delay[delayed], torch.log1p(delay[delayed]), reduction="sum")
    delays = delays / delayed.sum().clamp(min=1)
    defined = link.isfinite()
    links = binary_cross_entropy_with_logits(answer.link[defined], link[defined], reduction="sum") / head.numel()
    pairs = 0.6 * leaders + 0.3 * roots + 0.2 * links
    return heads / math.sqrt(head.shape[1]) + pairs + 0.3 * no_leader + 0.1 * delays


def _load_start(network: nn.Module, path: str) -> int:
    """Load a weights file, whose number of features of pairs is returned; later ones have no influence at first."""
    arrays, state = {name: torch.tensor(array) for name, array in read_arrays(path).items()}, network.state_dict()
    known_pairs = len(arrays.get("pair_mean", ()))
    for name in ("pair_mean", "pair_scale", "enter.weight"):
        if name in arrays and known_pairs < state[name].shape[-1]:
            arrays[name] = nn.functional.pad(arrays[name], (0, state[name].shape[-1] - known_pairs))
    for name in ("links.weight", "links.bias"):
        if name in arrays and len(arrays[name]) == 2:  # the first edition had no links
            arrays[name] = torch.cat([arrays[name], arrays[name][:1]])
    if {name: value.shape for name, value in arrays.items()} != {name: value.shape for name, value in state.items()}:
        raise ArgumentError(f"start must hold a network of these sizes, got {quote(path)}.")
    network.load_state_dict(arrays)
    return known_pairs


def _group_batches(shard: list[Batch], together: int) -> list[list[Batch]]:
    """The batches in groups, each of at most so many with the same number of UAVs."""
    by_uavs = dict[int, list[Batch]]()
    for batch in shard:
        by_uavs.setdefault(batch[1].head.shape[1], []).append(batch)
    return [batches[k : k + together] for batches in by_uavs.values() for k in range(0, len(batches), together)]


class _Trainer:
    """The state of a training: the network, the average of its weights, the optimiser, and a row a shard."""

    def __init__(self, training: ReaderTraining) -> None:
        self.training = training
        self.shards = training.shards or _PRESETS[training.preset]
        seed = int(np.random.default_rng([training.seed, _START]).integers(2**63))
        self.network = draw_network(training.part(NetworkSizes), seed).to(training.device)
        self.known_pairs = _load_start(self.network, training.start) if training.start else 0
        self.both = nn.ModuleDict({"network": self.network, "average": deepcopy(self.network)})
        self.optimiser = torch.optim.AdamW(self.network.parameters(), weight_decay=0.01, fused=True)
        self.rows: list[dict[str, Any]] = []

    def learn(self, shard: list[Batch]) -> None:
        """Take the steps of a shard, and add its row, measured before a batch is learned."""
        if not self.rows:
            self._standardise(shard)
        rng = np.random.default_rng([self.training.seed, _ORDER, len(self.rows)])
        groups = _group_batches(shard, self.training.together)
        losses, exact = list[Tensor](), list[tuple[list[Batch], Tensor]]()
        for number in range(_PASSES):
            order = rng.permutation(len(groups))
            steps = np.split(order, range(_GROUPED, len(order), _GROUPED))
            for k, indices in enumerate(steps, start=(len(self.rows) * _PASSES + number) * len(steps)):
                windows = sum(len(truth.head) for index in indices for _, truth in groups[index])
                for group in (groups[index] for index in indices):
                    dropped = _GROUPS[rng.integers(len(_GROUPS))] if rng.random() < _DROPPED else None
                    loss, exact_counts = self._add_gradients(group, dropped, windows)
                    if number == 0 and dropped is None:
                        losses.append(loss)
                        exact.append((group, exact_counts))
                self._step(k, self.shards * _PASSES * len(steps))
        families = dict[str, list[int]]()
        for group, exact_counts in exact:
            for (_, truth), part in zip(group, exact_counts.tolist(), strict=True):
                exact_count, count = families.get(truth.family, (0, 0))
                families[truth.family] = [exact_count + part, count + len(truth.head)]
        share = np.divide(*np.sum([[0, 0], *families.values()], axis=0))
        mean = float(torch.stack(losses).mean()) if losses else math.nan
        self.rows.append({"shard": len(self.rows) + 1, "loss": mean, "exact": float(share), "families": families})

    def _add_gradients(
        self, group: list[Batch], dropped: tuple[str, slice] | None, windows: int
    ) -> tuple[Tensor, Tensor]:
        """Add a group's part of the gradients of so many windows; returns its loss, and its exact windows by batch."""
        device = self.training.device
        features = (np.concatenate(parts) for parts in zip(*(features for features, _ in group), strict=True))
        inputs = {
            name: torch.tensor(array, device=device).float()
            for name, array in zip(group[0][0]._fields, features, strict=True)
        }
        truth = (np.concatenate(parts) for parts in zip(*(truth[3:8] for _, truth in group), strict=True))
        head, leader, root, link, delay = (torch.tensor(array, device=device) for array in truth)
        if dropped is not None:
            name, columns = dropped
            inputs[name][..., columns] = self.network.get_buffer(f"{name}_mean")[columns]
        answer = self.network(**inputs)
        loss = compute_loss(answer, head, leader, root, link, delay)
        (loss * (len(head) / windows)).backward()  # type: ignore[no-untyped-call]  # torch leaves it untyped
        is_exact = ((answer.head > 0) == head).all(dim=1)
        return loss.detach(), is_exact.view(len(group), -1).sum(dim=1)

    def _step(self, step: int, total: int) -> None:
        """Take a step at a rate that rises at first and falls along a cosine."""
        rate = self.training.rate * min(1.0, (step + 1) / _WARM)
        self.optimiser.param_groups[0]["lr"] = rate * 0.5 * (1.0 + math.cos(math.pi * step / total))
        nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimiser.step()
        self.optimiser.zero_grad()
        decay = min(_MOST_DECAY, (1 + step) / (10 + step))
        with torch.no_grad():
            for average, parameter in zip(self.both["average"].parameters(), self.network.parameters(), strict=True):
                average.lerp_(parameter, 1.0 - decay)

    def _standardise(self, shard: list[Batch]) -> None:
        """Set means and scales of the inputs that are new to those of a shard; a seventh of the pairs is enough."""
        inputs = ("pair", 7, 1e-3), ("uav", 1, 1e-3), ("context", 1, 1e-2)
        for name, every, least in inputs[: 1 if self.known_pairs else 3]:
            first = self.known_pairs if name == "pair" else 0
            arrays = [getattr(features, name) for features, _ in shard]
            values = np.concatenate([array.reshape(-1, array.shape[-1])[::every] for array in arrays], dtype=np.float64)
            for network in self.both.values():
                network.get_buffer(f"{name}_mean")[first:] = torch.tensor(values.mean(axis=0)[first:])
                network.get_buffer(f"{name}_scale")[first:] = torch.tensor(1.0 / values.std(axis=0).clip(least)[first:])
        for network in self.both.values() if self.training.blind else ():
            network.get_buffer("pair_scale").zero_()
            for part in (UAV_GROUPS[name] for name in _COMPARED):
                network.get_buffer("uav_scale")[part] = 0.0

    def read(self, checkpoint: Checkpoint, folder: Path) -> None:
        """Go on from a checkpoint, if there is one."""
        read, losses = checkpoint.read()
        if losses:
            arrays = {name: torch.tensor(array) for name, array in read.items()}
            self.both.load_state_dict({name: arrays[name] for name in self.both.state_dict()})
            count = len(list(self.network.parameters()))
            state = {k: {name: arrays[f"optimiser.{k}.{name}"] for name in _STATE} for k in range(count)}
            self.optimiser.load_state_dict({**self.optimiser.state_dict(), "state": state})
            lines = (folder / "families.jsonl").read_text().splitlines()
            self.rows = [json.loads(line) for line in lines[: len(losses)]]

    def write(self, checkpoint: Checkpoint, folder: Path) -> None:
        """Write ``families.jsonl``, ``losses.csv`` and the checkpoint, in this order."""
        write_text(folder / "families.jsonl", "".join(json.dumps(row) + "\n" for row in self.rows))
        lines = [f"{row['shard']},{row['loss']:.6f},{row['exact']:.4f}\n" for row in self.rows]
        write_text(folder / "losses.csv", "shard,loss,exact\n" + "".join(lines))
        arrays = self.both.state_dict()
        for number, state in self.optimiser.state_dict()["state"].items():
            arrays |= {f"optimiser.{number}.{name}": state[name] for name in _STATE}
        checkpoint.write({name: array.cpu() for name, array in arrays.items()}, [row["loss"] for row in self.rows])


def train_reader(
    out: str | os.PathLike[str],
    training: ReaderTraining | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    resume: bool = True,
    *,
    workers: int = 1,
    backend: str | None = None,
) -> Path:
    """Train the network and write its weights, the running average.

    Files in ``out``: ``reader.safetensors`` and ``reader.json``, see :mod:`detectors.weights`; ``losses.csv`` and
    ``families.jsonl``, a row a shard: its loss and the share of its windows with exact heads when they were new, and
    [exact, all] windows by family; ``checkpoint.safetensors``. ``progress`` is called with the number of finished
    shards and of all; ``workers`` processes draw shards meanwhile, or this one (``backend="serial"``).

    Raises:
        ArgumentError: ``out`` can't be written or has a checkpoint with other settings, ``start`` has other arrays,
            ``without`` names no family, or there is no such device.
    """
    training = ReaderTraining() if training is None else training
    for name in set(training.without) - set(FAMILIES):
        raise unknown_name("without", name, FAMILIES)
    if training.device == "cuda" and not torch.cuda.is_available():
        raise ArgumentError("device must be 'cpu' where torch finds no CUDA device, got 'cuda'.")
    folder = reserve_folder(Path(out))
    settings = {**training.model_dump(mode="json"), "prior": PRIOR_VERSION}
    checkpoint, trainer = Checkpoint(folder, settings), _Trainer(training)
    if resume:
        trainer.read(checkpoint, folder)
    for shard in _draw_shards(training, range(len(trainer.rows), trainer.shards), workers, backend):
        trainer.learn(shard)
        trainer.write(checkpoint, folder)
        progress(len(trainer.rows), trainer.shards)
    last = trainer.rows[-5:]
    metrics = {f"last_{name}": float(np.mean([row[name] for row in last])) for name in ("loss", "exact")}
    arrays = {name: array.cpu() for name, array in trainer.both["average"].state_dict().items()}
    return write_weights(folder / "reader.safetensors", arrays, settings, {"shards_averaged": len(last), **metrics})


def _draw_shards(training: ReaderTraining, numbers: range, workers: int, backend: str | None) -> Iterator[list[Batch]]:
    settings = training.model_dump(include={"batches", "windows", "without", "most_uavs"})
    draw = partial(draw_shard, seed=(training.seed, _SHARD), **settings)
    if backend in ("serial", "ray"):
        return map_tasks(draw, numbers, workers=workers, backend=backend)
    return draw_ahead(draw, numbers, workers, become_worker)

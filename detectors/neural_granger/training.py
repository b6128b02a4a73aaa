"""One network for each candidate head, and attention from how well each network predicts each UAV.

Each candidate j has a network of its own, which predicts all other UAVs from the past of j alone, because an average of
velocities, which the paper's GASSL forms, no longer contains the squares that f4 and f5 need. The networks are additive
over the coordinates of the past, because a window has only about a hundred samples. The winner's network is applied to
the past of every UAV, as all followers use the same strategy. Attention that does not vary with time has a closed form:
alpha_ij is the softmax over j of the log-likelihoods of the flight of UAV i, with the null model in the place of j = i.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from detectors.series.designs import stack_past
from detectors.series.gaps import fill_gaps
from usnet_env.arrays import Singles
from usnet_env.window import Window

_VELOCITY_SCALE = 1.7  # a coordinate of a unit vector has variance 1/3
_DISTANCE_SCALE = 300.0  # metres; keeps the offset between two UAVs of the arena near 1
_FOLDS = 8  # of the null model
_CHUNK_ENTRIES = 4_000_000  # pair errors formed at once where no gradient is kept


@dataclass(frozen=True)
class Samples:
    """V_{i,t}, newest first, ``(n, R, T_0, 3)``, p_{i,t} and v_{i,t+1} ``(n, R, 3)`` of n UAVs at R = T_ob - T_0 times.

    The ``weight`` ``(n, R)`` is 1 where the target was seen; where it was not, the target is 0. Other missing samples
    are filled in (:func:`detectors.series.gaps.fill_gaps`).
    """

    velocity: Tensor
    position: Tensor
    target: Tensor
    weight: Tensor


def build_samples(window: Window, members: NDArray[np.intp], memory: int, device: torch.device) -> Samples:
    """Build the samples of the ``members`` ``(n,)``."""
    filled = fill_gaps(window)
    velocity, seen = filled.velocity[:, members], window.velocity_seen[memory:, members]
    parts = (
        stack_past(velocity, memory),
        filled.position[memory - 1 : -2, members].swapaxes(0, 1),
        np.where(seen[..., None], velocity[memory:], np.float32(0)).swapaxes(0, 1),
        seen.T.astype(np.float32),
    )
    return Samples(*(torch.from_numpy(np.ascontiguousarray(part)).to(device) for part in parts))


class AdditiveNetwork:
    """S additive networks side by side; each coordinate of the source's past has its own hidden units.

    For the past u of source j, o = sum_c B_c tanh(w_c u_c + b_c) + A u + C [(p_j - p_i) / 300, its direction]
    + D null_i + b, where null_i is the prediction of the null model. The network predicts o / sqrt(|o|² + e^s), which
    is close to a unit vector where o is large, and close to a multiple of o where o is small.
    """

    def __init__(self, weights: list[Tensor], free: list[Tensor]) -> None:
        self.weights, self.free = weights, free  # weights decay, free parameters do not

    @classmethod
    def draw(cls, networks: int, coordinates: int, units: int, generator: torch.Generator) -> AdditiveNetwork:
        """Networks with random weights."""
        device = generator.device

        def normal(*shape: int, scale: float) -> Tensor:
            return scale * torch.randn(networks, *shape, generator=generator, device=device)

        weights = [
            normal(coordinates, units, scale=1.0),
            normal(coordinates * units, 3, scale=0.05),
            normal(coordinates, 3, scale=0.05),
            torch.zeros(networks, 6, 3, device=device),
        ]
        free = [
            normal(coordinates, units, scale=0.5),
            torch.zeros(networks, 1, 3, device=device),
            0.5 * torch.eye(3, device=device).repeat(networks, 1, 1),
            torch.full((networks, 1, 1), -1.0, device=device),
        ]
        for parameter in (*weights, *free):
            parameter.requires_grad_(True)
        return cls(weights, free)

    def select(self, index: Tensor) -> AdditiveNetwork:
        """Some of the networks, without gradient."""
        return AdditiveNetwork(*([part.detach()[index] for part in parts] for parts in (self.weights, self.free)))

    def encode_source(self, window: Tensor) -> Tensor:
        """Compute the terms that depend on the source alone: ``(S, t, C)`` to ``(S, t, 3)``."""
        slope, readout, linear, _ = self.weights
        shift, bias, _, _ = self.free
        hidden = torch.tanh(window.unsqueeze(-1) * slope.unsqueeze(1) + shift.unsqueeze(1)).flatten(2)
        return torch.baddbmm(torch.baddbmm(bias, hidden, readout), window, linear)

    def predict(self, source: Tensor, offset: Tensor, null: Tensor) -> Tensor:
        """Predict velocities ``(S, v, t, 3)`` from the source ``(S, t, 3)``, offsets p_j - p_i and the null model's."""
        networks, voters, times, _ = offset.shape
        distance = offset.norm(dim=-1, keepdim=True)
        geometry = torch.cat([offset / _DISTANCE_SCALE, offset / (distance + 1e-6), null], dim=-1)
        gains = torch.cat([self.weights[3], self.free[2]], dim=1)
        output = torch.bmm(geometry.reshape(networks, voters * times, 9), gains).view(networks, voters, times, 3)
        output = output + source.unsqueeze(1)
        return output * torch.rsqrt((output * output).sum(-1, keepdim=True) + self.free[3].exp().unsqueeze(1))


def split_times(times: int, blocks: int, gap: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Indices of the training times and of the held-out times.

    A fifth of all times is held out, in evenly spread blocks with ``gap`` times on each side that are neither; in fewer
    and longer blocks, and at last without gaps, if less than a third of the times would remain for training.
    """
    for count in range(min(blocks, times), 0, -1):
        is_held, is_excluded = torch.zeros(2, times, dtype=torch.bool, device=device)
        length = max(1, times // (5 * count))
        for block in range(count):
            first = int((block + 0.5) * times / count) - length // 2
            is_held[first : first + length] = True
            is_excluded[max(0, first - gap) : first + length + gap] = True
        if (~is_excluded).sum() >= max(1, times // 3):
            return (~is_excluded).nonzero()[:, 0], is_held.nonzero()[:, 0]
    used = ~is_held if times > 1 else is_held  # around the single block of the last try
    return used.nonzero()[:, 0], is_held.nonzero()[:, 0]


def _weighted_mean(values: Tensor, weight: Tensor) -> Tensor:
    return (values * weight).sum(-1) / weight.sum(-1).clamp(min=1.0)


def predict_from_own_past(past: Singles, target: Singles, weight: Singles, penalty: float, gap: int) -> Singles:
    """The null model: predict each UAV from its own past by a cross-fitted ridge regression.

    Each fold of consecutive rows is predicted by a fit to the others, without the ``gap`` rows next to it. ``past`` is
    ``(n, R, p)``, with a column of ones for the mean, ``target`` and prediction are ``(n, R, d)``, ``weight``
    ``(n, R)`` is 1 where the target was seen, and ``penalty`` is added to the diagonal of the Gram matrix.
    """
    index = np.arange(past.shape[-2])
    fold = index * _FOLDS // len(index)
    weighted = past * weight[..., None]
    eye = (penalty * np.eye(past.shape[-1])).astype(past.dtype)
    prediction = np.zeros_like(target)
    for k in np.unique(fold):
        fold_rows = np.flatnonzero(fold == k)
        other_rows = (index < fold_rows[0] - gap) | (index > fold_rows[-1] + gap)
        inputs = weighted[..., other_rows, :].swapaxes(-1, -2)
        weights = np.linalg.solve(inputs @ past[..., other_rows, :] + eye, inputs @ target[..., other_rows, :])
        prediction[..., fold_rows, :] = past[..., fold_rows, :] @ weights
    return prediction


class Problem:
    """The tensors of one fit of n UAVs by the arguments of the detector, and the prediction errors of pairs of UAVs."""

    def __init__(self, samples: Samples, settings: Any) -> None:
        self.samples, self.settings = samples, settings
        past = (_VELOCITY_SCALE * samples.velocity.flatten(2)).cpu().numpy()
        past = np.concatenate([past, np.ones_like(past[..., :1])], axis=-1)
        target, weight = samples.target.cpu().numpy(), samples.weight.cpu().numpy()
        null = predict_from_own_past(past, target, weight, settings.ridge, gap=samples.velocity.shape[2])
        self.null = torch.from_numpy(null).to(samples.target.device)
        self.null_error = ((self.null - samples.target) ** 2).sum(-1)  # (n, R)
        # The mean velocity of a UAV that flies nearly straight would dominate the inputs; biases replace it.
        velocity = samples.velocity - samples.velocity.mean((1, 2), keepdim=True)
        self.source = _VELOCITY_SCALE * velocity.flatten(2)
        surprise = (_weighted_mean(self.null_error, samples.weight) / 3.0).sqrt()
        self.noise = (settings.input_noise * _VELOCITY_SCALE * surprise).reshape(-1, 1, 1)

    def compute_errors(
        self, network: AdditiveNetwork, columns: Tensor, voters: Tensor, times: Tensor,
        generator: torch.Generator | None = None,
    ) -> Tensor:  # fmt: skip
        """Squared errors ``(c, v, t)`` of c networks that predict v voters from c columns, with noise or not."""
        samples, shape = self.samples, (len(columns), len(voters), len(times), 3)
        source = self.source[columns][:, times]
        if generator is not None:
            noise = torch.randn(source.shape, generator=generator, device=source.device)
            source = source + self.noise[columns] * noise
        offset = samples.position[columns][:, None, times] - samples.position[voters][:, times]
        null = self.null[voters][:, times].expand(shape)
        predicted = network.predict(network.encode_source(source), offset, null)
        return ((predicted - samples.target[voters][:, times]) ** 2).sum(-1)

    def compute_all_errors(self, select: Callable[[Tensor], AdditiveNetwork], times: Tensor) -> Tensor:
        """Mean squared errors ``(n, n)`` of UAV i, predicted from UAV j by its network of ``select``; in chunks."""
        everyone = torch.arange(len(self.samples.target), device=times.device)
        step = max(1, _CHUNK_ENTRIES // max(1, len(everyone) * len(times) * 3))
        weight = self.samples.weight[:, times]
        parts = [
            _weighted_mean(self.compute_errors(select(columns), columns, everyone, times), weight)
            for columns in torch.split(everyone, step)
        ]
        return torch.cat(parts).T


class Fit(NamedTuple):
    """The result of training, for n UAVs."""

    held_out_gain: Tensor  #: ``(n, n)`` log ratio of the null model's error for UAV i and that of candidate j's network
    attention: Tensor  #: ``(n, n)`` alpha_ij; the diagonal is the weight of the null model
    winner: int  #: the candidate whose network predicts best


def fit_networks(samples: Samples, settings: Any, generator: torch.Generator) -> Fit:
    """Train a network for every candidate, select the winner, and compute attention with the winner's network."""
    (uavs, count), device = samples.weight.shape, samples.target.device
    problem = Problem(samples, settings)
    used, held = split_times(count, settings.blocks, samples.velocity.shape[2], device)
    network = AdditiveNetwork.draw(uavs, problem.source.shape[2], settings.units, generator)
    _train(problem, network, used, generator)
    unused = torch.tensor(sorted(set(range(count)) - set(used.tolist())) or used.tolist(), device=device)
    with torch.no_grad():
        gains = []
        for times in (used, held, unused):
            null = _weighted_mean(problem.null_error[:, times], samples.weight[:, times])
            errors = problem.compute_all_errors(network.select, times)
            gain = torch.log((null.unsqueeze(1) + settings.floor) / (errors + settings.floor))
            gain.diagonal().zero_()
            gains.append(gain.mul_((samples.weight.sum(-1) > 0).unsqueeze(1)))
        # Added before they are clamped: a UAV that is fitted well and predicted badly adds nothing.
        total_gain = (gains[0] + 2.0 * gains[2]).clamp(min=0).sum(0)
        ties = total_gain == total_gain.max()  # all candidates if none beats the null model
        winner = int((ties * (1.0 - torch.rand(ties.shape, generator=generator, device=device))).argmax())
        attention = torch.softmax(_compare_leaders(problem, network, winner), dim=1)
    return Fit(gains[1], attention, winner)


def _train(problem: Problem, network: AdditiveNetwork, used: Tensor, generator: torch.Generator) -> None:
    """Train by AdamW at the times ``used``; the loss, the mean log error, gives each UAV its own variance."""
    samples, settings = problem.samples, problem.settings
    everyone = torch.arange(len(samples.target), device=used.device)
    is_other = everyone[:, None] != everyone
    groups: list[dict[str, Any]] = [{"params": network.weights}, {"params": network.free, "weight_decay": 0.0}]
    optimiser = torch.optim.AdamW(groups, lr=settings.learning_rate, weight_decay=settings.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)

    def draw(indices: Tensor, most: int) -> Tensor:
        return indices[torch.randperm(len(indices), generator=generator, device=indices.device)[:most]]

    for _ in range(settings.steps):
        times, voters = draw(used, settings.times), draw(everyone, settings.voters)
        errors = problem.compute_errors(network, everyone, voters, times, generator)
        weight = samples.weight[voters][:, times]
        is_counted = is_other[:, voters] & (weight.sum(-1) > 0)
        loss = (torch.log(_weighted_mean(errors, weight) + settings.floor) * is_counted).sum() / len(voters)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]  # torch leaves it untyped
        optimiser.step()
        schedule.step()


def _compare_leaders(problem: Problem, network: AdditiveNetwork, winner: int) -> Tensor:
    """Log-likelihoods ``(n, n)`` of all pairs by the winner's network."""
    samples = problem.samples
    times = torch.arange(samples.target.shape[1], device=problem.null.device)
    errors = problem.compute_all_errors(lambda columns: network.select(torch.full_like(columns, winner)), times)
    errors.diagonal().copy_(_weighted_mean(problem.null_error, samples.weight))
    return -1.5 * samples.weight.sum(-1).unsqueeze(1) * torch.log(errors + problem.settings.floor)

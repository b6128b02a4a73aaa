"""One network for each candidate head, and attention from how well each network predicts each UAV.

The paper's GASSL pools inputs: its attention averages the velocities of all UAVs, and one network predicts from the
average. An average of velocities no longer contains the squares that f4 and f5 need. Here each candidate j has a
network of its own, which predicts all other UAVs from the past of j alone. The null model predicts a UAV from its own
past.

All networks are trained at the same time. They are additive over the coordinates of the candidate's past, because a
window has only about a hundred samples. The candidate whose network predicts the other UAVs best, compared with the
null model, is the winner: times that the network was trained on count once, all other times twice. The gate looks at
held-out times only, with gaps around them.

The winner's network is then applied to the past of every UAV, as all followers use the same strategy. Attention that
does not vary with time has a closed form: alpha_ij is the softmax over j of the log-likelihoods of the flight of UAV i,
with the null model in the place of j = i.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from detectors.neural_granger.inputs import Samples
from detectors.series.null_models import predict_from_own_past
from usnet_env.config import Config

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]

_VELOCITY_SCALE = 1.7  # a coordinate of a unit vector has variance 1/3
_DISTANCE_SCALE = 300.0  # metres; keeps the offset between two UAVs of the arena near 1
_CHUNK_ENTRIES = 4_000_000  # pair errors formed at once where no gradient is kept


class PerCandidate(Config):
    """Sizes and rates of :func:`fit_per_candidate`; measured on tuning seeds, see benchmarks/README.md.

    Args:
        steps: training steps.
        times: random times a step.
        voters: random UAVs a step that each candidate's network must predict.
        units: tanh units for each coordinate of the candidate's past.
        learning_rate: of AdamW; a cosine schedule lowers it to 0.
        weight_decay: of all weights except biases, the gain of the null model and the scale of the output.
        input_noise: standard deviation of the noise on a candidate's velocities, as a fraction of the root mean
            square error of its null model (so that the noise stays small for smooth flight).
        blocks: contiguous blocks of times that are held out, a fifth of all times, with gaps of T_0 on both sides.
        ridge: penalty of the null model, a ridge regression of a UAV's velocity on its own past.
        floor: squared error, in (metres per step)², that is added to all errors before their logarithm is taken.
    """

    steps: Annotated[int, Field(ge=1, le=100_000)] = 200
    times: Annotated[int, Field(ge=1, le=100_000)] = 64
    voters: Annotated[int, Field(ge=2, le=100_000)] = 24
    units: Annotated[int, Field(ge=1, le=1000)] = 6
    learning_rate: Positive = 3e-2
    weight_decay: NonNegative = 0.3
    input_noise: NonNegative = 0.2
    blocks: Annotated[int, Field(ge=1, le=100)] = 4
    ridge: Positive = 1.0
    floor: Positive = 1e-3


@dataclass(frozen=True)
class Fit:
    """The result of training, for E windows of n UAVs.

    Args:
        held_out_gain: ``(E, n, n)`` entry (i, j): logarithm of the null model's error for UAV i, divided by the error
            of candidate j's network for UAV i, on the held-out times.
        attention: ``(E, n, n)`` entry (i, j): alpha_ij; the diagonal is the weight of the null model.
        winner: ``(E,)`` the candidate whose network predicts best.
        explained: ``(E, n)`` fraction of the squared velocity of UAV i that is explained on held-out times by the
            candidate to which i attends most.
    """

    held_out_gain: Tensor
    attention: Tensor
    winner: Tensor
    explained: Tensor


class AdditiveNetwork:
    """S additive networks side by side; each coordinate of the source's past has its own hidden units.

    For the past u of source j, o = sum_c B_c tanh(w_c u_c + b_c) + A u + C [(p_j - p_i) / 300, its direction]
    + D null_i + b, where null_i is the prediction of the null model. The network predicts o / sqrt(|o|² + e^s), which
    is close to a unit vector where o is large, and close to a multiple of o where o is small.
    """

    def __init__(self, networks: int, coordinates: int, units: int, generator: torch.Generator) -> None:
        device = generator.device

        def normal(*shape: int, scale: float) -> Tensor:
            return scale * torch.randn(networks, *shape, generator=generator, device=device)

        self.weights = [  # decayed
            normal(coordinates, units, scale=1.0),
            normal(coordinates * units, 3, scale=0.05),
            normal(coordinates, 3, scale=0.05),
            torch.zeros(networks, 6, 3, device=device),
        ]
        self.free = [  # not decayed
            normal(coordinates, units, scale=0.5),
            torch.zeros(networks, 1, 3, device=device),
            0.5 * torch.eye(3, device=device).repeat(networks, 1, 1),
            torch.full((networks, 1, 1), -1.0, device=device),
        ]
        for parameter in (*self.weights, *self.free):
            parameter.requires_grad_(True)

    def select(self, index: Tensor) -> AdditiveNetwork:
        """Copy some of the networks, without gradient."""
        return self._map(lambda parameter: parameter.detach()[index])

    def repeat(self, count: int) -> AdditiveNetwork:
        """Expand to ``count`` networks: the only one is repeated, and the gradients of the copies add up."""
        return self._map(lambda parameter: parameter.expand(count, *parameter.shape[1:]))

    def _map(self, change: Callable[[Tensor], Tensor]) -> AdditiveNetwork:
        """The networks with changed parameters."""
        changed = copy(self)
        changed.weights, changed.free = ([change(each) for each in part] for part in (self.weights, self.free))
        return changed

    def encode_source(self, window: Tensor) -> Tensor:
        """Compute the terms that depend on the source alone: ``(S, t, C)`` to ``(S, t, 3)``."""
        slope, readout, linear, _ = self.weights
        shift, bias, _, _ = self.free
        hidden = torch.tanh(window.unsqueeze(-1) * slope.unsqueeze(1) + shift.unsqueeze(1)).flatten(2)
        return torch.baddbmm(torch.baddbmm(bias, hidden, readout), window, linear)

    def predict(self, source: Tensor, offset: Tensor, null: Tensor) -> Tensor:
        """Predict the velocities ``(S, v, t, 3)`` of v UAVs.

        Args:
            source: ``(S, t, 3)`` from :meth:`encode_source`.
            offset: ``(S, v, t, 3)`` p_j - p_i, metres.
            null: ``(S, v, t, 3)`` predictions of the null model.
        """
        networks, voters, times, _ = offset.shape
        distance = offset.norm(dim=-1, keepdim=True)
        where = torch.cat([offset / _DISTANCE_SCALE, offset / (distance + 1e-6), null], dim=-1)
        gains = torch.cat([self.weights[3], self.free[2]], dim=1)
        output = torch.bmm(where.reshape(networks, voters * times, 9), gains).view(networks, voters, times, 3)
        output = output + source.unsqueeze(1)
        return output * torch.rsqrt((output * output).sum(-1, keepdim=True) + self.free[3].exp().unsqueeze(1))


def split_times(times: int, blocks: int, gap: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Split the times into training times and held-out times.

    A fifth of all times is held out, in evenly spread blocks with gaps on both sides. If less than a third of the times
    would remain for training, there are fewer and longer blocks, because every block costs two gaps. If even one block
    leaves too few times, there are no gaps.

    Returns:
        Indices of the training times and of the held-out times; the ``gap`` times on each side of a block are neither.
    """
    for fewer in range(min(blocks, times), 0, -1):
        held, near = torch.zeros(2, times, dtype=torch.bool, device=device)
        length = max(1, times // (5 * fewer))
        for block in range(fewer):
            first = int((block + 0.5) * times / fewer) - length // 2
            held[first : first + length] = True
            near[max(0, first - gap) : first + length + gap] = True
        if (~near).sum() >= max(1, times // 3):
            return (~near).nonzero()[:, 0], held.nonzero()[:, 0]
    used = ~held if times > 1 else held  # around the single block of the last try
    return used.nonzero()[:, 0], held.nonzero()[:, 0]


def find_untrained_times(used: Tensor, times: int) -> Tensor:
    """Indices of the times that are not training times; of all times if there are no others."""
    rest = torch.ones(times, dtype=torch.bool, device=used.device)
    rest[used] = False
    return (rest if rest.any() else ~rest).nonzero()[:, 0]


def predict_from_own_history(samples: Samples, ridge: float) -> Tensor:
    """Predict each UAV's next velocity ``(E, n, R, 3)`` from its own last ones, without those times: the null model."""
    past = (_VELOCITY_SCALE * samples.velocity.flatten(3)).cpu().numpy()
    past = np.concatenate([past, np.ones_like(past[..., :1])], axis=-1)
    target, weight = samples.target.cpu().numpy(), samples.weight.cpu().numpy()
    found = predict_from_own_past(past, target, weight, ridge, gap=samples.velocity.shape[3])
    return torch.from_numpy(found).to(samples.target.device)


def compute_weighted_mean(values: Tensor, weight: Tensor) -> Tensor:
    """Mean over the last axis; 0 where all weights are 0."""
    return (values * weight).sum(-1) / weight.sum(-1).clamp(min=1.0)


class Problem:
    """The tensors of one fit, and the prediction errors of pairs of UAVs.

    Args:
        samples: E windows of n UAVs.
        settings: sizes and rates.
        centre: whether the mean velocity of each source is subtracted. A network with one source replaces the mean by
            its biases; a network with several sources needs the means.
    """

    def __init__(self, samples: Samples, settings: PerCandidate, centre: bool = True) -> None:
        self.samples, self.settings = samples, settings
        self.null = predict_from_own_history(samples, settings.ridge)
        self.null_error = ((self.null - samples.target) ** 2).sum(-1)  # (E, n, R)
        windows, uavs, times = samples.windows, samples.uavs, samples.times
        # The mean velocity of a UAV that flies nearly straight would dominate the inputs.
        velocity = samples.velocity - samples.velocity.mean((2, 3), keepdim=True) if centre else samples.velocity
        self.source = _VELOCITY_SCALE * velocity.reshape(windows * uavs, times, -1)
        surprise = (compute_weighted_mean(self.null_error, samples.weight) / 3.0).sqrt()
        self.noise = (settings.input_noise * _VELOCITY_SCALE * surprise).reshape(-1, 1, 1)

    def compute_errors(
        self,
        network: AdditiveNetwork,
        columns: Tensor,
        voters: Tensor,
        times: Tensor,
        generator: torch.Generator | None = None,
    ) -> Tensor:
        """Squared errors ``(E, c, v, t)`` of predicting the voters from the columns.

        Args:
            network: E * c networks.
            columns: ``(c,)`` indices of the sources.
            voters: ``(v,)`` indices of the predicted UAVs.
            times: ``(t,)`` indices of times.
            generator: of the noise on the sources; ``None`` for no noise.
        """
        samples, windows, uavs = self.samples, self.samples.windows, self.samples.uavs
        count, shape = len(columns), (len(voters), len(times), 3)
        rows = (torch.arange(windows, device=columns.device)[:, None] * uavs + columns).reshape(-1)
        source = self.source[rows][:, times]
        if generator is not None:
            noise = torch.randn(source.shape, generator=generator, device=source.device)
            source = source + self.noise[rows] * noise
        theirs = samples.position.flatten(0, 1)[rows][:, times].view(windows, count, 1, len(times), 3)
        own = samples.position[:, voters][:, :, times].unsqueeze(1)
        offset = (theirs - own).reshape(windows * count, *shape)
        null = self.null[:, voters][:, :, times].unsqueeze(1).expand(windows, count, *shape)
        predicted = network.predict(network.encode_source(source), offset, null.reshape(windows * count, *shape))
        target = samples.target[:, voters][:, :, times].unsqueeze(1)
        return ((predicted.view(windows, count, *shape) - target) ** 2).sum(-1)


def fit_per_candidate(samples: Samples, settings: PerCandidate, generator: torch.Generator) -> Fit:
    """Train a network for every candidate, select the winner, and compute attention with the winner's network.

    ``generator``, of all random numbers, is on the same device as the samples of E windows.
    """
    windows, uavs = samples.windows, samples.uavs
    device = samples.target.device
    problem = Problem(samples, settings)
    used, held = split_times(samples.times, settings.blocks, samples.velocity.shape[3], device)
    network = AdditiveNetwork(windows * uavs, problem.source.shape[2], settings.units, generator)
    everyone = torch.arange(uavs, device=device)
    others = everyone[:, None] != everyone
    train_on_pairs(problem, network, (everyone, everyone, others), used, generator)

    rows = torch.arange(windows, device=device)[:, None] * uavs
    with torch.no_grad():
        gains = []
        for times in (used, held, find_untrained_times(used, samples.times)):
            weight = samples.weight[:, :, times]
            null = compute_weighted_mean(problem.null_error[:, :, times], weight)
            errors = compute_all_errors(problem, lambda columns: network.select((rows + columns).reshape(-1)), times)
            gains.append(torch.log((null.unsqueeze(2) + settings.floor) / (errors + settings.floor)))
        trained, held_out, untrained = gains
        for gain in gains:
            gain.diagonal(dim1=1, dim2=2).zero_()
            gain.mul_((samples.weight.sum(-1) > 0).unsqueeze(2))
        # Gains are added before they are clamped, so a UAV that is fitted well and predicted badly adds nothing. The
        # other times, which include the gaps, are the stronger evidence (measured on nearly straight flight).
        better = (trained + 2.0 * untrained).clamp(min=0).sum(1)
        ties = better == better.max(1, keepdim=True).values  # all candidates if none beats the null model
        winner = (ties * (1.0 - torch.rand(ties.shape, generator=generator, device=device))).argmax(1)
        likelihood, explained = _attend(problem, network, winner, held)
    return Fit(held_out, torch.softmax(likelihood, dim=2), winner, explained)


def train_on_pairs(
    problem: Problem,
    network: AdditiveNetwork,
    pairs: tuple[Tensor, Tensor, Tensor],
    used: Tensor,
    generator: torch.Generator,
) -> None:
    """Train by AdamW to predict UAVs from sources; the loss is the mean logarithm of the UAVs' errors.

    The logarithm of a UAV's mean error is a Gaussian log-likelihood in which each UAV has its own variance. A UAV that
    no network can predict, such as a decoy, then has no more weight than the others.

    Args:
        problem: E windows of n UAVs.
        network: a network for each source of each window, or one for all; only ``weights`` decay.
        pairs: indices ``(c,)`` of the sources and ``(v,)`` of the UAVs to predict, and which of the pairs count,
            ``(c, n)`` bool.
        used: ``(t,)`` indices of the training times.
        generator: of all random numbers.
    """
    samples, settings, (sources, followers, counts) = problem.samples, problem.settings, pairs
    groups: list[dict[str, Any]] = [{"params": network.weights}, {"params": network.free, "weight_decay": 0.0}]
    optimiser = torch.optim.AdamW(groups, lr=settings.learning_rate, weight_decay=settings.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)

    def draw(indices: Tensor, most: int) -> Tensor:
        return indices[torch.randperm(len(indices), generator=generator, device=indices.device)[:most]]

    for _ in range(settings.steps):
        times, voters = draw(used, settings.times), draw(followers, settings.voters)
        networks = network.repeat(samples.windows * len(sources))
        errors = problem.compute_errors(networks, sources, voters, times, generator)
        weight = samples.weight[:, voters][:, :, times].unsqueeze(1)
        counted = counts[:, voters] & (weight.sum(-1) > 0)
        loss = (torch.log(compute_weighted_mean(errors, weight) + settings.floor) * counted).sum() / len(voters)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]  # torch leaves it untyped
        optimiser.step()
        schedule.step()


def compute_all_errors(
    problem: Problem, select: Callable[[Tensor], AdditiveNetwork], times: Tensor, sources: Tensor | None = None
) -> Tensor:
    """Mean squared errors ``(E, n, s)`` of UAV i, predicted from source j, in bounded memory.

    ``select`` takes the candidates ``(c,)`` and returns their E * c networks. All UAVs are sources for ``None``.
    """
    samples = problem.samples
    everyone = torch.arange(samples.uavs, device=times.device)
    step = max(1, _CHUNK_ENTRIES // max(1, samples.windows * samples.uavs * len(times) * 3))
    weight = samples.weight[:, :, times].unsqueeze(1)
    parts = [
        compute_weighted_mean(problem.compute_errors(select(columns), columns, everyone, times), weight)
        for columns in torch.split(everyone if sources is None else sources, step)
    ]
    return torch.cat(parts, dim=1).transpose(1, 2)


def _attend(problem: Problem, network: AdditiveNetwork, winner: Tensor, held: Tensor) -> tuple[Tensor, Tensor]:
    """Log-likelihoods ``(E, n, n)`` of all pairs by the winner's network, and the explained fractions ``(E, n)``."""
    samples, floor = problem.samples, problem.settings.floor
    rows = torch.arange(samples.windows, device=winner.device) * samples.uavs + winner

    def measure(times: Tensor) -> Tensor:
        """Errors ``(E, n, n)`` by the winner's network at these times; on the diagonal those of the null model."""
        errors = compute_all_errors(
            problem, lambda columns: network.select(rows.repeat_interleave(len(columns))), times
        )
        null = compute_weighted_mean(problem.null_error[:, :, times], samples.weight[:, :, times])
        errors.diagonal(dim1=1, dim2=2).copy_(null)
        return errors

    errors = measure(torch.arange(samples.times, device=winner.device))
    likelihood = -1.5 * samples.weight.sum(-1).unsqueeze(2) * torch.log(errors + floor)
    power = compute_weighted_mean((samples.target[:, :, held] ** 2).sum(-1), samples.weight[:, :, held])
    chosen = measure(held).gather(2, likelihood.argmax(2).unsqueeze(2)).squeeze(2)
    return likelihood, 1.0 - chosen / power.clamp(min=1e-12)

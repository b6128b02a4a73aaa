"""Pooling of predictions: attention weighs what the IFSN predicts from each candidate's window, not the windows.

The paper pools inputs: v̂ is an average of all UAVs' velocities, and a soft average of velocities destroys the squares
of f4 and f5 before the IFSN sees them. Here the IFSN predicts UAV i from the window of each candidate j apart, and UAV
i attends to the candidates in proportion to how well that went. Attention that does not vary with time has a closed
form then: alpha_ij is the softmax of the log-likelihoods of i's flight under the candidates, its own history being the
candidate for "nobody".

Training starts once from every candidate (all UAVs attend to j, which trains IFSN Γ_j), for all candidates at once.
The IFSN is additive over the coordinates of the candidate's window: with some hundred samples the shape of the
network, not attention, decides what it can learn. A start is judged by how much better than their own histories it
predicts the UAVs, on the times that it was trained on and, counting twice, on those that it was not; for the gate on
times held out, with gaps around them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor

from detectors.neural_granger.inputs import Samples
from usnet_env.config import Config

__all__ = [
    "AdditiveNetwork",
    "Fit",
    "PerCandidate",
    "Problem",
    "fit_per_candidate",
    "held_out_times",
    "other_times",
    "weighted_mean",
]

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
        voters: random UAVs a step whose flight each candidate's network must predict.
        units: tanh units for each coordinate of the candidate's window.
        learning_rate: AdamW's, falling to 0 as a cosine.
        weight_decay: of all weights but biases, the null's gain and the output's scale.
        input_noise: standard deviation of the noise on a candidate's velocities, as a share of what its own history
            does not predict of them (so that smooth flight is not drowned).
        blocks: contiguous blocks of times that are held out, a fifth of all times, with gaps of T_0 on both sides.
        ridge: penalty of the null, the ridge regression of a UAV on its own history.
        floor: squared error, in (metres per step)², below which nothing is gained.
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
    """What training gives, for E windows of n UAVs.

    Args:
        trained_gain: ``(E, n, n)`` entry (i, j): log ratio of the null's error to that of candidate j's own network
            on UAV i, on the times of training.
        held_out_gain: the same on the times held out.
        attention: ``(E, n, n)`` alpha, row i; the diagonal is the weight of i's own history, the null.
        log_likelihood: ``(E, n, n)`` of UAV i's flight from candidate j's window by the winning network; the diagonal
            is the null's.
        winner: ``(E,)`` the start whose network predicts best.
        explained: ``(E, n)`` share of the held-out squared velocity that UAV i's most attended candidate explains.
    """

    trained_gain: Tensor
    held_out_gain: Tensor
    attention: Tensor
    log_likelihood: Tensor
    winner: Tensor
    explained: Tensor


class AdditiveNetwork:
    """S additive IFSNs side by side: each coordinate of the source's window has a learned basis of its own.

    o = sum_c B_c tanh(w_c u_c + b_c) + A u + C [(p_j - p_i) / 300, its direction] + D null_i + b, and the prediction
    is o / sqrt(|o|² + e^c): between o itself, small where little is known, and a unit vector.
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

    def rows(self, index: Tensor) -> AdditiveNetwork:
        """Some of the networks, without gradient."""
        some = object.__new__(AdditiveNetwork)
        some.weights = [parameter.detach()[index] for parameter in self.weights]
        some.free = [parameter.detach()[index] for parameter in self.free]
        return some

    def copies(self, count: int) -> AdditiveNetwork:
        """``count`` times the only network, whose gradients add up."""
        same = object.__new__(AdditiveNetwork)
        same.weights = [parameter.expand(count, *parameter.shape[1:]) for parameter in self.weights]
        same.free = [parameter.expand(count, *parameter.shape[1:]) for parameter in self.free]
        return same

    def optimiser(self, settings: PerCandidate) -> torch.optim.AdamW:
        """AdamW on its parameters, decay only where it belongs."""
        groups = [
            {"params": self.weights, "weight_decay": settings.weight_decay},
            {"params": self.free, "weight_decay": 0.0},
        ]
        return torch.optim.AdamW(groups, lr=settings.learning_rate)

    def from_source(self, window: Tensor) -> Tensor:
        """The part that depends on the source alone: ``(S, t, C)`` to ``(S, t, 3)``."""
        slope, readout, linear, _ = self.weights
        shift, bias, _, _ = self.free
        hidden = torch.tanh(window.unsqueeze(-1) * slope.unsqueeze(1) + shift.unsqueeze(1)).flatten(2)
        return torch.baddbmm(torch.baddbmm(bias, hidden, readout), window, linear)

    def predict(self, source: Tensor, offset: Tensor, null: Tensor) -> Tensor:
        """Predictions ``(S, v, t, 3)`` of v UAVs.

        Args:
            source: ``(S, t, 3)`` from :meth:`from_source`.
            offset: ``(S, v, t, 3)`` p_j - p_i, metres.
            null: ``(S, v, t, 3)`` what each UAV's own history predicts.
        """
        networks, voters, times, _ = offset.shape
        distance = offset.norm(dim=-1, keepdim=True)
        where = torch.cat([offset / _DISTANCE_SCALE, offset / (distance + 1e-6), null], dim=-1)
        gains = torch.cat([self.weights[3], self.free[2]], dim=1)
        output = torch.bmm(where.reshape(networks, voters * times, 9), gains).view(networks, voters, times, 3)
        output = output + source.unsqueeze(1)
        return output * torch.rsqrt((output * output).sum(-1, keepdim=True) + self.free[3].exp().unsqueeze(1))


def held_out_times(times: int, blocks: int, gap: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Indices of the times to train on, and of those held out: a fifth of all, in blocks with gaps on both sides.

    In a window in which that would leave less than a third of the times for training there are fewer blocks, and
    longer ones, as every block costs two gaps; where even one block costs too much, there are no gaps.
    """
    for fewer in range(min(blocks, times), 0, -1):
        held, near = _blocks(times, fewer, gap, device)
        if (~near).sum() >= max(1, times // 3):
            return (~near).nonzero()[:, 0], held.nonzero()[:, 0]
    held, _ = _blocks(times, 1, gap, device)
    used = ~held if times > 1 else held
    return used.nonzero()[:, 0], held.nonzero()[:, 0]


def _blocks(times: int, blocks: int, gap: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Which times lie in evenly spread blocks, a fifth of all together, and which in a block or its gaps."""
    held = torch.zeros(times, dtype=torch.bool, device=device)
    near = torch.zeros(times, dtype=torch.bool, device=device)
    length = max(1, times // (5 * blocks))
    for block in range(blocks):
        first = int((block + 0.5) * times / blocks) - length // 2
        held[first : first + length] = True
        near[max(0, first - gap) : first + length + gap] = True
    return held, near


def other_times(used: Tensor, times: int) -> Tensor:
    """Indices of the times that are not trained on; all of them where none is left."""
    rest = torch.ones(times, dtype=torch.bool, device=used.device)
    rest[used] = False
    return (rest if rest.any() else ~rest).nonzero()[:, 0]


def own_history(samples: Samples, ridge: float, folds: int = 8) -> Tensor:
    """The null: each UAV's next velocity from its own last ones, ``(E, n, R, 3)``, by cross-fitted ridge regression."""
    windows, uavs, times = samples.windows, samples.uavs, samples.times
    features = _VELOCITY_SCALE * samples.velocity.flatten(3)
    features = torch.cat([features, torch.ones_like(features[..., :1])], dim=-1)
    weighted = features * samples.weight.unsqueeze(-1)
    prediction = torch.zeros_like(samples.target)
    index = torch.arange(times, device=features.device)
    fold = index * folds // times
    eye = ridge * torch.eye(features.shape[-1], device=features.device)
    gap = samples.velocity.shape[3]
    for k in range(folds):
        inside = (fold == k).nonzero()[:, 0]
        if not len(inside):
            continue
        outside = ((index < inside[0] - gap) | (index > inside[-1] + gap)).nonzero()[:, 0]
        left = weighted[:, :, outside].transpose(-1, -2)
        solution = torch.linalg.solve(left @ features[:, :, outside] + eye, left @ samples.target[:, :, outside])
        prediction[:, :, inside] = features[:, :, inside] @ solution
    return prediction.view(windows, uavs, times, 3)


def weighted_mean(values: Tensor, weight: Tensor) -> Tensor:
    """Mean over the last axis with weights; 0 where all weights are 0."""
    return (values * weight).sum(-1) / weight.sum(-1).clamp(min=1.0)


def _centred(velocity: Tensor) -> Tensor:
    """Velocities ``(E, n, R, T_0, 3)`` less each UAV's mean; 0 where unseen.

    The network's biases can undo it. Without it, the small turns of a UAV that flies nearly straight are hard to tell
    from its mean flight, which weights are then busy with.
    """
    seen = (velocity != 0).any(-1, keepdim=True)
    mean = velocity.sum((2, 3), keepdim=True) / seen.sum((2, 3), keepdim=True).clamp(min=1)
    return torch.where(seen, velocity - mean, velocity)


class Problem:
    """The tensors of one fit, and errors of pairs from them.

    Args:
        samples: E windows of n UAVs.
        settings: sizes and rates.
        centre: whether sources are looked at without their mean velocities, which biases make up for where a network
            has one source to learn from; a network of several sources needs the means.
    """

    def __init__(self, samples: Samples, settings: PerCandidate, centre: bool = True) -> None:
        self.samples, self.settings = samples, settings
        self.null = own_history(samples, settings.ridge)
        self.null_error = ((self.null - samples.target) ** 2).sum(-1)  # (E, n, R)
        windows, uavs, times = samples.windows, samples.uavs, samples.times
        velocity = _centred(samples.velocity) if centre else samples.velocity
        self.source = _VELOCITY_SCALE * velocity.reshape(windows * uavs, times, -1)
        surprise = (weighted_mean(self.null_error, samples.weight) / 3.0).sqrt()
        self.noise = (settings.input_noise * _VELOCITY_SCALE * surprise).reshape(-1, 1, 1)

    def errors(
        self,
        network: AdditiveNetwork,
        columns: Tensor,
        voters: Tensor,
        times: Tensor,
        generator: torch.Generator | None = None,
    ) -> Tensor:
        """Squared errors ``(E, c, v, t)`` of predicting the voters from the columns, one network a row of (E, c).

        Args:
            network: E * c networks.
            columns: ``(c,)`` or ``(E, c)`` indices of the sources.
            voters: ``(v,)`` indices of the predicted UAVs.
            times: ``(t,)`` indices of times.
            generator: noise on the sources comes from it; none for ``None``.
        """
        samples, windows, uavs = self.samples, self.samples.windows, self.samples.uavs
        columns = columns.expand(windows, -1) if columns.dim() == 1 else columns
        count, shape = columns.shape[1], (len(voters), len(times), 3)
        rows = (torch.arange(windows, device=columns.device)[:, None] * uavs + columns).reshape(-1)
        source = self.source[rows][:, times]
        if generator is not None:
            noise = torch.randn(source.shape, generator=generator, device=source.device)
            source = source + self.noise[rows] * noise
        theirs = samples.position_now.flatten(0, 1)[rows][:, times].view(windows, count, 1, len(times), 3)
        own = samples.position_now[:, voters][:, :, times].unsqueeze(1)
        offset = (theirs - own).reshape(windows * count, *shape)
        null = self.null[:, voters][:, :, times].unsqueeze(1).expand(windows, count, *shape)
        predicted = network.predict(network.from_source(source), offset, null.reshape(windows * count, *shape))
        target = samples.target[:, voters][:, :, times].unsqueeze(1)
        return ((predicted.view(windows, count, *shape) - target) ** 2).sum(-1)


def fit_per_candidate(samples: Samples, settings: PerCandidate, generator: torch.Generator) -> Fit:
    """Train a network from every candidate, take the best start, and attend by it.

    Args:
        samples: E windows of n UAVs.
        settings: sizes and rates.
        generator: where all draws come from; its device is the samples'.
    """
    windows, uavs = samples.windows, samples.uavs
    device = samples.target.device
    problem = Problem(samples, settings)
    used, held = held_out_times(samples.times, settings.blocks, samples.velocity.shape[3], device)
    network = AdditiveNetwork(windows * uavs, problem.source.shape[2], settings.units, generator)
    _train(problem, network, used, generator)

    everyone = torch.arange(uavs, device=device)
    with torch.no_grad():
        gains = []
        for times in (used, held, other_times(used, samples.times)):
            weight = samples.weight[:, :, times]
            null = weighted_mean(problem.null_error[:, :, times], weight)
            errors = all_errors(problem, network, everyone, times)
            gains.append(torch.log((null.unsqueeze(2) + settings.floor) / (errors + settings.floor)))
        trained, held_out, untrained = gains
        for gain in gains:
            gain.diagonal(dim1=1, dim2=2).zero_()
            gain.mul_((samples.weight.sum(-1) > 0).unsqueeze(2))
        # All times together, UAV by UAV: who is fitted well and predicted badly adds nothing. Times that were not
        # trained on, the gaps among them, tell more (measured on nearly straight flight).
        better = (trained + 2.0 * untrained).clamp(min=0).sum(1)
        ties = better == better.max(1, keepdim=True).values  # all of them where no start beats the null
        winner = (ties * (1.0 - torch.rand(ties.shape, generator=generator, device=device))).argmax(1)
        likelihood, explained = _attend(problem, network, winner, held)
    return Fit(trained, held_out, torch.softmax(likelihood, dim=2), likelihood, winner, explained)


def _train(problem: Problem, network: AdditiveNetwork, used: Tensor, generator: torch.Generator) -> None:
    """Every candidate's network learns to predict the others; errors count by their logarithm.

    The logarithm of a UAV's mean error is its Gaussian likelihood with a variance of its own: a UAV that nobody can
    predict (a decoy) then weighs no more than the others.
    """
    settings, samples = problem.settings, problem.samples
    device = samples.target.device
    optimiser = network.optimiser(settings)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
    columns = torch.arange(samples.uavs, device=device)
    for _ in range(settings.steps):
        times = used[torch.randperm(len(used), generator=generator, device=device)[: settings.times]]
        voters = torch.randperm(samples.uavs, generator=generator, device=device)[: settings.voters]
        errors = problem.errors(network, columns, voters, times, generator)
        weight = samples.weight[:, voters][:, :, times].unsqueeze(1)
        others = (columns[:, None] != voters[None]) & (weight.sum(-1) > 0)
        loss = (torch.log(weighted_mean(errors, weight) + settings.floor) * others).sum() / len(voters)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]  # torch leaves it untyped
        optimiser.step()
        schedule.step()


def all_errors(problem: Problem, network: AdditiveNetwork, voters: Tensor, times: Tensor) -> Tensor:
    """Mean squared error ``(E, n, n)``, entry (i, j): UAV i from candidate j by j's own network; in bounded memory."""
    samples = problem.samples
    windows, uavs = samples.windows, samples.uavs
    step = max(1, _CHUNK_ENTRIES // max(1, windows * uavs * len(times) * 3))
    weight = samples.weight[:, :, times].unsqueeze(1)
    parts = []
    for first in range(0, uavs, step):
        columns = torch.arange(first, min(first + step, uavs), device=times.device)
        rows = (torch.arange(windows, device=times.device)[:, None] * uavs + columns).reshape(-1)
        parts.append(weighted_mean(problem.errors(network.rows(rows), columns, voters, times), weight))
    return torch.cat(parts, dim=1).transpose(1, 2)


def _attend(problem: Problem, network: AdditiveNetwork, winner: Tensor, held: Tensor) -> tuple[Tensor, Tensor]:
    """Log-likelihoods ``(E, n, n)`` of all pairs under the winning network, and the explained shares ``(E, n)``."""
    samples, floor = problem.samples, problem.settings.floor
    windows, uavs, device = samples.windows, samples.uavs, winner.device
    everyone = torch.arange(uavs, device=device)
    all_times = torch.arange(samples.times, device=device)
    rows = torch.arange(windows, device=device) * uavs + winner

    def shared(times: Tensor) -> Tensor:
        step = max(1, _CHUNK_ENTRIES // max(1, windows * uavs * len(times) * 3))
        parts = []
        for first in range(0, uavs, step):
            columns = everyone[first : first + step]
            weight = samples.weight[:, :, times].unsqueeze(1)
            errors = problem.errors(network.rows(rows.repeat_interleave(len(columns))), columns, everyone, times)
            parts.append(weighted_mean(errors, weight))
        return torch.cat(parts, dim=1).transpose(1, 2)

    error = shared(all_times)
    null = weighted_mean(problem.null_error, samples.weight)
    error.diagonal(dim1=1, dim2=2).copy_(null)
    seen = samples.weight.sum(-1)
    likelihood = -1.5 * seen.unsqueeze(2) * torch.log(error + floor)
    choice = likelihood.argmax(2)
    weight = samples.weight[:, :, held]
    left = shared(held)
    left.diagonal(dim1=1, dim2=2).copy_(weighted_mean(problem.null_error[:, :, held], weight))
    power = weighted_mean((samples.target[:, :, held] ** 2).sum(-1), weight)
    chosen = left.gather(2, choice.unsqueeze(2)).squeeze(2)
    return likelihood, 1.0 - chosen / power.clamp(min=1e-12)

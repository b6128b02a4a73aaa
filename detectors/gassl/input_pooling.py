"""Pooling of inputs, as the paper has it: Algorithm 1 for all UAVs of a window, and of several windows, at once.

Every UAV's AGAT pools the histories of all UAVs, and the shared IFSN predicts the UAV's next velocity from what was
pooled and its own positions. Where the paper is silent, research settled: AdamW with a cosine for both, 24 random
times a step in place of the whole batch (it overfits), inputs standardised feature by feature, noise on the IFSN's
inputs, and one update of Γ for all UAVs in place of one after another.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor

from detectors.gassl.agat import Agat, AgatSizes
from detectors.gassl.ifsn import Ifsn
from detectors.gassl.inputs import Samples
from usnet_env.config import Config

__all__ = ["InputFit", "InputPooling", "Standardised", "fit_input_pooling", "losses", "standardise"]

Width = Annotated[int, Field(ge=1, le=4096)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]

_CHUNK_ENTRIES = 4_000_000  # IFSN inputs formed at once where no gradient is kept


class InputPooling(Config):
    """Sizes and rates of :func:`fit_input_pooling`.

    Args:
        steps: training steps, the paper's Ω.
        times: random times a step; the paper's batch of all of them is ``times`` >= T_ob - T_0.
        query_hidden: hidden units of L.
        query: outputs of L.
        key: K, rows of K_l.
        similarity_hidden: units of the two hidden layers of s_l.
        ifsn_hidden: units of the hidden layers of the IFSN.
        learning_rate: AdamW's for Φ.
        ifsn_learning_rate: AdamW's for Γ.
        weight_decay: AdamW's, of all parameters.
        input_noise: standard deviation of the noise on the IFSN's standardised inputs while training.
    """

    steps: Annotated[int, Field(ge=1, le=100_000)] = 200
    times: Annotated[int, Field(ge=1, le=100_000)] = 24
    query_hidden: Width = 16
    query: Width = 8
    key: Width = 8
    similarity_hidden: tuple[Width, Width] = (16, 8)
    ifsn_hidden: tuple[Width, ...] = (32, 32, 32)
    learning_rate: Positive = 3e-2
    ifsn_learning_rate: Positive = 1e-2
    weight_decay: NonNegative = 1.0
    input_noise: NonNegative = 0.5


@dataclass(frozen=True)
class Standardised:
    """Inputs of zero mean and unit variance, feature by feature over all UAVs and times of a window.

    Args:
        velocity: ``(E, n, R, T_0, 3)``.
        position: ``(E, n, R, 3)`` p_{t-T_0+1}, each axis by its own scale.
        target: ``(E, n, R, 3)`` v_{i,t+1}, metres per step, as it is.
        weight: ``(E, n, R)``.
    """

    velocity: Tensor
    position: Tensor
    target: Tensor
    weight: Tensor

    def at(self, times: Tensor) -> Standardised:
        """The samples of some times."""
        return Standardised(
            self.velocity[:, :, times], self.position[:, :, times], self.target[:, :, times], self.weight[:, :, times]
        )


def standardise(samples: Samples) -> Standardised:
    """Zero mean and unit variance; one scale for all velocities, one for each axis of the positions."""
    speed = samples.velocity.std(dim=(1, 2, 3, 4), keepdim=True).clamp(min=1e-6)
    middle = samples.position.mean(dim=(1, 2), keepdim=True)
    spread = samples.position.std(dim=(1, 2), keepdim=True).clamp(min=1e-6)
    velocity = (samples.velocity - samples.velocity.mean(dim=(1, 2, 3, 4), keepdim=True)) / speed
    return Standardised(velocity, (samples.position - middle) / spread, samples.target, samples.weight)


def ifsn_inputs(velocity: Tensor, position: Tensor, pooled: Tensor) -> Tensor:
    """The IFSN's inputs ``(..., 6 T_0 + 6)``: own velocities and position, V̂, and p̂ - p_i.

    P_{i,t} enters as its first position and its differences, a linear map of it.
    """
    gap = pooled[..., -1, :] - position
    return torch.cat([velocity.flatten(-2), position, pooled[..., :-1, :].flatten(-2), gap], dim=-1)


def losses(agat: Agat, ifsn: Ifsn, batch: Standardised, noise: Tensor | None = None) -> Tensor:
    """L_B(Θ_i) of every UAV, ``(E, n)``: the squared errors summed over the batch's times, equation (23)."""
    inputs = ifsn_inputs(batch.velocity, batch.position, agat(batch.velocity, batch.position).pooled)
    if noise is not None:
        inputs = inputs + noise
    return (((ifsn(inputs) - batch.target) ** 2).sum(-1) * batch.weight).sum(-1)


@dataclass(frozen=True)
class InputFit:
    """What training gives, for E windows of n UAVs.

    Args:
        attention_heads: ``(E, T_0 + 1, n, n)`` alpha_{i,i',l}, mean over all times.
        rise: ``(E, n, n)`` entry (i, j): how much UAV i's mean squared error rises if j is dropped from its attention.
        explained: ``(E, n)`` share of the squared velocity that the prediction explains, over all times.
    """

    attention_heads: Tensor
    rise: Tensor
    explained: Tensor

    @property
    def attention(self) -> Tensor:
        """``(E, n, n)`` alpha_{i,i'}, the mean over the heads, equation (12)."""
        return self.attention_heads.mean(1)


def fit_input_pooling(samples: Samples, settings: InputPooling, generator: torch.Generator, occlude: bool) -> InputFit:
    """Train Φ and Γ and average the attention over all times.

    Args:
        samples: E windows of n UAVs.
        settings: sizes and rates.
        generator: where all draws come from; its device is the samples'.
        occlude: whether to compute :attr:`InputFit.rise`; zeros otherwise.
    """
    inputs = standardise(samples)
    memory = samples.velocity.shape[3]
    sizes = AgatSizes(memory, settings.query_hidden, settings.query, settings.key, settings.similarity_hidden)
    agat = Agat(samples.windows, samples.uavs, sizes, generator)
    ifsn = Ifsn(samples.windows, 6 * memory + 6, settings.ifsn_hidden, generator)
    device = samples.target.device
    optimiser = torch.optim.AdamW(
        [
            {"params": agat.parameters(), "lr": settings.learning_rate},
            {"params": ifsn.parameters(), "lr": settings.ifsn_learning_rate},
        ],
        betas=(0.9, 0.99),
        weight_decay=settings.weight_decay,
        fused=True,  # one pass over the many small parameters of Φ
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
    for _ in range(settings.steps):
        times = torch.randperm(samples.times, generator=generator, device=device)[: settings.times]
        shape = (samples.windows, samples.uavs, len(times), 6 * memory + 6)
        noise = settings.input_noise * torch.randn(shape, generator=generator, device=device)
        loss = losses(agat, ifsn, inputs.at(times), noise).sum()
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]  # torch leaves it untyped
        optimiser.step()
        schedule.step()
    with torch.no_grad():
        return _evaluate(agat, ifsn, inputs, occlude)


def _evaluate(agat: Agat, ifsn: Ifsn, inputs: Standardised, occlude: bool) -> InputFit:
    windows, uavs, times = inputs.target.shape[:3]
    heads = inputs.velocity.shape[3] + 1
    attention = torch.zeros(windows, heads, uavs, uavs, device=inputs.target.device)
    rise = torch.zeros(windows, uavs, uavs, device=inputs.target.device)
    squared = torch.zeros(windows, uavs, device=inputs.target.device)
    step = max(1, _CHUNK_ENTRIES // (windows * uavs * uavs * heads))
    for first in range(0, times, step):
        batch = inputs.at(torch.arange(first, min(first + step, times), device=inputs.target.device))
        attended = agat(batch.velocity, batch.position)
        attention += attended.alpha.sum(2).permute(0, 2, 1, 3)
        predicted = ifsn(ifsn_inputs(batch.velocity, batch.position, attended.pooled))
        error = ((predicted - batch.target) ** 2).sum(-1)
        squared += (error * batch.weight).sum(-1)
        if occlude:
            values = torch.cat([batch.velocity, batch.position.unsqueeze(3)], dim=3)  # (E, n, t, T_0 + 1, 3)
            for j in range(uavs):
                alpha = attended.alpha[..., j].unsqueeze(-1)
                without = (attended.pooled - alpha * values[:, j].unsqueeze(1)) / (1.0 - alpha).clamp(min=1e-6)
                dropped = ifsn(ifsn_inputs(batch.velocity, batch.position, without))
                more = ((dropped - batch.target) ** 2).sum(-1) - error
                rise[:, :, j] += (more * batch.weight).sum(-1)
    count = inputs.weight.sum(-1).clamp(min=1.0)
    power = ((inputs.target**2).sum(-1) * inputs.weight).sum(-1).clamp(min=1e-12)
    return InputFit(attention / times, rise / count.unsqueeze(2), 1.0 - squared / power)

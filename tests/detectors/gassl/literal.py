"""Algorithm 1 as the paper writes it, slowly: what the fast GASSL with pooling of inputs is held against.

:func:`losses` and :func:`attention` go one UAV, one attention head, one time and one candidate at a time, equation by
equation. :func:`train` is the algorithm's loop: one UAV after another, all its steps, the shared Γ updated in turn, all
times in every step (as one batch of tensors, as anybody would write it).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from detectors.gassl.agat import Agat
from detectors.gassl.ifsn import Ifsn
from detectors.gassl.input_pooling import InputPooling, Standardised

SLOPE = 0.01


def leaky(x: Tensor) -> Tensor:
    return torch.where(x > 0, x, SLOPE * x)


@dataclass
class Parameters:
    """Φ_i of one UAV, with matrices that stand left of what they multiply, and s_l's first layer for [q; k]."""

    query_in: Tensor
    query_in_bias: Tensor
    query_out: Tensor
    query_out_bias: Tensor
    key: list[Tensor]
    first: list[Tensor]
    first_bias: list[Tensor]
    second: list[Tensor]
    second_bias: list[Tensor]
    last: list[Tensor]


def parameters_of(phi: dict[str, Tensor], row: int) -> Parameters:
    """Φ of network ``row`` out of an Agat's tensors by name."""
    heads = range(phi["key"].shape[1])
    joint = [torch.cat([phi["first_query"][row, head], phi["first_key"][row, head]]).T for head in heads]
    return Parameters(
        query_in=phi["query_in"][row].T,
        query_in_bias=phi["query_in_bias"][row, 0],
        query_out=phi["query_out"][row].T,
        query_out_bias=phi["query_out_bias"][row, 0],
        key=[phi["key"][row, head] for head in heads],
        first=joint,
        first_bias=[phi["first_bias"][row, head, 0] for head in heads],
        second=[phi["second"][row, head].T for head in heads],
        second_bias=[phi["second_bias"][row, head] for head in heads],
        last=[phi["last"][row, head] for head in heads],
    )


def leaves(agat: Agat, ifsn: Ifsn, dtype: torch.dtype) -> tuple[dict[str, Tensor], list[Tensor]]:
    """Copies of all parameters, by name for Φ and in order for Γ, to take gradients of."""
    phi = {name: value for name, value in vars(agat).items() if isinstance(value, Tensor)}
    copy = {name: value.detach().to(dtype, copy=True).requires_grad_() for name, value in phi.items()}
    return copy, [value.detach().to(dtype, copy=True).requires_grad_() for value in ifsn.parameters()]


def attention_at(phi: Parameters, velocity: Tensor, position: Tensor, i: int) -> list[list[Tensor]]:
    """alpha_{i,i',l} at one time: equations (10) and (11), the latter with positions all through.

    Args:
        phi: Φ_i.
        velocity: ``(n, T_0, 3)``, newest first.
        position: ``(n, 3)``.
        i: the UAV.

    Returns:
        T_0 + 1 lists of n numbers.
    """
    uavs, memory = velocity.shape[:2]
    history = torch.cat([*(velocity[i, lag] for lag in range(memory)), position[i]])
    query = phi.query_out @ torch.tanh(phi.query_in @ history + phi.query_in_bias) + phi.query_out_bias
    result = []
    for head in range(memory + 1):
        exponentials = []
        for other in range(uavs):
            x = velocity[other, head] if head < memory else position[other]
            joined = torch.cat([query, phi.key[head] @ x])
            hidden = leaky(phi.first[head] @ joined + phi.first_bias[head])
            hidden = leaky(phi.second[head] @ hidden + phi.second_bias[head])
            exponentials.append(torch.exp(phi.last[head] @ hidden))
        total = torch.stack(exponentials).sum()
        result.append([one / total for one in exponentials])
    return result


def pooled_at(alpha: list[list[Tensor]], velocity: Tensor, position: Tensor) -> tuple[list[Tensor], Tensor]:
    """V̂, newest first, and p̂: equations (13) and (14)."""
    uavs, memory = velocity.shape[:2]
    estimates = []
    for lag in range(memory):
        estimates.append(sum((alpha[lag][j] * velocity[j, lag] for j in range(uavs)), torch.zeros_like(position[0])))
    where = sum((alpha[memory][j] * position[j] for j in range(uavs)), torch.zeros_like(position[0]))
    return estimates, where


def predicted_at(gamma: list[Tensor], velocity: Tensor, position: Tensor, v_hat: list[Tensor], p_hat: Tensor) -> Tensor:
    """f̂ of equation (15) for one UAV at one time, ``(3,)``; P_{i,t} enters as a position and its differences."""
    hidden = torch.cat([velocity.reshape(-1), position, *v_hat, p_hat - position])
    for layer in range(0, len(gamma), 2):
        hidden = gamma[layer].T @ hidden + gamma[layer + 1][0]
        if layer + 2 < len(gamma):
            hidden = torch.tanh(hidden)
    return hidden


def losses(phi: dict[str, Tensor], gamma: list[Tensor], batch: Standardised) -> Tensor:
    """L_B(Θ_i) of every UAV of every window, ``(E, n)``: equation (23), without what was not seen."""
    dtype = gamma[0].dtype
    windows, uavs, times = batch.target.shape[:3]
    result = []
    for e in range(windows):
        for i in range(uavs):
            own = parameters_of(phi, e * uavs + i)
            shared = [value[e] for value in gamma]
            total = torch.zeros((), dtype=dtype)
            for t in range(times):
                velocity, position = batch.velocity[e, :, t].to(dtype), batch.position[e, :, t].to(dtype)
                v_hat, p_hat = pooled_at(attention_at(own, velocity, position, i), velocity, position)
                predicted = predicted_at(shared, velocity[i], position[i], v_hat, p_hat)
                error = ((batch.target[e, i, t].to(dtype) - predicted) ** 2).sum()
                total = total + error * batch.weight[e, i, t].to(dtype)
            result.append(total)
    return torch.stack(result).view(windows, uavs)


def attention(phi: dict[str, Tensor], batch: Standardised) -> Tensor:
    """alpha_{i,i',l} at all times, ``(E, n, t, T_0 + 1, n)``."""
    dtype = phi["key"].dtype
    windows, uavs, times = batch.target.shape[:3]
    rows = [
        attention_at(
            parameters_of(phi, e * uavs + i), batch.velocity[e, :, t].to(dtype), batch.position[e, :, t].to(dtype), i
        )
        for e in range(windows)
        for i in range(uavs)
        for t in range(times)
    ]
    flat = torch.stack([torch.stack([torch.stack(head) for head in row]) for row in rows])
    return flat.view(windows, uavs, times, -1, uavs)


def forward(phi: Parameters, gamma: list[Tensor], window: Standardised, i: int) -> tuple[Tensor, Tensor]:
    """Predictions ``(t, 3)`` of UAV i of a window without its axis E at all times, and alpha ``(T_0 + 1, t, n)``."""
    velocity, position = window.velocity, window.position
    uavs, times, memory, _ = velocity.shape
    history = torch.cat([velocity[i].reshape(times, -1), position[i]], dim=-1)
    query = torch.tanh(history @ phi.query_in.T + phi.query_in_bias) @ phi.query_out.T + phi.query_out_bias
    alphas, pooled = [], []
    for head in range(memory + 1):
        value = (velocity[:, :, head] if head < memory else position).transpose(0, 1)  # (t, n, 3)
        keys = value @ phi.key[head].T
        joined = torch.cat([query[:, None].expand(times, uavs, -1), keys], dim=-1)
        hidden = torch.nn.functional.leaky_relu(joined @ phi.first[head].T + phi.first_bias[head], SLOPE)
        hidden = torch.nn.functional.leaky_relu(hidden @ phi.second[head].T + phi.second_bias[head], SLOPE)
        alpha = torch.softmax(hidden @ phi.last[head], dim=1)
        alphas.append(alpha)
        pooled.append((alpha[..., None] * value).sum(1))
    hidden = torch.cat([history, *pooled[:-1], pooled[-1] - position[i]], dim=-1)
    for layer in range(0, len(gamma), 2):
        hidden = hidden @ gamma[layer] + gamma[layer + 1]
        if layer + 2 < len(gamma):
            hidden = torch.tanh(hidden)
    return hidden, torch.stack(alphas)


def window_of(batch: Standardised, e: int) -> Standardised:
    """One window, without the axis E."""
    return Standardised(batch.velocity[e], batch.position[e], batch.target[e], batch.weight[e])


def train(
    agat: Agat, ifsn: Ifsn, inputs: Standardised, settings: InputPooling, steps: int, uavs: list[int] | None = None
) -> Tensor:
    """The two loops of Algorithm 1 over the UAVs and the steps, from the parameters given, in one window.

    Args:
        agat: the first Φ of all UAVs.
        ifsn: the first Γ.
        inputs: one window, all times.
        settings: rates; the optimiser is the fast one's.
        steps: Ω.
        uavs: which UAVs; all of them for ``None``.

    Returns:
        alpha_{i,i'} ``(len(uavs), n)``, equation (12), mean over all times.
    """
    phi, gamma = leaves(agat, ifsn, torch.float32)
    window = window_of(inputs, 0)
    shared = [value[0].detach().requires_grad_() for value in gamma]
    rates = {"betas": (0.9, 0.99), "weight_decay": settings.weight_decay}
    optimiser_of_gamma = torch.optim.AdamW(shared, lr=settings.ifsn_learning_rate, **rates)
    attended = []
    for i in range(agat.uavs) if uavs is None else uavs:
        own = {name: value[i : i + 1].detach().clone().requires_grad_() for name, value in phi.items()}
        optimiser = torch.optim.AdamW(own.values(), lr=settings.learning_rate, **rates)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
        for _ in range(steps):
            predicted, _ = forward(parameters_of(own, 0), shared, window, i)
            loss = (((window.target[i] - predicted) ** 2).sum(-1) * window.weight[i]).sum()
            for one in (optimiser, optimiser_of_gamma):
                one.zero_grad()
            loss.backward()
            for one in (optimiser, optimiser_of_gamma):
                one.step()
            schedule.step()
        with torch.no_grad():
            attended.append(forward(parameters_of(own, 0), shared, window, i)[1].mean(dim=(0, 1)))
    return torch.stack(attended)

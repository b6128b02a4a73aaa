"""Algorithm 1's networks read literally: one UAV, one attention head, one time and one other UAV at a time.

The readable loop of :mod:`detectors.gassl.algorithm_1` works on tensors of all times and UAVs; this module doesn't.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from detectors.gassl.agat import SLOPE, AgatSizes
from detectors.gassl.ifsn import VARIANCE_FLOOR
from detectors.gassl.training import Inputs


def leaky(x: Tensor) -> Tensor:
    return torch.where(x > 0, x, SLOPE * x)


@dataclass
class Agat:
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


def agat_of(phi: Tensor, sizes: AgatSizes) -> Agat:
    """Φ_i out of a flat vector: L, then K_l and s_l of one attention head after another."""
    rest = phi

    def take(*shape: int) -> Tensor:
        nonlocal rest
        size = int(torch.tensor(shape).prod())
        taken, rest = rest[:size].view(shape), rest[size:]
        return taken

    wide, narrow = sizes.similarity_hidden
    agat = Agat(
        query_in=take(3 * (sizes.memory + 1), sizes.query_hidden).T,
        query_in_bias=take(sizes.query_hidden),
        query_out=take(sizes.query_hidden, sizes.query).T,
        query_out_bias=take(sizes.query),
        key=[], first=[], first_bias=[], second=[], second_bias=[], last=[],
    )  # fmt: skip
    for _ in range(sizes.memory + 1):
        agat.key.append(take(sizes.key, 3))
        agat.first.append(torch.cat([take(sizes.query, wide), take(sizes.key, wide)]).T)
        agat.first_bias.append(take(wide))
        agat.second.append(take(wide, narrow).T)
        agat.second_bias.append(take(narrow))
        agat.last.append(take(narrow))
    assert len(rest) == 0
    return agat


def attention_at(phi: Agat, velocity: Tensor, position: Tensor, i: int) -> list[list[Tensor]]:
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
    for attn_head in range(memory + 1):
        exponentials = []
        for other in range(uavs):
            x = velocity[other, attn_head] if attn_head < memory else position[other]
            joined = torch.cat([query, phi.key[attn_head] @ x])
            hidden = leaky(phi.first[attn_head] @ joined + phi.first_bias[attn_head])
            hidden = leaky(phi.second[attn_head] @ hidden + phi.second_bias[attn_head])
            exponentials.append(torch.exp(phi.last[attn_head] @ hidden))
        total = torch.stack(exponentials).sum()
        result.append([one / total for one in exponentials])
    return result


def pooled_at(alpha: list[list[Tensor]], velocity: Tensor, position: Tensor) -> tuple[list[Tensor], Tensor]:
    """V̂, newest first, and p̂: equations (13) and (14)."""
    uavs, memory = velocity.shape[:2]
    v_hat = []
    for lag in range(memory):
        v_hat.append(sum((alpha[lag][j] * velocity[j, lag] for j in range(uavs)), torch.zeros_like(position[0])))
    p_hat = sum((alpha[memory][j] * position[j] for j in range(uavs)), torch.zeros_like(position[0]))
    return v_hat, p_hat


def standardised(rows: list[Tensor]) -> list[Tensor]:
    """One concatenation for each time, every entry with zero mean and unit variance over the times."""
    mean = sum(rows) / len(rows)
    variance = sum((row - mean) ** 2 for row in rows) / len(rows)
    return [(row - mean) / (variance + VARIANCE_FLOOR) ** 0.5 for row in rows]


def predicted_at(gamma: Tensor, width: int, concatenation: Tensor) -> Tensor:
    """v̂_{i,t+1} ``(3,)`` of one standardised concatenation: three hidden layers and a linear output."""
    hidden, rest = concatenation, gamma
    for layer in range(4):
        inputs, outputs = len(hidden), width if layer < 3 else 3
        matrix, bias = rest[: inputs * outputs].view(inputs, outputs), rest[inputs * outputs : (inputs + 1) * outputs]
        rest = rest[(inputs + 1) * outputs :]
        hidden = matrix.T @ hidden + bias
        if layer < 3:
            hidden = torch.tanh(hidden)
    assert len(rest) == 0
    return hidden


def loss_and_attention(
    inputs: Inputs, i: int, phi: Tensor, gamma: Tensor, agat: AgatSizes, ifsn: int
) -> tuple[Tensor, Tensor]:
    """L_B(Θ_i) of equation (23), and alpha_{i,i',l} ``(T_0 + 1, R, n)``."""
    network, dtype = agat_of(phi, agat), phi.dtype
    times = inputs.target.shape[1]
    alphas, concatenations = [], []
    for t in range(times):
        x = torch.from_numpy(inputs.value[..., t]).to(dtype)  # (T_0 + 1, 3, n)
        velocity, position = x[:-1].permute(2, 0, 1), x[-1].T
        alpha = attention_at(network, velocity, position, i)
        v_hat, p_hat = pooled_at(alpha, velocity, position)
        alphas.append(torch.stack([torch.stack(row) for row in alpha]))
        own = torch.from_numpy(inputs.own[i, t]).to(dtype)
        concatenations.append(torch.cat([own, *v_hat, p_hat]))
    loss = torch.zeros((), dtype=dtype)
    for t, concatenation in enumerate(standardised(concatenations)):
        error = torch.from_numpy(inputs.target[i, t]).to(dtype) - predicted_at(gamma, ifsn, concatenation)
        loss = loss + float(inputs.weight[i, t]) * (error**2).sum()
    return loss, torch.stack(alphas, dim=1)


def vote(attention: Tensor) -> tuple[Tensor, Tensor]:
    """Lines 6 and 8 of Algorithm 1.

    Args:
        attention: ``(n, n)`` alpha_{i,i'}, the mean of alpha_{i,i',l} over the attention heads, equation (12).

    Returns:
        i_L^{(i)} ``(n,)`` and c_i ``(n,)``; the top K of c are the candidates, equations (21) and (22).
    """
    uavs = len(attention)
    chosen = attention.argmax(dim=1)  # equation (19)
    c = torch.zeros(uavs)
    for i in range(uavs):  # equation (20)
        for other in range(uavs):
            if other != i and chosen[other] == i:
                c[i] += 1.0 / uavs
    return chosen, c

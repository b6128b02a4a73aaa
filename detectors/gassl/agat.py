"""AGAT, the adaptive graph attention network of §III-A: one network Φ_i for each UAV i, all of them at once.

For UAV i, the query data are q_i = L(V_{i,t}, p_{i,t-T_0+1}), and attention head l compares them with the key data K_l
x_{i',l} of every UAV i' by the similarity s_l: alpha_{i,i',l} is the softmax over i' of s_l(q_i, K_l x_{i',l}), where
x_{i',l} is v_{i',t-l+1} for l <= T_0 and p_{i',t-T_0+1} for the last head (equations (10), (11); the position head's
denominator takes positions too, decision (f)). The first layer of s_l is linear in its two inputs, so queries and keys
go through it apart and meet by one addition: no tensor of times x N x N x heads x width is ever formed. The rest of
s_l is a fused loop on the CPU (:mod:`detectors.gassl.similarity`) and plain tensor operations elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from detectors.gassl.similarity import similarity

__all__ = ["Agat", "AgatSizes", "Attention"]


@dataclass(frozen=True)
class AgatSizes:
    """Widths of the AGAT.

    Args:
        memory: T_0.
        query_hidden: hidden units of L.
        query: outputs of L.
        key: K, rows of K_l.
        similarity_hidden: units of the two hidden layers of s_l.
    """

    memory: int
    query_hidden: int
    query: int
    key: int
    similarity_hidden: tuple[int, int]


@dataclass(frozen=True)
class Attention:
    """Attention at some times, and what it pools.

    Args:
        alpha: ``(E, n, t, T_0 + 1, n)`` alpha_{i,i',l} at each time, i the second axis, i' the last.
        pooled: ``(E, n, t, T_0 + 1, 3)`` v̂ of the first T_0 heads, newest first, and p̂: equations (13), (14).
    """

    alpha: Tensor
    pooled: Tensor


class Agat:
    """Parameters Φ_i of E * n UAVs.

    Args:
        windows: E.
        uavs: n.
        sizes: widths.
        generator: where the first values come from; uniform in ±1/sqrt(inputs), the last layer of s_l ten times less,
            so that attention begins nearly even.
    """

    def __init__(self, windows: int, uavs: int, sizes: AgatSizes, generator: torch.Generator) -> None:
        self.windows, self.uavs, self.sizes = windows, uavs, sizes
        networks, heads = windows * uavs, sizes.memory + 1
        first, second = sizes.similarity_hidden

        def drawn(inputs: int, *shape: int, scale: float = 1.0) -> Tensor:
            values = torch.rand(networks, *shape, generator=generator, device=generator.device)
            return ((2.0 * values - 1.0) * (scale / inputs**0.5)).requires_grad_(True)

        window, joint = 3 * heads, sizes.query + sizes.key
        self.query_in = drawn(window, window, sizes.query_hidden)
        self.query_in_bias = drawn(window, 1, sizes.query_hidden)
        self.query_out = drawn(sizes.query_hidden, sizes.query_hidden, sizes.query)
        self.query_out_bias = drawn(sizes.query_hidden, 1, sizes.query)
        self.key = drawn(3, heads, sizes.key, 3)
        self.first_query = drawn(joint, heads, sizes.query, first)
        self.first_key = drawn(joint, heads, sizes.key, first)
        self.first_bias = drawn(joint, heads, 1, first)
        self.second = drawn(first, heads, first, second)
        self.second_bias = drawn(first, heads, second)
        self.last = drawn(second, heads, second, scale=0.1)

    def parameters(self) -> list[Tensor]:
        """All of Φ."""
        return [value for value in vars(self).values() if isinstance(value, Tensor)]

    def __call__(self, velocity: Tensor, position: Tensor) -> Attention:
        """Attend.

        Args:
            velocity: ``(E, n, t, T_0, 3)`` standardised, newest first.
            position: ``(E, n, t, 3)`` standardised p_{t-T_0+1}.
        """
        windows, uavs, times, memory, _ = velocity.shape
        history = torch.cat([velocity.flatten(3), position], dim=-1).reshape(windows * uavs, times, -1)
        hidden = torch.tanh(torch.baddbmm(self.query_in_bias, history, self.query_in))
        query = torch.baddbmm(self.query_out_bias, hidden, self.query_out)
        values = torch.cat([velocity, position.unsqueeze(3)], dim=3)  # (E, n, t, T_0 + 1, 3)
        alphas, pooled = [], []
        for head in range(memory + 1):
            from_query = torch.baddbmm(self.first_bias[:, head], query, self.first_query[:, head])
            from_key = self.key[:, head].transpose(1, 2) @ self.first_key[:, head]  # (S, 3, first): W_k K_l
            value = values[:, :, :, head].transpose(1, 2).contiguous()  # (E, t, n, 3)
            logits = similarity(
                from_query, from_key, self.second[:, head], self.second_bias[:, head], self.last[:, head], value
            )
            alpha = torch.softmax(logits, dim=-1).view(windows, uavs, times, uavs)
            alphas.append(alpha)
            pooled.append(torch.einsum("eitj,etjc->eitc", alpha, value))
        return Attention(torch.stack(alphas, dim=3), torch.stack(pooled, dim=3))

"""Algorithm 1 of the paper, to be read from top to bottom. Equation numbers are those of the paper's LaTeX source.

:mod:`detectors.gassl.training` computes the same function of the same inputs in compiled loops, much
faster; tests hold it against this file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from detectors.gassl.agat import SLOPE, list_agat_shapes
from detectors.gassl.ifsn import VARIANCE_FLOOR, list_ifsn_shapes
from detectors.gassl.layers import view_arrays
from detectors.gassl.topology_matrix import Inputs
from detectors.gassl.training import Fit

Parameters = Mapping[str, Tensor]


def algorithm_1(inputs: Inputs, phi: Tensor, gamma: Tensor, settings: Any) -> Fit:
    """Algorithm 1, lines 1 to 7; the count of the votes, line 8, is in :mod:`detectors.gassl.detector`.

    The ``inputs`` are line 2, the batch of topology matrices; ``phi`` ``(n, parameters)`` and ``gamma``
    ``(parameters,)`` the initial Φ and Γ. Of the ``settings``, the arguments of :class:`detectors.gassl.Gassl`,
    ``steps`` is Ω and ``learning_rate`` β. The result is that of :func:`detectors.gassl.training.train`.
    """
    uavs, rate = len(inputs.history), settings.learning_rate
    gamma = gamma.detach().clone()
    attn_heads, votes = torch.zeros(uavs, settings.memory + 1, uavs), torch.zeros(uavs, uavs)
    losses, explained = torch.zeros(uavs, settings.steps), torch.zeros(uavs)
    for i in range(uavs):  # line 1
        phi_i = phi[i].detach().clone()
        for step in range(settings.steps):  # line 3
            phi_i.requires_grad_(True)
            gamma.requires_grad_(True)
            loss, _ = find_loss(inputs, i, phi_i, gamma, settings)
            d_phi, d_gamma = torch.autograd.grad(loss, (phi_i, gamma))
            phi_i = phi_i.detach() - rate * d_phi  # line 4, equation (24)
            gamma = gamma.detach() - rate * d_gamma  # line 4, equation (25)
            losses[i, step] = loss.detach()
        final, alpha = find_loss(inputs, i, phi_i, gamma, settings)  # alpha_{i,i',l} at all times, (T_0 + 1, R, n)
        attn_heads[i] = alpha.mean(dim=1)  # over the times: decision (t)
        weight = alpha.mean(dim=0)  # equation (12), (R, n)
        chosen = (weight == weight.amax(dim=1, keepdim=True)).float()  # line 6, equation (19) at each time
        votes[i] = (chosen / chosen.sum(dim=1, keepdim=True)).mean(dim=0)
        power = (inputs.weight[i] * (inputs.target[i] ** 2).sum(axis=1)).sum()
        explained[i] = 1.0 - final / max(float(power), 1e-12)
    return Fit(attn_heads.numpy(), votes.numpy(), gamma.numpy(), losses.numpy(), explained.numpy())


def find_loss(inputs: Inputs, i: int, phi: Tensor, gamma: Tensor, settings: Any) -> tuple[Tensor, Tensor]:
    """L_B(Θ_i), equation (23), and alpha_{i,i',l} at all times, ``(T_0 + 1, R, n)``."""
    network = _name_arrays(phi, list_agat_shapes(settings))
    value = torch.from_numpy(inputs.value).to(phi.dtype).permute(0, 3, 1, 2)  # (T_0 + 1, R, 3, n)
    history = torch.from_numpy(inputs.history[i]).to(phi.dtype)  # (R, 3 (T_0 + 1)), V_{i,t} and p_{i,t-T_0+1}
    query = _compute_query(network, history)
    alphas, pooled = [], []
    for head in range(len(value)):
        x = value[head].transpose(1, 2)  # (R, n, 3)
        alpha = torch.softmax(_compare(network, head, query, x), dim=1)  # equations (10), (11)
        alphas.append(alpha)
        pooled.append((alpha[:, :, None] * x).sum(dim=1))  # equations (13), (14)
    own = torch.from_numpy(inputs.own[i]).to(phi.dtype)
    concatenation = torch.cat([own, *pooled], dim=1)  # (R, 6 (T_0 + 1)): P_{i,t+1}, V̂_{i,t}, p̂_{i,t-T_0+1}
    variance, mean = torch.var_mean(concatenation, dim=0, correction=0)
    standardised = (concatenation - mean) / torch.sqrt(variance + VARIANCE_FLOOR)
    predicted = _run_ifsn(_name_arrays(gamma, list_ifsn_shapes(inputs.entries, settings.ifsn_hidden)), standardised)
    target = torch.from_numpy(inputs.target[i]).to(phi.dtype)
    weight = torch.from_numpy(inputs.weight[i]).to(phi.dtype)
    return (weight * ((target - predicted) ** 2).sum(dim=1)).sum(), torch.stack(alphas)


def _compute_query(network: Parameters, history: Tensor) -> Tensor:
    """The query data L(V_{i,t}, p_{i,t-T_0+1}), ``(R, query)``: one hidden layer."""
    hidden = torch.tanh(history @ network["query_in"] + network["query_in_bias"])
    return hidden @ network["query_out"] + network["query_out_bias"]


def _compare(network: Parameters, head: int, query: Tensor, x: Tensor) -> Tensor:
    """s_l of the query data and the key data K_l x of all UAVs, ``(R, n)``: two hidden layers."""
    key = x @ network["key"][head].T  # (R, n, K)
    first = torch.cat([network["first_query"][head], network["first_key"][head]])
    query_and_key = torch.cat([query[:, None].expand(-1, x.shape[1], -1), key], dim=2)
    hidden = torch.nn.functional.leaky_relu(query_and_key @ first + network["first_bias"][head], SLOPE)
    hidden = torch.nn.functional.leaky_relu(hidden @ network["second"][head] + network["second_bias"][head], SLOPE)
    return hidden @ network["last"][head]


def _run_ifsn(network: Parameters, inputs: Tensor) -> Tensor:
    """v̂_{i,t+1} ``(R, 3)``: three hidden layers, no constraint layer."""
    hidden = inputs
    for layer in ("first", "second", "third"):
        hidden = torch.tanh(hidden @ network[layer] + network[f"{layer}_bias"])
    return hidden @ network["output"] + network["output_bias"]


def _name_arrays(flat: Tensor, shapes: Mapping[str, tuple[int, ...]]) -> Parameters:
    return dict(zip(shapes, view_arrays(flat, shapes), strict=True))

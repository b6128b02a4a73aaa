"""Algorithm 1, compiled: the same function of the same inputs as the readable :mod:`detectors.gassl.algorithm_1`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.gassl.agat import AgatSizes, attend, attend_backward
from detectors.gassl.ifsn import predict, predict_backward, standardise
from detectors.gassl.topology_matrix import Inputs
from usnet_env.arrays import Singles
from usnet_env.compiling import compiled

_ZERO = np.float32(0.0)
_TWO = np.float32(2.0)


@dataclass(frozen=True, eq=False)
class Fit:
    """What Algorithm 1 leaves."""

    attn_heads: Singles  #: ``(n, T_0 + 1, n)`` alpha_{i,i',l}, mean over all times (decision (t))
    votes: Singles  #: ``(n, n)`` share of the times at which UAV i attends most to UAV i'; a tie is divided
    gamma: Singles  #: ``(parameters,)`` the trained Γ
    loss: Singles  #: ``(n, Ω)`` L_B(Θ_i) of equation (23) before each step
    explained: Singles  #: ``(n,)`` share of the squared velocity that UAV i's last prediction explains

    @property
    def attention(self) -> Singles:
        """``(n, n)`` alpha_{i,i'}, the mean over the attention heads, equation (12)."""
        return self.attn_heads.mean(axis=1)


@compiled()
def _forward(phi, gamma, numbers, history, value, own, target, weight):
    """L_B(Θ_i) of equation (23), alpha_{i,i',l} ``(T_0 + 1, n, R)``, and what else the gradient needs."""
    alpha, pooled, hidden, query = attend(phi, numbers, history, value)
    times, owns = own.shape
    inputs = np.empty((times, owns + 3 * numbers[0]), np.float32)
    for t in range(times):
        for c in range(owns):
            inputs[t, c] = own[t, c]
        for head in range(numbers[0]):
            for c in range(3):
                inputs[t, owns + 3 * head + c] = pooled[head, c, t]
    scale = standardise(inputs)
    predicted, one, two, three = predict(gamma, inputs)
    loss = _ZERO
    for t in range(predicted.shape[0]):
        for c in range(3):
            error = predicted[t, c] - target[t, c]
            loss += weight[t] * error * error
            predicted[t, c] = _TWO * weight[t] * error  # from here on the gradient
    return loss, alpha, pooled, hidden, query, inputs, scale, one, two, three, predicted


@compiled()
def gradient(phi, gamma, numbers, history, value, own, target, weight):
    """L_B(Θ_i) of equation (23) and its gradients with respect to Φ_i and Γ, as flat vectors; see :meth:`Inputs.of`."""
    loss, alpha, pooled, hidden, query, inputs, scale, one, two, three, d_output = _forward(
        phi, gamma, numbers, history, value, own, target, weight
    )
    d_phi, d_gamma, d_pooled = np.empty_like(phi), np.empty_like(gamma), np.empty_like(pooled)
    d_inputs = predict_backward(gamma, inputs, scale, one, two, three, d_output, d_gamma)
    owns = own.shape[1]
    for head in range(numbers[0]):
        for c in range(3):
            for t in range(d_inputs.shape[0]):
                d_pooled[head, c, t] = d_inputs[t, owns + 3 * head + c]
    attend_backward(phi, numbers, history, value, alpha, pooled, hidden, query, d_pooled, d_phi)
    return loss, d_phi, d_gamma


@compiled()
def _share_votes(alpha, votes):
    """Equation (19) at each time: 1 / R to the UAV with the highest alpha_{i,i'}."""
    _, uavs, times = alpha.shape
    total = np.empty(uavs, np.float32)
    for t in range(times):
        for j in range(uavs):
            total[j] = alpha[:, j, t].sum()
        chosen = total == total.max()
        votes += chosen.astype(np.float32) / np.float32(max(1, chosen.sum()) * times)


@compiled()
def _train_uav(phi, gamma, numbers, history, value, own, target, weight, rate, loss, attn_heads, votes):
    """Lines 3 to 6 of Algorithm 1 for one UAV: Φ_i and Γ move, equations (24), (25); returns the last L_B(Θ_i)."""
    heads, _, uavs, times = value.shape
    for step in range(loss.shape[0]):
        loss[step], d_phi, d_gamma = gradient(phi, gamma, numbers, history, value, own, target, weight)
        phi -= rate * d_phi
        gamma -= rate * d_gamma
    last, alpha = _forward(phi, gamma, numbers, history, value, own, target, weight)[:2]
    for head in range(heads):
        for j in range(uavs):
            total = _ZERO
            for t in range(times):
                total += alpha[head, j, t]
            attn_heads[head, j] = total / np.float32(times)
    _share_votes(alpha, votes)
    return last


def train(inputs: Inputs, phi: Singles, gamma: Singles, sizes: AgatSizes, steps: int, learning_rate: float) -> Fit:
    """Lines 1 to 7 of Algorithm 1; the initial Φ ``phi`` ``(n, parameters)`` and Γ ``gamma`` ``(parameters,)`` stay.

    Each UAV has ``steps``, Ω, with the rate β.
    """
    uavs, heads = inputs.uavs, sizes.attn_heads
    phi, gamma = phi.copy(), gamma.copy()
    loss = np.zeros((uavs, steps), np.float32)
    attn_heads, votes = np.zeros((uavs, heads, uavs), np.float32), np.zeros((uavs, uavs), np.float32)
    explained = np.zeros(uavs, np.float32)
    for i in range(uavs):
        rate = np.float32(learning_rate)
        result = rate, loss[i], attn_heads[i], votes[i]
        last = _train_uav(phi[i], gamma, sizes.numbers(), *inputs.of(i), *result)
        power = float((inputs.weight[i] * (inputs.target[i] ** 2).sum(axis=1)).sum())
        explained[i] = 1.0 - last / max(power, 1e-12)
    # Where beta is too large, the loss overflows: the fit explains nothing, and the attention is even.
    attn_heads = np.where(np.isfinite(attn_heads), attn_heads, np.float32(1.0 / uavs))
    return Fit(attn_heads, votes, gamma, loss, np.nan_to_num(explained, nan=0.0, posinf=0.0, neginf=0.0))

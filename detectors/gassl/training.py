"""Algorithm 1 by compiled networks: the same function of the same inputs as :mod:`detectors.gassl.algorithm_1`.

A compiled function optimises the code of all that it calls once more, so these few lines, which call the networks, are
plain NumPy: that halves the compilation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from detectors.gassl.agat import attend, attend_backward, list_agat_shapes
from detectors.gassl.ifsn import list_ifsn_shapes, predict, predict_backward, standardise
from detectors.gassl.layers import view_arrays
from detectors.gassl.topology_matrix import Inputs
from usnet_env.arrays import Singles

Arrays = tuple[Singles, ...]  # of a network, or the inputs for one UAV


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


class _Pass(NamedTuple):
    """One forward pass, and what its gradient needs."""

    loss: np.float32  # L_B(Θ_i), equation (23)
    d_predicted: Singles  # (R, 3) its gradient with respect to the prediction
    alpha: Singles  # (T_0 + 1, n, R) alpha_{i,i',l}
    pooled: Singles  # (T_0 + 1, 3, R)
    hidden: Singles
    query: Singles
    concatenation: Singles  # (R, 6 (T_0 + 1)) standardised
    scale: Singles
    layers: list[Singles]


def _forward(phi: Arrays, gamma: Arrays, inputs: Arrays) -> _Pass:
    """Both networks for one UAV; ``inputs`` are those of :meth:`Inputs.of`."""
    history, value, own, target, weight = inputs
    alpha, pooled, hidden, query = attend(phi, history, value)
    concatenation = np.concatenate([own, pooled.transpose(2, 0, 1).reshape(len(own), -1)], axis=1)
    scale = standardise(concatenation)
    predicted, *layers = predict(gamma, concatenation)
    error = predicted - target
    weighted = weight[:, None] * error
    return _Pass((weighted * error).sum(), 2 * weighted, alpha, pooled, hidden, query, concatenation, scale, layers)


def compute_gradient(phi: Arrays, gamma: Arrays, inputs: Arrays, d_phi: Arrays, d_gamma: Arrays) -> np.float32:
    """L_B(Θ_i) of equation (23); its gradients with respect to Φ_i and Γ are written to ``d_phi`` and ``d_gamma``.

    ``inputs`` are those of :meth:`Inputs.of`.
    """
    history, value, own, *_ = inputs
    fit = _forward(phi, gamma, inputs)
    d_inputs = predict_backward(gamma, fit.concatenation, fit.scale, *fit.layers, fit.d_predicted, d_gamma)
    d_pooled = d_inputs[:, own.shape[1] :].reshape(len(own), -1, 3).transpose(1, 2, 0).copy()
    attend_backward(phi, history, value, fit.alpha, fit.pooled, fit.hidden, fit.query, d_pooled, d_phi)
    return fit.loss


def _share_votes(alpha: Singles) -> Singles:
    """``(n,)``, equation (19) at each time: 1 / R to the UAV with the highest alpha_{i,i'}; a tie is divided."""
    total = alpha.sum(axis=0).T  # (R, n)
    chosen = (total == total.max(axis=1, keepdims=True)).astype(np.float32)
    shares = chosen / (chosen.sum(axis=1, keepdims=True).clip(1) * np.float32(len(total)))
    return np.ascontiguousarray(shares).sum(axis=0)


def train(inputs: Inputs, phi: Singles, gamma: Singles, settings: Any) -> Fit:
    """Lines 1 to 7 of Algorithm 1; the arguments are those of :func:`detectors.gassl.algorithm_1.algorithm_1`.

    The initial Φ ``phi`` ``(n, parameters)`` and Γ ``gamma`` ``(parameters,)`` stay.
    """
    uavs, steps, rate = len(inputs.history), settings.steps, np.float32(settings.learning_rate)
    phi, gamma, d_phi, d_gamma = phi.copy(), gamma.copy(), np.empty_like(phi[0]), np.empty_like(gamma)
    phi_shapes, gamma_shapes = list_agat_shapes(settings), list_ifsn_shapes(inputs.entries, settings.ifsn_hidden)
    gamma_arrays = view_arrays(gamma, gamma_shapes)
    gradients = view_arrays(d_phi, phi_shapes), view_arrays(d_gamma, gamma_shapes)
    loss, explained = np.zeros((uavs, steps), np.float32), np.zeros(uavs, np.float32)
    attn_heads, votes = np.zeros((uavs, settings.memory + 1, uavs), np.float32), np.zeros((uavs, uavs), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # where beta is too large, the loss overflows
        for i in range(uavs):  # line 1
            uav_inputs, phi_arrays = inputs.of(i), view_arrays(phi[i], phi_shapes)
            for step in range(steps):  # line 3
                loss[i, step] = compute_gradient(phi_arrays, gamma_arrays, uav_inputs, *gradients)
                phi[i] -= rate * d_phi  # line 4, equation (24)
                gamma -= rate * d_gamma  # line 4, equation (25)
            final = _forward(phi_arrays, gamma_arrays, uav_inputs)
            attn_heads[i] = final.alpha.mean(axis=2)
            votes[i] = _share_votes(final.alpha)  # line 6
            power = float((inputs.weight[i] * (inputs.target[i] ** 2).sum(axis=1)).sum())
            explained[i] = 1.0 - final.loss / max(power, 1e-12)
    # After an overflow the fit explains nothing, and the attention is even.
    attn_heads = np.where(np.isfinite(attn_heads), attn_heads, np.float32(1.0 / uavs))
    return Fit(attn_heads, votes, gamma, loss, np.nan_to_num(explained, nan=0.0, posinf=0.0, neginf=0.0))

"""IFSN, the inherent follow strategy network of §III-A: one MLP Γ, shared by all UAVs.

Its input is the concatenation of a UAV's own positions, V̂_{i,t} and p̂_{i,t-T_0+1}, standardised to zero mean and unit
variance, each entry over the batch's times (decision (s)). Three hidden layers (tanh), a linear output v̂_{i,t+1}.
"""

from __future__ import annotations

import numpy as np

from detectors.gassl.layers import affine, affine_backward, tanh_backward, tanh_in_place
from usnet_env.arrays import Singles
from usnet_env.compiling import compiled

VARIANCE_FLOOR = 1e-6  # added to the variance of an entry, which is 0 where a UAV does not move along an axis
_FLOOR = np.float32(VARIANCE_FLOOR)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)


def list_ifsn_shapes(inputs: int, width: int) -> dict[str, tuple[int, ...]]:
    """The arrays of Γ in the order in which they lie in one flat vector; matrices map rows to columns.

    ``inputs`` are the entries of the concatenation, 6 (T_0 + 1); ``width`` are the units of each of the three hidden
    layers, on which the paper is silent (decision (u)).
    """
    return {
        "first": (inputs, width), "first_bias": (width,),
        "second": (width, width), "second_bias": (width,),
        "third": (width, width), "third_bias": (width,),
        "output": (width, 3), "output_bias": (3,),
    }  # fmt: skip


def draw_ifsn(inputs: int, width: int, rng: np.random.Generator) -> Singles:
    """Initial Γ, ``(parameters,)``: uniform in ±1 / sqrt(inputs of the layer)."""
    parts = []
    for name, shape in list_ifsn_shapes(inputs, width).items():
        bound = 1.0 / (inputs if name.startswith("first") else width) ** 0.5
        parts.append(rng.uniform(-bound, bound, int(np.prod(shape))))
    return np.concatenate(parts).astype(np.float32)


@compiled(error_model="numpy")
def standardise(values):
    """``values`` ``(R, d)`` become zero-mean with unit variance over the times; returns the factors ``(d,)``."""
    times, entries = values.shape
    scale = np.empty(entries, np.float32)
    for f in range(entries):
        mean = _ZERO
        for t in range(times):
            mean += values[t, f]
        mean /= np.float32(times)
        variance = _ZERO
        for t in range(times):
            variance += (values[t, f] - mean) ** 2
        factor = _ONE / np.sqrt(variance / np.float32(times) + _FLOOR)
        scale[f] = factor
        for t in range(times):
            values[t, f] = (values[t, f] - mean) * factor
    return scale


@compiled(inner=True)
def _run_hidden_layers(gamma, h1, h2, h3, predicted):
    """All layers after the first affine one, in place."""
    second, second_bias, third, third_bias, output, output_bias = gamma[2:]
    tanh_in_place(h1)
    affine(h1, second, second_bias, h2)
    tanh_in_place(h2)
    affine(h2, third, third_bias, h3)
    tanh_in_place(h3)
    affine(h3, output, output_bias, predicted)


@compiled()
def predict(gamma, inputs):
    """v̂_{i,t+1} ``(R, 3)`` of standardised inputs ``(R, d)``, and the three hidden layers; ``gamma`` are Γ's arrays."""
    first, first_bias = gamma[:2]
    h1 = np.empty((len(inputs), len(first_bias)), np.float32)
    h2, h3, predicted = np.empty_like(h1), np.empty_like(h1), np.empty((len(inputs), 3), np.float32)
    affine(inputs, first, first_bias, h1)
    _run_hidden_layers(gamma, h1, h2, h3, predicted)
    return predicted, h1, h2, h3


@compiled(error_model="numpy")
def predict_backward(gamma, inputs, scale, h1, h2, h3, d_predicted, d_gamma):
    """The gradient with respect to Γ, written to ``d_gamma``; returns that of the inputs before standardisation."""
    times, entries = inputs.shape
    first, _, second, _, third, _, output, _ = gamma
    d_first, d_bias_1, d_second, d_bias_2, d_third, d_bias_3, d_output, d_output_bias = d_gamma
    d_h1, d_h2, d_h3, d_inputs = np.empty_like(h1), np.empty_like(h1), np.empty_like(h1), np.empty_like(inputs)
    affine_backward(h3, output, d_predicted, d_output, d_output_bias, d_h3)
    tanh_backward(h3, d_h3)
    affine_backward(h2, third, d_h3, d_third, d_bias_3, d_h2)
    tanh_backward(h2, d_h2)
    affine_backward(h1, second, d_h2, d_second, d_bias_2, d_h1)
    tanh_backward(h1, d_h1)
    affine_backward(inputs, first, d_h1, d_first, d_bias_1, d_inputs)
    for f in range(entries):
        mean, projection = _ZERO, _ZERO
        for t in range(times):
            mean += d_inputs[t, f]
            projection += d_inputs[t, f] * inputs[t, f]
        mean /= np.float32(times)
        projection /= np.float32(times)
        for t in range(times):
            d_inputs[t, f] = (d_inputs[t, f] - mean - inputs[t, f] * projection) * scale[f]
    return d_inputs


@compiled()
def compute_pair_losses(gamma, own, source, target, weight):
    """The squared error of Γ for every pair of UAVs, summed over the times: the sum of equation (37).

    The input for UAV i and source i' is the concatenation of P_i, V_{i'} and p_{i'}; each entry is standardised over
    the times, as in training: ``own`` ``(n, R, a)`` and ``source`` ``(n, R, b)``, velocities newest first. The first
    layer is linear in the two parts, which meet by one addition. ``target`` ``(n, R, 3)`` are v_{i,t+1}. Returns
    ``(n, n)``: row i, column i'.
    """
    uavs, times, own_entries = own.shape
    (first, first_bias), width = gamma[:2], len(gamma[1])
    from_own, from_source = np.empty((uavs, times, width), np.float32), np.empty((uavs, times, width), np.float32)
    no_bias = np.zeros(width, np.float32)
    for i in range(uavs):
        affine(own[i], first[:own_entries], first_bias, from_own[i])
        affine(source[i], first[own_entries:], no_bias, from_source[i])
    h1 = np.empty((times, width), np.float32)
    h2, h3, predicted = np.empty_like(h1), np.empty_like(h1), np.empty((times, 3), np.float32)
    result = np.empty((uavs, uavs), np.float32)
    for i in range(uavs):
        for j in range(uavs):
            np.add(from_own[i], from_source[j], h1)
            _run_hidden_layers(gamma, h1, h2, h3, predicted)
            total = _ZERO
            for t in range(times):
                for c in range(3):
                    total += weight[i, t] * (predicted[t, c] - target[i, t, c]) ** 2
            result[i, j] = total
    return result

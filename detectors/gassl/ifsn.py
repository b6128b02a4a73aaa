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


@compiled(inner=True)
def _arrays(gamma, inputs):
    """Γ's arrays, views of the flat vector; the width follows from its length."""
    width = 1
    while width * (inputs + 2 * width + 6) + 3 < gamma.shape[0]:
        width += 1
    a = inputs * width
    b = a + width
    c = b + width * width
    d = c + width
    e = d + width * width
    f = e + width
    g = f + 3 * width
    return (
        gamma[:a].reshape((inputs, width)), gamma[a:b],
        gamma[b:c].reshape((width, width)), gamma[c:d],
        gamma[d:e].reshape((width, width)), gamma[e:f],
        gamma[f:g].reshape((width, 3)), gamma[g:],
    )  # fmt: skip


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
def _finish(one, second, second_bias, third, third_bias, output, output_bias, two, three, predicted):
    """All layers after the first affine one, in place."""
    tanh_in_place(one)
    affine(one, second, second_bias, two)
    tanh_in_place(two)
    affine(two, third, third_bias, three)
    tanh_in_place(three)
    affine(three, output, output_bias, predicted)


@compiled()
def predict(gamma, inputs):
    """v̂_{i,t+1} ``(R, 3)`` of standardised inputs ``(R, d)``, and the three hidden layers."""
    first, first_bias, second, second_bias, third, third_bias, output, output_bias = _arrays(gamma, inputs.shape[1])
    times, width = inputs.shape[0], second.shape[0]
    one = np.empty((times, width), np.float32)
    two, three, predicted = np.empty_like(one), np.empty_like(one), np.empty((times, 3), np.float32)
    affine(inputs, first, first_bias, one)
    _finish(one, second, second_bias, third, third_bias, output, output_bias, two, three, predicted)
    return predicted, one, two, three


@compiled(error_model="numpy")
def predict_backward(gamma, inputs, scale, one, two, three, d_output, d_gamma):
    """The gradient with respect to Γ, written to ``d_gamma``; returns that of the inputs before standardisation."""
    times, entries = inputs.shape
    first, _, second, _, third, _, output, _ = _arrays(gamma, entries)
    d_first, d_first_bias, d_second, d_second_bias, d_third, d_third_bias, d_out, d_out_bias = _arrays(d_gamma, entries)
    d_one, d_two, d_three, d_inputs = np.empty_like(one), np.empty_like(one), np.empty_like(one), np.empty_like(inputs)
    affine_backward(three, output, d_output, d_out, d_out_bias, d_three)
    tanh_backward(three, d_three)
    affine_backward(two, third, d_three, d_third, d_third_bias, d_two)
    tanh_backward(two, d_two)
    affine_backward(one, second, d_two, d_second, d_second_bias, d_one)
    tanh_backward(one, d_one)
    affine_backward(inputs, first, d_one, d_first, d_first_bias, d_inputs)
    for f in range(entries):
        mean, along = _ZERO, _ZERO
        for t in range(times):
            mean += d_inputs[t, f]
            along += d_inputs[t, f] * inputs[t, f]
        mean /= np.float32(times)
        along /= np.float32(times)
        for t in range(times):
            d_inputs[t, f] = (d_inputs[t, f] - mean - inputs[t, f] * along) * scale[f]
    return d_inputs


@compiled()
def pair_losses(gamma, own, source, target, weight):
    """The squared error of Γ for every pair of UAVs, summed over the times: the sum of equation (37).

    The input for UAV i and source i' is the concatenation of P_i, V_{i'} and p_{i'}; each entry is standardised over
    the times, as in training: ``own`` ``(n, R, a)`` and ``source`` ``(n, R, b)``, velocities newest first. The first
    layer is linear in the two parts, which meet by one addition. ``target`` ``(n, R, 3)`` are v_{i,t+1}. Returns
    ``(n, n)``: row i, column i'.
    """
    uavs, times, owns = own.shape
    first, first_bias, second, second_bias, third, third_bias, output, output_bias = _arrays(
        gamma, owns + source.shape[2]
    )
    width = first.shape[1]
    from_own, from_source = np.empty((uavs, times, width), np.float32), np.empty((uavs, times, width), np.float32)
    no_bias = np.zeros(width, np.float32)
    for i in range(uavs):
        affine(own[i], first[:owns], first_bias, from_own[i])
        affine(source[i], first[owns:], no_bias, from_source[i])
    one = np.empty((times, width), np.float32)
    two, three, predicted = np.empty_like(one), np.empty_like(one), np.empty((times, 3), np.float32)
    result = np.empty((uavs, uavs), np.float32)
    for i in range(uavs):
        for j in range(uavs):
            np.add(from_own[i], from_source[j], one)
            _finish(one, second, second_bias, third, third_bias, output, output_bias, two, three, predicted)
            total = _ZERO
            for t in range(times):
                for c in range(3):
                    total += weight[i, t] * (predicted[t, c] - target[i, t, c]) ** 2
            result[i, j] = total
    return result

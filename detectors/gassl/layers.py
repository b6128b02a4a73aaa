"""What the compiled networks are made of: affine layers, exp and tanh of whole arrays.

No function may reorder its floating-point operations (Numba's ``fastmath``): how a compiler reorders them depends on
where a function is inlined, and answers of a process that compiles would differ from those of one that loads the cache.
Sums over many terms are products of matrices instead, which BLAS computes.

Arrays are copied and added by loops. For ``part[:] = array`` or ``array += part`` Numba compiles a message about wrong
shapes, and the texts for it, into every function above, and the first call takes seconds more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from usnet_env.compiling import compiled

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_LOG2_E = np.float32(1.4426950408889634)
_LN_2 = np.float32(0.6931471805599453)
_HALF = np.float32(0.5)
_THIRD, _FOURTH, _FIFTH = np.float32(1.0 / 6.0), np.float32(1.0 / 24.0), np.float32(1.0 / 120.0)
_SIXTH = np.float32(1.0 / 720.0)
_LOWEST = np.float32(-120.0)  # 2**-120 is 0 beside any other term of a softmax, and no denormal number


def view_arrays(flat: Any, shapes: Mapping[str, tuple[int, ...]]) -> tuple[Any, ...]:
    """The arrays or tensors of a network, in the order of their ``shapes``, as views of one flat vector."""
    ends = np.cumsum([math.prod(shape) for shape in shapes.values()]).tolist()
    return tuple(flat[a:b].reshape(shape) for a, b, shape in zip([0, *ends], ends, shapes.values(), strict=False))


@compiled(inner=True)
def exp_in_place(x, bits):
    """``x`` ``(n,)`` becomes e**x, for x <= 0: a power of two by its exponent bits times a polynomial of degree 6.

    ``bits`` ``(>= n,)`` int32 is a buffer.
    """
    power = bits.view(np.float32)
    for p in range(x.shape[0]):
        y = max(x[p] * _LOG2_E, _LOWEST)
        exponent = np.int32(y + np.float32(128.5)) - np.int32(128)  # the nearest whole number
        f = (y - np.float32(exponent)) * _LN_2
        e = _SIXTH
        e = e * f + _FIFTH
        e = e * f + _FOURTH
        e = e * f + _THIRD
        e = e * f + _HALF
        e = e * f + _ONE
        x[p] = e * f + _ONE
        bits[p] = (exponent + np.int32(127)) << np.int32(23)
    for p in range(x.shape[0]):
        x[p] *= power[p]


@compiled(inner=True, error_model="numpy")
def tanh_in_place(x):
    """``x`` ``(R, d)``, contiguous float32, becomes tanh(x), by e**(-2 |x|)."""
    flat = x.reshape(x.size)
    decay, bits = np.empty(x.size, np.float32), np.empty(x.size, np.int32)
    for p in range(x.size):
        decay[p] = -_TWO * abs(flat[p])
    exp_in_place(decay, bits)
    for p in range(x.size):
        magnitude = (_ONE - decay[p]) / (_ONE + decay[p])
        flat[p] = magnitude if flat[p] >= _ZERO else -magnitude


@compiled(inner=True)
def tanh_backward(y, d_y):
    """The gradient with respect to y = tanh(x), ``(R, d)``, becomes that with respect to x."""
    for t in range(y.shape[0]):
        for k in range(y.shape[1]):
            d_y[t, k] *= _ONE - y[t, k] * y[t, k]


@compiled(inner=True)
def add_in_place(total, part):
    """``total`` ``(n,)`` += ``part``."""
    for k in range(total.shape[0]):
        total[k] += part[k]


@compiled(inner=True)
def affine(x, weight, bias, out):
    """``out`` ``(R, outputs)`` = ``x`` ``(R, inputs)`` times ``weight`` plus ``bias``."""
    np.dot(x, weight, out)
    for t in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[t, k] += bias[k]


@compiled(inner=True)
def multiply_backward(x, d_out, d_weight, d_bias):
    """Gradients of :func:`affine` with respect to weight and bias, written to ``d_weight`` and ``d_bias``."""
    np.dot(x.T, d_out, d_weight)
    d_bias[:] = _ZERO
    for t in range(d_out.shape[0]):
        for k in range(d_out.shape[1]):
            d_bias[k] += d_out[t, k]


@compiled(inner=True)
def affine_backward(x, weight, d_out, d_weight, d_bias, d_x):
    """As :func:`multiply_backward`, and the gradient with respect to ``x``, written to ``d_x``."""
    multiply_backward(x, d_out, d_weight, d_bias)
    np.dot(d_out, weight.T, d_x)

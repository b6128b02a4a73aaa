"""exp and tanh of whole arrays, as compiled loops that use vector instructions; good to float32 rounding."""

from __future__ import annotations

import numpy as np

from usnet_env.compiling import compiled

__all__ = ["exp_in_place", "tanh"]

_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_LOG2_E = np.float32(1.4426950408889634)
_LN_2 = np.float32(0.6931471805599453)
_HALF = np.float32(0.5)
_THIRD, _FOURTH, _FIFTH = np.float32(1.0 / 6.0), np.float32(1.0 / 24.0), np.float32(1.0 / 120.0)
_SIXTH = np.float32(1.0 / 720.0)
_LOWEST = np.float32(-120.0)  # 2**-120 is 0 beside any other term of a softmax, and no denormal number


@compiled(fastmath={"contract", "reassoc", "nsz"})
def exp_in_place(x, bits):  # type: ignore[no-untyped-def]
    """``x`` becomes e**x, for x <= 0: a power of two by its exponent bits times a polynomial of degree 6.

    Args:
        x: ``(n,)`` float32.
        bits: ``(>= n,)`` int32, a buffer.
    """
    power = bits.view(np.float32)
    for p in range(x.shape[0]):
        y = max(x[p] * _LOG2_E, _LOWEST)
        whole = np.int32(y + np.float32(128.5)) - np.int32(128)  # the nearest whole number
        f = (y - np.float32(whole)) * _LN_2
        e = _SIXTH
        e = e * f + _FIFTH
        e = e * f + _FOURTH
        e = e * f + _THIRD
        e = e * f + _HALF
        e = e * f + _ONE
        x[p] = e * f + _ONE
        bits[p] = (whole + np.int32(127)) << np.int32(23)
    for p in range(x.shape[0]):
        x[p] *= power[p]


@compiled(fastmath={"contract", "reassoc", "nsz"})
def tanh(x):  # type: ignore[no-untyped-def]
    """Tanh of a contiguous float32 array of any shape, by e**(-2 |x|)."""
    result = np.empty_like(x)
    flat, out = x.reshape(x.size), result.reshape(x.size)
    bits = np.empty(x.size, np.int32)
    for p in range(x.size):
        out[p] = -_TWO * abs(flat[p])
    exp_in_place(out, bits)
    for p in range(x.size):
        magnitude = (_ONE - out[p]) / (_ONE + out[p])
        out[p] = magnitude if flat[p] >= np.float32(0.0) else -magnitude
    return result

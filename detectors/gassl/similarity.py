"""The similarity s_l of all pairs of UAVs: two hidden layers on sums that are never stored.

s(i, i') = w · r(W r(a_i + B_i x_{i'}) + b), r the leaky ReLU with slope 0.01. On the CPU a compiled loop takes some
hundred pairs at a time through both layers, in buffers that fit the cache, and again for the gradient, so that memory
and its traffic grow with times x N x N and not with the width; a batched tensor product of the same was slower than the
loop over UAVs. On other devices plain tensor operations serve.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

__all__ = ["similarity", "similarity_by_tensors"]

SLOPE = 0.01
_SLOPE = np.float32(SLOPE)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_COLUMNS = 256  # pairs that go through the layers side by side: long enough for vectors, few enough for the cache


def similarity(
    from_query: Tensor, from_key: Tensor, second: Tensor, bias: Tensor, last: Tensor, value: Tensor
) -> Tensor:
    """Similarities ``(S, t, n)`` with S = E * n networks.

    Args:
        from_query: ``(S, t, h)`` a, the query's share of the first layer, bias included.
        from_key: ``(S, 3, h)`` B, the key's share.
        second: ``(S, h, g)`` W.
        bias: ``(S, g)`` b.
        last: ``(S, g)`` w.
        value: ``(E, t, n, 3)`` x, without gradient.
    """
    if from_query.device.type == "cpu" and from_query.dtype == torch.float32:
        result: Tensor = _Fused.apply(from_query, from_key, second, bias, last, value)  # type: ignore[no-untyped-call]  # torch's
        return result
    return similarity_by_tensors(from_query, from_key, second, bias, last, value)


def similarity_by_tensors(
    from_query: Tensor, from_key: Tensor, second: Tensor, bias: Tensor, last: Tensor, value: Tensor
) -> Tensor:
    """The same by plain tensor operations, for any device and precision."""
    windows, times, uavs, _ = value.shape
    networks, width = from_query.shape[0], from_query.shape[2]
    own = value.unsqueeze(1).expand(windows, networks // windows, times, uavs, 3).reshape(networks, times * uavs, 3)
    keys = torch.bmm(own, from_key).view(networks, times, uavs, width)
    hidden = torch.nn.functional.leaky_relu(from_query.unsqueeze(2) + keys, SLOPE).view(networks, times * uavs, width)
    hidden = torch.nn.functional.leaky_relu(torch.baddbmm(bias.unsqueeze(1), hidden, second), SLOPE)
    return torch.bmm(hidden, last.unsqueeze(2)).view(networks, times, uavs)


class _Fused(torch.autograd.Function):
    """The compiled loops as one differentiable operation."""

    @staticmethod
    def forward(ctx: Any, *inputs: Tensor) -> Tensor:
        """Similarities; only the inputs are kept."""
        kept = tuple(tensor.detach().contiguous() for tensor in inputs)
        ctx.save_for_backward(*kept)
        from_query, value = kept[0], kept[5]
        result = torch.empty(*from_query.shape[:2], value.shape[2])
        _forward(*_by_axis(kept), result.numpy())  # type: ignore[call-arg]  # numba's
        return result

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> Any:
        """Gradients of all but the values."""
        kept = ctx.saved_tensors
        results = [torch.zeros_like(tensor) for tensor in kept[:5]]
        _backward(  # type: ignore[call-arg]  # numba's
            *_by_axis(kept),
            gradients[0].contiguous().numpy(),
            *(tensor.numpy() for tensor in results),
        )
        return (*results, None)


def _by_axis(kept: tuple[Tensor, ...]) -> list[NDArray[np.float32]]:
    """As arrays, the values as ``(E, t, 3, n)``: what the loops run along lies side by side."""
    return [*(tensor.numpy() for tensor in kept[:5]), kept[5].transpose(2, 3).contiguous().numpy()]


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _layers(from_query, from_key, second, bias, value, s, e, begin, end, first, deep):  # type: ignore[no-untyped-def]
    """Both hidden layers of network s at some times, columns (time, UAV); the leaky ReLU leaves their signs."""
    width, narrow, uavs = first.shape[0], deep.shape[0], value.shape[3]
    for k in range(width):
        b, c, d = from_key[s, 0, k], from_key[s, 1, k], from_key[s, 2, k]
        for t in range(begin, end):
            a = from_query[s, t, k]
            row = first[k, (t - begin) * uavs : (t - begin + 1) * uavs]
            for j in range(uavs):
                h = a + b * value[e, t, 0, j] + c * value[e, t, 1, j] + d * value[e, t, 2, j]
                row[j] = h if h > _ZERO else _SLOPE * h
    columns = (end - begin) * uavs
    for u in range(narrow):
        w = bias[s, u]
        for p in range(columns):
            deep[u, p] = w
        for k in range(width):
            w = second[s, k, u]
            for p in range(columns):
                deep[u, p] += w * first[k, p]
        for p in range(columns):
            h = deep[u, p]
            deep[u, p] = h if h > _ZERO else _SLOPE * h


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _forward(from_query, from_key, second, bias, last, value, result):  # type: ignore[no-untyped-def]
    networks, times, width = from_query.shape
    windows, uavs, narrow = value.shape[0], value.shape[3], second.shape[2]
    step = max(1, _COLUMNS // uavs)
    first = np.empty((width, step * uavs), np.float32)
    deep = np.empty((narrow, step * uavs), np.float32)
    total = np.empty(step * uavs, np.float32)
    for s in range(networks):
        for begin in range(0, times, step):
            end = min(begin + step, times)
            _layers(from_query, from_key, second, bias, value, s, s // (networks // windows), begin, end, first, deep)
            total[:] = _ZERO
            for u in range(narrow):
                w = last[s, u]
                for p in range((end - begin) * uavs):
                    total[p] += w * deep[u, p]
            for t in range(begin, end):
                result[s, t] = total[(t - begin) * uavs : (t - begin + 1) * uavs]


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _backward(  # type: ignore[no-untyped-def]
    from_query, from_key, second, bias, last, value, gradient, d_query, d_key, d_second, d_bias, d_last
):
    networks, times, width = from_query.shape
    windows, uavs, narrow = value.shape[0], value.shape[3], second.shape[2]
    step = max(1, _COLUMNS // uavs)
    first = np.empty((width, step * uavs), np.float32)
    deep = np.empty((narrow, step * uavs), np.float32)
    upstream = np.empty(step * uavs, np.float32)
    back = np.empty(step * uavs, np.float32)
    for s in range(networks):
        e = s // (networks // windows)
        for begin in range(0, times, step):
            end = min(begin + step, times)
            columns = (end - begin) * uavs
            _layers(from_query, from_key, second, bias, value, s, e, begin, end, first, deep)
            for t in range(begin, end):
                upstream[(t - begin) * uavs : (t - begin + 1) * uavs] = gradient[s, t]
            for u in range(narrow):  # deep becomes the gradient of itself
                w, of_last, of_bias = last[s, u], _ZERO, _ZERO
                for p in range(columns):
                    h, g = deep[u, p], upstream[p]
                    of_last += g * h
                    g *= _ONE if h > _ZERO else _SLOPE
                    of_bias += g
                    deep[u, p] = w * g
                d_last[s, u] += of_last
                d_bias[s, u] += w * of_bias
            for k in range(width):
                back[:] = _ZERO
                for u in range(narrow):
                    w, total = second[s, k, u], _ZERO
                    for p in range(columns):
                        total += deep[u, p] * first[k, p]
                        back[p] += w * deep[u, p]
                    d_second[s, k, u] += total
                for p in range(columns):
                    back[p] *= _ONE if first[k, p] > _ZERO else _SLOPE
                for t in range(begin, end):
                    row = back[(t - begin) * uavs : (t - begin + 1) * uavs]
                    total, x, y, z = _ZERO, _ZERO, _ZERO, _ZERO
                    for j in range(uavs):
                        h = row[j]
                        total += h
                        x += h * value[e, t, 0, j]
                        y += h * value[e, t, 1, j]
                        z += h * value[e, t, 2, j]
                    d_query[s, t, k] += total
                    d_key[s, 0, k] += x
                    d_key[s, 1, k] += y
                    d_key[s, 2, k] += z

"""The similarity s_l of all pairs of UAVs: two hidden layers on sums that are never stored.

s(i, i') = w · r(W r(a_i + B_i x_{i'}) + b), r the leaky ReLU with slope 0.01. On the CPU a fused loop forms it pair by
pair in registers, and again for the gradient, so that memory and its traffic grow with times x N x N and not with the
width; a batched tensor product of the same was slower than the loop over UAVs. On other devices plain tensor
operations serve.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit
from torch import Tensor

__all__ = ["similarity", "similarity_by_tensors"]

SLOPE = 0.01
_SLOPE = np.float32(SLOPE)
_ZERO = np.float32(0.0)


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
        _forward(*(tensor.numpy() for tensor in kept), result.numpy())  # type: ignore[call-arg]  # numba's
        return result

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> Any:
        """Gradients of all but the values."""
        kept = ctx.saved_tensors
        results = [torch.zeros_like(tensor) for tensor in kept[:5]]
        _backward(  # type: ignore[call-arg]  # numba's
            *(tensor.numpy() for tensor in kept),
            gradients[0].contiguous().numpy(),
            *(tensor.numpy() for tensor in results),
        )
        return (*results, None)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _forward(from_query, from_key, second, bias, last, value, result):  # type: ignore[no-untyped-def]
    networks, times, width = from_query.shape
    windows, uavs, narrow = value.shape[0], value.shape[2], second.shape[2]
    each = networks // windows
    first = np.empty(width, np.float32)
    deep = np.empty(narrow, np.float32)
    for s in range(networks):
        e = s // each
        for t in range(times):
            for j in range(uavs):
                x, y, z = value[e, t, j, 0], value[e, t, j, 1], value[e, t, j, 2]
                for k in range(width):
                    h = from_query[s, t, k] + x * from_key[s, 0, k] + y * from_key[s, 1, k] + z * from_key[s, 2, k]
                    first[k] = h if h > _ZERO else _SLOPE * h
                for u in range(narrow):
                    deep[u] = bias[s, u]
                for k in range(width):
                    h = first[k]
                    for u in range(narrow):
                        deep[u] += h * second[s, k, u]
                total = _ZERO
                for u in range(narrow):
                    h = deep[u]
                    total += last[s, u] * (h if h > _ZERO else _SLOPE * h)
                result[s, t, j] = total


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _backward(  # type: ignore[no-untyped-def]
    from_query, from_key, second, bias, last, value, gradient, d_query, d_key, d_second, d_bias, d_last
):
    networks, times, width = from_query.shape
    windows, uavs, narrow = value.shape[0], value.shape[2], second.shape[2]
    each = networks // windows
    first = np.empty(width, np.float32)
    slope = np.empty(width, np.float32)
    back = np.empty(width, np.float32)
    deep = np.empty(narrow, np.float32)
    turned = np.empty((narrow, width), np.float32)
    for s in range(networks):
        e = s // each
        for k in range(width):
            for u in range(narrow):
                turned[u, k] = second[s, k, u]
        for t in range(times):
            for j in range(uavs):
                g = gradient[s, t, j]
                x, y, z = value[e, t, j, 0], value[e, t, j, 1], value[e, t, j, 2]
                for k in range(width):
                    h = from_query[s, t, k] + x * from_key[s, 0, k] + y * from_key[s, 1, k] + z * from_key[s, 2, k]
                    slope[k] = np.float32(1.0) if h > _ZERO else _SLOPE
                    first[k] = h * slope[k]
                    back[k] = _ZERO
                for u in range(narrow):
                    deep[u] = bias[s, u]
                for k in range(width):
                    h = first[k]
                    for u in range(narrow):
                        deep[u] += h * second[s, k, u]
                for u in range(narrow):
                    h = deep[u]
                    inner = np.float32(1.0) if h > _ZERO else _SLOPE
                    d_last[s, u] += g * h * inner
                    through = g * last[s, u] * inner
                    d_bias[s, u] += through
                    deep[u] = through
                    for k in range(width):
                        back[k] += turned[u, k] * through
                for k in range(width):
                    h = first[k]
                    for u in range(narrow):
                        d_second[s, k, u] += h * deep[u]
                for k in range(width):
                    h = back[k] * slope[k]
                    d_query[s, t, k] += h
                    d_key[s, 0, k] += x * h
                    d_key[s, 1, k] += y * h
                    d_key[s, 2, k] += z * h

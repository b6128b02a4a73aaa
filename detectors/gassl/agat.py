"""AGAT, the adaptive graph attention network of §III-A: one network Φ_i for each UAV i.

For UAV i the query data are q_i = L(V_{i,t}, p_{i,t-T_0+1}). Attention head l compares them with the key data K_l x of
every UAV i' by the similarity s_l: alpha_{i,i',l} is the softmax over i' of s_l(q_i, K_l x_{i',l}), where x_{i',l} is
v_{i',t-l+1} for l <= T_0 and p_{i',t-T_0+1} for the last attention head (equations (10) and (11); the denominator of
(11) takes positions too, decision (f)). The values that alpha weighs are the x themselves, equations (13) and (14).

L has one hidden layer (tanh), s_l has two (leaky ReLU), K_l is a matrix without bias. The first layer of s_l is linear
in its two inputs, so queries and keys pass it separately and meet by one addition: no array of times x N x width is
formed. The compiled loops take some hundred pairs (time, UAV) at a time, in buffers that fit the cache.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.gassl.elementwise import exp_in_place, tanh
from usnet_env.compiling import compiled
from usnet_env.config import Config

__all__ = ["SLOPE", "AgatSizes", "attend", "attend_backward", "draw_agat"]

SLOPE = 0.01  # of the leaky ReLU
_SLOPE = np.float32(SLOPE)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_PAIRS = 512  # pairs that pass the layers together: long enough for vectors, few enough for the cache

Width = Annotated[int, Field(ge=1, le=4096)]


class AgatSizes(Config):
    """Widths of the AGAT, on which the paper is silent (decision (u)).

    Args:
        memory: T_0.
        query_hidden: hidden units of L.
        query: outputs of L.
        key: K, rows of K_l.
        similarity_hidden: units of the two hidden layers of s_l.
        gain: scale of the initial values of K_l and s_l, in units of 1 / sqrt(inputs of the layer).
    """

    memory: Annotated[int, Field(ge=1, le=1000)] = 4
    query_hidden: Width = 16
    query: Width = 8
    key: Width = 8
    similarity_hidden: tuple[Width, Width] = (16, 8)
    gain: Annotated[float, Field(gt=0)] = 3.0

    @property
    def attn_heads(self) -> int:
        """Attention heads, T_0 + 1."""
        return self.memory + 1

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The arrays of Φ_i in the order in which they lie in one flat vector; matrices map rows to columns."""
        first, second = self.similarity_hidden
        inputs = 3 * self.attn_heads
        shapes: dict[str, tuple[int, ...]] = {
            "query_in": (inputs, self.query_hidden),
            "query_in_bias": (self.query_hidden,),
            "query_out": (self.query_hidden, self.query),
            "query_out_bias": (self.query,),
        }
        for head in range(self.attn_heads):
            shapes |= {
                f"key_{head}": (self.key, 3),
                f"first_query_{head}": (self.query, first),
                f"first_key_{head}": (self.key, first),
                f"first_bias_{head}": (first,),
                f"second_{head}": (first, second),
                f"second_bias_{head}": (second,),
                f"last_{head}": (second,),
            }
        return shapes

    def numbers(self) -> tuple[int, int, int, int, int, int, int]:
        """T_0 + 1 attention heads, inputs, hidden units and outputs of L, K, and both widths of s_l."""
        return (
            self.attn_heads,
            3 * self.attn_heads,
            self.query_hidden,
            self.query,
            self.key,
            *self.similarity_hidden,
        )


def draw_agat(sizes: AgatSizes, uavs: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Initial Φ of n UAVs, ``(n, parameters)``: uniform in ±scale / sqrt(inputs), see :class:`AgatSizes`."""
    first, second = sizes.similarity_hidden
    inputs = {"query_in": 3 * sizes.attn_heads, "query_out": sizes.query_hidden}
    similarity = {"key": 3, "first": sizes.query + sizes.key, "second": first, "last": second}
    parts = []
    for name, shape in sizes.shapes().items():
        kind = name.removesuffix("_bias")
        of_similarity = sizes.gain / similarity.get(kind.split("_")[0], 1) ** 0.5
        bound = 1.0 / inputs[kind] ** 0.5 if kind in inputs else of_similarity
        parts.append(rng.uniform(-bound, bound, (uavs, int(np.prod(shape)))))
    return np.concatenate(parts, axis=1).astype(np.float32)


@compiled(fastmath={"contract", "reassoc", "nsz"})
def _layers(from_query, from_key, second, bias, value, begin, end, hidden, deep):  # type: ignore[no-untyped-def]
    """Both hidden layers of s_l at times begin to end, columns (time, UAV)."""
    width, narrow, uavs = hidden.shape[0], deep.shape[0], value.shape[2]
    for k in range(width):
        b, c, d = from_key[0, k], from_key[1, k], from_key[2, k]
        for t in range(begin, end):
            a = from_query[t, k]
            row = hidden[k, (t - begin) * uavs : (t - begin + 1) * uavs]
            for j in range(uavs):
                h = a + b * value[t, 0, j] + c * value[t, 1, j] + d * value[t, 2, j]
                row[j] = h if h > _ZERO else _SLOPE * h
    pairs = (end - begin) * uavs
    for u in range(narrow):
        row = deep[u]
        for p in range(pairs):
            row[p] = bias[u]
        for k in range(width):
            w, below = second[k, u], hidden[k]
            for p in range(pairs):
                row[p] += w * below[p]
        for p in range(pairs):
            h = row[p]
            row[p] = h if h > _ZERO else _SLOPE * h


@compiled(fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _weigh(from_query, from_key, second, bias, last, value, alpha, pooled):  # type: ignore[no-untyped-def]
    """One attention head: alpha ``(R, n)`` by equations (10), (11), and the pooled values ``(R, 3)`` by (13), (14)."""
    times, uavs = value.shape[0], value.shape[2]
    width, narrow = second.shape
    step = max(1, _PAIRS // uavs)
    hidden = np.empty((width, step * uavs), np.float32)
    deep = np.empty((narrow, step * uavs), np.float32)
    bits = np.empty(step * uavs, np.int32)
    for begin in range(0, times, step):
        end = min(begin + step, times)
        _layers(from_query, from_key, second, bias, value, begin, end, hidden, deep)
        for t in range(begin, end):
            first = (t - begin) * uavs
            row = alpha[t]
            row[:] = _ZERO
            for u in range(narrow):
                w = last[u]
                for j in range(uavs):
                    row[j] += w * deep[u, first + j]
            highest = row.max()
            for j in range(uavs):
                row[j] -= highest
        exp_in_place(alpha[begin:end].reshape((end - begin) * uavs), bits)
        for t in range(begin, end):
            row = alpha[t]
            total = _ZERO
            for j in range(uavs):
                total += row[j]
            share = _ONE / total
            x, y, z = _ZERO, _ZERO, _ZERO
            for j in range(uavs):
                w = row[j] * share
                row[j] = w
                x += w * value[t, 0, j]
                y += w * value[t, 1, j]
                z += w * value[t, 2, j]
            pooled[t, 0], pooled[t, 1], pooled[t, 2] = x, y, z


@compiled(fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _weigh_backward(  # type: ignore[no-untyped-def]
    from_query, from_key, second, bias, last, value, alpha, pooled, d_pooled,
    d_query, d_key, d_second, d_bias, d_last,
):  # fmt: skip
    """Gradients of :func:`_weigh`, written to the d_… arrays; the layers are computed again, not stored."""
    times, uavs = value.shape[0], value.shape[2]
    width, narrow = second.shape
    step = max(1, _PAIRS // uavs)
    hidden = np.empty((width, step * uavs), np.float32)
    deep = np.empty((narrow, step * uavs), np.float32)
    above = np.empty(step * uavs, np.float32)
    below = np.empty(step * uavs, np.float32)
    d_key[:] = _ZERO
    d_second[:] = _ZERO
    d_bias[:] = _ZERO
    d_last[:] = _ZERO
    for begin in range(0, times, step):
        end = min(begin + step, times)
        pairs = (end - begin) * uavs
        _layers(from_query, from_key, second, bias, value, begin, end, hidden, deep)
        for t in range(begin, end):
            first = (t - begin) * uavs
            x, y, z = d_pooled[t, 0], d_pooled[t, 1], d_pooled[t, 2]
            mean = x * pooled[t, 0] + y * pooled[t, 1] + z * pooled[t, 2]
            for j in range(uavs):
                gradient = x * value[t, 0, j] + y * value[t, 1, j] + z * value[t, 2, j] - mean
                above[first + j] = alpha[t, j] * gradient
        for u in range(narrow):  # deep becomes the gradient of itself
            w, of_last, of_bias, row = last[u], _ZERO, _ZERO, deep[u]
            for p in range(pairs):
                h, g = row[p], above[p]
                of_last += g * h
                g = g if h > _ZERO else _SLOPE * g
                of_bias += g
                row[p] = w * g
            d_last[u] += of_last
            d_bias[u] += w * of_bias
        for k in range(width):
            row = hidden[k]
            below[:] = _ZERO
            for u in range(narrow):
                w, total, g = second[k, u], _ZERO, deep[u]
                for p in range(pairs):
                    total += g[p] * row[p]
                    below[p] += w * g[p]
                d_second[k, u] += total
            for p in range(pairs):
                below[p] = below[p] if row[p] > _ZERO else _SLOPE * below[p]
            for t in range(begin, end):
                first = (t - begin) * uavs
                total, x, y, z = _ZERO, _ZERO, _ZERO, _ZERO
                for j in range(uavs):
                    h = below[first + j]
                    total += h
                    x += h * value[t, 0, j]
                    y += h * value[t, 1, j]
                    z += h * value[t, 2, j]
                d_query[t, k] = total
                d_key[0, k] += x
                d_key[1, k] += y
                d_key[2, k] += z


@compiled()
def _query_arrays(phi, numbers):  # type: ignore[no-untyped-def]
    """L's arrays, views of the flat vector."""
    _, inputs, width, outputs, _, _, _ = numbers
    a, b = inputs * width, inputs * width + width
    c = b + width * outputs
    return (
        phi[:a].reshape((inputs, width)),
        phi[a:b],
        phi[b:c].reshape((width, outputs)),
        phi[c : c + outputs],
    )


@compiled()
def _attn_head_arrays(phi, numbers, head):  # type: ignore[no-untyped-def]
    """The arrays of attention head l, views of the flat vector."""
    _, inputs, width, outputs, key, first, second = numbers
    size = key * 3 + (outputs + key + 1) * first + (first + 2) * second
    o = inputs * width + width + width * outputs + outputs + head * size
    a = o + key * 3
    b = a + outputs * first
    c = b + key * first
    d = c + first
    e = d + first * second
    f = e + second
    return (
        phi[o:a].reshape((key, 3)),
        phi[a:b].reshape((outputs, first)),
        phi[b:c].reshape((key, first)),
        phi[c:d],
        phi[d:e].reshape((first, second)),
        phi[e:f],
        phi[f : f + second],
    )


@compiled()
def attend(phi, numbers, history, value, alpha, pooled):  # type: ignore[no-untyped-def]
    """Forward pass of one UAV's AGAT over all R times.

    Args:
        phi: ``(parameters,)`` Φ_i.
        numbers: :meth:`AgatSizes.numbers`.
        history: ``(R, 3 (T_0 + 1))`` V_{i,t}, newest first, and p_{i,t-T_0+1}.
        value: ``(T_0 + 1, R, 3, n)`` x_{i',l} of all UAVs.
        alpha: ``(T_0 + 1, R, n)``, written.
        pooled: ``(T_0 + 1, R, 3)``, written: v̂_{i,t}, ..., v̂_{i,t-T_0+1}, p̂_{i,t-T_0+1}.

    Returns:
        L's hidden layer and the query data, for :func:`attend_backward`.
    """
    query_in, query_in_bias, query_out, query_out_bias = _query_arrays(phi, numbers)
    hidden = tanh(np.dot(history, query_in) + query_in_bias)
    query = np.dot(hidden, query_out) + query_out_bias
    for head in range(numbers[0]):
        key, first_query, first_key, first_bias, second, second_bias, last = _attn_head_arrays(phi, numbers, head)
        from_query = np.dot(query, first_query) + first_bias
        from_key = np.dot(key.T.copy(), first_key)
        _weigh(from_query, from_key, second, second_bias, last, value[head], alpha[head], pooled[head])
    return hidden, query


@compiled()
def attend_backward(  # type: ignore[no-untyped-def]
    phi, numbers, history, value, alpha, pooled, hidden, query, d_pooled, d_phi
):
    """The gradient with respect to Φ_i, written to ``d_phi``, from that with respect to the pooled values."""
    times = history.shape[0]
    _, _, query_out, _ = _query_arrays(phi, numbers)
    d_query = np.zeros_like(query)
    from_d_query = np.empty((times, numbers[5]), np.float32)
    d_from_key = np.empty((3, numbers[5]), np.float32)
    for head in range(numbers[0]):
        key, first_query, first_key, first_bias, second, second_bias, last = _attn_head_arrays(phi, numbers, head)
        d_key, d_first_query, d_first_key, d_first_bias, d_second, d_second_bias, d_last = _attn_head_arrays(
            d_phi, numbers, head
        )
        from_query = np.dot(query, first_query) + first_bias
        from_key = np.dot(key.T.copy(), first_key)
        _weigh_backward(
            from_query, from_key, second, second_bias, last, value[head], alpha[head], pooled[head], d_pooled[head],
            from_d_query, d_from_key, d_second, d_second_bias, d_last,
        )  # fmt: skip
        d_first_query[:] = np.dot(query.T, from_d_query)
        d_first_bias[:] = from_d_query.sum(axis=0)
        d_query += np.dot(from_d_query, first_query.T)
        d_key[:] = np.dot(first_key, d_from_key.T)
        d_first_key[:] = np.dot(key, d_from_key)
    d_query_in, d_query_in_bias, d_query_out, d_query_out_bias = _query_arrays(d_phi, numbers)
    d_query_out[:] = np.dot(hidden.T, d_query)
    d_query_out_bias[:] = d_query.sum(axis=0)
    d_hidden = np.dot(d_query, query_out.T) * (_ONE - hidden * hidden)
    d_query_in[:] = np.dot(history.T, d_hidden)
    d_query_in_bias[:] = d_hidden.sum(axis=0)

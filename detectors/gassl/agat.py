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

from typing import Any

import numpy as np

from detectors.gassl.layers import (
    add_in_place,
    affine,
    affine_backward,
    exp_in_place,
    multiply_backward,
    tanh_backward,
    tanh_in_place,
)
from usnet_env.arrays import Floats, Singles
from usnet_env.compiling import compiled

SLOPE = 0.01  # of the leaky ReLU
_SLOPE = np.float32(SLOPE)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_PAIRS = 512  # pairs that pass the layers together: long enough for vectors, few enough for the cache


def list_agat_shapes(settings: Any) -> dict[str, tuple[int, ...]]:
    """The arrays of Φ_i in the order in which they lie in one flat vector; matrices map rows to columns.

    ``settings`` are the arguments of :class:`detectors.gassl.Gassl`: the paper is silent on the widths (decision (u)).
    """
    heads, width, query, key = settings.memory + 1, settings.query_hidden, settings.query, settings.key
    first, second = settings.similarity_hidden
    return {
        "query_in": (3 * heads, width), "query_in_bias": (width,),
        "query_out": (width, query), "query_out_bias": (query,), "key": (heads, key, 3),
        "first_query": (heads, query, first), "first_key": (heads, key, first), "first_bias": (heads, first),
        "second": (heads, first, second), "second_bias": (heads, second), "last": (heads, second),
    }  # fmt: skip


def draw_agat(settings: Any, uavs: int, rng: np.random.Generator) -> Singles:
    """Initial Φ of n UAVs, ``(n, parameters)``: uniform in ±scale / sqrt(inputs of the layer).

    The scale is 1 for L, and the ``gain`` for K_l and s_l.
    """
    (first, second), shapes = settings.similarity_hidden, list(list_agat_shapes(settings).items())
    inputs = {"query_in": 3 * (settings.memory + 1), "query_out": settings.query_hidden}
    inputs |= {"key": 3, "first": settings.query + settings.key, "second": first, "last": second}

    def draw(name: str, shape: tuple[int, ...]) -> Floats:
        layer = name.removesuffix("_bias")
        count = inputs[layer] if layer in inputs else inputs["first"]
        bound = (1.0 if layer.startswith("query") else settings.gain) / count**0.5
        return rng.uniform(-bound, bound, (uavs, int(np.prod(shape))))

    query = [draw(name, shape) for name, shape in shapes[:4]]
    heads = [[draw(name, shape[1:]) for name, shape in shapes[4:]] for _ in range(settings.memory + 1)]
    parts = query + [part for of_heads in zip(*heads, strict=True) for part in of_heads]
    return np.concatenate(parts, axis=1).astype(np.float32)


@compiled(inner=True)
def _run_layers(from_query, from_key, second, bias, value, begin, end, points, hidden, deep):
    """Both hidden layers of s_l for the UAVs begin to end, columns (UAV, time); ``points`` gets their values.

    Columns past the last UAV hold what they held before, and nothing reads them.
    """
    times = value.shape[2]
    for c in range(3):
        for j in range(begin, end):
            columns, uav_values = points[c, (j - begin) * times : (j - begin + 1) * times], value[c, j]
            for t in range(times):
                columns[t] = uav_values[t]
    for k in range(hidden.shape[0]):
        a, b, c, d = from_query[k], from_key[0, k], from_key[1, k], from_key[2, k]
        for j in range(begin, end):
            x, y, z = value[0, j], value[1, j], value[2, j]
            columns = hidden[k, (j - begin) * times : (j - begin + 1) * times]
            for t in range(times):
                h = a[t] + b * x[t] + c * y[t] + d * z[t]
                columns[t] = max(h, _SLOPE * h)  # leaky ReLU, as the slope is below 1
    np.dot(second.T, hidden, deep)
    for u in range(deep.shape[0]):
        row, a = deep[u], bias[u]
        for p in range(row.shape[0]):
            h = row[p] + a
            row[p] = max(h, _SLOPE * h)


@compiled(inner=True)
def _make_buffers(times, width, narrow):
    """Number of UAVs whose pairs are computed at once, and arrays for them."""
    step = max(1, _PAIRS // times)
    points = np.zeros((3, step * times), np.float32)
    hidden = np.zeros((width, step * times), np.float32)
    return step, points, hidden, np.empty((narrow, step * times), np.float32)


@compiled(inner=True, error_model="numpy")
def _weigh(from_query, from_key, second, bias, last, value, alpha, pooled):
    """One attention head: alpha ``(n, R)`` by equations (10), (11), and the pooled values ``(3, R)`` by (13), (14)."""
    _, uavs, times = value.shape
    width, narrow = second.shape
    step, points, hidden, deep = _make_buffers(times, width, narrow)
    bits = np.empty(times, np.int32)
    highest, total = np.full(times, -np.inf, np.float32), np.zeros(times, np.float32)
    for begin in range(0, uavs, step):
        end = min(begin + step, uavs)
        _run_layers(from_query, from_key, second, bias, value, begin, end, points, hidden, deep)
        for j in range(begin, end):
            row = alpha[j]
            row[:] = _ZERO
            for u in range(narrow):
                w, columns = last[u], deep[u, (j - begin) * times : (j - begin + 1) * times]
                for t in range(times):
                    row[t] += w * columns[t]
            for t in range(times):
                highest[t] = max(highest[t], row[t])
    pooled[:] = _ZERO
    for j in range(uavs):
        row = alpha[j]
        for t in range(times):
            row[t] -= highest[t]
        exp_in_place(row, bits)
        for t in range(times):
            total[t] += row[t]
        for c in range(3):
            sums, uav_values = pooled[c], value[c, j]
            for t in range(times):
                sums[t] += row[t] * uav_values[t]
    for t in range(times):
        total[t] = _ONE / total[t]
    for rows in (alpha, pooled):
        for j in range(rows.shape[0]):
            row = rows[j]
            for t in range(times):
                row[t] *= total[t]


@compiled(inner=True, error_model="numpy")
def _weigh_backward(
    from_query, from_key, second, bias, last, value, alpha, pooled, d_pooled,
    d_query, d_key, d_second, d_bias, d_last,
):  # fmt: skip
    """Gradients of :func:`_weigh`, written to the d_… arrays; the layers are computed again, not stored.

    Sums over pairs are products of matrices, see :mod:`detectors.gassl.layers`.
    """
    _, uavs, times = value.shape
    width, narrow = second.shape
    step, points, hidden, deep = _make_buffers(times, width, narrow)
    d_similarity = np.empty(step * times, np.float32)
    d_hidden = np.empty((width, step * times), np.float32)
    ones = np.ones(step * times, np.float32)
    mean = np.zeros(times, np.float32)
    sum_last, sum_bias = np.empty(narrow, np.float32), np.empty(narrow, np.float32)
    sum_second, sum_key = np.empty((width, narrow), np.float32), np.empty((width, 3), np.float32)
    d_query[:] = _ZERO
    d_key[:] = _ZERO
    d_second[:] = _ZERO
    d_bias[:] = _ZERO
    d_last[:] = _ZERO
    for c in range(3):
        for t in range(times):
            mean[t] += d_pooled[c, t] * pooled[c, t]
    for begin in range(0, uavs, step):
        end = min(begin + step, uavs)
        _run_layers(from_query, from_key, second, bias, value, begin, end, points, hidden, deep)
        d_similarity[(end - begin) * times :] = _ZERO
        dx, dy, dz = d_pooled[0], d_pooled[1], d_pooled[2]
        for j in range(begin, end):
            x, y, z, weights = value[0, j], value[1, j], value[2, j], alpha[j]
            columns = d_similarity[(j - begin) * times : (j - begin + 1) * times]
            for t in range(times):
                columns[t] = weights[t] * (dx[t] * x[t] + dy[t] * y[t] + dz[t] * z[t] - mean[t])
        np.dot(deep, d_similarity, sum_last)
        for u in range(narrow):  # deep becomes the gradient of itself
            w, row = last[u], deep[u]
            for p in range(step * times):
                g = w * d_similarity[p]
                row[p] = g if row[p] > _ZERO else _SLOPE * g
        np.dot(deep, ones, sum_bias)
        np.dot(hidden, deep.T, sum_second)
        np.dot(second, deep, d_hidden)
        for k in range(width):
            row, gradients = hidden[k], d_hidden[k]
            for p in range(step * times):
                gradients[p] = gradients[p] if row[p] > _ZERO else _SLOPE * gradients[p]
            sums = d_query[k]
            for j in range(end - begin):
                columns = gradients[j * times : (j + 1) * times]
                for t in range(times):
                    sums[t] += columns[t]
        np.dot(d_hidden, points.T, sum_key)
        add_in_place(d_last, sum_last)
        add_in_place(d_bias, sum_bias)
        for k in range(width):
            add_in_place(d_second[k], sum_second[k])
            for c in range(3):
                d_key[c, k] += sum_key[k, c]


@compiled()
def attend(phi, history, value):
    """Forward pass of one UAV's AGAT with Φ_i, ``phi``, the arrays of :func:`list_agat_shapes`, over all R times.

    ``history`` ``(R, 3 (T_0 + 1))`` is V_{i,t}, newest first, and p_{i,t-T_0+1}; ``value`` ``(T_0 + 1, 3, n, R)`` are
    x_{i',l} of all UAVs.

    Returns:
        alpha ``(T_0 + 1, n, R)``; the pooled v̂_{i,t}, ..., v̂_{i,t-T_0+1}, p̂_{i,t-T_0+1} ``(T_0 + 1, 3, R)``; L's hidden
        layer and the query data, for :func:`attend_backward`.
    """
    heads, _, uavs, times = value.shape
    alpha, pooled = np.empty((heads, uavs, times), np.float32), np.empty((heads, 3, times), np.float32)
    query_in, query_in_bias, query_out, query_out_bias = phi[:4]
    key, first_query, first_key, first_bias, second, second_bias, last = phi[4:]
    (width, outputs), units = query_out.shape, first_bias.shape[1]
    hidden, query = np.empty((times, width), np.float32), np.empty((times, outputs), np.float32)
    affine(history, query_in, query_in_bias, hidden)
    tanh_in_place(hidden)
    affine(hidden, query_out, query_out_bias, query)
    from_query, from_key = np.empty((times, units), np.float32), np.empty((3, units), np.float32)
    for h in range(heads):
        affine(query, first_query[h], first_bias[h], from_query)
        np.dot(key[h].T, first_key[h], from_key)
        _weigh(from_query.T.copy(), from_key, second[h], second_bias[h], last[h], value[h], alpha[h], pooled[h])
    return alpha, pooled, hidden, query


@compiled()
def attend_backward(phi, history, value, alpha, pooled, hidden, query, d_pooled, d_phi):
    """The gradient with respect to Φ_i, written to ``d_phi``, from that with respect to the pooled values."""
    key, first_query, first_key, first_bias, second, second_bias, last = phi[4:]
    d_query_in, d_query_in_bias, d_query_out, d_query_out_bias = d_phi[:4]
    d_key, d_first_query, d_first_key, d_first_bias, d_second, d_second_bias, d_last = d_phi[4:]
    times, (heads, units) = history.shape[0], first_bias.shape
    d_query, d_query_part = np.zeros_like(query), np.empty_like(query)
    d_hidden = np.empty_like(hidden)
    from_query, from_key = np.empty((times, units), np.float32), np.empty((3, units), np.float32)
    d_from_query, d_from_key = np.empty_like(from_query), np.empty_like(from_key)
    d_from_query_t = np.empty((units, times), np.float32)
    for h in range(heads):
        affine(query, first_query[h], first_bias[h], from_query)
        np.dot(key[h].T, first_key[h], from_key)
        _weigh_backward(
            from_query.T.copy(), from_key, second[h], second_bias[h], last[h], value[h], alpha[h], pooled[h],
            d_pooled[h], d_from_query_t, d_from_key, d_second[h], d_second_bias[h], d_last[h],
        )  # fmt: skip
        for t in range(times):
            for k in range(units):
                d_from_query[t, k] = d_from_query_t[k, t]
        affine_backward(query, first_query[h], d_from_query, d_first_query[h], d_first_bias[h], d_query_part)
        np.dot(first_key[h], d_from_key.T, d_key[h])
        np.dot(key[h], d_from_key, d_first_key[h])
        for t in range(times):
            add_in_place(d_query[t], d_query_part[t])
    affine_backward(hidden, phi[2], d_query, d_query_out, d_query_out_bias, d_hidden)
    tanh_backward(hidden, d_hidden)
    multiply_backward(history, d_hidden, d_query_in, d_query_in_bias)

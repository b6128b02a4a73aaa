"""The network of the reader without torch: the same answers from the same file, by NumPy and compiled loops.

A loop does all that happens to the vectors of pairs ``(n, n, w)`` between two products of matrices.
"""

from __future__ import annotations

import math
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from detectors.reader.features import CONTEXT_FEATURES, PAIR_FEATURES, UAV_FEATURES, Features
from detectors.weights import read_arrays, read_packaged_arrays
from usnet_env.arrays import Singles
from usnet_env.compiling import compiled
from usnet_env.config import ArgumentError, quote

T = TypeVar("T")
Weights = dict[str, Singles]  #: the arrays of :class:`detectors.reader.network.ReaderNetwork`, by their names

_FAST: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "reassoc"}}
LARGEST, ROW_NOISE, _NORM_NOISE = np.float32(6.0), np.float32(1e-3), np.float32(1e-5)  #: the first of inputs
_ONE, _HALF, _TANH_LIMIT = np.float32(1.0), np.float32(0.5), np.float32(7.905)
_SLOPE, _CUBE = np.float32(math.sqrt(2.0 / math.pi)), np.float32(0.044715)
# tanh(x) = x P(x²) / Q(x²) to some units in the last place of single precision (the fit of the library Eigen)
_P = np.array([-2.76077e-16, 2.000188e-13, -8.604672e-11, 5.1222971e-8, 1.4857224e-5, 6.3726193e-4, 4.8935246e-3], "f4")
_Q = np.array([1.1982584e-6, 1.1853471e-4, 2.2684346e-3, 4.8935252e-3], "f4")


class Answer(NamedTuple, Generic[T]):
    """What the network says of n UAVs; of arrays here, and of tensors that begin with an axis of windows in training.

    All are logits but ``delay``, log(1 + steps after which i repeats its leader).
    """

    head: T  #: ``(n,)``: the UAV leads another
    leader: T  #: ``(n, n)`` over j: i follows j directly; (i, i): i follows no UAV
    root: T  #: ``(n, n)`` over j: the chain of i's leaders ends at j; (i, i): i follows no UAV
    link: T  #: ``(n, n)``: i's motion depends on j's itself
    silent: T  #: ``()``: no UAV leads
    delay: T  #: ``(n,)``


def load_reader(weights: str = "shipped") -> Weights:
    """Read ``"shipped"`` or ``"blind"`` weights, or those of a file; a file with other arrays is an ``ArgumentError``.

    Those of a network that is ``"untrained"`` are drawn anew; it scales its inputs as the shipped one does.
    """
    np.empty(2**22, np.float32)  # glibc keeps freed blocks up to the largest so far: windows need no new pages
    if weights in ("shipped", "blind"):
        return read_packaged_arrays("detectors.reader", {"shipped": "reader"}.get(weights, weights))
    if weights == "untrained":
        arrays, rng = read_packaged_arrays("detectors.reader", "reader"), np.random.default_rng(0)
        # Sorted, as the order of a file's arrays changes from one reading to the next.
        shapes = {name: array.shape for name, array in sorted(arrays.items()) if array.ndim == 2}
        drawn = {name: rng.standard_normal(shape, np.float32) for name, shape in shapes.items()}
        drawn = {name: values / np.float32(np.sqrt(values.shape[1])) for name, values in drawn.items()}
        return arrays | drawn
    arrays = read_arrays(weights)
    counts = tuple(len(arrays.get(f"{name}_mean", ())) for name in ("pair", "uav", "context"))
    if counts != (PAIR_FEATURES, UAV_FEATURES, CONTEXT_FEATURES) or "silent.2.bias" not in arrays:
        raise ArgumentError(f"weights must be a file of a reader with this version's features, got {quote(weights)}.")
    return arrays


def predict(weights: Weights, features: Features) -> Answer[Singles]:
    """Answer for a window of n UAVs."""
    n, width = len(features.uav), len(weights["itself"])
    context, state = (
        np.clip((values - weights[f"{name}_mean"]) * weights[f"{name}_scale"], -LARGEST, LARGEST)
        for name, values in (("context", features.context), ("uav", features.uav))
    )
    state = _apply_layers(weights, "enter_uav", np.hstack([state, np.broadcast_to(context, (n, len(context)))]))
    row, column = (state @ half.T for half in np.split(weights["ends.weight"], 2))
    row = row + _apply(weights, "context", context)
    spare, scaled = np.empty((n, n, 2 * width), np.float32), np.empty((len(weights["pair_mean"]), n), np.float32)
    enter = np.ascontiguousarray(weights["enter.weight"].T)
    for pairs, out in zip(features.pair, spare, strict=True):  # of one UAV each, which stay in the cache
        _standardise(pairs.T, weights["pair_mean"], weights["pair_scale"], scaled)
        np.matmul(scaled.T, enter, out=out)
    entered = np.empty((n, n, width), np.float32)
    _combine_pairs(spare, row, column, weights["itself"], entered)
    absolute, relative = np.split(weights["rows.weight"].T, 2)
    mean = entered.mean(axis=1, keepdims=True)
    entered -= mean
    scale = _ONE / np.sqrt(np.einsum("ijc,ijc->ic", entered, entered) / np.float32(n) + ROW_NOISE)
    change = np.matmul(entered, absolute + scale[:, :, None] * relative)  # relative: of values with variance 1 in a row
    change = (change + (mean @ absolute + weights["rows.bias"])).reshape(n * n, width)
    pair, normed = np.zeros_like(change), np.empty_like(change)
    for block in range(sum(name.endswith(".attention.weight") for name in weights)):
        _add_and_normalise(pair, change, normed)
        state = _update(weights, f"blocks.{block}", normed, state, spare, entered)
        np.matmul(entered.reshape(n * n, width), weights[f"blocks.{block}.out.weight"].T, out=change)
    _add_and_normalise(pair, change, normed)
    leader, root, link = np.ascontiguousarray(_apply(weights, "links", normed).T).reshape(3, n, n)
    state = _normalise(state)
    head, delay = _apply_layers(weights, "head", state).T
    no_leader = _apply_layers(weights, "silent", np.concatenate([state.mean(axis=0), state.max(axis=0)]))
    return Answer(head, leader, root, link, no_leader[0], delay)


def _update(weights: Weights, block: str, normed: Singles, state: Singles, spare: Singles, mixed: Singles) -> Singles:
    """The new vectors of UAVs ``(n, w)``; those of pairs ``(n, n, w)`` go to ``mixed``; ``spare`` is overwritten."""
    n, width = state.shape
    pair = normed.reshape(n, n, width)
    attention = np.matmul(weights[f"{block}.attention.weight"], pair.transpose(0, 2, 1))  # (n, heads, n)
    attention = np.exp(attention - attention.max(axis=2, keepdims=True))
    attention /= attention.sum(axis=2, keepdims=True)
    normed_state, heads = _normalise(state), attention.shape[1]
    attention_to = np.ascontiguousarray(attention.transpose(2, 1, 0))  # (n, heads, n): of j by i
    vectors = np.stack([attention @ pair, attention_to @ pair.transpose(1, 0, 2)])
    attended = np.hstack([attention[:, h] @ part for h, part in enumerate(np.split(normed_state, heads, axis=1))])
    matrix = weights[f"{block}.gathered.weight"].reshape(heads, -1, 2, width).transpose(2, 0, 3, 1)  # (2, h, w, d)
    chosen, received = np.matmul(vectors.swapaxes(1, 2), matrix).swapaxes(1, 2).reshape(2, n, width)
    received = np.sign(received) * np.log1p(np.abs(received))
    mean_state = np.broadcast_to(state.mean(axis=0), state.shape)
    inputs = [normed_state, chosen, received, attended, mean_state, np.log1p(attention_to.sum(axis=2))]
    state = state + _apply_layers(weights, f"{block}.uav", np.hstack(inputs))
    row, column = (_normalise(state) @ half.T for half in np.split(weights[f"{block}.ends.weight"], 2))
    direct, reverse = np.split(weights[f"{block}.mix.weight"], 2, axis=1)
    np.matmul(pair, np.hstack([direct.T, reverse.T]), out=spare)
    _combine_pairs(spare, row + weights[f"{block}.mix.bias"], column, np.zeros(width, np.float32), mixed)
    return state


def _apply(weights: Weights, name: str, values: Singles) -> Singles:
    return values @ weights[f"{name}.weight"].T + weights[f"{name}.bias"]


def _apply_layers(weights: Weights, name: str, values: Singles) -> Singles:
    hidden = _apply(weights, f"{name}.0", values)
    hidden *= _HALF * (_ONE + np.tanh(_SLOPE * (hidden + _CUBE * hidden * hidden * hidden)))
    return _apply(weights, f"{name}.2", hidden)


def _normalise(values: Singles) -> Singles:
    """Rows with mean 0 and variance 1."""
    centred = values - values.mean(axis=1, keepdims=True)
    centred *= _ONE / np.sqrt((centred * centred).mean(axis=1, keepdims=True) + _NORM_NOISE)
    return centred


@compiled(**_FAST)
def _gelu(value):
    inner = _SLOPE * (value + _CUBE * value * value * value)
    inner = min(max(inner, -_TANH_LIMIT), _TANH_LIMIT)
    square = inner * inner
    numerator, denominator = _P[0], _Q[0]
    for k in range(1, 7):
        numerator = numerator * square + _P[k]
    for k in range(1, 4):
        denominator = denominator * square + _Q[k]
    return _HALF * value * (_ONE + inner * numerator / denominator)


@compiled(**_FAST)
def _standardise(values, mean, scale, out):
    for k in range(len(mean)):
        for pair in range(values.shape[1]):
            out[k, pair] = min(max((values[k, pair] - mean[k]) * scale[k], -LARGEST), LARGEST)


@compiled(**_FAST)
def _combine_pairs(products, row, column, self_bias, out):
    """GELU of a pair's own share, the share that its reverse gives, and those of both UAVs."""
    n, width = row.shape
    for i in range(n):
        for j in range(n):
            is_self = np.float32(i == j)
            for c in range(width):
                out[i, j, c] = _gelu(
                    products[i, j, c] + products[j, i, width + c] + row[i, c] + column[j, c] + is_self * self_bias[c]
                )


@compiled(**_FAST)
def _add_and_normalise(pair, change, normed):
    """Add a change to the vectors of pairs, and write them with mean 0 and variance 1."""
    width = np.float32(pair.shape[1])
    for k in range(len(pair)):
        mean = square = np.float32(0.0)
        for c in range(pair.shape[1]):
            pair[k, c] += change[k, c]
            mean += pair[k, c]
        mean /= width
        for c in range(pair.shape[1]):
            normed[k, c] = pair[k, c] - mean
            square += normed[k, c] * normed[k, c]
        scale = _ONE / np.float32(math.sqrt(square / width + _NORM_NOISE))
        for c in range(pair.shape[1]):
            normed[k, c] *= scale

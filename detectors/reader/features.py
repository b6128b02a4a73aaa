"""The numbers that the reader knows of a window: of every ordered pair, of every UAV, and of the whole.

They don't depend on the axes, the origin or the unit of length. Time is told in steps and length in steps of flight: the
root mean square of the window's velocities is 1. Entry (i, j) of a pair says what speaks for "i follows j". Where data
are missing, what is left counts; what can't be told is 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from detectors.reader import flock, kernels, series
from detectors.reader.kernels import BLOCK, STRIDE
from usnet_env.arrays import Mask, Singles

_LAGS = tuple(range(13))
_PLACES = (1, 2, 4, 8, 16, 32)
_LONG = (4, 8, 16, 24, 32)
_SLACK, _TINY = np.float32(1e-5), np.float32(1e-4)
_BLOCK_LAGS, _BLOCK_FEATURES = (0, 1, 2, 3), 22
_SHARES = (  # components of j (velocity, its squares), axes of i (innovations, velocity), lag
    ("plain", "innovation", 1), ("plain", "innovation", 2), ("plain", "innovation", 3), ("squared", "innovation", 1),
    ("squared", "innovation", 2), ("plain", "velocity", 0), ("plain", "velocity", 1), ("squared", "velocity", 1),
)  # fmt: skip
_CORRELATIONS: Mapping[str, tuple[tuple[str, str, tuple[int, ...]], ...]] = {  # (later i, earlier j, lags)
    "cc": (("velocity", "velocity", _LAGS),),
    "ee": (("innovation", "innovation", _LAGS),),
    "gg": (("turn", "turn", (0, 2, 4, 6, 8, 10, 12)),),
    "ss": (("smooth", "smooth", (0, 3, 6, 9, 12)),),
    "ec": (("innovation", "velocity", (1, 2, 3, 4, 6, 8, 12)),),
    "resid": (
        ("near", "near", (0, 1, 2, 4)), ("innovation", "near", (1, 2, 4, 8)), ("turn", "near", (0, 3, 6, 9)),
        ("far", "far", (0, 2)),
    ),
    "long": (("slow", "slow", _LONG), ("slow_innovation", "slow_innovation", _LONG)),
    "flock": (("residual", "residual", (0, 1, 2)), ("innovation", "residual", (1, 2, 4))),
    "push": (("force", "force", (0, 1)), ("force", "velocity", (0,))),
}  # fmt: skip
_CORRELATION_LENGTHS = {name: sum(len(x[2]) for x in kinds) for name, kinds in _CORRELATIONS.items()}


def _slice_groups(lengths: Mapping[str, int]) -> dict[str, slice]:
    """The slice of each group, one after the other."""
    ends = np.cumsum(list(lengths.values())).tolist()
    return {name: slice(end - length, end) for (name, length), end in zip(lengths.items(), ends, strict=True)}


PAIR_GROUPS = _slice_groups({
    **_CORRELATION_LENGTHS, "halves": 4, "raw": 2, "tops": 5, "net": 5, "shares": len(_SHARES),
    "local": _BLOCK_FEATURES, "geo": 6 + len(flock.RADII), "pc": 16, "force": 5, "places": 13,
})  # fmt: skip
UAV_GROUPS = _slice_groups({"track": 20, "nearest": 4, "neighbours": 26, "rule": 13})
CONTEXT_GROUPS = _slice_groups({"size": 3, "motion": 6})
PAIR_FEATURES, UAV_FEATURES, CONTEXT_FEATURES = (
    list(groups.values())[-1].stop for groups in (PAIR_GROUPS, UAV_GROUPS, CONTEXT_GROUPS)
)


class Features(NamedTuple):
    """What the reader knows of a window of n UAVs, float32.

    Args:
        pair: ``(n, n, F)``; its memory is ordered features first.
        uav: ``(n, G)``.
        context: ``(K,)``.
    """

    pair: Singles
    uav: Singles
    context: Singles


class _Window(NamedTuple):
    """A window in steps of flight: places (T + 1, 3, n), seen (T + 1, n), velocities (T, 3, n), seen steps (T, n)."""

    p: Singles
    seen: Singles
    v: Singles
    m: Singles


class _Flock(NamedTuple):
    """Answers of :func:`flock.survey_neighbours` and :func:`flock.fit_flock`."""

    align: Singles
    count: Singles
    nearest: Singles
    coefficients: Singles
    error: Singles
    least: Singles
    persistence: Singles


def make_features(position: Singles, velocity: Singles, seen: Mask) -> Features:
    """Make the features of one window of living UAVs.

    Args:
        position: ``(T + 1, n, 3)``, metres.
        velocity: ``(T, n, 3)``, metres a step.
        seen: ``(T + 1, n)``; what isn't seen has no influence.
    """
    w = _scale_window(position, velocity, seen)
    signals, rule = _make_signals(w)
    n = w.m.shape[1]
    pair = _make_array((PAIR_FEATURES, n, n))
    _fill_correlations(pair, w, signals)
    _fill_shares(pair, w, signals)
    _fill_blocks(pair[PAIR_GROUPS["local"]], w, signals)
    _fill_own_past(pair[PAIR_GROUPS["pc"]], w, signals)
    own = _fill_places(pair, w, signals)
    uav = _describe_uavs(w, signals, rule, own)
    for x in pair:
        np.fill_diagonal(x, 0)
    never = ~(w.m > 0).any(0)
    if never.any():
        pair[:, never] = 0
        pair[:, :, never] = 0
    context = _describe_window(w, uav, never)
    return Features(pair.transpose(1, 2, 0), np.ascontiguousarray(uav.T), context)


def _make_array(shape: tuple[int, ...]) -> Singles:
    """Zeros that begin at a multiple of 64 bytes, so that sums never depend on where memory was free."""
    size = int(np.prod(shape))
    memory = np.zeros(4 * size + 64, np.uint8)
    start = -memory.ctypes.data % 64
    return memory[start : start + 4 * size].view(np.float32).reshape(shape)


def _align(x: Singles) -> Singles:
    """A copy that begins at a multiple of 64 bytes."""
    out = _make_array(x.shape)
    out[...] = x
    return out


def _scale_window(position: Singles, velocity: Singles, seen: Mask) -> _Window:
    """Put the axis of the UAVs last, the origin in the middle of the swarm, and the typical speed to 1."""
    s = _align(seen)
    m = _align(s[1:] * s[:-1])
    v = np.where(m[..., None] > 0, velocity, 0).astype(np.float64)
    rms = max(float(np.sqrt((v**2).sum() / max(float(m.sum()), 1))), 1e-9)
    p = np.where(seen[..., None], position, 0).astype(np.float64)
    middle = p.sum((0, 1)) / max(float(s.sum()), 1)
    p = (p - middle) * s[..., None] / rms
    places = _align(p.transpose(0, 2, 1))
    series.hold_positions(places, s)
    return _Window(places, s, _align((v / rms).transpose(0, 2, 1)), m)


def _make_signals(w: _Window) -> tuple[dict[str, Singles], _Flock]:
    """Series of each UAV, (T, 3, n), by name; those that are correlated have the sum of squares 1."""
    v, m = w.v, w.m
    c = v.copy()
    series.centre_series(c, m)
    complete = np.zeros_like(m)
    complete[2:] = m[2:] * m[1:-1] * m[:-2]
    e = series.find_innovations(c, complete)
    smooth, enough = series.average_series(v, m, 5)
    turn = series.change_series(smooth, enough, 5)
    series.centre_series(smooth, enough)
    slow, _ = series.average_series(c, m, 4)
    slow_innovation, _ = series.average_series(e, complete, 4)
    force = series.change_series(v, m, 1)
    align, attract, count, repel, nearest = flock.survey_neighbours(w.p, w.seen, v, m, flock.RADII)
    residual, *fit = flock.fit_flock(v, complete, align, attract, repel)
    near, far = (flock.leave_crowd(v, m, align[k], count[k]) for k in (3, 4))
    rest, first, second = series.remove_past(c, complete)
    raw = {"velocity": c, "innovation": e, "turn": turn, "smooth": smooth, "slow": slow, "force": force, "near": near,
           "slow_innovation": slow_innovation, "far": far, "residual": residual}  # fmt: skip
    signals = {name: _align(series.scale_series(x, _SLACK)) for name, x in raw.items()}
    squared = series.square_series(v)
    series.centre_series(squared, m)
    for name, x in (("plain", c), ("squared", squared)):
        signals[name] = _align(series.whiten_series(x, np.float32(3e-3), np.float32(1e-6)))
    signals |= {"rest": rest, "first": first, "second": second, "complete": complete, "raw_turn": turn, "raw_c": c,
                "raw_innovation": e, "raw_force": force, "raw_near": near, "raw_far": far}  # fmt: skip
    return signals, _Flock(align, count, nearest, *fit)


def _correlate(later: Singles, earlier: Singles, lags: Sequence[int], out: Singles) -> None:
    """Out (L, n, n): the product of i's series with j's, each lag earlier."""
    steps = len(later)
    for k, lag in enumerate(lags):
        if lag < steps:
            x, y = later[lag:], earlier[: steps - lag]
            np.matmul(x.reshape(-1, x.shape[-1]).T, y.reshape(-1, y.shape[-1]), out=out[k])


def _fill_correlations(pair: Singles, w: _Window, signals: Mapping[str, Singles]) -> None:
    """Fill all groups of lagged products, and what is seen in their lags."""
    steps, n = w.m.shape
    for name, kinds in _CORRELATIONS.items():
        start = PAIR_GROUPS[name].start
        for later, earlier, lags in kinds:
            cap = steps // 3 if name == "long" else steps
            used = [lag for lag in lags if lag <= cap]
            _correlate(signals[later], signals[earlier], used, pair[start : start + len(lags)])
            start += len(lags)
    halves = _make_array((2, 2, n, n))
    for half, part in zip((slice(0, steps // 2), slice(steps // 2, steps)), halves, strict=True):
        x = signals["innovation"][half]
        _correlate(x, x, (1, 2), part)
    target = pair[PAIR_GROUPS["halves"]]
    target[:2], target[2:] = 2 * halves.min(0), 2 * halves.max(0)
    both = _make_array((n, n))
    np.matmul(w.m.T, w.m, out=both)
    share = np.maximum(w.m.mean(0), np.float32(0.02))
    overlap = both / (steps * np.sqrt(share[:, None] * share))
    pair[: PAIR_GROUPS["halves"].stop] *= 1 / np.maximum(overlap, np.float32(0.3))
    direction = _align(w.v / np.maximum(np.sqrt((w.v**2).sum(1, keepdims=True)), np.float32(1e-6)))
    raw = pair[PAIR_GROUPS["raw"]]
    _correlate(direction, direction, (0,), raw)
    raw[0] /= np.maximum(both, 1)
    raw[1] = overlap
    tops, net, found = pair[PAIR_GROUPS["tops"]], pair[PAIR_GROUPS["net"]], _make_array((3, 3, n, n))
    for k, name in enumerate(("ee", "cc", "gg")):
        lags = np.array(_CORRELATIONS[name][0][2])
        first = 1 if k < 2 else 0
        kernels.summarise_lags(pair[PAIR_GROUPS[name]][first:], lags[first:], found[k])
    tops[0:2], tops[2:4], tops[4] = found[0, :2], found[1, :2], found[2, 0]
    for k, x in enumerate((found[0, 0], found[1, 0], found[0, 2], found[1, 2], found[2, 2])):
        net[k] = x - x.T


def _fill_shares(pair: Singles, w: _Window, signals: Mapping[str, Singles]) -> None:
    """Fill the shares of i's motion that linear maps of j's velocity, or of its squares, explain."""
    steps, n = w.m.shape
    for k, (source, target, lag) in enumerate(_SHARES):
        x, y = signals[source], signals[target]
        p = x.shape[1]
        if steps - lag < p + 6:
            continue
        product = _make_array((3 * n, p * n))
        np.matmul(y[lag:].reshape(-1, 3 * n).T, x[: steps - lag].reshape(-1, p * n), out=product)
        kernels.sum_shares(product, p, np.float32(p / steps), pair[PAIR_GROUPS["shares"].start + k])


def _fill_blocks(out: Singles, w: _Window, signals: Mapping[str, Singles]) -> None:
    """Fill what is seen in blocks of 8 steps, for j's motion 0 to 3 steps before."""
    steps, n = w.m.shape
    blocks = steps // BLOCK
    if blocks < 2:
        return
    used = blocks * BLOCK
    e, power = signals["innovation"] * np.float32(np.sqrt(blocks)), (w.v**2).sum(1)
    delayed = [_delay(x, 1) for x in (w.v, w.m)]
    seen = w.m * delayed[1]
    change = (((w.v - delayed[0]) ** 2).sum(1) * seen)[:used].reshape(blocks, BLOCK, n).sum(1)
    persistence = change / np.maximum(seen[:used].reshape(blocks, BLOCK, n).sum(1), 1)
    cut = lambda x: x[:used].reshape(blocks, -1, n)  # noqa: E731
    left = _align(np.concatenate([-2 * cut(w.v), cut(power), cut(w.m)], 1)).transpose(0, 2, 1)
    mi, ei = _align(cut(w.m)).transpose(0, 2, 1), _align(cut(e)).transpose(0, 2, 1)
    product = _make_array((3, blocks, n, n))
    found = _make_array((6, n, n))
    start = 0
    for lag in _BLOCK_LAGS:
        vj, mj, pj, ej = (cut(_delay(x, lag)) for x in (w.v, w.m, power, e))
        np.matmul(left, _align(np.concatenate([vj, mj, pj], 1)), out=product[0])
        np.matmul(mi, _align(mj), out=product[1])
        np.matmul(ei, _align(ej), out=product[2])
        kernels.judge_blocks(product[0], product[1], product[2], persistence, found)
        count = 6 if lag else 4  # nobody's own change is compared with an undelayed copy
        out[start : start + count] = found[:count]
        start += count


def _delay(x: Singles, lag: int) -> Singles:
    """The series ``lag`` steps later, with zeros before."""
    out = np.zeros_like(x)
    out[lag:] = x[: len(x) - lag] if lag < len(x) else 0
    return out


def _fill_own_past(out: Singles, w: _Window, signals: Mapping[str, Singles]) -> None:
    """Fill the partial correlations of i's velocity with j's 1 to 12 steps before, given i's own last two."""
    steps, n = w.m.shape
    lags = [lag for lag in _LAGS[1:] if lag < steps]
    stack = _align(np.concatenate([signals[name] for name in ("rest", "first", "second")], 2))
    power = _align((signals["velocity"] ** 2).sum(1, keepdims=True))
    products, length = _make_array((12, 3 * n, n)), _make_array((12, n, n))
    _correlate(stack, signals["velocity"], lags, products)
    _correlate(_align(signals["complete"][:, None]), power, lags, length)
    kernels.add_own_past(products.reshape(12, 3, n, n), length, w.m.sum(0), out)
    out[14] = out[12] - out[12].T


def _fill_places(pair: Singles, w: _Window, signals: Mapping[str, Singles]) -> Singles:
    """Fill geometry, forces and places; return what a UAV's bearings say of itself, (4, n)."""
    steps, n = w.m.shape
    instants = max(1, steps // STRIDE)
    used = min(instants * STRIDE, steps)
    count = w.m[:used].reshape(instants, -1, n).sum(1)
    mean = w.v[:used].reshape(instants, -1, 3, n).sum(1) / np.maximum(count, 1)[:, None]
    places = w.p[: instants * STRIDE : STRIDE][:instants].copy()
    moving = (count > 0).astype(np.float32)
    own = np.zeros((4, n), np.float32)
    kernels.measure_geometry(places, mean, moving, flock.RADII, pair[PAIR_GROUPS["geo"]], own)
    pushed = np.zeros_like(w.m)
    pushed[:-1] = w.m[1:] * w.m[:-1]
    kernels.measure_forces(w.p[1:].copy(), w.v, signals["raw_force"], pushed, pair[PAIR_GROUPS["force"]])
    lags = np.array([0, *(lag for lag in _PLACES if lag <= steps // 3)])
    near = _make_array((len(lags) + 3, n, n))
    kernels.measure_places(w.p, w.seen, lags, max(1, steps // 50), near)
    out, k = pair[PAIR_GROUPS["places"]], len(lags)
    size = np.log(near[: k + 1] + np.float32(0.5))
    out[: k - 1] = size[1:k] - size[0]
    for slot, lag in enumerate((2, 8, 32)):
        if lag in lags:
            x = size[lags.tolist().index(lag)]
            out[6 + slot] = x - x.T
    out[9], out[10], out[11] = size[k] - size[0], near[k + 1], near[k + 2]
    out[12] = near[k + 1] - near[k + 1].T
    return own


def _log(x: Singles, least: np.float32 = _TINY) -> Singles:
    """Logarithm of a power that may be 0."""
    return np.log(x + least)


def _describe_uavs(w: _Window, signals: Mapping[str, Singles], rule: _Flock, own: Singles) -> Singles:
    """What single tracks and neighbourhoods say of each UAV: (G, n)."""
    steps, n = w.m.shape
    multiply = series.multiply_series
    count, rows = np.maximum(w.m.sum(0), 1), np.maximum(signals["complete"].sum(0), 1)
    kinds = (("velocity", (1, 2, 4, 8, 12)), ("innovation", (1, 2, 4)), ("turn", (2, 6)))
    echoes = [multiply(signals[name], signals[name], lag) for name, lags in kinds for lag in lags]
    powers = [multiply(signals[name], signals[name], 0) for name in ("raw_innovation", "raw_c", "raw_turn")]
    tail = ((signals["raw_innovation"] ** 2).sum(1) ** 2).sum(0) / rows / ((powers[0] / rows) ** 2 + np.float32(1e-6))
    speed = np.sqrt((w.v**2).sum(1))
    typical = speed.sum(0) / count
    spread = ((speed - typical) ** 2 * w.m).sum(0) / count
    straight = np.sqrt((w.v.sum(0) ** 2).sum(0)) / count
    ends = [w.seen.argmax(0) / np.float32(steps), 1 - w.seen[::-1].argmax(0) / np.float32(steps)]
    track = [*echoes, *(_log(x / y) for x, y in zip(powers, (rows, count, count), strict=True)),
             np.log1p(np.minimum(tail, 20)), typical, _log(spread), straight, w.m.mean(0), *ends]  # fmt: skip
    neighbours = []
    for k, name in ((3, "near"), (4, "far")):
        turns, deviation = flock.compare_turns(w.v, w.m, rule.align[k], np.array([2, 4, 8, 12]))
        neighbours += [_log(multiply(signals["raw_" + name], signals["raw_" + name], 0) / count, np.float32(1e-3))]
        neighbours += [multiply(signals[name], signals[name], lag) for lag in (1, 4)]
        neighbours += [np.log(rule.count[k].mean(0) + np.float32(0.1)), *turns]
        neighbours += [_log(deviation / count, np.float32(1e-3))]
    residual = signals["residual"]
    length = np.sqrt((residual**2).sum(1))
    direction = (residual / np.maximum(length, np.float32(1e-6))[:, None]).sum(0)
    seen = signals["complete"] > 0
    ordered = np.sort(np.where(seen, length * np.sqrt(rows), np.float32(30)), 0)
    near = rule.nearest[1:] if steps > 1 else rule.nearest
    rules = [_log(rule.error), _log(rule.persistence) - _log(rule.error), _log(rule.least) - _log(rule.error),
             _log(ordered[steps // 4]), *np.clip(rule.coefficients, -3, 3), np.log(np.minimum(near, 400) + 1).mean(0),
             *(multiply(residual, residual, lag) for lag in (1, 4, 16)),
             np.sqrt((direction**2).sum(0)) / rows]  # fmt: skip
    out = np.stack([*track, *own, *neighbours, *rules]).astype(np.float32)
    out[:, ~(w.m > 0).any(0)] = 0
    return out


def _describe_window(w: _Window, uav: Singles, never: Mask) -> Singles:
    """Sizes of the window and means over its UAVs: (K,)."""
    present = uav[:, ~never] if (~never).any() else uav
    steps, n = w.m.shape
    spread = np.linalg.svd(w.v.transpose(0, 2, 1).reshape(-1, 3).astype(np.float64), compute_uv=False)
    flat = float(spread[-1] / max(spread[0], 1e-9)) if len(spread) == 3 else 0.0
    sizes = [np.log(n) - 3.4, np.log(steps) - 4.6, 1 - w.m.mean()]
    return np.array([*sizes, *(present[k].mean() for k in (5, 0, 15, 10, 12)), flat], np.float32)

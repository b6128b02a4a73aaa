"""The numbers that the reader knows of a window: of every ordered pair, of every UAV, and of the whole.

They don't depend on the axes, the origin or the unit of length. Time is told in steps, and length in steps of flight:
the root mean square of the window's velocities is 1. Entry (i, j) of a pair says what speaks for "i follows j". Where
data are missing, what is left counts; what can't be told is 0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from detectors.reader import flock, kernels, series
from usnet_env.arrays import Mask, Singles

_Signals = dict[str, Singles]  # series of each UAV, (T, p, n) or (T, n), by name
_BLOCK, _STRIDE = 8, 2  # steps of a block in which one leader is supposed; steps between two bearings
_LAGS = tuple(range(13))
_PLACES = (1, 2, 4, 8, 16, 32)
_CROWDS = {"near": 3, "far": 4}  # of the bank of radii, those in which UAVs are compared with their neighbours
_BLOCK_LAGS, _BLOCK_FEATURES = (0, 1, 2, 3), 22
_WAY_STEPS, _WAY_LAGS = (4, 16), (0, 1, 2, 4, 6, 8, 12, 16, 24, 32)  # steps of a displacement, delays between two
_JOINT = ((0, 1, (1e-2, 1e-6)), (1, 0, (1e-2,)))  # of places 0 and velocities 1: of all UAVs, of i alone; ridges
_SHARES = (  # components of j (velocity, its squares), axes of i (innovations, velocity), lag
    ("plain", "innovation", 1), ("plain", "innovation", 2), ("plain", "innovation", 3), ("squared", "innovation", 1),
    ("squared", "innovation", 2), ("plain", "velocity", 0), ("plain", "velocity", 1), ("squared", "velocity", 1),
)  # fmt: skip
_CORRELATIONS: Mapping[str, tuple[str, tuple[int, ...]]] = {  # series of the later i and the earlier j, and lags
    "cc": ("velocity", _LAGS[::2]), "ee": ("innovation", _LAGS), "gg": ("turn", _LAGS[::2])
}  # fmt: skip
_TURN, _ANSWER_LAGS = 3, (1, 2, 3, 4, 5, 6, 8, 10, 12)  # steps of a turn; steps until it is answered
_ANSWERS = {"torque": "bend", "response": "change"}  # series of i, what it answers of j
_ANSWER_SHARES = (
    *(("plain", "response", lag) for lag in (1, 3, 5, 7, 9, 12)), *(("shift", "response", lag) for lag in (1, 3, 5, 7))
)  # fmt: skip


def _slice_groups(lengths: Mapping[str, int]) -> dict[str, slice]:
    """The slice of each group, one after the other."""
    ends = np.cumsum(list(lengths.values())).tolist()
    return {name: slice(end - length, end) for (name, length), end in zip(lengths.items(), ends, strict=True)}


PAIR_GROUPS = _slice_groups({
    **{name: len(lags) for name, (_, lags) in _CORRELATIONS.items()}, "raw": 2, "tops": 5, "shares": len(_SHARES),
    "local": _BLOCK_FEATURES, "geo": 6 + kernels.BANK, "force": 5, "places": 13, "joint": 6,
    "ways": len(_WAY_STEPS) * (1 + len(_WAY_LAGS)), "answers": len(_ANSWERS) * (len(_ANSWER_LAGS) + 2),
    "answered": len(_ANSWER_SHARES),
})  # fmt: skip
UAV_GROUPS = _slice_groups({
    "track": 20, "nearest": 4, "neighbours": 26, "rule": 13,
    "companions": len(_WAY_STEPS) * (1 + len(_WAY_LAGS)), "pulls": 8,
})  # fmt: skip
CONTEXT_GROUPS = _slice_groups({"size": 3, "motion": 6})
PAIR_FEATURES, UAV_FEATURES, CONTEXT_FEATURES = (
    list(groups.values())[-1].stop for groups in (PAIR_GROUPS, UAV_GROUPS, CONTEXT_GROUPS)
)

LEAST_STRIDED = 32  #: steps of a window that is also read at every second sample


class Features(NamedTuple):
    """Float32 numbers of a window of n UAVs: (n, n, F), in memory features first; (n, G); (K,)."""

    pair: Singles
    uav: Singles
    context: Singles


def make_features(position: Singles, velocity: Singles, seen: Mask) -> Features:
    """Make the features of one window of living UAVs.

    Args:
        position: ``(T + 1, n, 3)``, metres.
        velocity: ``(T, n, 3)``, metres a step.
        seen: ``(T + 1, n)``; what isn't seen has no influence.
    """
    s = _make_signals(*_scale_window(position, velocity, seen))
    n = s["m"].shape[1]
    pair = _make_array((PAIR_FEATURES, n, n))
    _fill_correlations(pair, s)
    _fill_shares(pair[PAIR_GROUPS["shares"]], s, _SHARES)
    _fill_answers(pair[PAIR_GROUPS["answers"]], s)
    _fill_shares(pair[PAIR_GROUPS["answered"]], s, _ANSWER_SHARES)
    _fill_blocks(pair[PAIR_GROUPS["local"]], s)
    _fill_places(pair[PAIR_GROUPS["places"]], s)
    bearings = _fill_bearings(pair[PAIR_GROUPS["geo"]], pair[PAIR_GROUPS["force"]], s)
    companions, pulls = _fill_ways(pair[PAIR_GROUPS["ways"]], s), _fill_joint(pair[PAIR_GROUPS["joint"]], s)
    uav = np.stack([*_describe_uavs(s, bearings), *companions, *pulls]).astype(np.float32)
    for x in pair:
        np.fill_diagonal(x, 0)
    unseen = s["m"].sum(0) == 0
    pair[:, unseen], pair[:, :, unseen], uav[:, unseen] = 0, 0, 0
    context = _describe_window(s, uav, unseen)
    return Features(pair.transpose(1, 2, 0), np.ascontiguousarray(uav.T), context)


def _make_array(shape: tuple[int, ...]) -> Singles:
    """Zeros that begin at a multiple of 64 bytes, so that sums never depend on where memory was free."""
    size = math.prod(shape)
    memory = np.zeros(size + 16, np.float32)
    start = -memory.ctypes.data % 64 // 4
    return memory[start : start + size].reshape(shape)


def _align(x: NDArray[Any]) -> Singles:
    """A copy that begins at a multiple of 64 bytes."""
    out = _make_array(x.shape)
    out[...] = x
    return out


def _scale_window(position: Singles, velocity: Singles, seen: Mask) -> tuple[Singles, ...]:
    """Places (T + 1, 3, n) and velocities (T, 3, n) in steps of flight; what is seen of both, (T + 1, n), (T, n)."""
    s = _align(seen)
    m = _align(s[1:] * s[:-1])
    p, v = (
        np.where(shown[:, None] > 0, x.transpose(0, 2, 1), 0).astype(np.float64, order="C")
        for x, shown in ((position, s), (velocity, m))
    )
    rms = float(np.sqrt((v**2).sum() / max(float(m.sum()), 1)))
    rms = rms if rms > 1e-9 else 1.0
    p -= p.sum((0, 2))[:, None] / max(float(s.sum()), 1)
    p *= s[:, None]
    return _align(series.hold_positions(p / rms, s)), _align(v / rms), s, m


def _make_signals(p: Singles, v: Singles, seen: Singles, m: Singles) -> _Signals:
    """All series. Those that are correlated have the sum of squares 1, and their own lengths as ``raw_…``."""
    c = series.centre_series(v, m)
    complete = m * series.delay_series(m, 1) * series.delay_series(m, 2)
    e = series.find_innovations(c, complete)
    smooth, enough = series.average_series(v, m, 5)
    bank, count, nearest = flock.survey_neighbours(p, seen, v, m)
    rule = flock.fit_flock(v, complete, bank)
    raw = {"velocity": c, "innovation": e, "turn": series.change_series(smooth, enough, 5),
           "residual": rule["residual"]}  # fmt: skip
    course, raw["response"] = series.find_responses(v, complete)
    raw["torque"] = np.cross(course, raw["response"], axis=1)
    raw["bend"], raw["change"] = series.find_turns(v, m, _TURN)
    s = {"p": p, "v": v, "seen": seen, "m": m, "complete": complete, "nearest": nearest, **rule}
    for name, k in _CROWDS.items():
        s["align_" + name], s["count_" + name] = np.ascontiguousarray(bank[:, :, 1 + k]), count[:, k]
        raw[name] = flock.leave_crowd(v, m, s["align_" + name], count[:, k])
    s |= {"raw_" + name: raw[name] for name in ("velocity", "innovation", "turn", "residual", *_CROWDS)}
    s |= {name: _align(series.scale_series(x)) for name, x in raw.items()}
    s["shift"] = _align(series.whiten_series(raw["change"]))
    s["plain"] = _align(series.whiten_series(c))
    s["squared"] = _align(series.whiten_series(series.centre_series(series.square_series(v), m)))
    return s


def _correlate(later: Singles, earlier: Singles, lags: Sequence[int], out: Singles) -> None:
    """Out (L, n, n): the product of i's series with j's, each lag earlier."""
    (steps, _, n), count = later.shape, len(lags)
    for lag, product in zip(lags, out[:count], strict=True):
        np.matmul(later[lag:].reshape(-1, n).T, earlier[: max(steps - lag, 0)].reshape(-1, n), out=product)


def _fill_correlations(pair: Singles, s: _Signals) -> None:
    """Fill all groups of lagged products, and what is seen in their lags."""
    steps, n = s["m"].shape
    for group, (name, lags) in _CORRELATIONS.items():
        _correlate(s[name], s[name], [lag for lag in lags if lag <= steps], pair[PAIR_GROUPS[group]])
    common_steps = _make_array((n, n))
    np.matmul(s["m"].T, s["m"], out=common_steps)
    share = np.maximum(s["m"].mean(0), np.float32(0.02))
    overlap = common_steps / (steps * np.sqrt(share[:, None] * share))
    pair[: PAIR_GROUPS["raw"].start] *= 1 / np.maximum(overlap, np.float32(0.3))
    direction = _align(s["v"] / np.maximum(np.sqrt((s["v"] ** 2).sum(1, keepdims=True)), np.float32(1e-6)))
    cosine = _make_array((1, n, n))
    _correlate(direction, direction, (0,), cosine)
    pair[PAIR_GROUPS["raw"]] = cosine[0] / np.maximum(common_steps, 1), overlap
    (e, e_lag), (c, c_lag), (g, _) = (
        _summarise_lags(pair[PAIR_GROUPS[name]][first:], _CORRELATIONS[name][1][first:])
        for name, first in (("ee", 1), ("cc", 1), ("gg", 0))
    )
    pair[PAIR_GROUPS["tops"]] = e, e_lag, c, c_lag, g


def _summarise_lags(x: Singles, lags: Sequence[int]) -> tuple[Singles, Singles]:
    """Of correlations (L, n, n): the greatest, and the mean place of its lag (0 to 1)."""
    weight = np.maximum(x, 0)
    weight *= weight
    weight *= weight * weight
    total, mean_lag = weight.sum(0) + np.float32(1e-9), np.zeros_like(x[0])
    for w, lag in zip(weight, lags, strict=True):
        mean_lag += np.float32(lag / lags[-1]) * w
    return x.max(0), mean_lag / total


def _fill_answers(out: Singles, s: _Signals) -> None:
    """Fill how i's answers resemble j's turns and changes some steps before, and the largest of these with its lag."""
    size = len(_ANSWER_LAGS)
    parts = out.reshape(len(_ANSWERS), size + 2, *out.shape[1:])
    for rows, (later, earlier) in zip(parts, _ANSWERS.items(), strict=True):
        _correlate(s[later], s[earlier], [lag for lag in _ANSWER_LAGS if lag <= len(s["m"])], rows)
        rows[size], rows[size + 1] = _summarise_lags(np.abs(rows[:size]), _ANSWER_LAGS)


def _fill_shares(out: Singles, s: _Signals, shares: Sequence[tuple[str, str, int]]) -> None:
    """Fill the shares of i's motion that linear maps of j's motion explain."""
    for k, (source, target, lag) in enumerate(shares):
        x, y = s[source], s[target]
        steps, p, n = x.shape
        if steps - lag >= p + 6:
            product = _make_array((3, n, p, n))
            later, earlier = y[lag:].reshape(-1, 3 * n).T, x[: steps - lag].reshape(-1, p * n)
            np.matmul(later, earlier, out=product.reshape(3 * n, p * n))
            kernels.sum_squares(product, out[k])
            out[k] -= np.float32(p / steps)


def _cut_blocks(x: Singles, lag: int = 0) -> Singles:
    """Of a series (3 + T, p, n) that begins with 3 empty steps: some steps later, in blocks, (blocks, 8 p, n)."""
    blocks, start = (len(x) - _BLOCK_LAGS[-1]) // _BLOCK, _BLOCK_LAGS[-1] - lag
    return x[start : start + blocks * _BLOCK].reshape(blocks, -1, x.shape[-1])


def _fill_blocks(out: Singles, s: _Signals) -> None:
    """Fill what is seen in blocks of 8 steps, for j's motion 0 to 3 steps before."""
    steps, n = s["m"].shape
    blocks, first = steps // _BLOCK, _BLOCK_LAGS[-1]
    if blocks < 2:
        return
    (rows, columns), e = _make_array((2, first + steps, 5, n)), _make_array((first + steps, 3, n))
    v, m, power = s["v"], s["m"], (s["v"] ** 2).sum(1)
    rows[first:, :3], rows[first:, 3], rows[first:, 4] = -2 * v, power, m
    columns[first:, :3], columns[first:, 3], columns[first:, 4] = v, m, power
    np.multiply(s["innovation"], np.float32(np.sqrt(blocks)), out=e[first:])
    seen, change = _make_array((2, first + steps, 1, n))
    seen[first + 1 :, 0] = m[1:] * m[:-1]
    change[first + 1 :, 0] = ((v[1:] - v[:-1]) ** 2).sum(1) * seen[first + 1 :, 0]
    persistence = _cut_blocks(change).sum(1) / np.maximum(_cut_blocks(seen).sum(1), 1)
    start = 0
    square, overlap, product = products = _make_array((3, blocks, n, n))
    for lag in _BLOCK_LAGS:
        for y, left, right in zip(products, (rows, rows[:, 4:], e), (columns, columns[:, 3:4], e), strict=True):
            np.matmul(_cut_blocks(left).transpose(0, 2, 1), _cut_blocks(right, lag), out=y)
        features = out[start : start + (6 if lag else 4)]  # without a delay, j's motion isn't a forecast of i's
        kernels.judge_blocks(square, overlap, product, persistence, features)
        start += len(features)


def _fill_bearings(geo: Singles, force: Singles, s: _Signals) -> list[Singles]:
    """Fill bearings and forces; return what a UAV's bearings say of itself, (n,) each."""
    steps, n = s["m"].shape
    instants = -(-steps // _STRIDE)
    spare = np.zeros((instants * _STRIDE - steps, 3, n), np.float32)
    seen_steps = np.concatenate([s["m"], spare[:, 0]]).reshape(instants, _STRIDE, n).sum(1)
    v = np.concatenate([s["v"], spare]).reshape(instants, _STRIDE, 3, n).sum(1) / np.maximum(seen_steps, 1)[:, None]
    moving, turns, a = np.minimum(seen_steps, 1), np.zeros_like(seen_steps), np.zeros_like(v)
    turns[:-1] = moving[:-1] * moving[1:]
    a[:-1] = (v[1:] - v[:-1]) * turns[:-1, None]
    sums, nearest = kernels.measure_bearings(s["p"][:steps:_STRIDE].copy(), v, a, moving, turns)
    count, turned = np.maximum(sums[4], 1), np.maximum(sums[12], 1)
    geo[:3] = sums[:3] / count
    geo[3], geo[4] = _log_distance(sums[3] / count), np.minimum(_log_distance(sums[7]), 4)
    first, second = (sums[3] - sums[5]) / np.maximum(sums[4] - sums[6], 1), sums[5] / np.maximum(sums[6], 1)  # halves
    geo[5] = (_log_distance(second) - _log_distance(first)) * ((sums[6] > 0) & (sums[4] > sums[6]))
    geo[6:] = sums[18 : 18 + kernels.BANK] / count
    pull = sums[9] - (sums[13:16] * a.sum(0)[:, :, None]).sum(0) / turned
    spread = np.maximum(sums[10] - (sums[13:16] ** 2).sum(0) / turned, 0) + np.float32(1e-3) * sums[10]
    sizes = (turned, turned, sums[10], spread, sums[17])
    for k, (x, size) in enumerate(zip((sums[2], sums[8], sums[9], pull, sums[16]), sizes, strict=True)):
        force[k] = x / (np.sqrt(sums[11] * size) + np.float32(1e-3))
    is_met = nearest[0] < 1e5
    encounters, cosine = np.maximum(is_met.sum(0), 1), nearest[1] * is_met
    for x in sums[-2:]:
        np.fill_diagonal(x, 0)
    frontness = sums[-1].sum(1) / np.maximum(sums[-2].sum(1), np.float32(0.5))
    return [*(x.sum(0) / encounters for x in (cosine, np.abs(cosine), _log_distance(nearest[0]) * is_met)), frontness]


def _log_distance(x: Singles) -> Singles:
    """Distances in steps of flight as logarithms near 0."""
    return _log(x / np.float32(20), 0.05)


def _fill_places(out: Singles, s: _Signals) -> None:
    """Fill how close i comes to where j was, and who was there first."""
    steps, n = s["m"].shape
    lags = [0, *(lag for lag in _PLACES if lag <= steps // 3)]
    k, last, distances = len(lags), len(_PLACES), _make_array((len(lags) + 3, n, n))
    kernels.measure_places(s["p"], s["seen"], np.array(lags), max(1, steps // 50), distances)
    size = _log(distances[: k + 1], 0.5)
    out[: k - 1] = size[1:k] - size[0]
    for slot, lag in enumerate((2, 8, 32)):
        if lag in lags:
            out[last + slot] = size[lags.index(lag)] - size[lags.index(lag)].T
    out[last + 3], out[last + 4 : last + 6] = size[k] - size[0], distances[k + 1 :]
    out[last + 6] = distances[k + 1] - distances[k + 1].T


def _fill_ways(out: Singles, s: _Signals) -> list[Singles]:
    """Fill who flies like i, and how j's displacements resemble those of i's companions later; return what they say.

    With noise, displacements in many steps tell more than velocities do, and the mean of companions more than a UAV.
    """
    (steps, n), size = s["m"].shape, 1 + len(_WAY_LAGS)
    if steps < 3 or n < 2:
        return [np.zeros(n, np.float32)] * (len(_WAY_STEPS) * size)
    descriptions = list[Singles]()
    for rows, longest in zip(out.reshape(len(_WAY_STEPS), size, n, n), _WAY_STEPS, strict=True):
        width = min(longest, steps // 3)
        displacement, is_seen, weight = flock.find_companions(s["p"], s["seen"], width)
        descriptions += flock.compare_companions(displacement, is_seen, weight, _WAY_LAGS)
        rows[0] = _log(weight, 1e-3)
        companions = weight.max(1, keepdims=True) * np.eye(n, dtype=np.float32) + weight
        mean, share = flock.average_companions(displacement, is_seen, companions)
        mean_share, stride = np.minimum(share, 1), max(width // 4, 1)
        powers = (mean**2).sum(1), (displacement**2).sum(1)
        for row, lag in zip(rows[1:], (lag for lag in _WAY_LAGS if 2 * lag < len(displacement)), strict=False):
            later, earlier = slice(lag, None, stride), slice(0, len(displacement) - lag, stride)
            square = (powers[0][later].T @ is_seen[earlier]) * (mean_share[later].T @ powers[1][earlier])
            product = mean[later].reshape(-1, n).T @ displacement[earlier].reshape(-1, n)
            row[:] = _log(1 - np.minimum(np.maximum(product, 0) ** 2 / (square + np.float32(1e-9)), 1))
        rows[2:] -= rows[1] * (rows[2:] != 0)
    return descriptions


def _fill_joint(out: Singles, s: _Signals) -> list[Singles]:
    """Fill how the places of all UAVs at once, or their velocities, explain i's change of velocity: j's part of it.

    Changes much larger than their mean, as at a wall, are left out. Of each regression, the t statistic of j, and its
    coefficient relative to those of all UAVs. Returns standard scores of the UAVs: of the mean and the least of these
    parts in regressions on places.
    """
    if len(s["v"]) < 3:
        return [np.zeros(out.shape[1], np.float32)] * 8
    change = series.change_series(s["v"], s["m"], 1)[:-1]
    size = np.sqrt((change**2).sum(1, keepdims=True))
    change *= size < 8 * size.mean(0, keepdims=True) + np.float32(1e-9)
    predictors = [x - x.mean(0) for x in (s["p"][1:-1], s["v"][:-1])]
    flat = np.stack([*predictors, change], axis=2).reshape(-1, 3, change.shape[2]).astype(np.float64)
    regressions = series.regress_jointly(flat, _JOINT)
    flying = s["m"].sum(0) > 0
    out[::2] = [np.arcsinh(t_statistic) for t_statistic, _ in regressions]
    size = max(np.count_nonzero(flying), 1)
    out[1::2] = [b / (np.sqrt((b**2).sum(1, keepdims=True) / size) + 1e-12) for _, b in regressions]
    is_other = flying[:, None] & ~np.eye(len(flying), dtype=bool)
    mean = out[:4].sum(1, where=is_other) / np.maximum(is_other.sum(0), 1)
    least = out[:4].min(1, where=is_other, initial=np.float32(60)) * is_other.any(0)
    parts = np.concatenate([mean, least]) * flying
    parts -= parts.sum(1, keepdims=True) / size
    return [*(parts * flying / (np.sqrt((parts**2 * flying).sum(1, keepdims=True) / size) + np.float32(1e-2)))]


def _log(x: Singles, least: float = 1e-4) -> Singles:
    """Logarithm of a power that may be 0."""
    return np.asarray(np.log(x + np.float32(least)))


def _describe_uavs(s: _Signals, bearings: list[Singles]) -> list[Singles]:
    """What single tracks and neighbourhoods say of each UAV, (n,) each."""
    steps, multiply = len(s["m"]), kernels.multiply_series
    count, rows = np.maximum(s["m"].sum(0), 1), np.maximum(s["complete"].sum(0), 1)

    def echo(name: str, *lags: int) -> list[Singles]:
        """Autocorrelations of a series."""
        return [multiply(s[name], s[name], lag) for lag in lags]

    e, c, g = (multiply(s[name], s[name]) for name in ("raw_innovation", "raw_velocity", "raw_turn"))
    tail = ((s["raw_innovation"] ** 2).sum(1) ** 2).sum(0) / rows / ((e / rows) ** 2 + np.float32(1e-6))
    speed = np.sqrt((s["v"] ** 2).sum(1))
    typical = speed.sum(0) / count
    spread = ((speed - typical) ** 2 * s["m"]).sum(0) / count
    straight = np.sqrt((s["v"].sum(0) ** 2).sum(0)) / count
    track = [*echo("velocity", 1, 2, 4, 8, 12), *echo("innovation", 1, 2, 4), *echo("turn", 2, 6),
             _log(e / rows), _log(c / count), _log(g / count), np.log1p(np.minimum(tail, 20)), typical, _log(spread),
             straight, s["m"].mean(0), s["seen"].argmax(0) / steps, 1 - s["seen"][::-1].argmax(0) / steps]  # fmt: skip
    neighbours = []
    for name in _CROWDS:
        turns, deviation = flock.compare_turns(s["v"], s["m"], s["align_" + name], (2, 4, 8, 12))
        x, crowd = s["raw_" + name], _log(s["count_" + name].mean(0), 0.1)
        neighbours += [_log(multiply(x, x) / count, 1e-3), *echo(name, 1, 4), crowd, *turns]
        neighbours.append(_log(deviation / count, 1e-3))
    length = np.sqrt((s["raw_residual"] ** 2).sum(1))
    direction = (s["raw_residual"] / np.maximum(length, np.float32(1e-6))[:, None]).sum(0)
    least = np.sort(np.where(s["complete"] > 0, length, 4), 0)[steps // 4]
    error = _log(s["error"])
    rules = [error, _log(s["last"]) - error, _log(s["least"]) - error, _log(least**2),
             *np.clip(s["coefficients"], -3, 3), np.log1p(np.minimum(s["nearest"][-max(steps - 1, 1) :], 400)).mean(0),
             *echo("residual", 1, 4, 16), np.sqrt((direction**2).sum(0)) / rows]  # fmt: skip
    return [*track, *bearings, *neighbours, *rules]


def _describe_window(s: _Signals, uav: Singles, unseen: Mask) -> Singles:
    """Sizes of the window and means over its UAVs: (K,)."""
    seen_uavs = ~unseen if not unseen.all() else unseen
    v = _align(s["v"].transpose(1, 0, 2).reshape(3, -1))
    spread = np.linalg.eigvalsh((v @ v.T).astype(np.float64))
    sizes = [np.log(seen_uavs.sum()) - 3.4, np.log(len(s["m"])) - 4.6, 1 - s["m"][:, seen_uavs].mean()]
    flat = np.sqrt(max(spread[0], 0) / max(spread[2], 1e-9))
    return np.array([*sizes, *(uav[k, seen_uavs].mean() for k in (5, 0, 15, 10, 12)), flat], np.float32)

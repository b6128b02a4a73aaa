"""Direct links in a group, and their delays, from the positions at the sampling interval.

In a group of n ids, id i follows the id j whose past around its peak lag leaves the least of the velocity of i. It
counts as direct where the residual of j is clearly smaller than that of every other id that is ahead of i, and the past
of no other one takes much from it: then i copies several, or what j copies.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.tracks.found import Link
from usnet_env.tracks.resample import resample_positions, typical_intervals
from usnet_env.tracks.tracks import Tracks, TrackWindow

_MOST_SAMPLES = 4  # of a step; more are averaged
_MOST_LAG = 12  # steps of the window, at most a third of it
_TAPS = 3  # lags on each side of the peak that a regression takes
_BLOCKS = 8  # parts of the window, for errors
_RIDGE = 1e-10  # of the sum of squares: smooth pasts at neighbouring lags are nearly equal
_CHUNK = 16  # ids whose pasts are held at once
_COPY = 1e-3  # a residual below this share is that of a copy: other copies leave as little
_SURE, _ENOUGH = 2.0, 0.1  # of z by blocks; the past of another id takes less than this share of the residual
_SURE_NAMED, _ENOUGH_NAMED = 0.5, 0.3  # if the detector names the same
_OTHERS = 10  # ids whose pasts are added to that of the leader: those with the least residuals
_SAME_WAY = 0.1  # squared distance to where the leader was, as a share of that to where it is
_LONGEST_WAY = 30.0  # seconds, at most a third of the window
_QUANTILE = 2.36  # 97.5 % of Student's t with 7 degrees of freedom
_LEAST_ERROR = 0.1  # samples


class _Pairs(NamedTuple):
    """What the past of each id j tells of each id i, ``(n, n)``."""

    top: Indices  # the number of the lag with the largest correlation
    ahead: Mask  # whether the peak is at a later time of i, and inside of the lags
    left: Floats  # (B, n, n): the residual of a regression on the lags around the peak, in each block
    share: Floats  # of the sum of squares of i


def sample_finely(tracks: Tracks) -> Tracks:
    """Resampled tracks at their sampling interval, or at a quarter of their step if samples are nearer than that."""
    if tracks.source is None or not tracks.step:
        return tracks
    interval = float(np.nanmedian(typical_intervals(tracks.source)))
    steps = max(1, round(tracks.step / interval))
    return resample_positions(tracks.source, interval * -(-steps // _MOST_SAMPLES), tracks.max_gap)


def find_links(
    fine: Tracks, track_window: TrackWindow, head: int, followers: Sequence[int], leader: Indices | None
) -> list[Link]:
    """The link of each follower of a head, in a window and in the tracks of :func:`sample_finely`.

    ``leader`` ``(N,)`` is the id that each follows by the detector's answer, -1: none; ``None``: the answer has none.
    """
    group, ids, step = np.array([head, *followers]), track_window.ids, float(fine.step or 1.0)
    position, velocity, known, half, longest = cut_velocities(fine, track_window, group)
    named = np.full(len(group), -1)
    if leader is not None:
        place = {int(uav): k for k, uav in enumerate(group)}
        named = np.array([place.get(int(leader[uav]), -1) for uav in group])
    if longest < 1 or len(velocity) - longest < 2 * _BLOCKS:
        return [Link(ids[i], ids[head], ids[head], None, direct=False) for i in followers]
    lags = np.arange(-half - 1, longest + 1)
    pairs = _compare_pairs(velocity, known, lags)
    parent = _grow_tree(np.where(pairs.ahead, pairs.share, 9.0 + pairs.share))
    direct = _judge_parents(pairs, parent, named, _add_others(velocity, known, lags, pairs, parent))
    same_way = compare_ways(position, named, step) < _SAME_WAY
    parent, direct = np.where(same_way, named, parent), direct | same_way
    links = []
    for i, (j, sure) in enumerate(zip(parent, direct, strict=True)):
        if i:
            ahead = int(j) if sure else 0
            delay = measure_delay(velocity[:, [i, ahead]], known[:, [i, ahead]], half, longest, step)
            links.append(Link(ids[group[i]], ids[group[ahead]], ids[head], *delay, direct=bool(sure)))
    return links


def measure_delay(
    velocity: Floats, known: Mask, half: int, longest: int, step: float
) -> tuple[float | None, float | None, float | None]:
    """How many seconds the first of two velocities ``(T, 2, d)`` is later than the second, and a 95 % interval.

    The delay is at the peak of a parabola through the correlations at ``half`` lags on each side of the largest one.
    The interval is that of the delays without each of 8 parts of the window. ``None`` if the first isn't later.
    """
    lags = np.arange(-half - 1, longest + 1)
    behind, past = shift_past(velocity[:, :1], velocity[:, 1:], known[:, :1], lags)
    parts = np.array_split(np.arange(behind.shape[1]), _BLOCKS)
    cross, square, other = np.empty((3, _BLOCKS, len(lags)))
    for b, part in enumerate(parts):
        own, then = behind[0, part].ravel(), past[0][:, part].reshape(len(lags), -1)
        cross[b], square[b], other[b] = then @ own, own @ own, (then**2).sum(axis=1)
    kept = 1.0 - np.vstack([np.zeros(_BLOCKS), np.eye(_BLOCKS)])  # all parts, and all but each
    curves = kept @ cross / np.sqrt(np.maximum((kept @ square) * (kept @ other), 1e-300))
    delay, *without = find_peak(curves, half) + lags[0]
    if not 0.5 < delay < lags[-1]:
        return None, None, None
    error = np.sqrt((_BLOCKS - 1) * np.var(without))
    margin = _QUANTILE * np.hypot(error, _LEAST_ERROR)
    low, middle, high = (round(float(each) * step, 9) for each in (max(delay - margin, 0.0), delay, delay + margin))
    return middle, low, high


def find_peak(curves: Floats, half: int) -> Floats:
    """``(…)`` indices, with fractions, of the peaks of curves ``(…, K)``.

    A peak is that of a parabola fitted to the largest value and ``half`` ones on each side.
    """
    top, last = curves.argmax(axis=-1), curves.shape[-1] - 1
    middle = top.clip(half, last - half)
    at = np.arange(-half, half + 1)
    near = np.take_along_axis(curves, middle[..., None] + at, axis=-1)
    square = at**2 - np.mean(at**2)
    slope, bend = near @ at / (at @ at), near @ square / (square @ square)
    inner = (top == middle) & (bend < 0)
    shift = np.where(inner, -slope / 2 / np.where(inner, bend, 1.0), 0.0)
    return np.where(inner, top + shift.clip(-half, half), top)


def cut_velocities(
    fine: Tracks, track_window: TrackWindow, group: Sequence[int] | Indices
) -> tuple[Floats, Floats, Mask, int, int]:
    """Positions and velocities ``(T, n, d)`` of a group of a window, where both are seen, and two numbers of samples.

    A velocity is the difference of positions half a step of the window before and after, which is the first number; the
    second is the longest lag, less than 1 in a window that is too short.
    """
    step = float(fine.step or 1.0)
    half = max(1, round(track_window.step / step / 2))
    rows = track_window.rows[np.asarray(group)]
    position, seen = cut_positions(fine, rows, track_window.start, track_window.end)
    longest = min(1 + round(_MOST_LAG * track_window.step / step), len(position) // 3 - half)
    velocity, known = position[2 * half :] - position[: -2 * half], seen[2 * half :] & seen[: -2 * half]
    return position, velocity, known, half, longest


def cut_positions(tracks: Tracks, rows: Indices, start: float, end: float) -> tuple[Floats, Mask]:
    """Positions ``(T, n, d)`` of some ids from second ``start`` to ``end``, interpolated in gaps, and where seen."""
    step = float(tracks.step or 1.0)
    times = np.arange(np.ceil(start / step - 1e-6), np.floor(end / step + 1e-6) + 1)
    limits = (times[0] - 0.5) * step, (times[-1] + 0.5) * step
    position, seen = np.zeros((len(times), len(rows), 3)), np.zeros((len(times), len(rows)), bool)
    for k, row in enumerate(rows):
        first, last = tracks.offsets[row], tracks.offsets[row + 1]
        low, high = first + np.searchsorted(tracks.time[first:last], limits)
        number, place = np.round(tracks.time[low:high] / step), tracks.position[low:high]
        if len(number):
            seen[(number - times[0]).astype(int), k] = True
            position[:, k] = np.stack([np.interp(times, number, axis) for axis in place.T], axis=1)
    return position[..., : 3 if np.ptp(position[..., 2]) > 0 else 2], seen


def shift_past(behind: Floats, ahead: Floats, known: Mask, lags: Indices) -> tuple[Floats, Floats]:
    """Centred velocities ``(n, T', d)``, and those of others at each lag ``(m, K, T', d)``, at the same instants."""
    first, last = int(lags[-1]), len(behind) + int(lags[0])
    weight = known[first:last, :, None].astype(np.float64)
    mean = (behind[first:last] * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), 1.0)
    past = sliding_window_view(ahead, last - first, axis=0)[::-1]  # (K, m, d, T'): the largest start is the least lag
    past = past - past.mean(axis=3, keepdims=True)
    own = (behind[first:last] - mean) * weight
    return own.transpose(1, 0, 2), past.transpose(1, 0, 3, 2)


def _compare_pairs(velocity: Floats, known: Mask, lags: Indices) -> _Pairs:
    """Compare all pairs of velocities ``(T, n, d)``: with an intercept, and sums over the same instants."""
    n = velocity.shape[1]
    top, lag, left = np.empty((n, n), np.int64), np.empty((n, n)), np.empty((_BLOCKS, n, n))
    square = np.empty(n)
    for begin in range(0, n, _CHUNK):
        some = slice(begin, begin + _CHUNK)
        sums = _sum_products(*shift_past(velocity, velocity[:, some], known, lags))
        square, cross, gram = (each.sum(axis=0) for each in sums)
        size = np.diagonal(gram, axis1=1, axis2=2)[..., None] * square
        peak = find_peak((cross / np.sqrt(np.maximum(size, 1e-300))).transpose(0, 2, 1), 1)
        top[:, some], lag[:, some] = np.rint(peak).T, peak.T + lags[0]
        left[:, :, some] = _leave_least(sums, top[:, some].T)
    share = left.sum(axis=0) / np.maximum(square, 1e-300)[:, None]
    return _Pairs(top, (lag > 0.5) & (top < len(lags) - 1) & ~np.eye(n, dtype=bool), left, share)


class _Sums(NamedTuple):
    """Sums over each of B parts of the time: of n velocities, and of the pasts of c others at K lags."""

    square: Floats  # (B, n)
    cross: Floats  # (B, c, K, n)
    gram: Floats  # (B, c, K, K)


def _sum_products(behind: Floats, past: Floats) -> _Sums:
    cuts = np.linspace(0, behind.shape[1], _BLOCKS + 1).astype(int)
    blocks = [slice(*pair) for pair in pairwise(cuts.tolist())]
    own = [behind[:, part].reshape(len(behind), -1) for part in blocks]
    then = [past[:, :, part].reshape(*past.shape[:2], -1) for part in blocks]
    cross = np.stack([x @ y.T for x, y in zip(then, own, strict=True)])
    return _Sums(np.stack([(y**2).sum(axis=1) for y in own]), cross, np.stack([x @ x.transpose(0, 2, 1) for x in then]))


def _leave_least(sums: _Sums, peak: Indices) -> Floats:
    """The residuals ``(B, n, c)`` of regressions on the lags around the peaks ``(c, n)``."""
    _, _, lags, n = sums.cross.shape
    near = _list_taps(peak, lags)  # (c, n, taps)
    other = np.arange(len(peak))[:, None, None]
    both = other[..., None], near[..., :, None], near[..., None, :]
    each = other, near, np.arange(n)[:, None]
    gram = sums.gram.sum(axis=0)[both]
    ridge = _RIDGE * np.trace(gram, axis1=2, axis2=3) + 1e-300
    gram = gram + ridge[..., None, None] * np.eye(near.shape[2])
    weights = np.linalg.solve(gram, sums.cross.sum(axis=0)[each][..., None])[..., 0]
    left = np.empty((len(sums.square), n, len(peak)))
    for block, (square, cross, part) in enumerate(zip(*sums, strict=True)):
        made = np.einsum("cis,cist,cit->ci", weights, part[both], weights, optimize=True)
        left[block] = (square - 2 * (weights * cross[each]).sum(axis=2) + made).T
    return left


def compare_ways(position: Floats, named: Indices, step: float) -> Floats:
    """``(n,)`` mean squared distance to where a ``named`` id was some time before, as a share of that to where it is.

    It is infinite for an id with none, -1, or itself.
    """
    longest = min(round(_LONGEST_WAY / step), len(position) // 3)
    now, then = position[longest:], position[:, named]
    apart = [((now - then[longest - k : len(then) - k]) ** 2).sum(axis=2).mean(axis=0) for k in range(longest + 1)]
    other = (named >= 0) & (named != np.arange(len(named))) & (apart[0] > 0)
    return np.where(other, np.min(apart[1:], axis=0, initial=np.inf) / np.where(other, apart[0], 1.0), np.inf)


def _add_others(velocity: Floats, known: Mask, lags: Indices, pairs: _Pairs, parent: Indices) -> Floats:
    """``(n,)`` the largest share of the residual after its parent that the past of one more id ahead takes."""
    most = np.zeros(len(parent))
    for i in range(1, len(parent)):
        others = [j for j in pairs.share[i].argsort() if pairs.ahead[i, j] and j != parent[i]]
        both = np.array([parent[i], *others[:_OTHERS]])
        own, past = shift_past(velocity[:, [i]], velocity[:, both], known[:, [i]], lags)
        near = _list_taps(pairs.top[i, both], len(lags))
        taps = past[np.arange(len(both))[:, None], near].reshape(*near.shape, -1)
        basis = np.linalg.qr(taps[0].T).Q
        rest = own.ravel() - basis @ (own.ravel() @ basis)
        added = np.linalg.qr((taps[1:] - taps[1:] @ basis @ basis.T).transpose(0, 2, 1)).Q
        most[i] = ((rest @ added) ** 2).sum(axis=1).max(initial=0.0) / max(rest @ rest, 1e-300)
    return most


def _list_taps(peak: Indices, lags: int) -> Indices:
    """The numbers of the lags around each peak, along a last axis."""
    return peak.clip(_TAPS, lags - 1 - _TAPS)[..., None] + np.arange(-_TAPS, _TAPS + 1)


def _judge_parents(pairs: _Pairs, parent: Indices, named: Indices, added: Floats) -> Mask:
    """Whether the parent of each id, ``(n,)``, is its direct leader.

    It is if every other one ahead leaves clearly more in the blocks of the window, and takes little from its residual;
    less is asked for if the detector names it, too. It isn't known if the residual is that of a copy. 0 is the head.
    """
    me = np.arange(len(parent))
    gain = pairs.left - pairs.left[:, me, parent][..., None]
    z = gain.mean(axis=0) / (gain.std(axis=0, ddof=1) / np.sqrt(_BLOCKS) + 1e-300)
    z = np.where(pairs.ahead & (me != parent[:, None]), z, np.inf).min(axis=1)
    known = (z >= _SURE) & (added < _ENOUGH)
    known |= (parent == named) & (z >= _SURE_NAMED) & (added < _ENOUGH_NAMED)
    return known & (pairs.share[me, parent] >= _COPY) & pairs.ahead[me, parent] & (me > 0)


def _grow_tree(cost: Floats) -> Indices:
    """The parent of each, of least cost ``(n, n)``, the next one where that closes a circle; 0 has none."""
    n = len(cost)
    parent, root = np.zeros(n, np.int64), np.arange(n)
    for i in np.argsort(cost[1:].min(axis=1)) + 1:
        free = np.where(root != root[i], cost[i], np.inf)
        parent[i] = free.argmin()
        root[root == root[i]] = root[parent[i]]
    return parent

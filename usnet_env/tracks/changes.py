"""When groups change their leader: short windows that overlap, a path of least cost, and the time that fits best.

A detector reads short windows of the file; of a long file, only those where the links differ from one window to the
next. Ids that mostly share their root are a group. The leaders of a group are the states of a path (Viterbi), in which
each change has a price. The time of a change is the one at which the followers stop copying the old leader and begin to
copy the new one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.detection import Detection
from usnet_env.objectives import find_roots
from usnet_env.tracks.confirm import confirm_leaders
from usnet_env.tracks.found import DetectedWindow, Event, Name, name_kind
from usnet_env.tracks.links import cut_positions
from usnet_env.tracks.tracks import Tracks, TrackWindow

_LENGTH, _STRIDE = 40, 5  # steps of a short window, and to the next one
_MOST, _MOST_IDS = 400, 20_000  # short windows; ids in all of them
_FEW_IDS = 5_000  # in all short windows of a file that is read wholly
_APART = 0.3  # share of windows in which the members of a group have different roots
_PRICE = 24.0  # of a change, in nats
_LEAST = -5.0  # the logarithm of a probability that a detector gives as 0
_MOST_LAG = 12  # steps
_MARGIN = 0.025  # of the probability on each side of an interval
_NEVER = -1e6  # evidence for what can't be
NO_LEADER = -1


@dataclass(frozen=True)
class Period:
    """A time in which a group follows one leader, or none.

    Args:
        rows: the group's members, as rows of ``Tracks.ids``; the leader may be one of them.
        leader: its row, or -1: none.
        start: in seconds, when it began.
        end: when it ended.
        low: lower end of the 95 % interval of ``start``.
        high: upper end.
        probability: that the leader changed there, by the detector; 1 at the start of the tracks.
    """

    rows: tuple[int, ...]
    leader: int
    start: float
    end: float
    low: float
    high: float
    probability: float


def trace_periods(
    resampled: Tracks,
    windows: Sequence[DetectedWindow],
    track_windows: Sequence[TrackWindow],
    answer: Callable[[TrackWindow], Detection],
    confirm: bool,
) -> tuple[Period, ...]:
    """The periods of all groups in the order of time; empty if the tracks are too short, or too long.

    Args:
        resampled: the tracks of the windows.
        windows: what was found in them.
        track_windows: the windows.
        answer: a detector.
        confirm: whether a leader of each group must be confirmed in a period, or lead in a window of which the period
            has the most.
    """
    step, most = float(resampled.step or 1.0), min(_MOST, max(1, _MOST_IDS // len(resampled.ids)))
    ends = track_windows[0].start, track_windows[-1].end
    long = ends[1] - ends[0] > min(most, _FEW_IDS // len(resampled.ids)) * _STRIDE * step
    span = _find_span(windows, track_windows) if long else ends
    if span is None or span[1] - span[0] < _LENGTH * step:
        return ()
    stride = max(_STRIDE, -(-round((span[1] - span[0]) / step) // most))
    if 2 * stride > _LENGTH:
        return ()
    part = _cut_span(resampled, *span)
    short = [each for each in part.windows(_LENGTH, stride) if each.end <= span[1] + step / 2]
    root, surely, silent = _read_roots(short, answer, len(resampled.ids))
    centres = np.array([(each.start + each.end) / 2 for each in short])
    periods = list[Period]()
    for rows in _find_groups(root):
        candidates = np.unique(root[:, rows][root[:, rows] >= 0])
        there = np.flatnonzero((root[:, rows] >= 0).any(axis=1))
        if not len(there):
            continue
        if len(rows) == 1:
            candidates = candidates[candidates != rows]
        evidence = _weigh(root[there][:, rows], rows, surely[there], silent[there], candidates)
        evidence[_are_led(rows, centres[there], resampled.ids, windows, track_windows), -1] = _NEVER
        path = _find_path(evidence, _PRICE)
        states = np.append(candidates, NO_LEADER)
        group = _list_periods(resampled, rows, states[path], evidence, states, centres[there], ends)
        if not confirm or any(_is_led(each, resampled, windows, track_windows) for each in group):
            periods += group
    return tuple(sorted(periods, key=lambda each: (each.start, -len(each.rows))))


def _find_span(windows: Sequence[DetectedWindow], track_windows: Sequence[TrackWindow]) -> tuple[float, float] | None:
    """From the window before the first one that differs from it to the last such one, in seconds."""
    roles = [dict(zip(t.ids, w.roots(t.ids), strict=True)) for w, t in zip(windows, track_windows, strict=True)]
    named = [
        {name: t.ids[root] if root >= 0 else None for name, root in each.items()}
        for each, t in zip(roles, track_windows, strict=True)
    ]
    differ = [k for k, (a, b) in enumerate(pairwise(named)) if any(a[name] != b[name] for name in a.keys() & b.keys())]
    return (track_windows[differ[0]].start, track_windows[differ[-1] + 1].end) if differ else None


def _cut_span(tracks: Tracks, begin: float, end: float) -> Tracks:
    """The tracks from second ``begin`` to ``end``, at their times."""
    slack = 1e-6 * float(tracks.step or 1.0)
    kept = (tracks.time >= begin - slack) & (tracks.time <= end + slack)
    offsets = np.append(0, np.cumsum(kept))[tracks.offsets]
    return replace(
        tracks, offsets=offsets, time=tracks.time[kept], position=tracks.position[kept], leader=None, source=None
    )


def _read_roots(
    short: Sequence[TrackWindow], answer: Callable[[TrackWindow], Detection], ids: int
) -> tuple[Indices, Floats, Floats]:
    """The root of each id, ``(W, N)``, -1 where it isn't seen; logarithms of probabilities: it leads, no id does."""
    silent = np.full(len(short), _LEAST)
    root, surely = np.full((len(short), ids), -1), np.full((len(short), ids), _LEAST)
    for k, track_window in enumerate(short):
        found, rows = answer(track_window), track_window.rows
        itself = np.arange(len(rows))
        direct = itself if found.leader is None else np.where(found.leader < 0, itself, found.leader)
        own = np.asarray(found.extras.get("root", find_roots(direct)))
        root[k, rows] = rows[np.where(own >= 0, own, itself)]
        chance = np.asarray(found.extras.get("probability", found.candidates), np.float64)
        surely[k, rows] = np.log(np.maximum(chance, np.exp(_LEAST)))
        unled = found.extras.get("p_no_leader", np.prod(1.0 - chance))
        silent[k] = np.log(max(float(unled), np.exp(_LEAST)))
    return root, surely, silent


def _find_groups(root: Indices) -> list[Indices]:
    """Ids that mostly share their root in the windows ``(W, N)`` in which they are seen, by average linkage."""
    from scipy.cluster.hierarchy import fcluster, linkage
    from scipy.spatial.distance import squareform

    same, both = np.zeros((2, root.shape[1], root.shape[1]))
    for own in root:
        known = own >= 0
        both += known[:, None] & known
        same += (own[:, None] == own) & known[:, None]
    apart = 1.0 - same / np.maximum(both, 1.0)
    np.fill_diagonal(apart, 0.0)
    number = fcluster(linkage(squareform(apart, checks=False), "average"), _APART, "distance")
    return [np.flatnonzero(number == k) for k in np.unique(number)]


def _weigh(root: Indices, rows: Indices, surely: Floats, silent: Floats, candidates: Indices) -> Floats:
    """The evidence ``(W, C + 1)`` that each candidate leads those with roots ``(W, n)``; the last one: none does."""
    there = np.maximum((root >= 0).sum(axis=1), 1)
    share = (root[..., None] == candidates).sum(axis=1) / there[:, None]
    alone = (root == rows).sum(axis=1) / there
    return np.column_stack([_LEAST * (1.0 - share) + surely[:, candidates], _LEAST * (1.0 - alone) + silent])


def _are_led(
    rows: Indices,
    centres: Floats,
    ids: Sequence[Name],
    windows: Sequence[DetectedWindow],
    track_windows: Sequence[TrackWindow],
) -> Mask:
    """Which times are in a window in which most members of a group follow or lead: there, no leader is no answer.

    A single id that leads follows none.
    """
    names, led = {ids[row] for row in rows}, np.zeros(len(centres), bool)
    for window, cut in zip(windows, track_windows, strict=True):
        roles = {link.follower for link in window.links} | {leader.id for leader in window.leaders if len(names) > 1}
        if 2 * len(names & roles) > len(names):
            led |= (centres >= cut.start) & (centres <= cut.end)
    return led


def _find_path(evidence: Floats, price: float) -> Indices:
    """The state in each of W windows with the most evidence ``(W, C)`` in all, less the price of each change."""
    windows, states = evidence.shape
    come, total = np.empty((windows, states), np.int64), evidence[0].copy()
    for k in range(1, windows):
        best = int(total.argmax())
        moves = total[best] - price > total
        come[k] = np.where(moves, best, np.arange(states))
        total = np.where(moves, total[best] - price, total) + evidence[k]
    path = np.empty(windows, np.int64)
    path[-1] = total.argmax()
    for k in range(windows - 1, 0, -1):
        path[k - 1] = come[k, path[k]]
    return path


def _list_periods(
    tracks: Tracks,
    rows: Indices,
    path: Indices,
    evidence: Floats,
    states: Indices,
    centres: Floats,
    ends: tuple[float, float],
) -> list[Period]:
    """The periods of a group, from the leader in each window ``(W,)``, with the times at which they change."""
    cuts = np.flatnonzero(np.diff(path)) + 1
    bounds = [0, *cuts.tolist(), len(path)]
    middles = [(centres[a] + centres[b - 1]) / 2 for a, b in pairwise(bounds)]
    changes = [(ends[0], ends[0], ends[0], 1.0)]
    for k, cut in enumerate(cuts):
        before, after = slice(bounds[k], cut), slice(cut, bounds[k + 2])
        about = (centres[cut - 1] + centres[cut]) / 2
        when = find_change(tracks, rows, int(path[cut - 1]), int(path[cut]), (middles[k], about, middles[k + 1]))
        changes.append((*when, _compare_paths(evidence, path, states, before, after)))
    starts = [*(each[0] for each in changes), ends[1]]
    return [
        Period(tuple(rows.tolist()), int(path[bounds[k]]), start, starts[k + 1], low, high, probability)
        for k, (start, low, high, probability) in enumerate(changes)
    ]


def _compare_paths(evidence: Floats, path: Indices, states: Indices, before: slice, after: slice) -> float:
    """The probability of a change by the evidence of windows that don't overlap, beside no change."""
    first, then = (int(np.flatnonzero(states == path[part.start])[0]) for part in (before, after))
    with_change = evidence[before, first].sum() + evidence[after, then].sum()
    whole = slice(before.start, after.stop)
    without = max(evidence[whole, first].sum(), evidence[whole, then].sum())
    return round(float(1 / (1 + np.exp(-(with_change - without) * _STRIDE / _LENGTH))), 6)


def find_change(
    tracks: Tracks, rows: Indices, old: int, new: int, between: tuple[float, float, float]
) -> tuple[float, float, float]:
    """The second at which the members stop copying ``old`` and begin to copy ``new``, and its 95 % interval.

    Before and after, each velocity is that of the leader some steps earlier, times a number, or constant if the leader
    is -1. The time is the one with the least sum of squares of what is left over.

    Args:
        tracks: resampled tracks.
        rows: of the members; those of both leaders don't count, unless there is no other.
        old: the row of the leader before, or -1.
        new: the row of the leader after, or -1.
        between: seconds: the earliest time, a guess, and the latest.
    """
    step = float(tracks.step or 1.0)
    followers = rows[~np.isin(rows, (old, new))] if len(np.setdiff1d(rows, (old, new))) else rows[:1]
    begin = max(between[0] - _MOST_LAG * step, 0.0)
    position, seen = cut_positions(tracks, np.append(followers, [old, new]), begin, between[2])
    velocity, known = np.diff(position, axis=0), (seen[1:] & seen[:-1])[:, : len(followers)]
    first = np.ceil(begin / step - 1e-6)
    low, cut, high = (int(np.clip(round(t / step) - first, 1, len(velocity) - 1)) for t in between)
    low = min(max(low, _MOST_LAG), cut)
    for _ in range(4):
        left = np.stack(
            [
                _leave(velocity[:, :-2], velocity[:, place], known, part, led)
                for place, part, led in ((-2, slice(low, cut), old >= 0), (-1, slice(cut, high), new >= 0))
            ]
        )
        total = np.cumsum(left[0])[low:high] + left[1].sum() - np.cumsum(left[1])[low:high]
        if (now := low + 1 + int(total.argmin())) == cut:
            break
        cut = min(max(now, low + 2), high - 2) if high - low > 4 else cut
    degrees = max(known[low:high].sum() * velocity.shape[2], 1)
    chance = np.exp(-(total - total.min()) / 2 / max(total.min() / degrees, 1e-300))
    level = np.cumsum(chance) / chance.sum()
    at = [cut, low + 1 + int(np.searchsorted(level, _MARGIN)), low + 1 + int(np.searchsorted(level, 1 - _MARGIN))]
    at[1:] = min(at[1], cut - 1), max(at[2], cut + 1)
    when, earliest, latest = (round(float((first + k) * step), 9) for k in at)
    return when, earliest, latest


def _leave(velocity: Floats, ahead: Floats, known: Mask, part: slice, led: bool) -> Floats:
    """``(T,)`` squares of what is left over of velocities ``(T, n, d)``, by the lags and gains that fit in a part."""
    if not led:
        rest = velocity - velocity[part].mean(axis=0)
        return np.asarray((rest**2).sum(axis=2) * known).sum(axis=1)
    lags = np.arange(min(_MOST_LAG, part.stop - 1) + 1)
    past = np.stack([np.concatenate([np.repeat(ahead[:1], k, axis=0), ahead[: len(ahead) - k]]) for k in lags])
    own = velocity[part] * known[part, :, None]
    dot = np.einsum("tnd,ktd->kn", own, past[:, part])
    size = np.maximum(np.einsum("tn,ktd,ktd->kn", known[part], past[:, part], past[:, part]), 1e-300)
    best = (dot**2 / size * (dot > 0)).argmax(axis=0)
    gain = np.maximum(np.take_along_axis(dot / size, best[None], axis=0)[0], 0.0)
    rest = velocity - gain[:, None] * past[best].transpose(1, 0, 2)
    return np.asarray(((rest**2).sum(axis=2) * known).sum(axis=1))


def _is_led(
    period: Period, tracks: Tracks, windows: Sequence[DetectedWindow], track_windows: Sequence[TrackWindow]
) -> bool:
    """Whether the leader of a period leads in a window of which it has the most, or is confirmed in the period."""
    if period.leader == NO_LEADER:
        return False
    name = tracks.ids[period.leader]
    for window, cut in zip(windows, track_windows, strict=True):
        shared = min(cut.end, period.end) - max(cut.start, period.start)
        if 2 * shared >= min(cut.end - cut.start, period.end - period.start) and name in {x.id for x in window.leaders}:
            return True
    everyone = np.arange(len(tracks.ids))
    cut_out = tracks.cut_like(replace(track_windows[0], start=period.start, end=period.end, rows=everyone))
    if cut_out is None or not np.isin((period.leader, *period.rows), cut_out.rows).all():
        return False
    place = np.searchsorted(cut_out.rows, period.rows)
    leader = int(np.searchsorted(cut_out.rows, period.leader))
    return bool(confirm_leaders(cut_out.window, [leader], [[int(k) for k in place if k != leader]])[0][0])


def list_events(periods: Sequence[Period], tracks: Tracks) -> tuple[Event, ...]:
    """The events between the periods of each group; groups that change at once, from and to the same, have one."""
    before = dict[tuple[int, ...], int]()
    moves = dict[tuple[float, int, int], list[Period]]()
    for each in sorted(periods, key=lambda each: each.start):
        known = before.get(each.rows, NO_LEADER)
        before[each.rows] = each.leader
        if known != each.leader:
            moves.setdefault((each.start, known, each.leader), []).append(each)
    events = []
    for (time, *heads), parts in moves.items():
        rows = sorted(row for each in parts for row in each.rows)
        old, new = (None if head == NO_LEADER else tracks.ids[head] for head in heads)
        kind = name_kind(heads[0] in rows, heads[1] in rows, old, new)
        ids = tuple(tracks.ids[row] for row in rows if row not in heads)
        low, high = (
            tracks.file_time(edge(getattr(each, name) for each in parts))
            for name, edge in (("low", min), ("high", max))
        )
        event = Event(tracks.file_time(time), kind, ids, old, new, low, high, min(each.probability for each in parts))
        events += [event] if ids or kind in ("ends", "merges") else []
    return tuple(events)


def blur_links(
    window: DetectedWindow, track_window: TrackWindow, periods: Sequence[Period], ids: Sequence[Name]
) -> DetectedWindow:
    """A window in which links of groups that change their leader inside of it are not direct."""
    inner = [each for each in periods if track_window.start < each.low and each.high < track_window.end]
    moving = {ids[row] for each in inner for row in each.rows}
    links = [
        replace(link, leader=link.head, delay=link.behind_head, delay_low=None, delay_high=None, direct=False)
        if link.follower in moving
        else link
        for link in window.links
    ]
    return replace(window, links=tuple(links))

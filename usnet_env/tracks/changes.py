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
from usnet_env.tracks.found import DetectedWindow, Event, Found, Name, name_kind
from usnet_env.tracks.links import cut_positions
from usnet_env.tracks.samples import keep_samples
from usnet_env.tracks.tracks import Tracks, TrackWindow

_LENGTH, _STRIDE = 40, 5  # steps of a short window, and to the next one
_MAX_WINDOWS, _MAX_IDS = 400, 20_000  # short windows; ids in all of them
_WHOLE_FILE_IDS = 5_000  # in all short windows of a file that is read wholly
_MAX_DISTANCE = 0.3  # share of windows in which the members of a group have different roots
_CHANGE_PRICE = 24.0  # of a change, in nats
_LOG_ZERO = -5.0  # the logarithm of a probability that a detector gives as 0
_MAX_LAG = 12  # steps
_TAIL = 0.025  # of the probability on each side of an interval
_IMPOSSIBLE = -1e6  # evidence for what can't be
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
    resampled: Tracks, found: Sequence[Found], answer: Callable[[TrackWindow], Detection], confirm: bool
) -> tuple[Period, ...]:
    """The periods of all groups in the order of time; empty if the tracks are too short, or too long.

    ``answer`` asks a detector. With ``confirm``, a leader of each group must be confirmed in a period, or lead in a
    window of which the period has the most.
    """
    step, max_windows = float(resampled.step or 1.0), min(_MAX_WINDOWS, max(1, _MAX_IDS // len(resampled.ids)))
    ends = found[0][0].start, found[-1][0].end
    is_long = ends[1] - ends[0] > min(max_windows, _WHOLE_FILE_IDS // len(resampled.ids)) * _STRIDE * step
    span = _find_span(found) if is_long else ends
    if span is None or span[1] - span[0] < _LENGTH * step:
        return ()
    stride = max(_STRIDE, -(-round((span[1] - span[0]) / step) // max_windows))
    if 2 * stride > _LENGTH:
        return ()
    is_inside = (resampled.time >= span[0] - 1e-6 * step) & (resampled.time <= span[1] + 1e-6 * step)
    span_tracks = replace(keep_samples(resampled, is_inside), leader=None, source=None)
    short_windows = [each for each in span_tracks.windows(_LENGTH, stride) if each.end <= span[1] + step / 2]
    root, log_p_leads, log_p_none = _read_roots(short_windows, answer, len(resampled.ids))
    centres = np.array([(each.start + each.end) / 2 for each in short_windows])
    periods = list[Period]()
    for rows in _find_groups(root):
        present = np.flatnonzero((root[:, rows] >= 0).any(axis=1))
        if not len(present):
            continue
        group_root, group_centres = root[np.ix_(present, rows)], centres[present]
        candidates = np.unique(group_root[group_root >= 0])
        if len(rows) == 1:
            candidates = candidates[candidates != rows]
        evidence = _compute_evidence(group_root, rows, log_p_leads[present], log_p_none[present], candidates)
        evidence[_find_led_times({resampled.ids[row] for row in rows}, group_centres, found), -1] = _IMPOSSIBLE
        states = np.append(candidates, NO_LEADER)
        path = states[_find_path(evidence, _CHANGE_PRICE)]
        group_periods = _list_periods(resampled, rows, path, evidence, states, group_centres, ends)
        if not confirm or any(_is_supported(each, resampled, found) for each in group_periods):
            periods += group_periods
    return tuple(sorted(periods, key=lambda each: (each.start, -len(each.rows))))


def _find_span(found: Sequence[Found]) -> tuple[float, float] | None:
    """From the window before the first one that differs from it to the last such one, in seconds."""
    heads = [
        {name: t.ids[root] if root >= 0 else None for name, root in zip(t.ids, window.roots(t.ids), strict=True)}
        for t, _, window in found
    ]
    changes = [k for k, (a, b) in enumerate(pairwise(heads)) if any(a[name] != b[name] for name in a.keys() & b.keys())]
    return (found[changes[0]][0].start, found[changes[-1] + 1][0].end) if changes else None


def _read_roots(
    short_windows: Sequence[TrackWindow], answer: Callable[[TrackWindow], Detection], ids: int
) -> tuple[Indices, Floats, Floats]:
    """The root of each id, ``(W, N)``, -1 where it isn't seen; logarithms of probabilities: it leads, no id does."""
    log_p_none = np.full(len(short_windows), _LOG_ZERO)
    root, log_p_leads = np.full((len(short_windows), ids), -1), np.full((len(short_windows), ids), _LOG_ZERO)
    for k, track_window in enumerate(short_windows):
        detection, rows = answer(track_window), track_window.rows
        indices = np.arange(len(rows))
        direct = indices if detection.leader is None else np.where(detection.leader < 0, indices, detection.leader)
        detected_root = np.asarray(detection.extras.get("root", find_roots(direct)))
        root[k, rows] = rows[np.where(detected_root >= 0, detected_root, indices)]
        probability = np.asarray(detection.extras.get("probability", detection.candidates), np.float64)
        log_p_leads[k, rows] = np.log(np.maximum(probability, np.exp(_LOG_ZERO)))
        p_no_leader = detection.extras.get("p_no_leader", np.prod(1.0 - probability))
        log_p_none[k] = np.log(max(float(p_no_leader), np.exp(_LOG_ZERO)))
    return root, log_p_leads, log_p_none


def _find_groups(root: Indices) -> list[Indices]:
    """Ids that mostly share their root in the windows ``(W, N)`` in which they are seen, by average linkage."""
    from scipy.cluster.hierarchy import fcluster, linkage
    from scipy.spatial.distance import squareform

    times_shared, times_seen = np.zeros((2, root.shape[1], root.shape[1]))
    for window_root in root:
        seen = window_root >= 0
        times_seen += seen[:, None] & seen
        times_shared += (window_root[:, None] == window_root) & seen[:, None]
    distance = 1.0 - times_shared / np.maximum(times_seen, 1.0)
    np.fill_diagonal(distance, 0.0)
    number = fcluster(linkage(squareform(distance, checks=False), "average"), _MAX_DISTANCE, "distance")
    return [np.flatnonzero(number == k) for k in np.unique(number)]


def _compute_evidence(
    root: Indices, rows: Indices, log_p_leads: Floats, log_p_none: Floats, candidates: Indices
) -> Floats:
    """The evidence ``(W, C + 1)`` that each candidate leads those with roots ``(W, n)``; the last one: none does."""
    members_seen = np.maximum((root >= 0).sum(axis=1), 1)
    led_share = (root[..., None] == candidates).sum(axis=1) / members_seen[:, None]
    free_share = (root == rows).sum(axis=1) / members_seen
    leader_evidence = _LOG_ZERO * (1.0 - led_share) + log_p_leads[:, candidates]
    return np.column_stack([leader_evidence, _LOG_ZERO * (1.0 - free_share) + log_p_none])


def _find_led_times(members: set[Name], centres: Floats, found: Sequence[Found]) -> Mask:
    """Which times are in a window in which most members of a group follow or lead: there, no leader is no answer.

    A single id that leads follows none.
    """
    is_led = np.zeros(len(centres), bool)
    for track_window, _, window in found:
        roles = {link.follower for link in window.links} | {leader.id for leader in window.leaders if len(members) > 1}
        if 2 * len(members & roles) > len(members):
            is_led |= (centres >= track_window.start) & (centres <= track_window.end)
    return is_led


def _find_path(evidence: Floats, price: float) -> Indices:
    """The state in each of W windows with the most evidence ``(W, C)`` in all, less the price of each change."""
    windows, states = evidence.shape
    previous_state, total = np.empty((windows, states), np.int64), evidence[0].copy()
    for k in range(1, windows):
        best = int(total.argmax())
        is_change = total[best] - price > total
        previous_state[k] = np.where(is_change, best, np.arange(states))
        total = np.where(is_change, total[best] - price, total) + evidence[k]
    path = np.empty(windows, np.int64)
    path[-1] = total.argmax()
    for k in range(windows - 1, 0, -1):
        path[k - 1] = previous_state[k, path[k]]
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
        old_windows, new_windows = slice(bounds[k], cut), slice(cut, bounds[k + 2])
        guess = (centres[cut - 1] + centres[cut]) / 2
        change = find_change(tracks, rows, int(path[cut - 1]), int(path[cut]), (middles[k], guess, middles[k + 1]))
        changes.append((*change, _compare_paths(evidence, path, states, old_windows, new_windows)))
    starts = [*(each[0] for each in changes), ends[1]]
    return [
        Period(tuple(rows.tolist()), int(path[bounds[k]]), start, starts[k + 1], low, high, probability)
        for k, (start, low, high, probability) in enumerate(changes)
    ]


def _compare_paths(evidence: Floats, path: Indices, states: Indices, old_windows: slice, new_windows: slice) -> float:
    """The probability of a change by the evidence of windows that don't overlap, beside no change."""
    old_state, new_state = (int(np.flatnonzero(states == path[k.start])[0]) for k in (old_windows, new_windows))
    with_change = evidence[old_windows, old_state].sum() + evidence[new_windows, new_state].sum()
    all_windows = slice(old_windows.start, new_windows.stop)
    without_change = max(evidence[all_windows, old_state].sum(), evidence[all_windows, new_state].sum())
    return round(float(1 / (1 + np.exp(-(with_change - without_change) * _STRIDE / _LENGTH))), 6)


def find_change(
    tracks: Tracks, rows: Indices, old: int, new: int, between: tuple[float, float, float]
) -> tuple[float, float, float]:
    """The second at which the members stop copying ``old`` and begin to copy ``new``, and its 95 % interval.

    Before and after, each velocity is that of the leader some steps earlier, times a number, or constant if the leader
    is -1. The time is the one with the least sum of squared residuals. ``rows`` are those of the members; the leaders
    don't count, unless there is no other. ``between`` are seconds: the earliest time, a guess, and the latest.
    """
    step = float(tracks.step or 1.0)
    followers = rows[~np.isin(rows, (old, new))] if len(np.setdiff1d(rows, (old, new))) else rows[:1]
    begin = max(between[0] - _MAX_LAG * step, 0.0)
    position, seen = cut_positions(tracks, np.append(followers, [old, new]), begin, between[2])
    velocity, velocity_seen = np.diff(position, axis=0), (seen[1:] & seen[:-1])[:, : len(followers)]
    first_instant = np.ceil(begin / step - 1e-6)
    low, cut, high = (int(np.clip(round(t / step) - first_instant, 1, len(velocity) - 1)) for t in between)
    low = min(max(low, _MAX_LAG), cut)
    for _ in range(4):
        old_squares = _compute_residuals(velocity[:, :-2], velocity[:, -2], velocity_seen, slice(low, cut), old >= 0)
        new_squares = _compute_residuals(velocity[:, :-2], velocity[:, -1], velocity_seen, slice(cut, high), new >= 0)
        total = np.cumsum(old_squares)[low:high] + new_squares.sum() - np.cumsum(new_squares)[low:high]
        if (best_cut := low + 1 + int(total.argmin())) == cut:
            break
        cut = min(max(best_cut, low + 2), high - 2) if high - low > 4 else cut
    degrees = max(velocity_seen[low:high].sum() * velocity.shape[2], 1)
    likelihood = np.exp(-(total - total.min()) / 2 / max(total.min() / degrees, 1e-300))
    cumulative = np.cumsum(likelihood) / likelihood.sum()
    earliest, latest = (low + 1 + int(np.searchsorted(cumulative, level)) for level in (_TAIL, 1 - _TAIL))
    instants = cut, min(earliest, cut - 1), max(latest, cut + 1)
    time, start, end = (round(float((first_instant + k) * step), 9) for k in instants)
    return time, start, end


def _compute_residuals(velocity: Floats, leader_velocity: Floats, seen: Mask, part: slice, is_led: bool) -> Floats:
    """``(T,)`` squared residuals of velocities ``(T, n, d)``, by the lags and gains that fit best in a part."""
    if not is_led:
        residual = velocity - velocity[part].mean(axis=0)
        return np.asarray((residual**2).sum(axis=2) * seen).sum(axis=1)
    lags = np.arange(min(_MAX_LAG, part.stop - 1) + 1)
    past = leader_velocity[np.maximum(np.arange(len(velocity)) - lags[:, None], 0)]  # (K, T, d)
    follower_velocity = velocity[part] * seen[part, :, None]
    dot = np.einsum("tnd,ktd->kn", follower_velocity, past[:, part])
    past_square = np.maximum(np.einsum("tn,ktd,ktd->kn", seen[part], past[:, part], past[:, part]), 1e-300)
    best = (dot**2 / past_square * (dot > 0)).argmax(axis=0)
    gain = np.maximum(np.take_along_axis(dot / past_square, best[None], axis=0)[0], 0.0)
    residual = velocity - gain[:, None] * past[best].transpose(1, 0, 2)
    return np.asarray(((residual**2).sum(axis=2) * seen).sum(axis=1))


def _is_supported(period: Period, tracks: Tracks, found: Sequence[Found]) -> bool:
    """Whether the leader of a period leads in a window of which it has the most, or is confirmed in the period."""
    if period.leader == NO_LEADER:
        return False
    name = tracks.ids[period.leader]
    for track_window, _, window in found:
        overlap = min(track_window.end, period.end) - max(track_window.start, period.start)
        leads = any(leader.id == name for leader in window.leaders)
        if leads and 2 * overlap >= min(track_window.end - track_window.start, period.end - period.start):
            return True
    all_rows = np.arange(len(tracks.ids))
    period_window = tracks.cut_like(replace(found[0][0], start=period.start, end=period.end, rows=all_rows))
    if period_window is None or not np.isin((period.leader, *period.rows), period_window.rows).all():
        return False
    members = np.searchsorted(period_window.rows, period.rows)
    leader = int(np.searchsorted(period_window.rows, period.leader))
    return bool(confirm_leaders(period_window.window, [leader], [[int(k) for k in members if k != leader]])[0][0])


def list_events(periods: Sequence[Period], tracks: Tracks) -> tuple[Event, ...]:
    """The events between the periods of each group; groups that change at once, from and to the same, have one."""
    leader_of = dict[tuple[int, ...], int]()
    moves = dict[tuple[float, int, int], list[Period]]()
    for period in sorted(periods, key=lambda period: period.start):
        old_leader = leader_of.get(period.rows, NO_LEADER)
        leader_of[period.rows] = period.leader
        if old_leader != period.leader:
            moves.setdefault((period.start, old_leader, period.leader), []).append(period)
    events = []
    for (time, *heads), changes in moves.items():
        rows = sorted(row for period in changes for row in period.rows)
        old, new = (None if head == NO_LEADER else tracks.ids[head] for head in heads)
        kind = name_kind(heads[0] in rows, heads[1] in rows, old, new)
        ids = tuple(tracks.ids[row] for row in rows if row not in heads)
        low = tracks.file_time(min(period.low for period in changes))
        high = tracks.file_time(max(period.high for period in changes))
        probability = min(period.probability for period in changes)
        event = Event(tracks.file_time(time), kind, ids, old, new, low, high, probability)
        events += [event] if ids or kind in ("ends", "merges") else []
    return tuple(events)


def blur_links(
    window: DetectedWindow, track_window: TrackWindow, periods: Sequence[Period], ids: Sequence[Name]
) -> DetectedWindow:
    """A window in which links of groups that change their leader inside of it are not direct."""
    inner_periods = [period for period in periods if track_window.start < period.low and period.high < track_window.end]
    moving_ids = {ids[row] for period in inner_periods for row in period.rows}
    links = [
        replace(link, leader=link.head, delay=link.behind_head, delay_low=None, delay_high=None, direct=False)
        if link.follower in moving_ids
        else link
        for link in window.links
    ]
    return replace(window, links=tuple(links))

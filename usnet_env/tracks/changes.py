"""When groups change their leader: short windows that overlap, a path of least cost, and the time that fits best.

A detector reads short windows of the file; of a long file, only those where the links differ from one window to the
next. Ids that mostly share their root are a group. The leaders of a group are the states of a path (Viterbi), in which
each change has a price. The time of a change is the one at which the followers stop copying the old leader and begin to
copy the new one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.detection import Detection
from usnet_env.objectives import find_roots
from usnet_env.tracks.confirm import confirm_leaders
from usnet_env.tracks.dates import NO_LEADER, Dates, Span, explain_motion, join_dates, read_date, weigh_dates
from usnet_env.tracks.found import DetectedWindow, Event, Found, Name, name_kind
from usnet_env.tracks.samples import keep_samples
from usnet_env.tracks.tracks import Tracks, TrackWindow

_LENGTH, _STRIDE = 40, 5  # steps of a short window, and to the next one
_MAX_WINDOWS, _MAX_IDS = 400, 20_000  # short windows; ids in all of them
_WHOLE_FILE_IDS = 5_000  # in all short windows of a file that is read wholly
_MAX_DISTANCE = 0.3  # share of windows in which the members of a group have different roots
_CHANGE_PRICE = 24.0  # of a change, in nats
_IMPOSSIBLE = -1e6  # evidence for what can't be
_LEAST_GAIN = 6.0  # of the past of a leader that no window names, in nats
_CUTS = 5  # places in a time without a leader at which one may take over from another
_LOG_ZERO = -5.0  # the logarithm of a probability that a detector gives as 0


@dataclass(frozen=True)
class Period:
    """A time in which a group follows one leader, or none.

    Args:
        rows: the group's members with a track then, as rows of ``Tracks.ids``; the leader may be one of them.
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


class _Path(NamedTuple):
    """The leader of a group in each of W short windows.

    Args:
        rows: of the members.
        centres: of the windows, in seconds, ``(W,)``.
        evidence: for each state in each window, ``(W, C)``.
        states: rows of leaders, and -1.
        leader: in each window, ``(W,)``.
    """

    rows: Indices
    centres: Floats
    evidence: Floats
    states: Indices
    leader: Indices

    @property
    def bounds(self) -> list[int]:
        """The window at which each period begins, and W."""
        return [0, *(np.flatnonzero(np.diff(self.leader)) + 1).tolist(), len(self.leader)]

    def list_periods(self, ends: Span) -> list[Period]:
        """The periods, which change midway between two windows."""
        cuts, members = np.array(self.bounds[1:-1], np.int64), tuple(self.rows.tolist())
        times = [ends[0], *((self.centres[cuts - 1] + self.centres[cuts]) / 2).tolist(), ends[1]]
        spans = zip(self.leader[self.bounds[:-1]].tolist(), pairwise(times), strict=True)
        return [Period(members, leader, start, end, start, start, 1.0) for leader, (start, end) in spans]

    def compare(self, k: int) -> float:
        """The probability that period k begins, by the evidence of windows that don't overlap, beside no change."""
        start, cut, end = self.bounds[k - 1 : k + 2]
        old, new = (int(np.flatnonzero(self.states == self.leader[window])[0]) for window in (start, cut))
        with_change = self.evidence[start:cut, old].sum() + self.evidence[cut:end, new].sum()
        without_change = max(self.evidence[start:end, state].sum() for state in (old, new))
        return round(float(1 / (1 + np.exp(-(with_change - without_change) * _STRIDE / _LENGTH))), 6)


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
    paths = list[_Path]()
    for rows in _find_groups(root):
        present = np.flatnonzero((root[:, rows] >= 0).any(axis=1))
        if not len(present):
            continue
        group_root, group_centres = root[np.ix_(present, rows)], centres[present]
        candidates = np.unique(group_root[group_root >= 0])
        if len(rows) == 1:
            candidates = candidates[candidates != rows]
        evidence = _compute_evidence(group_root, rows, log_p_leads[present], log_p_none[present], candidates)
        states = np.append(candidates, NO_LEADER)
        is_led = _find_led_times({resampled.ids[row] for row in rows}, group_centres, found)
        possible = np.where(is_led[:, None] & (states == NO_LEADER), _IMPOSSIBLE, evidence)
        path = _Path(rows, group_centres, evidence, states, states[_find_path(possible, _CHANGE_PRICE)])
        rough = path.list_periods(ends)
        named = [not confirm or _is_named(each, resampled.ids, found) for each in rough]
        if any(named) or any(_is_confirmed(each, resampled, found) for each in rough):
            path = _drop_leaders(resampled, path, named, span)
            paths.append(_fill_gaps(resampled, path, span))
    periods = chain(*(_clip_periods(resampled, each) for each in _date_periods(resampled, paths, ends)))
    return tuple(sorted(periods, key=lambda each: (each.start, -len(each.rows))))


def _find_span(found: Sequence[Found]) -> Span | None:
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


def _drop_leaders(tracks: Tracks, path: _Path, named: Sequence[bool], ends: Span) -> _Path:
    """The path without the leaders of periods that no window names and whose past explains little."""
    leader = path.leader.copy()
    for period, is_named, span in zip(path.list_periods(ends), named, pairwise(path.bounds), strict=True):
        if period.leader >= 0 and not is_named:
            (gain,) = explain_motion(tracks, path.rows, period.leader, [(period.start, period.end)])
            leader[slice(*span)] = period.leader if gain > _LEAST_GAIN else NO_LEADER
    return path._replace(leader=leader)


def _fill_gaps(tracks: Tracks, path: _Path, ends: Span) -> _Path:
    """The path led where the group goes on as it follows the leader before a gap, that after it, or one until a cut."""
    periods, leader, bounds = path.list_periods(ends), path.leader.copy(), path.bounds
    margin = _STRIDE * float(tracks.step or 1.0)
    for k in (k for k, period in enumerate(periods) if period.leader == NO_LEADER):
        first, last = bounds[k : k + 2]
        cuts = np.linspace(first, last, _CUTS).astype(int)
        times = periods[k].start + (periods[k].end - periods[k].start) * (cuts - first) / (last - first)
        sides = [(k - 1, [(periods[k].start - margin, time) for time in times], cuts > first)]
        sides += [(k + 1, [(time, periods[k].end + margin) for time in times], cuts < last)]
        gains, heads = np.zeros(_CUTS), [NO_LEADER, NO_LEADER]
        for side, (other, spans, counts) in enumerate(sides):
            if 0 <= other < len(periods):
                heads[side] = periods[other].leader
                known = [(each.start, each.end) for each in periods if each.leader == heads[side]]
                gains += np.where(counts, explain_motion(tracks, path.rows, heads[side], spans, known), 0.0)
            else:
                gains[counts] = -np.inf
        cut = cuts[gains.argmax()]
        if gains.max() > 0:
            leader[first:cut], leader[cut:last] = heads
    return path._replace(leader=leader)


def _date_periods(tracks: Tracks, paths: Sequence[_Path], ends: Span) -> list[list[Period]]:
    """The periods of each group; changes at once, from and to the same leader, have one date."""
    moves = dict[tuple[int, int], list[tuple[int, int, Dates]]]()
    periods = [path.list_periods(ends) for path in paths]
    for g, (path, group_periods) in enumerate(zip(paths, periods, strict=True)):
        middles = [(path.centres[a] + path.centres[b - 1]) / 2 for a, b in pairwise(path.bounds)]
        for k, (old, new) in enumerate(pairwise(group_periods), start=1):
            between = middles[k - 1], new.start, middles[k]
            dates = weigh_dates(tracks, path.rows, old.leader, new.leader, between)
            moves.setdefault((old.leader, new.leader), []).append((g, k, dates))
    for changes in moves.values():
        for (g, k, _), dates in zip(changes, join_dates([dates for _, _, dates in changes]), strict=True):
            start, low, high = read_date(dates, float(tracks.step or 1.0))
            periods[g][k - 1] = replace(periods[g][k - 1], end=start)
            periods[g][k] = replace(periods[g][k], start=start, low=low, high=high, probability=paths[g].compare(k))
    return periods


def _clip_periods(tracks: Tracks, periods: Sequence[Period]) -> list[Period]:
    """The periods of a group, of each follower while it and its leader are seen, and of a leader while it has one."""
    step = float(tracks.step or 1.0)
    first, last = tracks.time[tracks.offsets[:-1]], tracks.time[tracks.offsets[1:] - 1]
    first = np.where(first > tracks.time.min() + 1.5 * step, first, -np.inf)  # fixes needn't be at one instant
    half_window, clipped, old = _LENGTH / 2 * step, list[Period](), NO_LEADER
    for period in periods:
        head, parts = period.leader, dict[Period, list[int]]()
        for row in (row for row in period.rows if row != head):
            if head == NO_LEADER:
                parts.setdefault(period, []).extend([row] if row == old or last[row] > period.start else [])
                continue
            seen = max(first[row], first[head]), min(last[row], last[head])
            start, low, high, end = np.clip((period.start, period.low, period.high, period.end), *seen).tolist()
            if start < end:
                led = replace(period, start=start, low=low, high=high, end=end)
                parts.setdefault(led, []).append(row)
            if end == last[head] < min(period.end, last[row] - half_window):  # it goes on without a leader
                free = replace(period, leader=NO_LEADER, start=end, low=end, high=end, probability=1.0)
                parts.setdefault(free, []).append(row)
        if head in period.rows and (led_parts := [part for part in parts if part.leader == head]):
            whole = replace(min(led_parts, key=lambda part: part.start), end=max(part.end for part in led_parts))
            parts.setdefault(whole, []).append(head)
            parts |= {part: [*rows, head] for part, rows in parts.items() if part.leader == NO_LEADER}
        clipped += [replace(part, rows=tuple(sorted(rows))) for part, rows in parts.items() if rows]
        old = head
    return clipped


def _is_named(period: Period, ids: Sequence[Name], found: Sequence[Found]) -> bool:
    """Whether the leader of a period leads in a window of which it has the most."""
    for track_window, _, window in found:
        overlap = min(track_window.end, period.end) - max(track_window.start, period.start)
        leads = period.leader >= 0 and any(leader.id == ids[period.leader] for leader in window.leaders)
        if leads and 2 * overlap >= min(track_window.end - track_window.start, period.end - period.start):
            return True
    return False


def _is_confirmed(period: Period, tracks: Tracks, found: Sequence[Found]) -> bool:
    """Whether the leader of a period is confirmed in it."""
    all_rows = np.arange(len(tracks.ids))
    period_window = tracks.cut_like(replace(found[0][0], start=period.start, end=period.end, rows=all_rows))
    needed = {period.leader, *period.rows}
    if period_window is None or not needed <= {*period_window.rows.tolist()}:
        return False
    members = np.searchsorted(period_window.rows, period.rows)
    leader = int(np.searchsorted(period_window.rows, period.leader))
    return bool(confirm_leaders(period_window.window, [leader], [[int(k) for k in members if k != leader]])[0][0])


def list_events(periods: Sequence[Period], tracks: Tracks) -> tuple[Event, ...]:
    """The events between the periods of each id; ids that change at once, from and to the same, have one."""
    leader_of, moves = dict[int, int](), dict[tuple[float, int, int], dict[int, Period]]()
    for period in sorted(periods, key=lambda period: period.start):
        for row in period.rows:
            old_leader = leader_of.get(row, NO_LEADER)
            leader_of[row] = period.leader
            if old_leader != period.leader:
                moves.setdefault((period.start, old_leader, period.leader), {})[row] = period
    events = []
    for (time, *heads), changes in moves.items():
        rows = sorted(changes)
        old, new = (None if head == NO_LEADER else tracks.ids[head] for head in heads)
        kind = name_kind(heads[0] in rows, heads[1] in rows, old, new)
        ids = tuple(tracks.ids[row] for row in rows if row not in heads)
        low = tracks.file_time(min(period.low for period in changes.values()))
        high = tracks.file_time(max(period.high for period in changes.values()))
        probability = min(period.probability for period in changes.values())
        event = Event(tracks.file_time(time), kind, ids, old, new, low, high, probability)
        events += [event] if ids or kind in ("ends", "merges") else []
    return tuple(events)


def blur_links(
    window: DetectedWindow, track_window: TrackWindow, periods: Sequence[Period], ids: Sequence[Name]
) -> DetectedWindow:
    """A window in which links of groups that change their leader inside of it are not direct."""
    inner_periods = [period for period in periods if track_window.start < period.low < period.high < track_window.end]
    moving_ids = {ids[row] for period in inner_periods for row in period.rows}
    links = [
        replace(link, leader=link.head, delay=link.behind_head, delay_low=None, delay_high=None, direct=False)
        if link.follower in moving_ids
        else link
        for link in window.links
    ]
    return replace(window, links=tuple(links))

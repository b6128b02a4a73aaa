"""What is doubtful about recorded tracks: gaps, jumps, spikes, exchanged ids, clocks and velocities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from usnet_env.arrays import Floats, Indices
from usnet_env.config import format_count, format_number
from usnet_env.tracks.resample import JUMP, find_jumps, typical_intervals
from usnet_env.tracks.samples import Clock, Samples, is_epoch

_GAP = 3.0  # a gap is an interval of more than this many typical intervals of its id
_UNEVEN = 0.1  # sampling is uneven if a tenth of the intervals differ from the typical one by more than this share
_EXCHANGE = 0.25  # after an exchange of ids, each is this close to the place expected of the other, in jump lengths
_MOST_JUMPS = 2000  # compared with each other for exchanged ids
_AGREEMENT = 0.3  # velocities agree with positions if half of them differ by less than this share
_SYNCHRONOUS, _PHASE = 0.6, 0.1  # share of ids that are sampled at the same times, up to this part of an interval
_MOST_NAMED = 3
_UNIT_WORDS = {1e-3: ("milliseconds", "0.001"), 1e-6: ("microseconds", "1e-6"), 1e-9: ("nanoseconds", "1e-9")}
_LEVEL = 0.01  # probability that chance alone makes the rate of one id in a file look different


@dataclass(frozen=True)
class Finding:
    """Something doubtful about tracks.

    Args:
        kind: ``"time unit"``, ``"clocks"``, ``"gaps"``, ``"uneven sampling"``, ``"spikes"``, ``"jumps"``,
            ``"exchanged ids"``, ``"velocities"`` or ``"degrees"``.
        sentence: what was found, where first, and what it means.
        count: how often.
    """

    kind: str
    sentence: str
    count: int


@dataclass(frozen=True)
class TrackReport:
    """What tracks hold, and what is doubtful about them.

    Args:
        facts: sentences about the whole file, and what the reader decided.
        warnings: what is doubtful.
    """

    facts: tuple[str, ...]
    warnings: tuple[Finding, ...]

    def __str__(self) -> str:
        return "\n".join([*self.facts, *(f"Warning: {finding.sentence}" for finding in self.warnings)])


def find_problems(tracks: Samples) -> TrackReport:
    """Describe tracks and find what is doubtful about them."""
    ids = len(tracks.ids)
    typical = typical_intervals(tracks)
    usual = float(np.median(typical[np.isfinite(typical)])) if np.isfinite(typical).any() else 0.0
    filled = np.flatnonzero(np.diff(tracks.offsets) > 0)
    first, last = tracks.time[tracks.offsets[filled]], tracks.time[tracks.offsets[filled + 1] - 1]
    slack = 0.01 * tracks.duration
    whole = int(((first <= slack) & (last >= tracks.duration - slack)).sum())
    facts = (
        f"{ids} ids, {tracks.samples} samples from {tracks.file_time(0.0)} to {tracks.file_time(tracks.duration)} "
        f"({format_number(tracks.duration)} s), one every {format_number(usual)} s; {tracks.dimensions}-D, "
        f"{tracks.frame}.",
        f"{whole} of {ids} ids are there from the beginning to the end.",
        *tracks.notes,
    )
    found = [
        *_find_time_unit(tracks.clock),
        *_find_rates(tracks, typical, usual),
        *_find_clocks(tracks, usual, filled, first, last),
        *_find_gaps(tracks, typical),
        *_find_jumps(tracks),
        *_find_velocity_conflicts(tracks),
        *_find_degrees(tracks),
    ]
    return TrackReport(facts, tuple(found))


def _count(number: int, noun: str) -> str:
    """A number with its noun and verb."""
    return f"{format_count(number, noun)} {'is' if number == 1 else 'are'}"


def _name(tracks: Samples, who: Indices) -> str:
    """Name some ids, at most three."""
    names = ", ".join(str(tracks.ids[i]) for i in who[:_MOST_NAMED])
    return names if len(who) <= _MOST_NAMED else f"{names} and {len(who) - _MOST_NAMED} more"


def _owner(tracks: Samples, sample: int) -> str | int:
    """The id that a sample belongs to."""
    return tracks.ids[int(np.searchsorted(tracks.offsets, sample, side="right")) - 1]


def _place(tracks: Samples, sample: int) -> str:
    """The time and the id of a sample."""
    return f"{tracks.file_time(tracks.time[sample])} (id {_owner(tracks, sample)})"


def _find_time_unit(clock: Clock) -> Iterator[Finding]:
    """Find times that were read as seconds and are probably milliseconds, microseconds or nanoseconds."""
    if clock.likely_unit is None:
        return
    name, number = _UNIT_WORDS[clock.likely_unit]
    why = f"the name of their column says {name}"
    if is_epoch(clock.origin, clock.likely_unit):
        why = f"their numbers are those of {name} since 1970"
    sentence = f"Times are read as seconds, but {why}: a time unit of {number} reads them so (--time-unit {number})."
    yield Finding("time unit", sentence, 1)


def _find_rates(tracks: Samples, typical: Floats, usual: float) -> Iterator[Finding]:
    """Find ids with another sampling rate.

    The confidence interval of an id's median interval lies between two order statistics: the number of intervals below
    the median is binomial whatever their distribution is. So ids with scattered intervals have a wide one, and ids with
    equal intervals one of no width. All N intervals hold together with the probability 1 - ``_LEVEL``.
    """
    low, high = np.full((2, len(tracks.ids)), np.nan)
    quantile = -float(ndtri(_LEVEL / (2 * len(tracks.ids))))
    for i, (first, last) in enumerate(zip(tracks.offsets[:-1], tracks.offsets[1:], strict=True)):
        count = int(last - first) - 1
        rank = int(np.floor((count - quantile * np.sqrt(max(count, 0))) / 2))  # how many lie below the lower end
        if count > 0 and rank > 0:
            intervals = np.sort(np.diff(tracks.time[first:last]))
            low[i], high[i] = intervals[rank - 1], intervals[count - rank]
    middle = int(np.argmin(np.where(np.isfinite(low), np.abs(typical - usual), np.inf)))  # an id of the usual rate
    other = (low > high[middle]) | (high < low[middle])
    rate = np.flatnonzero(other & (np.abs(typical - usual) > 0.01 * usual))
    if not len(rate):
        return
    sentence = (
        f"{_count(len(rate), 'id')} sampled at another rate than every {format_number(usual)} s: {_name(tracks, rate)}."
    )
    if 2 * len(rate) > np.isfinite(typical).sum():  # no rate is the usual one
        least, most = (format_number(interval, 3) for interval in (np.nanmin(typical), np.nanmax(typical)))
        sentence = f"The ids are sampled at different rates, every {least} to {most} s."
    yield Finding("clocks", sentence, len(rate))


def _find_clocks(tracks: Samples, usual: float, filled: Indices, first: Floats, last: Floats) -> Iterator[Finding]:
    """Find ids with samples between those of the others, or at other times altogether.

    Args:
        tracks: the tracks.
        usual: the usual interval, seconds.
        filled: the rows of the ids that have samples.
        first: the time of the first sample of each of these.
        last: that of the last one.
    """
    begun_before_end = np.searchsorted(np.sort(first), last, side="right")
    ended_before_begin = np.searchsorted(np.sort(last), first, side="left")
    apart = filled[begun_before_end - ended_before_begin == 1]  # only its own
    if len(filled) > 1 and len(apart):
        sentence = (
            f"{_count(len(apart), 'id')} sampled at times that no other id shares: {_name(tracks, apart)}; the "
            "clocks may disagree with the others'."
        )
        yield Finding("clocks", sentence, len(apart))
    if usual <= 0 or len(filled) < 3:
        return
    phase = first / usual % 1.0
    mode = (np.bincount((phase * 50).astype(int) % 50).argmax() + 0.5) / 50
    shifted = filled[np.abs((phase - mode + 0.5) % 1.0 - 0.5) > _PHASE]
    if 0 < len(shifted) <= (1 - _SYNCHRONOUS) * len(filled):
        sentence = (
            f"{_count(len(shifted), 'id')} sampled between the times of the others: {_name(tracks, shifted)}; their "
            "clocks may disagree."
        )
        yield Finding("clocks", sentence, len(shifted))


def _find_gaps(tracks: Samples, typical: Floats) -> Iterator[Finding]:
    """Find intervals that are much longer than the typical one of the id, and uneven sampling."""
    interval, inner = np.diff(tracks.time), tracks.inner_steps
    expected = np.repeat(typical, np.diff(tracks.offsets))[:-1]
    gaps = np.flatnonzero(inner & (interval > _GAP * expected))
    if len(gaps):
        longest = int(gaps[interval[gaps].argmax()])
        sentence = (
            f"{_count(len(gaps), 'gap')} longer than {_GAP:g} typical intervals; the longest takes "
            f"{format_number(interval[longest])} s, after {_place(tracks, longest)}."
        )
        yield Finding("gaps", sentence, len(gaps))
    off = int((inner & (np.abs(interval - expected) > _UNEVEN * expected)).sum())
    share = off / max(int(inner.sum()), 1)
    if share > _UNEVEN:
        sentence = f"Sampling is uneven: {share:.0%} of the intervals differ from the typical one by more than 10 %."
        yield Finding("uneven sampling", sentence, off)


def _find_jumps(tracks: Samples) -> Iterator[Finding]:
    """Find single samples off the track, other jumps, and pairs of ids that exchange their places."""
    jumps = find_jumps(tracks)
    fast = f"more than {JUMP:g} times as fast as 95 % of the steps ({format_number(jumps.usual, 3)} m/s)"
    if count := len(jumps.spikes):
        who = "1 sample is a spike" if count == 1 else f"{count} samples are spikes"
        sentence = (
            f"{who}: the steps to it and from it are {fast}, the step that skips it is not; the first is at "
            f"{_place(tracks, int(jumps.spikes[0]))}."
        )
        yield Finding("spikes", sentence, count)
    steps = np.setdiff1d(jumps.steps, np.concatenate([jumps.spikes, jumps.spikes - 1]))
    if count := len(steps):
        fastest = int(steps[jumps.speed[steps].argmax()])
        what = "1 step is a jump" if count == 1 else f"{count} steps are jumps"
        speed = format_number(jumps.speed[fastest], 3)
        sentence = f"{what}, {fast}; the fastest has {speed} m/s, after {_place(tracks, fastest)}."
        yield Finding("jumps", sentence, count)
    if pairs := _find_exchanges(tracks, jumps.steps[:_MOST_JUMPS]):
        one, other = (int(sample) for sample in pairs[0])
        sentence = (
            f"{len(pairs)} pairs of ids jump to each other's places, the first {_owner(tracks, one)} and "
            f"{_owner(tracks, other)} after {tracks.file_time(tracks.time[one])}; their ids may be exchanged."
        )
        yield Finding("exchanged ids", sentence, len(pairs))


def _find_exchanges(tracks: Samples, jumps: Indices) -> list[tuple[int, int]]:
    """Pairs of jumps, as indices of their first samples, in which each ends where the other began."""
    start, end = tracks.position[jumps], tracks.position[jumps + 1]
    begun, ended = tracks.time[jumps], tracks.time[jumps + 1]
    length = np.linalg.norm(end - start, axis=1)
    pairs = []
    for k in range(len(jumps)):
        near = (
            (np.linalg.norm(end - start[k], axis=1) < _EXCHANGE * length[k])
            & (np.linalg.norm(start - end[k], axis=1) < _EXCHANGE * length[k])
            & (begun < ended[k])
            & (ended > begun[k])
        )
        pairs += [(int(jumps[k]), int(jumps[j])) for j in np.flatnonzero(near) if j > k]
    return pairs


def _find_velocity_conflicts(tracks: Samples) -> Iterator[Finding]:
    """Compare the velocities in the file with the differences of the positions, after and before the sample."""
    steps = np.flatnonzero(tracks.inner_steps)
    if tracks.velocity is None or not len(steps):
        return
    moved = np.diff(tracks.position, axis=0)[steps] / np.diff(tracks.time)[steps, None]
    size = np.linalg.norm(moved, axis=1)
    fast = size > 0.1 * np.median(size)
    moved, steps, size = moved[fast], steps[fast], size[fast]

    def difference(velocity: Floats) -> float:
        return float(np.median(np.linalg.norm(velocity - moved, axis=1) / size)) if len(size) else 0.0

    after, before = tracks.velocity[steps], tracks.velocity[steps + 1]
    middle = (after + before) / 2
    best = min(difference(after), difference(before), difference(middle))
    if best <= _AGREEMENT:
        return
    ratio = float(np.median(np.linalg.norm(middle, axis=1) / size))
    why = f"half of them differ by more than {best:.0%}"
    if ratio > 0 and difference(middle / ratio) <= _AGREEMENT:
        why = f"they are {ratio:.3g} times as large, so they are probably in another unit"
    sentence = f"The velocities contradict the positions: {why}. Only the positions are used."
    yield Finding("velocities", sentence, len(steps))


def _find_degrees(tracks: Samples) -> Iterator[Finding]:
    """Find coordinates that are said to be metres but look like longitude and latitude."""
    if tracks.frame != "metres" or not tracks.samples:
        return
    place = tracks.position[:, :2] + tracks.origin[:2]
    extent = float(np.ptp(place, axis=0).max())
    far = np.abs(place)
    if (far <= (180, 90)).all() and (place != np.round(place)).any() and 0 < extent <= 5 <= far.min(axis=0).max():
        sentence = (
            f"All x are from -180 to 180, all y from -90 to 90, and the tracks extend over {extent:.3g} m: they may be "
            "degrees (then map the columns lon and lat)."
        )
        yield Finding("degrees", sentence, 1)

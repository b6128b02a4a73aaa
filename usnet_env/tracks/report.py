"""What is doubtful about recorded tracks: gaps, jumps, spikes, clocks and units."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from usnet_env.config import format_count, format_number, format_seconds, list_names
from usnet_env.tracks.clean import skip_pauses
from usnet_env.tracks.resample import JUMP, Jumps, find_jumps, typical_intervals
from usnet_env.tracks.samples import Samples, find_one_body

_GAP = 3.0  # a gap is an interval of more than this many typical intervals of its id
_UNEVEN = 0.1  # sampling is uneven if a tenth of the intervals differ from the typical one by more than this share
_SLOW = 0.003  # metres a second, of nearly all steps; an aircraft's 300 m/s are 0.003 degrees a second


@dataclass(frozen=True)
class TrackReport:
    """What tracks hold, and what is doubtful about them.

    Args:
        facts: sentences about the whole file, and what the reader decided.
        warnings: a sentence about each kind of doubt: what was found, how often, and where first.
    """

    facts: tuple[str, ...]
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join([*self.facts, *(f"Warning: {sentence}" for sentence in self.warnings)])


def describe_samples(tracks: Samples) -> tuple[str, ...]:
    """Two sentences: what the tracks hold, and how many ids are always there."""
    ids, intervals = len(tracks.ids), typical_intervals(tracks)
    interval = float(np.median(intervals[np.isfinite(intervals)])) if np.isfinite(intervals).any() else 0.0
    filled = np.flatnonzero(np.diff(tracks.offsets) > 0)
    first, last = tracks.time[tracks.offsets[filled]], tracks.time[tracks.offsets[filled + 1] - 1]
    slack = 0.01 * tracks.duration
    complete = int(((first <= slack) & (last >= tracks.duration - slack)).sum())
    some = f"{complete} of {ids} ids {'is' if complete == 1 else 'are'}"
    present = f"All {ids} ids are" if complete == ids else some
    return (
        f"{ids} ids, {tracks.samples} samples from {tracks.file_time(0.0)} to {tracks.file_time(tracks.duration)} "
        f"({format_seconds(tracks.duration)}), one every {format_seconds(interval)}; {tracks.dimensions}-D, "
        f"{tracks.frame}.",
        f"{present} present throughout.",
    )


def find_problems(tracks: Samples) -> TrackReport:
    """Describe tracks and find what is doubtful about them."""
    moving, _ = skip_pauses(tracks)
    jumps = find_jumps(moving)
    doubts = [*_doubt_units(tracks, jumps.typical_speed), *_doubt_gaps(tracks)]
    doubts += [*_doubt_jumps(moving, jumps), *_doubt_bodies(tracks)]
    return TrackReport((*describe_samples(tracks), *tracks.notes), (*tracks.doubts, *doubts))


def _locate(tracks: Samples, sample: int) -> str:
    return f"{tracks.file_time(tracks.time[sample])} (id {tracks.ids[tracks.owner[sample]]})"


def _doubt_units(tracks: Samples, typical_speed: float) -> Iterator[str]:
    """Times whose unit was guessed; coordinates that are as small, and change as slowly, as degrees."""
    if tracks.clock.guessed:
        yield f"Times are read as {tracks.clock.guessed}, not as seconds (--time-unit 1 reads seconds)."
    x, y, _ = np.abs(tracks.position + tracks.origin).max(axis=0, initial=0.0)
    if tracks.frame == "metres" and x <= 180 and y <= 90 and max(x, y) > 1 and 0 < typical_speed < _SLOW:
        yield "Columns x and y are read as metres, but may be degrees (--column lon=NAME --column lat=NAME reads them)."


def _doubt_gaps(tracks: Samples) -> Iterator[str]:
    interval, inside = np.diff(tracks.time), tracks.inner_steps
    expected = typical_intervals(tracks)[tracks.owner[:-1]]
    recording = np.searchsorted([begin for begin, _ in tracks.recordings], tracks.time, side="right")
    inside = inside & (np.diff(recording) == 0)  # between two recordings is no gap
    gaps = np.flatnonzero(inside & (interval > _GAP * expected))
    if len(gaps):
        longest_gap = int(gaps[interval[gaps].argmax()])
        longest = f"the longest takes {format_seconds(interval[longest_gap])}, after {_locate(tracks, longest_gap)}"
        yield f"{format_count(len(gaps), 'gap')} longer than {_GAP:g} typical intervals; {longest}."
    share = (inside & (np.abs(interval - expected) > _UNEVEN * expected)).sum() / max(int(inside.sum()), 1)
    if share > _UNEVEN:
        yield f"Sampling is uneven: {share:.0%} of the intervals differ from the typical one by more than 10 %."


def _doubt_bodies(tracks: Samples) -> Iterator[str]:
    if ids := find_one_body(tracks):
        names = list_names(ids, 6, ", …")
        advice = "If they are one body, with two tags or two estimates of its places, keep the rows of one."
        yield f"{len(ids)} ids ({names}) are hardly ever apart from another of them. {advice}"


def _doubt_jumps(tracks: Samples, jumps: Jumps) -> Iterator[str]:
    unit = f"{tracks.length_unit}/s"
    limit = f"more than {JUMP:g} times as fast as 95 % of the steps ({format_number(jumps.typical_speed, 3)} {unit})"
    if count := len(jumps.spikes):
        first = _locate(tracks, int(jumps.spikes[0]))
        yield f"{format_count(count, 'spike')}, samples to and from which tracks move {limit}; the first is at {first}."
    steps = np.setdiff1d(jumps.steps, np.concatenate([jumps.spikes, jumps.spikes - 1]))
    if count := len(steps):
        fastest = int(steps[jumps.speed[steps].argmax()])
        speed = f"{format_number(jumps.speed[fastest], 3)} {unit}"
        yield f"{format_count(count, 'jump')}, {limit}; the fastest has {speed}, after {_locate(tracks, fastest)}."

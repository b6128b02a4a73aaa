"""What is changed in samples before they are resampled: repeated places, pauses, spikes, jumps and noisy heights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from usnet_env.arrays import Floats, Indices
from usnet_env.config import format_count, list_names
from usnet_env.tracks.resample import close_jumps, leave_out_heights, leave_out_spikes, typical_intervals
from usnet_env.tracks.samples import Samples, SamplesT, keep_samples

_REPEAT_FACTOR = 2.0  # times as long as with a quarter of the ids, half of an id's places are repeated
_REST_SPEED = 0.25  # of the speed that 99 % of the steps don't exceed; an id that rests is slower
_MARGIN = 8  # typical intervals before and after movement that are kept, and of which a pause is left
_MIN_PAUSE_SHARE = 0.5  # of the time; shorter pauses in all stay
_MIN_LIVE = 32  # typical intervals; less movement is too little to read
_GAP = 3.0  # a gap is an interval of more than this many typical intervals


def clean_samples(tracks: SamplesT) -> tuple[SamplesT, list[str]]:
    """The tracks without repeated places, long pauses, spikes, gross jumps and noisy heights, and what was done."""
    cleaned, repeats = leave_out_repeats(tracks)
    cleaned, pauses = skip_pauses(cleaned)
    spikeless = leave_out_spikes(cleaned)
    spikes = cleaned.samples - spikeless.samples
    cleaned, jumps = close_jumps(spikeless)
    cleaned, noise = leave_out_heights(cleaned)
    notes = [*repeats, *pauses]
    if spikes:
        notes.append(f"{format_count(spikes, 'spike')} left out, unless keep_spikes (--keep-spikes) is given.")
    if jumps:
        notes.append(f"{format_count(jumps, 'jump')} closed: the track goes on from where it was before.")
    if noise:
        hidden = f"their noise of about {noise:.2g} {tracks.length_unit} hides the movement in a step"
        notes.append(f"Heights are left out: {hidden}.")
    return cleaned, notes


def leave_out_repeats(tracks: SamplesT) -> tuple[SamplesT, list[str]]:
    """The tracks without places that are older than their times, and a sentence about them.

    A receiver that is asked more often than places are renewed repeats the last one, so the id seems to be late. If the
    median place of an id is held twice as long as that of other ids, its repetitions are left out, but for a place that
    is held twice as long again: there, the id may rest.
    """
    is_same = (np.diff(tracks.position, axis=0) == 0).all(axis=1) & tracks.inner_steps
    if not is_same.any():
        return tracks, []
    starts = np.flatnonzero(np.append(True, ~is_same))
    length = np.diff(np.append(starts, tracks.samples))  # of each run of one place
    owner, runs = tracks.owner[starts], np.split(length, np.searchsorted(starts, tracks.offsets)[1:-1])
    typical_run = np.array([np.median(lengths) if len(lengths) >= _MARGIN else 0.0 for lengths in runs])
    is_stale = typical_run[owner] >= _REPEAT_FACTOR * max(1.0, np.quantile(typical_run, 0.25))
    is_stale &= length <= 2 * typical_run[owner]
    is_kept = np.repeat(~is_stale, length)
    is_kept[starts] = True
    if is_kept.all():
        return tracks, []
    names = list_names([tracks.ids[k] for k in np.unique(owner[is_stale])], 3)
    count = format_count(int((~is_kept).sum()), "repetition")
    note = f"{count} of places left out: those of {names} are renewed more rarely than sampled."
    return keep_samples(tracks, is_kept), [note]


def find_moving(tracks: Samples, intervals: Floats, interval: float) -> Indices:
    """Numbers of the times ``interval`` in which half of the ids that are seen move; ``intervals`` are those of ids.

    An id moves that is faster than a quarter of the speed that 99 % of the steps don't exceed.
    """
    from scipy.ndimage import median_filter  # a refusal does not wait for SciPy

    duration = np.diff(tracks.time)
    is_near = tracks.inner_steps & (duration <= _GAP * intervals[tracks.owner[:-1]])
    speed = np.linalg.norm(np.diff(tracks.position, axis=0), axis=1)[is_near] / duration[is_near]
    top_speed = np.quantile(median_filter(speed, 5), 0.99) if len(speed) else 0.0  # the speed of no spike
    number, index = np.unique(_number_intervals(tracks.time[:-1][is_near], interval), return_inverse=True)
    return number[2 * np.bincount(index, speed > _REST_SPEED * top_speed) >= np.bincount(index)]


def skip_pauses(tracks: SamplesT) -> tuple[SamplesT, list[str]]:
    """The tracks without pauses, if these are half of the time or more, and a sentence about them.

    Lags are counted in steps of movement, so a time in which no id moves or is seen holds nothing. A short gap stays.
    """
    if tracks.clock.recordings or not tracks.inner_steps.any():
        return tracks, []
    intervals = typical_intervals(tracks)
    interval = float(np.nanmedian(intervals))
    moving, total = find_moving(tracks, intervals, interval), int(tracks.duration / interval) + 1
    starts, ends = np.append(0, moving + _MARGIN + 1), np.append(moving - _MARGIN, total)
    is_pause, share = ends - starts > _MARGIN, len(moving) / total
    starts, ends = starts[is_pause], ends[is_pause]
    paused = int((ends - starts).sum())
    if paused < _MIN_PAUSE_SHARE * total:
        return tracks, []
    if total - paused < _MIN_LIVE:
        reason = f"Half of the ids that are seen move in {share:.1%} of the time only"
        return tracks, [f"{reason}, which may be too little to find who follows: a longer recording shows more."]
    skipped = np.cumsum(ends - starts - _MARGIN)  # with each pause
    number = _number_intervals(tracks.time, interval)
    pause = np.searchsorted(starts, number, side="right") - 1
    is_kept = (pause < 0) | (number >= ends[pause])
    delay = np.where(pause < 0, 0, skipped[pause]) * interval
    resumed, paused_for = ((ends - skipped) * interval).tolist(), (skipped * interval).tolist()
    clock = replace(tracks.clock, skipped=tuple(zip(resumed, paused_for, strict=True)))
    shortened = keep_samples(replace(tracks, time=tracks.time - delay, clock=clock), is_kept)
    count = f"{format_count(len(starts), 'pause')} skipped, {skipped[-1] / total:.0%} of the time"
    reason = f"no id is seen there, or fewer than half of those seen move; they move in {share:.1%}."
    return shortened, [f"{count}: {reason}"]


def _number_intervals(time: Floats, interval: float) -> Indices:
    return np.floor(time / interval + 1e-6).astype(np.int64)

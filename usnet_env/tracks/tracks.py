"""Recorded tracks of several animals or vehicles: what they hold, their resampling, and windows for detectors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from usnet_env.arrays import Floats, Indices
from usnet_env.config import ArgumentError, MissingExtraError, format_seconds, quote, real_number, whole_number
from usnet_env.tracks.clean import clean_samples
from usnet_env.tracks.report import TrackReport, describe_samples, find_problems
from usnet_env.tracks.resample import choose_step, resample_positions, typical_intervals, typical_stay
from usnet_env.tracks.samples import Samples, match_leaders, number_labels, sort_samples
from usnet_env.window import Window, as_array, frozen_array

_TYPICAL_STEPS, _MIN_STEPS = 100, 16  # steps of a window
_OTHER_FACTORS, _MAX_STEPS = (0.25, 0.5), 400  # times a chosen step; steps of a window at another step
_MIN_REMAINDER = 0.1  # of a window; so many steps at the end are no reason for one more window


@dataclass(frozen=True, eq=False)
class TrackWindow:
    """A window of recorded tracks, with what a :class:`usnet_env.Window` doesn't hold.

    Args:
        window: what a detector takes. Its velocities are the differences of the positions, metres per step, and its
            ``step`` is in seconds.
        ids: the ids of the N UAVs of the window, as in the file.
        rows: ``(N,)`` int64, index of each in ``Tracks.ids``.
        start: seconds of the first instant after the start of the tracks.
        end: seconds of the last instant.
        step: seconds between instants.
        origin: ``(3,)`` metres; add it to the window's positions to get those of the tracks.
        leader: ``(N,)`` int64, index in the window of the id that each follows through most of the window (-1: none or
            one that is not in the window), or ``None`` if the file has no leaders.
        left_out: the ids that are seen in the window, but in too few of its steps.
    """

    window: Window
    ids: tuple[str | int, ...]
    rows: Indices
    start: float
    end: float
    step: float
    origin: Floats
    leader: Indices | None = None
    left_out: tuple[str | int, ...] = ()

    def __repr__(self) -> str:
        return f"<TrackWindow of {len(self.ids)} ids from {self.start:g} s to {self.end:g} s, {self.window!r}>"

    def among(self, ids: int, steps: int | None = None) -> Window:
        """The window of all ids of the tracks, so many, in their coordinates; those that it lacks are not seen.

        If so many ``steps`` are more than it has, the first ones are unseen.
        """
        window = self.window
        steps = window.observation_steps if steps is None else steps
        seen = np.zeros((steps + 1, ids), bool)
        position, velocity = np.zeros((steps + 1, ids, 3), np.float32), np.zeros((steps, ids, 3), np.float32)
        first = steps - window.observation_steps
        seen[first:, self.rows], velocity[first:, self.rows] = window.seen, window.velocity
        position[first:, self.rows] = np.where(window.seen[..., None], window.position + self.origin, 0.0)
        return Window(position, velocity, seen, np.ones(ids, bool), step=self.step)


class Tracks(Samples):
    """The tracks of N ids: S samples, sorted by id and then by time. All arrays are read-only.

    :func:`usnet_env.tracks.read_tracks` and :meth:`from_samples` make them.

    Args:
        ids: the N ids as in the file, texts or whole numbers.
        offsets: ``(N + 1,)`` int64; the samples of id i are ``offsets[i]`` to ``offsets[i + 1] - 1``.
        time: ``(S,)`` float64, seconds after the earliest sample; it rises strictly within an id.
        position: ``(S, 3)`` float64, metres from ``origin``; z is 0 in planar tracks.
        origin: ``(3,)`` float64, the coordinates of the local origin: metres, or longitude and latitude in degrees and
            height in metres.
        leader: ``(S,)`` int64, index of the id that each id follows at that time (-1: none), or ``None`` if no
            leader is known.
        clock: how seconds are written as times of the file.
        frame: what the positions are, in words.
        notes: what the reader decided or found, a sentence each.
        doubts: what the reader warns of, and resampling, a sentence each.
        step: seconds between the samples if they lie on the common grid of :meth:`resample`, otherwise ``None``.
        source: the tracks of which :attr:`other_steps` are made, if the step was chosen.
        sampled: of resampled tracks, sentences about them before.
        max_gap: longest time in seconds that was interpolated, as :meth:`resample` got it.

    Example:
        >>> position = np.random.default_rng(0).normal(size=(200, 2)).cumsum(axis=0)
        >>> tracks = Tracks.from_samples(["a", "b"] * 100, np.repeat(np.arange(100), 2), position)
        >>> [track_window.start for track_window in tracks.resample(0.5).windows(length=60)]
        [0.0, 30.0, 60.0, 69.0]
    """

    @classmethod
    def from_samples(
        cls, ids: Sequence[str | int], time: ArrayLike, position: ArrayLike, leader: Sequence[str | int] | None = None
    ) -> Tracks:
        """Make tracks of S samples in any order.

        Args:
            ids: ``(S,)`` id of each sample, texts or whole numbers; if both, all are texts.
            time: ``(S,)`` seconds.
            position: ``(S, 2)`` or ``(S, 3)`` metres.
            leader: ``(S,)`` the id that each id follows, its own or ``""`` for none; ``None``: not known. One without a
                track counts as none; if none of them has a track, it is not known who leads.

        Raises:
            ArgumentError: lengths differ, values are not finite numbers, or an id has two samples at one time.
        """
        shape = as_array("position", position).shape
        points = frozen_array("position", position, np.float64, (None, 2 if shape[1:] == (2,) else 3))
        seconds = frozen_array("time", time, np.float64, (len(points),))
        codes, names = _read_ids("ids", ids, len(points))
        leaders: Indices | None = None
        notes: list[str] = []
        if leader is not None:
            leaders, notes = match_leaders(*_read_ids("leader", leader, len(points)), codes, names)
        return cls(**sort_samples(names, codes, seconds, list(points.T), leader=leaders, notes=notes))

    def __repr__(self) -> str:
        step = f", one every {self.step:g} s" if self.step else ""
        return f"<Tracks: {len(self.ids)} ids, {self.samples} samples, {self.duration:g} s{step}, {self.dimensions}-D>"

    def report(self) -> TrackReport:
        """What the tracks hold, and what is doubtful about them: nothing of it is repaired."""
        return find_problems(self)

    @property
    def facts(self) -> tuple[str, ...]:
        """Sentences about the tracks, before they were resampled, and what was decided since they were read."""
        return (*(self.sampled or describe_samples(self)), *self.notes)

    def resample(
        self, step: float | None = None, *, max_gap: float | None = None, keep_spikes: bool = False, length: int = 0
    ) -> Tracks:
        """Resample all tracks to one grid of times, which starts at the earliest sample.

        Where a grid step has at least three samples, the value at the grid time is that of a straight line that is
        fitted to the samples within half a step; otherwise it is interpolated linearly between the two samples around
        it. An id has no sample at grid times that no two samples enclose, or whose two samples are further apart than
        ``max_gap``. Samples off the track, to which it jumps and back, are left out (``find_jumps``), gross jumps
        that stay are closed, and heights are left out if their noise exceeds the movement of the other axes.

        Args:
            step: seconds between grid times. ``None`` chooses it: at least so long that the movement in a step exceeds
                the jitter of the positions, and then the shortest that shows clearly which id follows which, after 1 to
                4 steps; ``notes`` say which and why.
            max_gap: longest time in seconds between two samples that is interpolated; ``None``: one and a half times
                the interval that 90 % of the id's intervals don't exceed, at least the step.
            keep_spikes: whether to keep spikes, jumps and noisy heights.
            length: steps of the windows that will be cut, for which a chosen step leaves room; 0: not known.

        Raises:
            ArgumentError: ``step`` or ``max_gap`` is not a positive number, or no id has two samples, before or after.
        """
        max_gap = None if max_gap is None else real_number("max_gap", max_gap, 1e-9, 1e9)
        step = None if step is None else real_number("step", step, 1e-9, 1e9)
        if (np.diff(self.offsets) < 2).all():
            raise ArgumentError("tracks must hold an id with at least 2 samples; each id has only one.")
        tracks, notes = self, [*self.notes]
        if not keep_spikes:
            tracks, changes = clean_samples(self)
            notes += changes
        source = replace(tracks, leader=None) if step is None else None
        interval, doubts = float(np.nanmedian(typical_intervals(self))), self.doubts
        if step is not None and step < interval / 2:
            far = f"The step of {format_seconds(step)} is far below the sampling interval, {format_seconds(interval)}"
            doubts = (*doubts, f"{far}: most positions are interpolated, and what is found may be wrong.")
        if step is None:
            step, reason = choose_step(tracks, length)
            notes.append(reason)
        resampled = resample_positions(tracks, step, max_gap)
        if not resampled.inner_steps.any():
            got = f"{step:g} s for tracks of {self.duration:g} s"
            raise ArgumentError(f"step must be so short that an id is seen at two times, got {got} (--step sets it).")
        sampled = self.sampled or describe_samples(self)
        details: Any = {"notes": tuple(notes), "doubts": doubts, "source": source, "sampled": sampled}
        return replace(resampled, max_gap=max_gap, **details)

    @cached_property
    def other_steps(self) -> tuple[Tracks, ...]:
        """The tracks at a quarter and a half of a chosen step, if samples are so near; else none."""
        if not self.source or not self.step:
            return ()
        least = float(np.nanmedian(typical_intervals(self.source))) * (1 - 1e-6)
        steps = [factor * self.step for factor in _OTHER_FACTORS if factor * self.step >= least]
        return tuple(resample_positions(self.source, step, self.max_gap) for step in steps)

    def cut_like(self, track_window: TrackWindow, most: int = _MAX_STEPS) -> TrackWindow | None:
        """The window with the same ids and times in these tracks; ``None`` if it is of no use or has too many steps."""
        step = float(self.step or 1.0)
        first = int(np.ceil(track_window.start / step - 1e-6))
        length = int(np.floor(track_window.end / step + 1e-6)) - first
        return None if length > most else _cut_window(self, first, length, 0, track_window.rows)

    def to_dataset(self) -> Any:
        """A dataset of xarray with ``position`` in metres ``(time, space, individuals)``, as that of movement."""
        try:
            import xarray
        except ModuleNotFoundError:
            raise MissingExtraError("to_dataset needs xarray; `pip install xarray` installs it.") from None
        times, instant = np.unique(self.time, return_inverse=True)
        position = np.full((len(times), 3, len(self.ids)), np.nan)
        position[instant, :, self.owner] = self.position + self.origin * ("degrees" not in self.frame)
        coordinates: Any = {"time": times, "space": [*"xyz"][: self.dimensions], "individuals": [*self.ids]}
        attributes: dict[str, Any] = {"time_unit": "seconds", "source_software": "usnet"}
        attributes |= {"fps": 1 / self.step} if self.step else {}
        return xarray.Dataset({"position": ([*coordinates], position[:, : self.dimensions])}, coordinates, attributes)

    def windows(
        self, length: int | None = None, stride: int | None = None, *, least_steps: int | None = None
    ) -> Iterator[TrackWindow]:
        """Cut resampled tracks into windows; tracks that are not resampled are resampled with a step that is chosen.

        Args:
            length: number of steps of a window (T_ob); it has one more instant. ``None``: :meth:`choose_length`.
            stride: number of steps from the start of a window to the start of the next; ``None``: ``length``. The last
                window ends at the end of the tracks.
            least_steps: number of steps in which an id must be seen, at most ``length``; ``None``: half of them. A
                window with fewer than two such ids is left out.

        Raises:
            ArgumentError: an argument is out of range, or the tracks are shorter than one window.
        """
        resampled = self if self.step is not None else self.resample()
        length = resampled.choose_length() if length is None else whole_number("length", length, 1, 10**7)
        stride = length if stride is None else whole_number("stride", stride, 1, 10**9)
        least_steps = -(-length // 2) if least_steps is None else whole_number("least_steps", least_steps, 1, length)
        starts, step = resampled._window_starts(length, stride), float(resampled.step or 1.0)
        if not len(starts):
            limit = f"{round(resampled.duration / step)}, the steps of {step:g} s in the tracks"
            raise ArgumentError(f"length must be at most {limit}, got {length} (--window sets it).")
        instants = np.unique(resampled.step_numbers)
        filled = np.searchsorted(instants, starts + length, side="right") > np.searchsorted(instants, starts)
        return filter(None, (_cut_window(resampled, int(first), length, least_steps) for first in starts[filled]))

    def choose_length(self) -> int:
        """Steps of windows that fit resampled tracks: 100 to 199, or fewer if ids typically stay for fewer steps."""
        step = self.step or 1.0
        steps = round(min(end - begin for begin, end in self.recordings) / step)
        stay = round(typical_stay(self) / step)
        min_steps = max(1, min(_TYPICAL_STEPS, steps, max(stay, _MIN_STEPS)))
        return max(1, steps // max(1, steps // min_steps))

    def count_windows(self, length: int, stride: int) -> int:
        """Number of windows in resampled tracks."""
        return len(self._window_starts(length, stride))

    def _window_starts(self, length: int, stride: int) -> Indices:
        """First steps of the windows. The last one ends at the last step: one more, or the last, moved by a little."""
        all_starts = []
        for begin, end in self.recordings:
            last = round(end / (self.step or 1.0)) - length
            starts = np.arange(np.ceil(round(begin / (self.step or 1.0), 6)), last + 1, stride).astype(np.int64)
            if len(starts) and last - starts[-1] > length * _MIN_REMAINDER:
                starts = np.append(starts, last)
            starts[-1:] = last
            all_starts.append(starts)
        return np.concatenate(all_starts)


def _read_ids(name: str, value: Any, samples: int) -> tuple[Indices, tuple[str | int, ...]]:
    ids = as_array(name, value)
    labels = ids.tolist()
    if ids.shape != (samples,) or not samples or not all(isinstance(label, str | int) for label in labels):
        raise ArgumentError(f"{name} must hold a text or a whole number for {samples} samples, got {quote(value)}.")
    return number_labels(pd.Series(labels, dtype=object))


def _cut_window(
    tracks: Tracks, first: int, length: int, least_steps: int, subset: Indices | None = None
) -> TrackWindow | None:
    """Cut the window from grid time ``first`` on, of the ids in ``subset`` or all, if two are seen long enough."""
    step, instant = float(tracks.step or 0.0), tracks.step_numbers - first
    samples = np.flatnonzero((instant >= 0) & (instant <= length))
    rows = np.unique(tracks.owner[samples]) if subset is None else subset
    samples = samples[np.isin(tracks.owner[samples], rows)]
    column = np.searchsorted(rows, tracks.owner[samples])
    seen = np.zeros((length + 1, len(rows)), bool)
    seen[instant[samples], column] = True
    is_enough = (seen[1:] & seen[:-1]).sum(axis=0) >= least_steps
    if is_enough.sum() < 2:
        return None
    is_kept = is_enough[column]
    left_out = tuple(tracks.ids[i] for i in rows[~is_enough])
    samples, column = samples[is_kept], (np.cumsum(is_enough) - 1)[column[is_kept]]
    rows, seen = rows[is_enough], seen[:, is_enough]
    origin = tracks.position[samples].mean(axis=0)
    position = np.zeros((length + 1, len(rows), 3))
    position[instant[samples], column] = tracks.position[samples] - origin
    velocity = np.where((seen[1:] & seen[:-1])[..., None], np.diff(position, axis=0), 0.0)
    leader = None
    if tracks.leader is not None:
        pairs = pd.DataFrame({"column": column, "leader": tracks.leader[samples]}).groupby(["column", "leader"]).size()
        most_frequent = pairs.sort_values(ascending=False, kind="stable").reset_index().drop_duplicates("column")
        leader = pd.Index(rows).get_indexer(most_frequent.sort_values("column")["leader"]).astype(np.int64)
    ids, alive = tuple(tracks.ids[i] for i in rows), np.ones(len(rows), bool)
    window = Window(position.astype(np.float32), velocity.astype(np.float32), seen, alive, step=step)
    return TrackWindow(window, ids, rows, first * step, (first + length) * step, step, origin, leader, left_out)

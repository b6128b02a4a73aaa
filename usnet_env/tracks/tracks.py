"""Recorded tracks: positions of several animals or vehicles over time, with times and ids as in their file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.config import ArgumentError, format_number, quote, real_number, whole_number
from usnet_env.tracks.findings import TrackReport, find_problems
from usnet_env.tracks.jumps import leave_out_spikes
from usnet_env.tracks.labels import match_leaders
from usnet_env.tracks.resampling import choose_step, resample_positions
from usnet_env.tracks.windows import TrackWindow, cut_windows
from usnet_env.window import as_array, frozen_array

_DIGITS = 9  # decimals of a time that is written as a number, where float64 has as many
_EPOCH = datetime(1970, 1, 1)
_UNIT_NAMES = {1.0: "s", 1e-3: "ms", 1e-6: "µs", 1e-9: "ns", 60.0: "min", 3600.0: "h"}
_SHORTEST_STEP, _LONGEST_STEP = 1e-9, 1e9  # seconds


@dataclass(frozen=True)
class Clock:
    """How seconds of :class:`Tracks` are written as times of the file.

    Args:
        origin: the file's time at second 0: a number in units of the file, or seconds since 1970-01-01 UTC.
        unit: seconds in one unit of the file's times; 1 for timestamps.
        timestamps: whether the file's times are dates with a time of day; they are written as ISO 8601 in UTC.
        whole: whether the file's times are whole numbers.
        frames: whether the file's times are numbers of frames.
        likely_unit: 0.001, 1e-6 or 1e-9 seconds, if the times were read as seconds because no unit was given, but their
            numbers or the name of their column say this unit; otherwise ``None``.
    """

    origin: float = 0.0
    unit: float = 1.0
    timestamps: bool = False
    whole: bool = False
    frames: bool = False
    likely_unit: float | None = None

    @property
    def unit_name(self) -> str:
        """The unit of the file's times, such as ``"s"`` or ``"frames"``; nothing for timestamps."""
        if self.timestamps or self.frames:
            return "frames" if self.frames else ""
        return _UNIT_NAMES.get(self.unit, f"units of {format_number(self.unit)} s")

    def file_time(self, seconds: float) -> float | int | str:
        """Write ``seconds`` after the start as a time of the file."""
        if self.timestamps:
            moment = _EPOCH + timedelta(milliseconds=round(1000 * (self.origin + seconds)))
            return moment.isoformat(timespec="milliseconds") + "Z"
        number = self.origin + seconds / self.unit
        number = round(number, _count_decimals(number))
        return int(number) if self.whole and number.is_integer() else number


@dataclass(frozen=True, eq=False)
class Tracks:
    """The tracks of N ids: S samples, sorted by id and then by time. All arrays are read-only.

    Args:
        ids: the N ids as in the file, texts or whole numbers.
        offsets: ``(N + 1,)`` int64; the samples of id i are ``offsets[i]`` to ``offsets[i + 1] - 1``.
        time: ``(S,)`` float64, seconds after the earliest sample; it rises strictly within an id.
        position: ``(S, 3)`` float64, metres from ``origin``; z is 0 in planar tracks.
        origin: ``(3,)`` float64, the coordinates of the local origin: metres, or longitude and latitude in degrees and
            height in metres.
        velocity: ``(S, 3)`` float64, the velocities in the file, or ``None``. They are compared with the positions in
            :meth:`report` and are not used for anything else.
        leader: ``(S,)`` int64, index of the id that each id follows at that time (-1: none), or ``None`` if the file
            has no column of leaders, or if none of the leaders in it has a track.
        clock: how seconds are written as times of the file.
        frame: what the positions are, in words.
        notes: what the reader decided or found, a sentence each.
        step: seconds between the samples if they lie on the common grid of :meth:`resample`, otherwise ``None``.

    Raises:
        ArgumentError: an array has another shape, values that are not finite, or samples in another order.
    """

    ids: tuple[str | int, ...]
    offsets: Indices
    time: Floats
    position: Floats
    origin: Floats
    velocity: Floats | None = None
    leader: Indices | None = None
    clock: Clock = Clock()
    frame: str = "metres"
    notes: tuple[str, ...] = ()
    step: float | None = None

    def __post_init__(self) -> None:
        def put(name: str, dtype: type, shape: tuple[int | None, ...]) -> Any:
            value = getattr(self, name)
            if not _is_frozen(value, dtype, shape):  # a second copy of large files would double the memory
                value = frozen_array(name, value, dtype, shape)
            object.__setattr__(self, name, value)
            return value

        if len(set(self.ids)) != len(self.ids) or not self.ids:
            raise ArgumentError(f"ids must be different and at least one, got {quote(self.ids)}.")
        time = put("time", np.float64, (None,))
        offsets = put("offsets", np.int64, (len(self.ids) + 1,))
        if offsets[0] != 0 or offsets[-1] != len(time) or (np.diff(offsets) < 0).any():
            raise ArgumentError(f"offsets must rise from 0 to the {len(time)} samples, got {quote(offsets)}.")
        put("position", np.float64, (len(time), 3))
        put("origin", np.float64, (3,))
        if self.velocity is not None:
            put("velocity", np.float64, (len(time), 3))
        if self.leader is not None:
            leader = put("leader", np.int64, (len(time),))
            if not ((leader >= -1) & (leader < len(self.ids))).all():
                raise ArgumentError(f"leader must hold indices from -1 to {len(self.ids) - 1}, got {quote(leader)}.")
        if (np.diff(time)[self.inner_steps] <= 0).any():
            raise ArgumentError("time must rise strictly within each id; it does not.")

    @classmethod
    def from_samples(
        cls, ids: Sequence[str | int], time: ArrayLike, position: ArrayLike, leader: Sequence[str | int] | None = None
    ) -> Tracks:
        """Make tracks of S samples in any order.

        Args:
            ids: ``(S,)`` id of each sample, texts or whole numbers; if both, all are texts.
            time: ``(S,)`` seconds.
            position: ``(S, 2)`` or ``(S, 3)`` metres.
            leader: ``(S,)`` the id that each id follows, its own or ``""`` for none; ``None``: not known. As in files,
                a leader is the id of the same text, or else of an equal number. One without a track counts as none, and
                ``notes`` name it; if none of them has a track, it is not known who leads.

        Raises:
            ArgumentError: lengths differ, values are not finite numbers, or an id has two samples at one time.
        """
        places = as_array("position", position)
        if places.ndim != 2 or places.shape[1] not in (2, 3):
            raise ArgumentError(f"position must have shape (any, 2) or (any, 3), got {places.shape}.")
        samples = len(places)
        places = frozen_array("position", places, np.float64, (samples, places.shape[1]))
        seconds = frozen_array("time", time, np.float64, (samples,))
        codes, names = _read_ids("ids", ids, samples)
        led: Indices | None = None
        notes: list[str] = []
        if leader is not None:
            led, notes = match_leaders(*_read_ids("leader", leader, samples), codes, names)
        return assemble(names, codes, seconds, list(places.T), None, led, Clock(), "metres", tuple(notes))

    @property
    def samples(self) -> int:
        """S, the number of samples."""
        return len(self.time)

    @property
    def dimensions(self) -> int:
        """2 if all heights are equal, otherwise 3."""
        height = self.position[:, 2]
        return 3 if len(height) and (height != height[0]).any() else 2

    @property
    def duration(self) -> float:
        """Seconds from the earliest to the latest sample."""
        return float(self.time.max(initial=0.0))

    @property
    def inner_steps(self) -> Mask:
        """``(S - 1,)`` bool: whether sample s and s + 1 belong to the same id."""
        inner = np.ones(max(len(self.time) - 1, 0), bool)
        edges = self.offsets[1:-1]
        inner[edges[(edges > 0) & (edges < len(self.time))] - 1] = False
        return inner

    def report(self) -> TrackReport:
        """What the tracks hold, and what is doubtful about them: nothing of it is repaired."""
        return find_problems(self)

    def resample(self, step: float | None = None, *, max_gap: float | None = None, keep_spikes: bool = False) -> Tracks:
        """Resample all tracks to one grid of times, which starts at the earliest sample.

        Where a grid step has at least three samples, the value at the grid time is that of a straight line that is
        fitted to the samples within half a step; otherwise it is interpolated linearly between the two samples around
        it. Both are exact for straight flight at constant speed. An id has no sample at grid times that no two samples
        enclose, or whose two samples are further apart than ``max_gap``. Spikes, single samples off the track, are left
        out: a track jumps to them and back from them, and the way past them is no jump.

        Args:
            step: seconds between grid times. ``None`` chooses it: at least so long that the movement in a step exceeds
                the noise of the positions, and then the shortest that shows clearly which id follows which, after 1 to
                4 steps; ``notes`` say which and why.
            max_gap: longest time in seconds between two samples that is interpolated; ``None``: one and a half times
                the interval that 90 % of the id's intervals don't exceed, at least the step.
            keep_spikes: whether to keep spikes.

        Raises:
            ArgumentError: ``step`` or ``max_gap`` is not a positive number, ``keep_spikes`` is not a truth value, or no
                id has two samples.
        """
        if max_gap is not None:
            max_gap = real_number("max_gap", max_gap, _SHORTEST_STEP, _LONGEST_STEP)
        if not isinstance(keep_spikes, bool):
            raise ArgumentError(f"keep_spikes must be True or False, got {quote(keep_spikes)}.")
        tracks = self if keep_spikes else leave_out_spikes(self)
        spikes = self.samples - tracks.samples
        if step is None:
            step, why = choose_step(tracks)
        else:
            step = real_number("step", step, _SHORTEST_STEP, _LONGEST_STEP)
            why = (f"The step of {format_number(step)} s was given.",)
        offsets, time, position, leader = resample_positions(tracks, step, max_gap)
        if spikes:
            left_out = "1 spike was" if spikes == 1 else f"{spikes} spikes were"
            why = (*why, f"{left_out} left out, unless keep_spikes=True is given.")
        return replace(
            self,
            offsets=offsets,
            time=time,
            position=position,
            velocity=None,
            leader=leader,
            notes=(*self.notes, *why),
            step=step,
        )

    def windows(
        self, length: int = 100, stride: int | None = None, *, least_steps: int | None = None
    ) -> Iterator[TrackWindow]:
        """Cut resampled tracks into windows; tracks that are not resampled are resampled with a step that is chosen.

        A window holds the ids that are seen in at least ``least_steps`` of its steps. Windows with fewer than two such
        ids are left out.

        Args:
            length: number of steps of a window (T_ob); it has one more instant.
            stride: number of steps from the start of a window to the start of the next; ``None``: ``length``.
            least_steps: number of steps in which an id must be seen, at most ``length``; ``None``: half of them.

        Raises:
            ArgumentError: an argument is out of range, or the tracks are shorter than one window.
        """
        length = whole_number("length", length, 1, 10**7)
        stride = length if stride is None else whole_number("stride", stride, 1, 10**9)
        least_steps = -(-length // 2) if least_steps is None else whole_number("least_steps", least_steps, 1, length)
        even = self if self.step is not None else self.resample()
        return cut_windows(even, length, stride, least_steps)

    def file_time(self, seconds: float) -> float | int | str:
        """Write ``seconds`` after the start as a time of the file."""
        return self.clock.file_time(seconds)


def _read_ids(name: str, value: Any, samples: int) -> tuple[Indices, tuple[str | int, ...]]:
    """Which of the different ids each sample has, ``(S,)``, and these ids: whole numbers if all are, otherwise texts.

    Raises:
        ArgumentError: there are none, another number of them, or other values among them.
    """
    ids = as_array(name, value)
    if ids.shape != (samples,) or not samples:
        raise ArgumentError(f"{name} must name each of the {samples} samples, at least one, got {quote(value)}.")
    plain = ids.tolist()
    if not all(isinstance(each, str | int) and not isinstance(each, bool) for each in plain):
        raise ArgumentError(f"{name} must hold texts or whole numbers, got {quote(value)}.")
    if len({isinstance(each, str) for each in plain}) > 1:  # NumPy makes texts of them, too, unless they are objects
        plain = [str(each) for each in plain]
    code: dict[str | int, int] = {}
    return np.array([code.setdefault(each, len(code)) for each in plain], np.int64), tuple(code)


def assemble(
    ids: tuple[str | int, ...],
    codes: NDArray[np.integer[Any]],
    time: Floats,
    position: list[Floats],
    velocity: Floats | None,
    leader: Indices | None,
    clock: Clock,
    frame: str,
    notes: tuple[str, ...],
    origin: Floats | None = None,
    name_places: Callable[[int, int], str] = lambda *both: f"samples {min(both)} and {max(both)}",
) -> Tracks:
    """Sort samples by id and time, and move the origin of time and space to the first sample and the middle.

    The arguments are those of :class:`Tracks`, but for ``codes`` ``(S,)``, index of the id of each sample in the order
    of the file; ``time`` ``(S,)`` in the clock's unit, or in seconds for timestamps; ``position``, the two or three
    coordinates ``(S,)``, a list that is emptied to free their memory; ``origin``, if the positions are relative to it
    already; and ``name_places``, which names where two samples stand, counted in the order of the file.

    Raises:
        ArgumentError: two samples of an id have one time and different places; the sentence names their rows.
    """
    start = float(time.min())
    latest = max(abs(start), abs(float(time.max())))
    time = time - start
    if _count_decimals(latest) < _DIGITS:  # seconds since 1970: the difference of two has as few decimals
        time = np.round(time, _count_decimals(latest))
    time *= clock.unit
    clock = replace(clock, origin=clock.origin + start)
    order: Any = slice(None)
    if not _is_sorted(codes, time):
        order = np.lexsort((time, codes))
        codes, time = codes[order], time[order]
    places = np.zeros((len(time), 3))
    for axis in reversed(range(len(position))):
        places[:, axis] = position.pop()[order]
    same = (np.diff(codes) == 0) & (np.diff(time) <= 0)
    if same.any():
        rows = np.arange(len(time))[order]
        doubled = np.flatnonzero(same)
        differ = (places[doubled] != places[doubled + 1]).any(axis=1)
        if differ.any():
            k = int(doubled[np.flatnonzero(differ)[0]])
            moment = clock.file_time(float(time[k]))
            raise ArgumentError(
                f"time must differ between the samples of an id, got {quote(moment)} with two places for id "
                f"{quote(ids[int(codes[k])])} in {name_places(int(rows[k]), int(rows[k + 1]))}."
            )
        notes = (
            *notes,
            f"Left out as repetitions (same id, time and place): {len(doubled)} sample{'s' * (len(doubled) > 1)}.",
        )
        keep = np.append(True, ~same)
        places, time, codes, order = places[keep], time[keep], codes[keep], rows[keep]
    if origin is None:
        origin = np.round((places.min(axis=0) + places.max(axis=0)) / 2)
        places -= origin
    for array in (time, places):
        array.setflags(write=False)
    return Tracks(
        ids=ids,
        offsets=np.searchsorted(codes, np.arange(len(ids) + 1)),
        time=time,
        position=places,
        origin=origin,
        velocity=None if velocity is None else velocity[order],
        leader=None if leader is None else leader[order],
        clock=clock,
        frame=frame,
        notes=notes,
    )


def _count_decimals(number: float) -> int:
    """How many decimals float64 has at this size, at most 9; -3 if it has whole thousands."""
    return min(_DIGITS, math.floor(-np.log10(np.spacing(abs(number)))))


def _is_frozen(value: Any, dtype: type, shape: tuple[int | None, ...]) -> bool:
    """Whether ``value`` is what ``frozen_array`` would return a copy of: read-only, its own, finite, of this type."""
    return (
        isinstance(value, np.ndarray)
        and value.dtype == dtype
        and value.flags.owndata
        and not value.flags.writeable
        and value.ndim == len(shape)
        and all(want in (None, has) for want, has in zip(shape, value.shape, strict=True))
        and bool(np.isfinite(value).all())
    )


def _is_sorted(codes: NDArray[Any], time: Floats) -> bool:
    """Whether samples are sorted by id and time already; then their order takes no memory."""
    step = np.diff(codes)
    return bool((step >= 0).all() and (np.diff(time)[step == 0] >= 0).all())

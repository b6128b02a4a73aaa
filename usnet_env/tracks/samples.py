"""Samples of recorded tracks, sorted by id and time, and the clock that writes their times as the file does."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, Literal, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.config import ArgumentError, format_count, quote

_COMPARED_INSTANTS = 64  # at which ids are compared
_MAX_DISTANCE, _MAX_DRIFT = 0.01, 0.03  # of the way, and of the movement
_MAX_NOISE_PRODUCT, _MIN_COSINE = 0.3, 0.7  # of the square, and of the size of an offset
_MAX_DECIMALS = 9  # decimals of a time that is written as a number, where float64 has as many
_EPOCH = datetime(1970, 1, 1)
_EMPTY_CELLS = {"", "-", "na", "n/a", "#n/a", "nan", "null", "none", "nat", "\\n", "?"}


@dataclass(frozen=True)
class Clock:
    """How seconds of :class:`Tracks` are written as times of the file.

    Args:
        origin: the file's time at second 0: a number in units of the file, or seconds since 1970-01-01 UTC.
        unit: seconds in one unit of the file's times; 1 for timestamps.
        timestamps: whether the file's times are dates with a time of day; they are written as ISO 8601 in UTC.
        whole: whether the file's times are whole numbers.
        guessed: what the times were taken for by the size of their numbers, such as "days of a spreadsheet".
        zone: the time zone of the file's timestamps, if they have one.
        recordings: of pooled tracks, the name, the first and the last second, and the clock of each, in this order.
        skipped: of tracks without their pauses, seconds from which on so many seconds in all were skipped.
    """

    origin: float = 0.0
    unit: float = 1.0
    timestamps: bool = False
    whole: bool = False
    guessed: str = ""
    zone: Any = None
    recordings: tuple[tuple[str, float, float, Clock], ...] = ()
    skipped: tuple[tuple[float, float], ...] = ()

    def file_time(self, seconds: float) -> float | int | str:
        """Write ``seconds`` after the start as a time of the file."""
        seconds += max((pause for begin, pause in self.skipped if begin <= seconds), default=0.0)
        if self.recordings:
            name, begin, _, clock = min(self.recordings, key=lambda each: max(each[1] - seconds, seconds - each[2]))
            return f"{name}: {clock.file_time(max(0.0, seconds - begin))}"
        if self.timestamps:
            moment = _EPOCH + timedelta(milliseconds=round(1000 * (self.origin + seconds)))
            return moment.isoformat(timespec="milliseconds").removesuffix(".000") + "Z"
        number = self.origin + seconds / self.unit
        number = round(number, _count_decimals(number))
        return int(number) if self.whole and number.is_integer() else number


@dataclass(frozen=True, eq=False)
class Samples:
    """The fields of :class:`usnet_env.tracks.Tracks`, which describes them; the arrays become read-only."""

    ids: tuple[str | int, ...]
    offsets: Indices
    time: Floats
    position: Floats
    origin: Floats
    leader: Indices | None = None
    clock: Clock = Clock()
    frame: str = "metres"
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    step: float | None = None
    source: Any = None
    sampled: tuple[str, ...] = ()
    max_gap: float | None = None

    def __post_init__(self) -> None:
        for values in vars(self).values():
            if isinstance(values, np.ndarray):
                values.setflags(write=False)

    @property
    def samples(self) -> int:
        """S, the number of samples."""
        return len(self.time)

    @property
    def dimensions(self) -> int:
        """2 if all heights are equal, otherwise 3."""
        return 3 if (self.position[:, 2] != self.position[:1, 2]).any() else 2

    @property
    def length_unit(self) -> str:
        """What the positions are in, in short: ``px`` or ``m``."""
        return "px" if self.frame == "pixels" else "m"

    @property
    def duration(self) -> float:
        """Seconds from the earliest to the latest sample."""
        return float(self.time.max(initial=0.0))

    @property
    def recordings(self) -> list[tuple[float, float]]:
        """The first and the last second of each recording: of all tracks, if they are not pooled."""
        return [(begin, end) for _, begin, end, _ in self.clock.recordings] or [(0.0, self.duration)]

    @cached_property
    def owner(self) -> Indices:
        """``(S,)`` index of the id of each sample."""
        return np.repeat(np.arange(len(self.ids)), np.diff(self.offsets))

    @property
    def inner_steps(self) -> Mask:
        """``(S - 1,)`` bool: whether sample s and s + 1 belong to the same id."""
        return np.asarray(np.diff(self.owner) == 0)

    @cached_property
    def step_numbers(self) -> Indices:
        """``(S,)`` number of the grid time of each sample, of resampled tracks."""
        return np.round(self.time / (self.step or 1.0)).astype(np.int64)

    def file_time(self, seconds: float) -> float | int | str:
        """Write ``seconds`` after the start as a time of the file."""
        return self.clock.file_time(seconds)


SamplesT = TypeVar("SamplesT", bound=Samples)


def sort_samples(
    ids: tuple[str | int, ...],
    codes: NDArray[np.integer[Any]],
    time: Floats,
    axes: list[Floats],
    *,
    clock: Clock = Clock(),
    origin: Floats | None = None,
    leader: Indices | None = None,
    notes: Sequence[str] = (),
    duplicates: Literal["error", "first", "mean"] = "error",
) -> dict[str, Any]:
    """The fields of :class:`Samples` but for ``frame`` and ``step``, of samples in any order, without repetitions.

    Of several places of an id at one time, ``duplicates`` keeps the first or the mean.

    ``codes`` ``(S,)`` is the index of the id of each sample, ``time`` ``(S,)`` is in the clock's unit, or in seconds
    for timestamps, and ``axes`` are the two or three coordinates ``(S,)``, relative to ``origin`` if it is given.
    """
    start = float(time.min())
    latest = max(abs(start), abs(float(time.max())))
    time = time - start
    if _count_decimals(latest) < _MAX_DECIMALS:  # seconds since 1970: the difference of two has as few decimals
        time = np.round(time, _count_decimals(latest))
    time *= clock.unit
    clock = replace(clock, origin=clock.origin + start)
    order = np.lexsort((time, codes))
    codes, time = codes[order], time[order]
    position = np.zeros((len(time), 3))
    position[:, : len(axes)] = np.stack(axes, axis=1)[order]
    repeated = np.flatnonzero((np.diff(codes) == 0) & (np.diff(time) <= 0))
    if len(repeated):
        conflicts = repeated[(position[repeated] != position[repeated + 1]).any(axis=1)]
        if len(conflicts) and duplicates == "error":
            moment, name = quote(clock.file_time(float(time[conflicts[0]]))), quote(ids[codes[conflicts[0]]])
            raise ArgumentError(
                f"time must differ between samples of an id, got {moment} with two places for id {name} "
                f"({format_count(len(conflicts), 'such pair')}; duplicates='first' or 'mean', or --duplicates, helps)."
            )
        if duplicates == "mean":
            first = np.setdiff1d(np.arange(len(time)), repeated + 1)
            position[first] = np.add.reduceat(position, first) / np.diff(np.append(first, len(time)))[:, None]
        same = "same id and time" if len(conflicts) else "same id, time and place"
        notes = [*notes, f"Left out as repetitions ({same}): {format_count(len(repeated), 'sample')}."]
        order = np.delete(order, repeated + 1)
        codes, time, position = (np.delete(values, repeated + 1, axis=0) for values in (codes, time, position))
    if origin is None:
        origin = np.round((position.min(axis=0) + position.max(axis=0)) / 2)
        position -= origin
    return {
        "ids": ids,
        "offsets": np.searchsorted(codes, np.arange(len(ids) + 1)),
        "time": time,
        "position": position,
        "origin": origin,
        "leader": None if leader is None else leader[order],
        "clock": clock,
        "notes": tuple(notes),
    }


def keep_samples(tracks: SamplesT, is_kept: Mask) -> SamplesT:
    """The tracks with some of their samples, ``(S,)`` bool."""
    offsets = np.append(0, np.cumsum(is_kept))[tracks.offsets]
    leader = None if tracks.leader is None else tracks.leader[is_kept]
    return replace(tracks, offsets=offsets, time=tracks.time[is_kept], position=tracks.position[is_kept], leader=leader)


def split_gaps(tracks: SamplesT, gap: float) -> SamplesT:
    """The tracks with another id after each gap of more than so many seconds: ``a``, then ``a/2``, ``a/3``."""
    parts = np.flatnonzero(np.append(True, ~tracks.inner_steps | (np.diff(tracks.time) > gap)))
    owner, start = tracks.owner[parts], tracks.time[parts]
    number = np.arange(len(parts)) - np.searchsorted(owner, owner)
    if len(parts) == tracks.samples > len(tracks.ids):
        got = f"{gap:g} s, which leaves each id with one sample"
        raise ArgumentError(f"split_gap (--split-gap) must be longer than the sampling interval, got {got}.")
    if not number.any():
        return tracks
    ids = tuple(f"{tracks.ids[k]}/{n + 1}" if n else str(tracks.ids[k]) for k, n in zip(owner, number, strict=True))
    leader = tracks.leader
    if leader is not None:  # the part of the leader that is there, or was last
        stride = tracks.duration + 1.0
        part = np.searchsorted(owner * stride + start, leader * stride + tracks.time, side="right") - 1
        leader = np.where(leader < 0, -1, np.maximum(part, np.searchsorted(owner, leader)))
    return replace(tracks, ids=ids, offsets=np.append(parts, tracks.samples), leader=leader)


def find_one_body(tracks: Samples) -> list[str | int]:
    """The ids that may be one body with another: all the time as near as 1 % of their way, and as if tied to it.

    Two estimates of a vehicle's places drift apart slowly, and neither is behind. The offsets between two tags of an
    animal are noise: successive ones are not alike.
    """
    if not tracks.inner_steps.any():
        return []
    interval, delay = 2 * np.median(np.diff(tracks.time)[tracks.inner_steps]), tracks.duration / _COMPARED_INSTANTS / 8
    starts = np.linspace(0.0, tracks.duration - max(interval, delay), _COMPARED_INSTANTS)
    times, plane = np.concatenate([starts, starts + interval, starts + delay]), tracks.position @ (1, 1j, 0)
    parts = [slice(*ends) for ends in pairwise(tracks.offsets)]
    positions = np.array([np.interp(times, tracks.time[part], plane[part], np.nan, np.nan) for part in parts])
    present, after_interval, after_delay = np.split(positions, 3, axis=1)
    rows_found, time_mean = set[int](), partial(np.nanmean, axis=1)
    with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore"):  # of ids that are never seen together
        extent = 2 * np.nanmax(np.abs(present - np.nanmean(present, axis=1, keepdims=True)), axis=1)
        for k in range(len(present) - 1):
            offset, travel = present[k + 1 :] - present[k], after_delay[k] - present[k]
            neighbours = time_mean(abs(offset)) < _MAX_DISTANCE * np.minimum(extent[k], extent[k + 1 :])
            neighbours = np.flatnonzero(neighbours & (np.isfinite(offset).sum(axis=1) > _COMPARED_INSTANTS // 4))
            next_offset, late_offset = (p[k + 1 + neighbours] - p[k] for p in (after_interval, after_delay))
            offset = offset[neighbours]
            square, travel_square = time_mean(abs(offset) ** 2), time_mean(abs(travel[None]) ** 2)
            is_noise = time_mean((offset * next_offset.conj()).real) < _MAX_NOISE_PRODUCT * square
            is_slow = time_mean(abs(late_offset - offset) ** 2) < _MAX_DRIFT**2 * travel_square
            is_behind = abs(time_mean((offset * (travel / abs(travel)).conj()).real)) > _MIN_COSINE * np.sqrt(square)
            tied_rows = k + 1 + neighbours[is_noise | (is_slow & ~is_behind)]
            rows_found.update([k, *tied_rows.tolist()] if len(tied_rows) else [])
    return [tracks.ids[k] for k in sorted(rows_found)]


def number_labels(labels: pd.Series[Any]) -> tuple[Indices, tuple[str | int, ...]]:
    """Which of the different labels each row has, in the order in which they come: whole numbers, or else texts."""
    if len({type(label) for label in labels.unique()}) > 1:
        labels = labels.astype(str)
    codes, distinct = pd.factorize(labels)
    return codes.astype(np.int64), tuple(pd.Series(distinct).tolist())


def match_leaders(
    index: NDArray[np.integer[Any]],
    labels: Sequence[str | int],
    codes: NDArray[np.integer[Any]],
    ids: Sequence[str | int],
    suffix: str = "",
) -> tuple[Indices | None, list[str]]:
    """Which id each sample follows: ``(S,)``, -1 for none, or ``None`` if no leader has a track; and sentences.

    A label, of which ``index`` ``(S,)`` are the numbers, names the id of the same text, or else the only id of an equal
    number: pandas writes 0 as 0.0 in a column with gaps. ``codes`` ``(S,)`` are the numbers of the samples' own ids.
    """
    row_of = {str(name): k for k, name in enumerate(ids)}
    row_of_number: dict[float | None, int] = {}
    for text, k in row_of.items():
        row_of_number[_to_number(text)] = -1 if _to_number(text) in row_of_number else k
    row_of_number[None] = -1
    rows = np.array([row_of.get(text, row_of_number.get(_to_number(text), -1)) for text in map(str, labels)], np.int64)
    notes = []
    unknown = [label for label, k in zip(labels, rows, strict=True) if k < 0 and not is_none(label)]
    if unknown:
        notes.append(f"Leaders without a track: {len(unknown)} ({', '.join(map(str, unknown[:3]))}).")
        if (rows < 0).all():
            return None, [*notes, f"No leader{suffix} has a track: it is not known who leads."]
    leader = rows[index]
    return np.where(leader == codes, -1, leader), notes


def is_none(value: Any) -> bool:
    """Whether a cell holds no value, as files write it."""
    return str(value).strip().lower() in _EMPTY_CELLS


def _to_number(text: str) -> float | None:
    try:
        return None if is_none(text) else float(text)
    except ValueError:
        return None


def _count_decimals(number: float) -> int:
    """How many decimals float64 has at this size, at most 9; -3 if it has whole thousands."""
    return min(_MAX_DECIMALS, math.floor(-np.log10(np.spacing(abs(number)))))

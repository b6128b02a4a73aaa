"""Samples of recorded tracks, sorted by id and time, and the clock that writes their times as the file does."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import pairwise
from typing import Any, Literal, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.config import ArgumentError, format_count, quote

_INSTANTS = 64  # at which ids are compared
_NEAR, _SLOW = 0.01, 0.03  # of the way, and of the movement
_LITTLE, _BEHIND = 0.3, 0.7  # of the square, and of the size of an offset
_DIGITS = 9  # decimals of a time that is written as a number, where float64 has as many
_EPOCH = datetime(1970, 1, 1)
_NO_VALUE = {"", "-", "na", "n/a", "#n/a", "nan", "null", "none", "nat", "\\n", "?"}


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
        seconds += max((late for begin, late in self.skipped if begin <= seconds), default=0.0)
        if self.recordings:
            name, begin, _, clock = min(self.recordings, key=lambda each: max(each[1] - seconds, seconds - each[2]))
            return f"{name}: {clock.file_time(max(0.0, seconds - begin))}"
        if self.timestamps:
            moment = _EPOCH + timedelta(milliseconds=round(1000 * (self.origin + seconds)))
            return moment.isoformat(timespec="milliseconds") + "Z"
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
    def duration(self) -> float:
        """Seconds from the earliest to the latest sample."""
        return float(self.time.max(initial=0.0))

    @property
    def recordings(self) -> list[tuple[float, float]]:
        """The first and the last second of each recording: of all tracks, if they are not pooled."""
        return [(begin, end) for _, begin, end, _ in self.clock.recordings] or [(0.0, self.duration)]

    @property
    def inner_steps(self) -> Mask:
        """``(S - 1,)`` bool: whether sample s and s + 1 belong to the same id."""
        owner = np.repeat(np.arange(len(self.ids)), np.diff(self.offsets))
        return np.asarray(owner[1:] == owner[:-1])

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
    if _count_decimals(latest) < _DIGITS:  # seconds since 1970: the difference of two has as few decimals
        time = np.round(time, _count_decimals(latest))
    time *= clock.unit
    clock = replace(clock, origin=clock.origin + start)
    order = np.lexsort((time, codes))
    codes, time = codes[order], time[order]
    position = np.zeros((len(time), 3))
    position[:, : len(axes)] = np.stack(axes, axis=1)[order]
    doubled = np.flatnonzero((np.diff(codes) == 0) & (np.diff(time) <= 0))
    if len(doubled):
        differ = doubled[(position[doubled] != position[doubled + 1]).any(axis=1)]
        if len(differ) and duplicates == "error":
            moment, who = quote(clock.file_time(float(time[differ[0]]))), quote(ids[codes[differ[0]]])
            raise ArgumentError(
                f"time must differ between samples of an id, got {moment} with two places for id {who} "
                f"({format_count(len(differ), 'such pair')}; duplicates='first' or 'mean', or --duplicates, helps)."
            )
        if duplicates == "mean":
            first = np.setdiff1d(np.arange(len(time)), doubled + 1)
            position[first] = np.add.reduceat(position, first) / np.diff(np.append(first, len(time)))[:, None]
        same = "same id and time" if len(differ) else "same id, time and place"
        notes = [*notes, f"Left out as repetitions ({same}): {format_count(len(doubled), 'sample')}."]
        order = np.delete(order, doubled + 1)
        codes, time, position = (np.delete(values, doubled + 1, axis=0) for values in (codes, time, position))
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


def split_gaps(tracks: SamplesT, gap: float) -> SamplesT:
    """The tracks with another id after each gap of more than so many seconds: ``a``, then ``a/2``, ``a/3``."""
    parts = np.flatnonzero(np.append(True, ~tracks.inner_steps | (np.diff(tracks.time) > gap)))
    owner, start = np.searchsorted(tracks.offsets, parts, side="right") - 1, tracks.time[parts]
    number = np.arange(len(parts)) - np.searchsorted(owner, owner)
    if not number.any():
        return tracks
    ids = tuple(f"{tracks.ids[k]}/{n + 1}" if n else str(tracks.ids[k]) for k, n in zip(owner, number, strict=True))
    leader = tracks.leader
    if leader is not None:  # the part of the leader that is there, or was last
        length = tracks.duration + 1.0
        part = np.searchsorted(owner * length + start, leader * length + tracks.time, side="right") - 1
        leader = np.where(leader < 0, -1, np.maximum(part, np.searchsorted(owner, leader)))
    return replace(tracks, ids=ids, offsets=np.append(parts, tracks.samples), leader=leader)


def find_one_body(tracks: Samples) -> list[str | int]:
    """The ids that may be one body with another: all the time as near as 1 % of their way, and as if tied to it.

    Two estimates of a vehicle's places drift apart slowly, and neither is behind. The offsets between two tags of an
    animal are noise: successive ones are not alike.
    """
    if not tracks.inner_steps.any():
        return []
    interval, long = 2 * np.median(np.diff(tracks.time)[tracks.inner_steps]), tracks.duration / _INSTANTS / 8
    start = np.linspace(0.0, tracks.duration - max(interval, long), _INSTANTS)
    times, plane = np.concatenate([start, start + interval, start + long]), tracks.position @ (1, 1j, 0)
    parts = [slice(*ends) for ends in pairwise(tracks.offsets)]
    place = np.array([np.interp(times, tracks.time[part], plane[part], np.nan, np.nan) for part in parts])
    now, soon, later = np.split(place, 3, axis=1)
    found: set[int] = set()
    with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore"):  # of ids that are never seen together
        extent = 2 * np.nanmax(np.abs(now - np.nanmean(now, axis=1, keepdims=True)), axis=1)
        for k in range(len(now) - 1):
            offset, way = now[k + 1 :] - now[k], later[k] - now[k]
            near = _mean(abs(offset)) < _NEAR * np.minimum(extent[k], extent[k + 1 :])
            near = np.flatnonzero(near & (np.isfinite(offset).sum(axis=1) > _INSTANTS // 4))
            then, last = (each[k + 1 + near] - each[k] for each in (soon, later))
            offset, size = offset[near], _mean(abs(offset[near]) ** 2)
            noise = _mean((offset * then.conj()).real) < _LITTLE * size
            slow = _mean(abs(last - offset) ** 2) < _SLOW**2 * _mean(abs(way[None]) ** 2)
            behind = abs(_mean((offset * (way / abs(way)).conj()).real)) > _BEHIND * np.sqrt(size)
            tied = k + 1 + near[noise | (slow & ~behind)]
            found.update([k, *tied.tolist()] if len(tied) else [])
    return [tracks.ids[k] for k in sorted(found)]


def _mean(values: Any) -> Any:
    return np.nanmean(values, axis=1)


def number_labels(labels: pd.Series[Any]) -> tuple[Indices, tuple[str | int, ...]]:
    """Which of the different labels each row has, in the order in which they come: whole numbers, or else texts."""
    if len({type(label) for label in labels.unique()}) > 1:
        labels = labels.astype(str)
    codes, different = pd.factorize(labels)
    return codes.astype(np.int64), tuple(pd.Series(different).tolist())


def match_leaders(
    index: NDArray[np.integer[Any]],
    labels: Sequence[str | int],
    codes: NDArray[np.integer[Any]],
    ids: Sequence[str | int],
    where: str = "",
) -> tuple[Indices | None, list[str]]:
    """Which id each sample follows: ``(S,)``, -1 for none, or ``None`` if no leader has a track; and sentences.

    A label, of which ``index`` ``(S,)`` are the numbers, names the id of the same text, or else the only id of an equal
    number: pandas writes 0 as 0.0 in a column with gaps. ``codes`` ``(S,)`` are the numbers of the samples' own ids.
    """
    same = {str(name): k for k, name in enumerate(ids)}
    equal: dict[float | None, int] = {}
    for text, k in same.items():
        equal[_to_number(text)] = -1 if _to_number(text) in equal else k
    equal[None] = -1
    known = np.array([same.get(text, equal.get(_to_number(text), -1)) for text in map(str, labels)], np.int64)
    notes = []
    unknown = [label for label, k in zip(labels, known, strict=True) if k < 0 and not is_none(label)]
    if unknown:
        notes.append(f"Leaders without a track: {len(unknown)} ({', '.join(map(str, unknown[:3]))}).")
        if (known < 0).all():
            return None, [*notes, f"No leader{where} has a track: it is not known who leads."]
    leader = known[index]
    return np.where(leader == codes, -1, leader), notes


def is_none(value: Any) -> bool:
    """Whether a cell holds no value, as files write it."""
    return str(value).strip().lower() in _NO_VALUE


def _to_number(text: str) -> float | None:
    try:
        return None if is_none(text) else float(text)
    except ValueError:
        return None


def _count_decimals(number: float) -> int:
    """How many decimals float64 has at this size, at most 9; -3 if it has whole thousands."""
    return min(_DIGITS, math.floor(-np.log10(np.spacing(abs(number)))))

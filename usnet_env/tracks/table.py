"""Collect the rows of files as columns of numbers, and make tracks of them."""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.config import ArgumentError, quote
from usnet_env.tracks.columns import OPTIONAL, read_marks
from usnet_env.tracks.degrees import to_local_metres
from usnet_env.tracks.formats import Block
from usnet_env.tracks.labels import LabelBook, Labels, match_leaders, to_labels
from usnet_env.tracks.tracks import Clock, Tracks, assemble
from usnet_env.tracks.values import guess_time_unit, read_numbers, read_times

_NUMBERS = ("x", "y", "lon", "lat", "z", "vx", "vy", "vz")
_TOGETHER = (("z",), ("vx", "vy", "vz"))  # the optional numbers; one without the others of its group is of no use


class Table:
    """Collects blocks of rows as columns of numbers, with ids and leaders as codes.

    Args:
        skip: whether rows without a needed value are skipped, not refused.
        unit: seconds in one unit of the times, or ``None``.
        named: roles whose columns the caller has named. The height is needed in every row if it is among them.
    """

    def __init__(self, skip: bool, unit: float | None, named: Collection[str]) -> None:
        self._skip, self._unit = skip, unit
        self._optional = {*OPTIONAL} - ({"z"} & {*named})
        self.rows = 0
        self._skipped = self._marked = 0
        self._ids, self._leaders = LabelBook(), LabelBook()
        self._parts: dict[str, list[NDArray[Any]]] = {}
        self._names: dict[str, str] = {}
        self._timestamps: bool | None = None
        self._whole, self._commas = True, False
        self._places = _Places()

    def add(self, path: Path, block: Block) -> None:
        """Convert a block to numbers.

        Raises:
            ArgumentError: a value is missing or no number, or files differ in their columns.
        """
        if self._parts and block.names.keys() != self._names.keys():
            raise ArgumentError(
                f"path must be files with the same columns, got {quote(sorted(self._names))} and, in "
                f"{quote(os.fspath(path))}, {quote(sorted(block.names))}."
            )
        self._names = dict(block.names)
        self.rows += len(block.rows)
        self._commas = self._commas or block.commas
        if block.movebank:
            keep = np.flatnonzero(~read_marks(block.values, len(block.rows)))
            self._marked += len(block.rows) - len(keep)
            if len(keep) < len(block.rows):
                block = block.take(keep)
        if not len(block.rows):
            return

        about = block.about(path)
        ids = to_labels(block.values["id"])
        parts: dict[str, NDArray[Any]] = self._read(block, about)
        good = self._find_good(ids, parts, self._skip or block.movebank, about)
        self._skipped += int((~good).sum())
        parts = {role: values[good] for role, values in parts.items()}
        parts["id"] = self._ids.add(ids, good, path if block.own_ids else None)
        if "leader" in block.values:
            parts["leader"] = self._leaders.add(to_labels(block.values["leader"]), good)
        for role, values in parts.items():
            self._parts.setdefault(role, []).append(values)
        self._places.add(path, block.unit, block.rows[good])

    def _read(self, block: Block, about: Callable[[str, int], str]) -> dict[str, Floats]:
        """The times and other numbers of a block by role, ``(rows,)`` each; NaN where there is none."""
        plain = {role: list(each) if isinstance(each, Labels) else each for role, each in block.values.items()}
        role = "t" if "t" in plain else "frame"
        times, timestamps = read_times(plain[role], role, about)
        if self._timestamps not in (None, timestamps):
            raise ArgumentError(
                f"{role} must be numbers or timestamps throughout, got both, first in {about(role, 0)}."
            )
        self._timestamps = timestamps
        known = times[np.isfinite(times)]
        self._whole = self._whole and bool((known == np.floor(known)).all())
        return {role: times} | {each: read_numbers(plain[each], each, about) for each in _NUMBERS if each in plain}

    def _find_good(self, ids: Labels, parts: dict[str, Floats], skip: bool, about: Callable[[str, int], str]) -> Mask:
        """``(rows,)`` which rows have a time, a place and an id.

        Raises:
            ArgumentError: a row lacks one, and such rows are not skipped.
        """
        none = np.array([label == "" for label in ids.names], bool)[ids.index]
        missing = {role: ~np.isfinite(values) for role, values in parts.items() if role not in self._optional}
        for role, bad in ({} if skip else missing | {"id": none}).items():
            if bad.any():
                must = "stand" if role == "id" else "be a number"
                raise ArgumentError(
                    f"{role} must {must} in every row unless missing='skip', got none in "
                    f"{about(role, int(bad.argmax()))}."
                )
        return ~np.logical_or.reduce([none, *missing.values()])

    def _take(self, role: str) -> NDArray[Any]:
        return np.concatenate(self._parts.pop(role))

    def finish(self, paths: Sequence[Path]) -> Tracks:
        """Make the tracks.

        Raises:
            ArgumentError: there are fewer than two ids, or an id has two places at one time.
        """
        where = ", ".join(quote(os.fspath(each)) for each in paths[:3])
        if not self.rows:
            raise ArgumentError(f"path must be a file with columns and rows, got {where} without rows.")
        ids = self._ids.names()
        if len(ids) < 2:
            have = ", ".join(map(quote, ids)) or "none"
            raise ArgumentError(
                f"path must hold the tracks of at least 2 ids, got {where} with {have} in column "
                f"{quote(self._names['id'])}."
            )
        gaps = self._leave_out_gaps()
        notes = [f"Columns: {', '.join(f'{role} = {name}' for role, name in self._names.items())}.", *gaps]
        if self._commas:
            notes.append("The commas in numbers are decimal signs.")
        if self._skipped:
            notes.append(f"{self._skipped} of {self.rows} rows had no time, place or id and are skipped.")
        if self._marked:
            marked = "is marked as an outlier" if self._marked == 1 else "are marked as outliers"
            notes.append(f"{self._marked} of {self.rows} rows {marked} in the file and skipped.")
        if "frame" in self._names and self._unit is None:
            notes.append("Times are numbers of frames; one frame counts as 1 s (time_unit= gives its seconds).")
        time, clock = self._take_times()
        position, origin, frame = self._take_positions()
        velocity = leader = None
        if {"vx", "vy"} <= self._parts.keys():
            velocity = np.zeros((len(time), 3))
            for axis, role in enumerate(("vx", "vy", "vz")):
                if role in self._parts:
                    velocity[:, axis] = self._take(role)
        codes = self._take("id")
        if "leader" in self._parts:
            where = f" in column {self._names['leader']}"
            leader, more = match_leaders(self._take("leader"), self._leaders.names(), codes, ids, where)
            notes += more
        return assemble(
            ids, codes, time, position, velocity, leader, clock, frame, tuple(notes), origin, self._places.name
        )

    def _leave_out_gaps(self) -> list[str]:
        """Leave out heights, or velocities, that have no value in some rows; a sentence about each."""
        sentences = []
        for group in _TOGETHER:
            found = [role for role in group if role in self._parts]
            blocks = list(zip(*(self._parts[role] for role in found), strict=True))
            empty = sum(int(np.isnan(block).any(axis=0).sum()) for block in blocks)
            if empty:
                named = ", ".join(f"{self._names.pop(role)} ({role})" for role in found)
                where = f"{empty} of {sum(len(block[0]) for block in blocks)} rows"
                sentences.append(
                    f"Column {named} has no value in {where} and is left out."
                    if len(found) == 1
                    else f"Columns {named} lack a value in {where} and are left out."
                )
                for role in found:
                    del self._parts[role]
        return sentences

    def _take_times(self) -> tuple[Floats, Clock]:
        """``(S,)`` times in the clock's unit, or in seconds for timestamps."""
        frames = "t" not in self._names
        time = self._take("frame" if frames else "t")
        if not self._timestamps:
            likely = None if frames or self._unit is not None else guess_time_unit(self._names["t"], time)
            return time, Clock(0.0, self._unit or 1.0, False, self._whole, frames, likely)
        if self._unit is not None:
            raise ArgumentError(f"time_unit must be None for timestamps, got {self._unit:g}.")
        start = float(time.min())  # whole microseconds: their differences are exact
        return (time - start) / 1e6, Clock(start / 1e6, 1.0, True, self._whole)

    def _take_positions(self) -> tuple[list[Floats], Floats | None, str]:
        """The two or three coordinates, ``(S,)`` metres each, their origin if it is known, and what they are."""
        axes = ("lon", "lat", "z") if "lon" in self._parts else ("x", "y", "z")
        position = [self._take(role) for role in axes if role in self._parts]
        if axes[0] == "x":
            return position, None, "metres"
        height = float(np.round(position[2].mean())) if len(position) == 3 else 0.0
        position[2:] = [each - height for each in position[2:]]
        position[0], position[1], middle, frame = to_local_metres(position[0], position[1])
        return position, np.array([*middle, height]), frame


class _Places:
    """Where the samples stand in their files."""

    def __init__(self) -> None:
        self._starts: list[int] = []
        self._parts: list[tuple[Path, str, range | NDArray[Any]]] = []
        self._samples = 0

    def add(self, path: Path, unit: str, rows: Indices) -> None:
        """Add the samples of the numbers ``rows`` of a file; successive numbers take no memory."""
        if not len(rows):
            return
        first, last = int(rows[0]), int(rows[-1])
        self._starts.append(self._samples)
        self._parts.append((path, unit, range(first, last + 1) if last - first + 1 == len(rows) else rows))
        self._samples += len(rows)

    def name(self, one: int, other: int) -> str:
        """Name the places of two samples, which are counted in the order in which they were added."""
        found = []
        for sample in sorted((one, other)):
            part = bisect_right(self._starts, sample) - 1
            path, unit, rows = self._parts[part]
            found.append((path, unit, int(rows[sample - self._starts[part]])))
        (path, unit, row), (next_path, next_unit, next_row) = found
        if path == next_path:
            return f"{unit}s {row} and {next_row} of {quote(os.fspath(path))}"
        return f"{unit} {row} of {quote(os.fspath(path))} and {next_unit} {next_row} of {quote(os.fspath(next_path))}"

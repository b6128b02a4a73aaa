"""Read tracks from files: block by block into columns of numbers, then sorted by id and time."""

from __future__ import annotations

import codecs
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices
from usnet_env.config import ArgumentError, plain_text, quote, real_number, whole_number
from usnet_env.files import as_path
from usnet_env.tracks.columns import check_mapping, read_marks
from usnet_env.tracks.degrees import to_local_metres
from usnet_env.tracks.formats import Block, ReadOptions, read_csv, read_npz, read_parquet, read_ulog
from usnet_env.tracks.gpx import read_gpx
from usnet_env.tracks.opening import is_zip
from usnet_env.tracks.tracks import Clock, Tracks, assemble

__all__ = ["read_tracks"]

_READERS = {
    ".parquet": read_parquet, ".pq": read_parquet, ".npz": read_npz, ".gpx": read_gpx, ".ulg": read_ulog,
}  # fmt: skip
_NO_VALUE = {"", "na", "n/a", "nan", "null", "none", "nat"}
_LIMITS = {"lon": 360.0, "lat": 90.0}  # degrees
_EPOCH, _MICROSECOND = datetime(1970, 1, 1, tzinfo=UTC), timedelta(microseconds=1)
_LARGEST = 1e15  # of numbers in a file: float64 has no fractions beyond


def read_tracks(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    columns: Mapping[str, str] | None = None,
    time_unit: float | None = None,
    missing: Literal["refuse", "skip"] = "refuse",
    encoding: str = "utf-8",
    max_bytes: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Tracks:
    """Read recorded tracks from one file, or from several with the same clock and coordinates.

    The format follows from the suffix: ``.parquet`` or ``.pq``, ``.npz``, ``.gpx``, ``.ulg`` (PX4); any other file is
    read as CSV, which may be compressed (gzip, or zip with one file in it). A CSV is read in blocks: a row takes 32
    bytes of memory in the end (40 with leaders, 24 more with velocities), and about 100 while rows are sorted.

    Args:
        path: the file or files. Files without ids (ULog) hold one track each, whose id is the name of the file.
        columns: names of columns by role, where they can't be guessed: ``id``, ``t`` (seconds or timestamps) or
            ``frame``, ``x`` and ``y`` (metres) or ``lon`` and ``lat`` (degrees), ``z``, ``vx``, ``vy``, ``vz``,
            ``leader``.
        time_unit: seconds in one unit of the time column, such as 0.001 for milliseconds or 1 / 30 for frames of a
            video; ``None``: 1.
        missing: ``"refuse"`` a row without a time, place or id, or ``"skip"`` it. Such rows of a Movebank file, which
            are missed fixes, are always skipped; so are those that Movebank marks as outliers.
        encoding: of a CSV file.
        max_bytes: the most bytes that a compressed file may expand to; ``None``: 256 MiB, or 20 times its size.
        progress: called with the number of rows that have been read.

    Returns:
        The tracks, in metres from a local origin and in seconds from the earliest sample.

    Raises:
        ArgumentError: an argument is refused, a file is damaged or empty, a column is missing, a value is no number,
            an id has two places at one time, or there are fewer than two ids. The sentence names the row or column.
    """
    paths = [as_path("path", each) for each in (path if isinstance(path, list | tuple) else [path])]
    if not isinstance(missing, str) or missing not in ("refuse", "skip"):
        raise ArgumentError(f"missing must be 'refuse' or 'skip', got {quote(missing)}.")
    if progress is not None and not callable(progress):
        raise ArgumentError(f"progress must be a function or None, got {quote(progress)}.")
    if max_bytes is not None:
        max_bytes = whole_number("max_bytes", max_bytes, 1)
    unit = None if time_unit is None else real_number("time_unit", time_unit, 1e-12, 1e9)
    options = ReadOptions(check_mapping(columns), _check_encoding(encoding), max_bytes)
    table = _Table(missing == "skip", unit, len(paths) > 1)
    for each in paths:
        for block in _open_blocks(each, options):
            table.add(each, block)
            if progress is not None:
                progress(table.rows)
    return table.finish(paths)


def _check_encoding(encoding: Any) -> str:
    try:
        codecs.lookup(plain_text("encoding", encoding))
    except (LookupError, ValueError):
        raise ArgumentError(
            f"encoding must be one that Python knows, such as utf-8 or latin-1, got {quote(encoding)}."
        ) from None
    try:
        plain = "id,1\n".encode(encoding) == b"id,1\n"
    except (LookupError, UnicodeError, ValueError):  # some encodings are not of texts
        plain = False
    if not plain:
        raise ArgumentError(
            "encoding must be one in which plain letters take one byte, such as utf-8 or latin-1, got "
            f"{quote(encoding)}."
        )
    return str(encoding)


def _open_blocks(path: Path, options: ReadOptions) -> Iterator[Block]:
    """Read the blocks of one file; problems of the file system are refused as arguments are."""
    where = quote(os.fspath(path))
    try:
        if path.is_dir() or not path.exists():
            state = "is a folder" if path.is_dir() else "does not exist"
            raise ArgumentError(f"path must be a file of tracks, got {where}, which {state}.")
        if not path.stat().st_size and path.is_file():
            raise ArgumentError(f"path must be a file with columns and rows, got {where}, which is empty.")
        reader = _READERS.get(path.suffix.lower(), read_csv)
        if reader is read_csv and path.suffix.lower() in (".xlsx", ".xls", ".ods") and is_zip(path):
            raise ArgumentError(f"path must be a CSV, Parquet, NPZ, GPX or ULog file, got {where}; save it as CSV.")
        yield from reader(path, options)
    except OSError as error:
        raise ArgumentError(f"path must be a file that can be read, got {where}: {error.strerror or error}.") from None


class _Table:
    """Collects blocks as columns of numbers, with ids and leaders as codes."""

    def __init__(self, skip: bool, unit: float | None, several: bool) -> None:
        self._skip, self._unit, self._several = skip, unit, several
        self.rows = 0
        self._skipped = self._marked = 0
        self._code: dict[Any, int] = {}
        self._leader_code: dict[Any, int] = {}
        self._parts: dict[str, list[NDArray[Any]]] = {}
        self._names: Mapping[str, str] = {}
        self._timestamps: bool | None = None
        self._whole = True

    def add(self, path: Path, block: Block) -> None:
        """Convert a block to numbers.

        Raises:
            ArgumentError: a value is missing or no number, or files differ in their columns.
        """
        if self._parts and set(block.names) - {"id"} != set(self._names) - {"id"}:
            raise ArgumentError(
                f"path must be files with the same columns, got {quote(sorted(self._names))} and, in "
                f"{quote(os.fspath(path))}, {quote(sorted(block.names))}."
            )
        self._names = block.names
        skip = self._skip or block.movebank
        rows = len(next(iter(block.values.values())))
        self.rows += rows
        whole, numbers = block.values, np.arange(rows)
        if block.movebank and (marked := read_marks(whole, rows)).any():
            self._marked += int(marked.sum())
            numbers = np.flatnonzero(~marked)
            rows = len(numbers)
            whole = {
                role: each[numbers] if isinstance(each, np.ndarray) else [each[k] for k in numbers.tolist()]
                for role, each in whole.items()
            }
        if not rows:
            return
        parts: dict[str, NDArray[Any]] = {}
        good = np.ones(rows, bool)

        def about(role: str, k: int) -> str:
            row = block.first_row + int(numbers[k])
            return f"row {row} of column {quote(block.names[role])} in {quote(os.fspath(path))}"

        time_role = "t" if "t" in whole else "frame"
        for role in (time_role, "x", "y", "lon", "lat", "z", "vx", "vy", "vz"):
            if role in whole:
                values = whole[role]
                parts[role] = self._times(values, role, about) if role == time_role else _numbers(values, role, about)
        names: list[Any] = [path.stem] * rows if "id" not in whole else _texts(whole["id"])
        for role, values in parts.items():
            bad = ~np.isfinite(values)
            if bad.any() and not skip:
                k = int(bad.argmax())
                raise ArgumentError(
                    f"{role} must be a number in every row unless missing='skip', got none in {about(role, k)}."
                )
            good &= ~bad
        nameless = np.array([each == "" for each in names]) if "" in names else None
        if nameless is not None:
            if not skip:
                raise ArgumentError(
                    "id must stand in every row unless missing='skip', got none in "
                    f"{about('id', int(nameless.argmax()))}."
                )
            good &= ~nameless
        if "leader" in whole:
            led = self._leader_code
            parts["leader"] = np.array([led.setdefault(each, len(led)) for each in _texts(whole["leader"])], np.int32)
        if not good.all():
            self._skipped += int((~good).sum())
            names = [name for name, fine in zip(names, good, strict=True) if fine]
            parts = {role: values[good] for role, values in parts.items()}
        code = self._code
        parts["id"] = np.array([code.setdefault(each, len(code)) for each in names], np.int32)
        for role, values in parts.items():
            self._parts.setdefault("t" if role == time_role else role, []).append(values)

    def _times(self, values: Any, role: str, about: Callable[[str, int], str]) -> Floats:
        """Convert times to numbers of the file's unit, or timestamps to whole microseconds since 1970."""
        if isinstance(values, np.ndarray) and values.dtype.kind == "M":
            timestamps = True
            half = np.timedelta64(500, "ns") if values.dtype == "datetime64[ns]" else np.timedelta64(0, "us")
            rounded = (values + half).astype("datetime64[us]").astype(np.float64)
            converted = np.where(np.isnat(values), np.nan, rounded)
        elif isinstance(values, np.ndarray):
            timestamps, converted = False, values.astype(np.float64)
        else:
            first = next((each for each in values if str(each).strip().lower() not in _NO_VALUE), "0")
            timestamps = isinstance(first, datetime) or not _is_number(first)
            converted = _timestamps(values, role, about) if timestamps else _numbers(values, role, about)
        if self._timestamps not in (None, timestamps):
            raise ArgumentError(
                f"{role} must be numbers or timestamps throughout, got both, first in {about(role, 0)}."
            )
        self._timestamps = timestamps
        known = converted[np.isfinite(converted)]
        self._whole = self._whole and bool((known == np.floor(known)).all())
        return converted

    def _take(self, role: str) -> NDArray[Any] | None:
        parts = self._parts.pop(role, None)
        return None if parts is None else np.concatenate(parts)

    def finish(self, paths: Sequence[Path]) -> Tracks:
        """Make the tracks.

        Raises:
            ArgumentError: there are fewer than two ids, or an id has two places at one time.
        """
        where = ", ".join(quote(os.fspath(each)) for each in paths[:3])
        if not self.rows:
            raise ArgumentError(f"path must be a file with columns and rows, got {where} without rows.")
        if len(self._code) < 2:
            have = ", ".join(map(quote, self._code)) or "none"
            raise ArgumentError(
                f"path must hold the tracks of at least 2 ids, got {where} with {have} in column "
                f"{quote(self._names.get('id', 'id'))}."
            )
        notes = [f"Columns: {', '.join(f'{role} = {name}' for role, name in self._names.items())}."]
        if self._skipped:
            notes.append(f"{self._skipped} of {self.rows} rows had no time, place or id and are skipped.")
        if self._marked:
            marked = "is marked as an outlier" if self._marked == 1 else "are marked as outliers"
            notes.append(f"{self._marked} of {self.rows} rows {marked} in the file and skipped.")
        unit = 1.0 if self._timestamps else self._unit or 1.0
        if "frame" in self._names and self._unit is None:
            notes.append("Times are numbers of frames; one frame counts as 1 s (time_unit= gives its seconds).")
        if self._timestamps and self._unit is not None:
            raise ArgumentError(f"time_unit must be None for timestamps, got {self._unit:g}.")
        time = self._take("t")
        assert time is not None
        start = 0.0
        if self._timestamps:  # whole microseconds: their differences are exact
            start = float(time.min())
            time = (time - start) / 1e6
        axes = ("lon", "lat", "z") if "lon" in self._parts else ("x", "y", "z")
        position = [each for role in axes if (each := self._take(role)) is not None]
        frame, origin = "metres", None
        if axes[0] == "lon":
            height = float(np.round(position[2].mean())) if len(position) == 3 else 0.0
            position[2:] = [each - height for each in position[2:]]
            position[0], position[1], middle, frame = to_local_metres(position[0], position[1])
            origin = np.array([*middle, height])
        velocity = None
        if {"vx", "vy"} <= self._parts.keys():
            flown = [self._take(role) for role in ("vx", "vy", "vz")]
            velocity = np.stack([np.zeros(len(time)) if each is None else each for each in flown], axis=1)
        codes = self._take("id")
        assert codes is not None
        leader = self._leaders(codes, notes)
        return assemble(
            tuple(self._code), codes, time, position, velocity, leader,
            Clock(start / 1e6, unit, bool(self._timestamps), self._whole), frame, tuple(notes), origin,
        )  # fmt: skip

    def _leaders(self, codes: NDArray[Any], notes: list[str]) -> Indices | None:
        """``(S,)`` index of each sample's leader, -1 for none."""
        named = self._take("leader")
        if named is None:
            return None
        unknown = [each for each in self._leader_code if each not in self._code and str(each).lower() not in _NO_VALUE]
        if unknown:
            notes.append(f"Leaders without a track: {len(unknown)} ({', '.join(map(str, unknown[:3]))}).")
        known = np.array([self._code.get(each, -1) for each in self._leader_code], np.int64)[named]
        return np.where(known == codes, -1, known)


def _is_number(text: Any) -> bool:
    try:
        float(text)
    except (TypeError, ValueError):
        return False
    return True


def _texts(values: Any) -> list[Any]:
    """Ids as texts without spaces around them, or as whole numbers."""
    plain = values.tolist() if isinstance(values, np.ndarray) else values
    if any(not isinstance(each, str) for each in plain):
        return [
            each.strip() if isinstance(each, str)
            else int(each) if isinstance(each, float) and each.is_integer()
            else each if isinstance(each, int)
            else "" if isinstance(each, float) and math.isnan(each) else str(each)
            for each in plain
        ]  # fmt: skip
    return [each.strip() for each in plain]


def _numbers(values: Any, role: str, about: Callable[[str, int], str]) -> Floats:
    """Convert values to float64; missing ones become NaN.

    Raises:
        ArgumentError: a value is another text, or too large.
    """
    if isinstance(values, np.ndarray):
        if values.dtype.kind not in "fiu":
            raise ArgumentError(f"{role} must be a number in every row, got {quote(values[0])} in {about(role, 0)}.")
        numbers = values.astype(np.float64)
    else:
        if bool in set(map(type, values)):
            k = list(map(type, values)).index(bool)
            raise ArgumentError(f"{role} must be a number in every row, got {values[k]} in {about(role, k)}.")
        try:
            numbers = np.fromiter(map(float, values), np.float64, len(values))
        except (TypeError, ValueError):
            numbers = np.array([_number(each, role, about, k) for k, each in enumerate(values)])
    limit = _LIMITS.get(role, _LARGEST)
    wild = np.isinf(numbers) | (np.abs(numbers) > limit)
    if wild.any():
        k = int(wild.argmax())
        raise ArgumentError(
            f"{role} must be a number from {-limit:g} to {limit:g}, got {numbers[k]:g} in {about(role, k)}."
        )
    return numbers


def _number(value: Any, role: str, about: Callable[[str, int], str], k: int) -> float:
    if str(value).strip().lower() in _NO_VALUE:
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ArgumentError(f"{role} must be a number in every row, got {quote(value)} in {about(role, k)}.") from None


def _timestamps(values: Sequence[Any], role: str, about: Callable[[str, int], str]) -> Floats:
    """Convert ISO 8601 timestamps to microseconds since 1970; without a time zone they are UTC."""
    micros = np.empty(len(values))
    for k, value in enumerate(values):
        try:
            moment = value if isinstance(value, datetime) else datetime.fromisoformat(value.strip())
        except (AttributeError, ValueError):
            if str(value).strip().lower() not in _NO_VALUE:
                raise ArgumentError(
                    f"{role} must be a number or an ISO 8601 timestamp in every row, got {quote(value)} in "
                    f"{about(role, k)}."
                ) from None
            micros[k] = math.nan
        else:
            micros[k] = ((moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - _EPOCH) // _MICROSECOND
    return micros

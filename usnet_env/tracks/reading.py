"""Read tracks from files: block by block into columns of numbers, then sorted by id and time."""

from __future__ import annotations

import codecs
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from usnet_env.config import ArgumentError, plain_text, quote, real_number, whole_number
from usnet_env.files import as_path
from usnet_env.tracks.columns import check_mapping
from usnet_env.tracks.formats import Block, ReadOptions, read_csv, read_parquet, read_ulog
from usnet_env.tracks.gpx import read_gpx
from usnet_env.tracks.npz import read_npz
from usnet_env.tracks.opening import find_suffix, is_zip
from usnet_env.tracks.table import Table
from usnet_env.tracks.tracks import Tracks

_READERS = {
    ".parquet": read_parquet, ".pq": read_parquet, ".npz": read_npz, ".gpx": read_gpx, ".ulg": read_ulog,
}  # fmt: skip


def read_tracks(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    columns: Mapping[str, str] | None = None,
    time_unit: float | None = None,
    missing: Literal["refuse", "skip"] = "refuse",
    encoding: str = "utf-8",
    decimal: Literal[".", ","] | None = None,
    max_bytes: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Tracks:
    """Read recorded tracks from one file, or from several with the same clock and coordinates.

    The format follows from the suffix: ``.parquet`` or ``.pq``, ``.npz``, ``.gpx``, ``.ulg`` (PX4); any other file is
    read as CSV. CSV and GPX may be compressed (gzip, or zip with one file in it). A CSV is read in blocks: a row takes
    32 bytes of memory in the end (40 with leaders, 24 more with velocities), and about 100 while rows are sorted.

    Args:
        path: the file or files. Files without ids (ULog) hold one track each, whose id is the name of the file. The
            tracks of one name in several GPX or ULog files are different ids, which have the file's name added; in one
            GPX file they have their number added.
        columns: names of columns by role, where they can't be guessed: ``id``, ``t`` (seconds or timestamps) or
            ``frame``, ``x`` and ``y`` (metres) or ``lon`` and ``lat`` (degrees), ``z``, ``vx``, ``vy``, ``vz``,
            ``leader``. ``""`` leaves out a column that tracks can be without. A height is left out where it is missing
            in some rows; if its column is named here, these rows are refused or skipped like others without a place.
        time_unit: seconds in one unit of the time column, such as 0.001 for milliseconds or 1 / 30 for frames of a
            video; ``None``: 1.
        missing: ``"refuse"`` a row without a time, place or id, or ``"skip"`` it. Such rows of a Movebank file, which
            are missed fixes, are always skipped; so are those that Movebank marks as outliers.
        encoding: of a CSV file.
        decimal: the decimal sign of a CSV file; ``None``: a comma if the first 50,000 rows leave no doubt, otherwise a
            point. A number such as ``1,234`` leaves a doubt, because its comma may separate thousands.
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
    if decimal is not None and (not isinstance(decimal, str) or decimal not in (".", ",")):
        raise ArgumentError(f"decimal must be '.', ',' or None, got {quote(decimal)}.")
    options = ReadOptions(check_mapping(columns), _check_encoding(encoding), max_bytes, decimal)
    named = {role for role, name in options.columns.items() if name}
    table = Table(missing == "skip", unit, named)
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
        plain = b"id,1\n".decode(encoding) == "id,1\n"
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
        reader = _READERS.get(find_suffix(path), read_csv)
        if reader is read_csv and path.suffix.lower() in (".xlsx", ".xls", ".ods") and is_zip(path):
            raise ArgumentError(f"path must be a CSV, Parquet, NPZ, GPX or ULog file, got {where}; save it as CSV.")
        yield from reader(path, options)
    except OSError as error:
        why = str(error.strerror or error).rstrip(".")
        raise ArgumentError(f"path must be a file that can be read, got {where}: {why}.") from None

"""Read tracks from files: tables of pandas become columns of numbers, sorted by id and time."""

from __future__ import annotations

import csv
import io
import os
import re
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pandas.errors import DtypeWarning, ParserWarning
from pydantic import Field

from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError, Config, how_to_install, quote
from usnet_env.files import as_path, read_csv
from usnet_env.tracks import columns as roles
from usnet_env.tracks.readers import READERS, check_archive, unpack
from usnet_env.tracks.samples import Clock, match_leaders, number_labels, sort_samples, split_gaps
from usnet_env.tracks.tracks import Tracks
from usnet_env.tracks.units import guess_time_unit, project_positions, scale_lengths

_DELIMITERS = ",;\t|"
_FOR_ITSELF = ("gpx", "ulg")  # formats in whose files a name is that of a track
_TIME_OF_DAY = r"\d{1,2}:\d\d"
_SKIPPED = {
    "skipped": "without a time, place or id that can be read",
    "marked": "marked as outliers in the file",
    "unsure": "with less than the least confidence",
}
_NO_NUMBER = ["", "NA", "na", "N/A", "n/a", "NaN", "nan", "NULL", "null", "None", "none"]  # others are read one by one


class _Options(Config):
    """The arguments of :func:`read_tracks` but for the files."""

    format: str | None
    columns: Mapping[roles.Role, str] | None
    header: Sequence[str] | None
    time_unit: Annotated[float, Field(ge=1e-12, le=1e9)] | None
    time_format: str | None
    length_unit: Literal["m", "cm", "mm", "km", "ft", "px"] | None
    missing: Literal["refuse", "skip"]
    missing_place: tuple[float, float] | None
    min_confidence: float | None
    split_gap: Annotated[float, Field(gt=0)] | None
    duplicates: Literal["error", "first", "mean"]
    pool: bool
    max_size: Annotated[float, Field(gt=0)]
    encoding: str
    decimal: Literal[".", ","]


def read_tracks(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | pd.DataFrame,
    *,
    format: str | None = None,
    columns: Mapping[str, str] | None = None,
    header: Sequence[str] | None = None,
    time_unit: float | None = None,
    time_format: str | None = None,
    length_unit: Literal["m", "cm", "mm", "km", "ft", "px"] | None = None,
    missing: Literal["refuse", "skip"] = "refuse",
    missing_place: tuple[float, float] | None = None,
    min_confidence: float | None = None,
    split_gap: float | None = None,
    duplicates: Literal["error", "first", "mean"] = "error",
    pool: bool = False,
    max_size: float = 256,
    encoding: str = "utf-8",
    decimal: Literal[".", ","] = ".",
) -> Tracks:
    """Read recorded tracks from one file, from several with the same clock and coordinates, or from a data frame.

    The format follows from the suffix, if it is the name of a reader (:mod:`usnet_env.tracks.readers`), such as
    ``.parquet`` or ``.h5``; any other file is read as CSV. Files may be compressed: gzip, or zip with one text in it.

    Args:
        path: the file or files, or a frame with a row for each sample, of which a named index is a column. ULog files
            hold one track each, whose id is the name of the file. The tracks of one name in several GPX or ULog files
            are different ids, which have the path added.
        format: the name of a reader, or ``"csv"``, where the suffix doesn't tell it.
        columns: names of columns by role, where they can't be guessed: ``id``, ``t`` (seconds or timestamps) or
            ``frame``, ``x`` and ``y`` (metres) or ``lon`` and ``lat`` (degrees), ``z``, ``leader``. ``""`` leaves one
            out. If heights are missing in some rows, all are left out unless their column is named here.
        header: names of the columns of a CSV file whose row 1 holds values.
        time_unit: seconds in one unit of the time column, such as 0.001 for milliseconds or 1 / 30 for frames of a
            video; ``None``: the unit in its name (``time_ms``), that of numbers that count from 1970, or of a
            spreadsheet's days, or else 1.
        time_format: of timestamps, as ``strftime`` writes it; ``None``: ISO 8601, or days and months in plain order.
        length_unit: of x, y and z (heights only beside degrees); ``None``: that in the name (``x_cm``), or metres.
        missing: ``"refuse"`` a row without a time, place or id that can be read, or ``"skip"`` it. Such rows of a
            Movebank file, which are missed fixes, are always skipped; so are those that Movebank marks as outliers, and
            empty cells of a table with a column for each id (``x1, y1, x2, y2``).
        missing_place: a place that stands for a missing one, such as (0, 0).
        min_confidence: leaves out rows with a smaller number, or none, in the column of the role ``confidence``.
        split_gap: seconds; after a longer gap, an id is another one: ``a`` is ``a/2``, and then ``a/3``.
        duplicates: of several places of an id at one time, keep the ``"first"`` or the ``"mean"``, or refuse them.
        pool: whether the files are recordings of the same ids, each with a time of its own; no window has two of them.
        max_size: MiB to which a file of gzip, zip or NumPy may unpack.
        encoding: of a CSV file.
        decimal: the decimal sign of a CSV file.

    Returns:
        The tracks, in metres from a local origin and in seconds from the earliest sample.

    Raises:
        ArgumentError: an argument is refused, a file is damaged or empty, a column is missing, a value is no number,
            an id has two places at one time, or there are fewer than two ids.

    Example:
        >>> frame = pd.DataFrame({"id": [*"abab"], "t": [0, 0, 1, 1], "x": [0.0, 5.0, 1.0, 6.0], "y": 0.0})
        >>> read_tracks(frame)
        <Tracks: 2 ids, 4 samples, 1 s, 2-D>
    """
    asked = {name: value for name, value in locals().items() if name != "path"}
    where, options = "the frame", _Options(**asked)
    try:
        if isinstance(path, pd.DataFrame):
            plain = path.reset_index() if any(path.index.names) else path
            table = _split_wide(roles.as_table(plain.rename(columns=str)), options)
            return _make_tracks([Path(where)], [_read_rows(table, options, where, None)], options, where)
        listed = path if isinstance(path, list | tuple) else [path]
        if not listed or not isinstance(listed[0], str | os.PathLike):
            what = "a file of tracks, a list of such files, or a pandas.DataFrame"
            raise ArgumentError(f"path must be {what}, got {quote(path)}.")
        files = [as_path("path", file) for file in listed]
        paths = list({file.resolve(): file for file in reversed(files)}.values())[::-1]  # two paths may be of one file
        where = ", ".join(quote(os.fspath(file)) for file in paths[:3])
        return _make_tracks(paths, [_read_file(file, options, len(paths) > 1) for file in paths], options, where)
    except ImportError as error:
        hint = f"{where}, which needs {error.name}; {how_to_install('tracks')}"
        raise ArgumentError(f"path must be in a format that can be read, got {hint}.") from None


@dataclass
class _FileRows:
    """The rows of a file: columns of numbers by role, and the labels in ``id`` and ``leader``, where ``""`` is none."""

    names: dict[str, str]  # of the columns by role
    rows: pd.DataFrame
    counts: Counter[str]  # of all "rows", and of those of _SKIPPED
    timestamps: bool  # in microseconds since 1970
    for_itself: bool  # an id means nothing in another file


def _read_file(path: Path, options: _Options, several: bool) -> _FileRows:
    """Read a file; one of several may be the track of one id, that of its name."""
    where = quote(os.fspath(path))
    try:
        table, for_itself = _open_table(path, options)
        rows = _read_rows(table, options, where, path.stem if several else None)
        return replace(rows, for_itself=rows.for_itself or for_itself)
    except (ArgumentError, ImportError, MemoryError):
        raise
    except Exception as error:  # libraries raise many kinds for damaged files
        reason = " ".join((getattr(error, "strerror", None) or str(error)).split()).rstrip(".") or type(error).__name__
        hint = " (encoding= names another one)" * isinstance(error, UnicodeError | LookupError)
        raise ArgumentError(f"path must be an intact file of tracks, got {where}: {reason}{hint}.") from error


def _read_rows(table_of_file: roles.Table, options: _Options, where: str, stem: str | None) -> _FileRows:
    """Read the columns of a table; ``stem`` is its id if it has none."""
    (header, read_columns), mapping, for_itself = table_of_file, options.columns or {}, False
    sure = {"confidence": options.min_confidence is not None}
    names = roles.choose_columns(header, mapping, where, one_id=stem is not None, **sure)
    movebank = roles.MOVEBANK & {name.replace("_", "-") for name in header}
    marks = {"visible": "visible"} if movebank and "visible" in header else {}
    if "t" in names and (dates := [name for name in header if name.strip().lower() == "date"]):
        marks["date"] = dates[0]
    table = read_columns(names | marks)
    if "id" in names and not mapping.get("id") and len(table) > 1 and table["id"].is_unique:
        other = [name for name in header if name != names["id"]]  # it numbers the rows
        again = roles.choose_columns(other, mapping, where, one_id=True, **sure)
        if "id" in again:
            names, table = again, read_columns(again | marks)
    if "id" not in names:
        names, table, for_itself = {"id": "file", **names}, table.assign(id=stem), True
    count = len(table)
    joins = options.time_format is None or "date" in marks
    if "t" in names and count and joins and re.match(_TIME_OF_DAY, roles.to_text(table["t"].iloc[0])):
        table["t"] = _join_date(table["t"].astype(str), table.get("date"))
        names["t"] += " + date" * ("date" in marks)
    if "visible" in marks:
        table = table[~table["visible"].astype(str).str.strip().str.lower().isin({"false", "f", "no", "0"})]
    rows = pd.DataFrame(index=table.index)
    skip = options.missing == "skip" or bool(movebank)
    good = np.ones(len(rows), bool)
    for role, name in names.items():
        column = table[role].rename(name)
        if role in roles.LABELS:
            rows[role] = roles.read_labels(column)
        else:
            few = options.missing == "skip"
            rows[role] = roles.read_numbers(column, role, where, options.decimal, options.time_format, skip_few=few)
        if role in ("leader", "confidence") or (role == "z" and not mapping.get("z")):
            continue
        none = (rows[role].isna() | (rows[role] == "")).to_numpy()
        if none.any() and not skip:
            roles.refuse_cell(role, column, "", where)
        good &= ~none
    if options.missing_place is not None:
        plane = [role for role in names if role in ("lon", "lat", "x", "y")]
        good &= (rows[plane].to_numpy() != options.missing_place).any(axis=1)
    unsure = np.zeros(len(rows), bool)
    if "confidence" in names:
        unsure = good & ~(rows["confidence"] >= options.min_confidence).to_numpy()
    dated = any(roles.has_timestamps(table[role]) for role in roles.TIMES if role in names)
    timestamps = dated or options.time_format is not None
    counts = Counter(rows=count, marked=count - len(rows), skipped=int((~good).sum()), unsure=int(unsure.sum()))
    kept = good & ~unsure
    return _FileRows(names, rows if kept.all() else rows[kept], counts, timestamps, for_itself)


def _join_date(clock: pd.Series[Any], date: pd.Series[Any] | None) -> pd.Series[Any]:
    """Times of day with their dates, or as seconds after midnight; if some are none, as they are."""
    if date is not None:
        return date.astype(str) + " " + clock
    seconds = pd.to_timedelta(clock, errors="coerce").dt.total_seconds()
    return seconds if seconds.notna().all() else clock


def _open_table(path: Path, options: _Options) -> tuple[roles.Table, bool]:
    """The table of a file, and whether its ids, such as the names of tracks, mean nothing in other files."""
    packed = path.suffix.lower() in (".gz", ".zip")
    data, name = unpack(path, options.max_size) if packed else (b"", path.name)
    rosbag = (path / "metadata.yaml").exists()  # a folder, in ROS 2
    kind = options.format or ("db3" if rosbag else Path(name).suffix[1:].lower())
    if kind in READERS or options.format not in (None, "csv"):
        reader = READERS.find(kind)
        with TemporaryDirectory() as folder:
            if packed:
                path = Path(folder, Path(name).name)
                path.write_bytes(data)
            check_archive(path, options.max_size)
            frame = reader(path)
        if not isinstance(frame, pd.DataFrame):
            raise ArgumentError(f"reader {kind!r} must return a pandas.DataFrame, got {quote(frame)}.")
        return roles.as_table(frame), kind in _FOR_ITSELF
    return _split_wide(_read_csv(data if packed else unpack(path, options.max_size)[0], options), options), False


def _split_wide(table: roles.Table, options: _Options) -> roles.Table:
    """The table with a row for each sample, if it has columns for each id and no argument names others."""
    return table if {"id", "x", "lon"} & (options.columns or {}).keys() else roles.as_long(table)


def _read_csv(data: bytes, options: _Options) -> roles.Table:
    """Read a CSV file with names in row 1, separated by commas, semicolons, tabs, bars or blanks."""
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else options.encoding
    if encoding == "utf-8" and b"\0" in data[:1024]:
        raise ValueError("it is no text, and its suffix names no format that is read (--format does)")
    comments = 0
    if data[:64].lstrip().startswith((b"{", b"[{", b"<?xml")):
        raise ValueError("it is JSON or XML, of which only the formats of `usnet list format` are read (--format)")
    with io.TextIOWrapper(io.BytesIO(data), encoding) as lines:
        while (first := lines.readline(2**20).removeprefix("\ufeff")).startswith("#"):
            comments += 1
    delimiter = max(_DELIMITERS, key=first.count)
    if blanks := delimiter not in first and len(first.split()) > 1:
        delimiter = r"\s+"
    cells = first.split() if blanks else next(csv.reader([first], delimiter=delimiter), [])
    header = [name.strip() for name in (options.header or cells)]
    if len(header) != len(cells):
        raise ValueError(f"row 1 has {len(cells)} cells for {len(header)} names in header (--columns)")

    def read(names: Mapping[str, str]) -> pd.DataFrame:
        role_of = {header.index(name): role for role, name in names.items()}
        plain = roles.NUMBERS - set(roles.TIMES if options.time_format is not None else ())  # others are texts
        numbers = [number for number, role in role_of.items() if role.partition(":")[0] in plain]
        with warnings.catch_warnings():
            warnings.simplefilter("error", ParserWarning)  # a row has more cells than the header
            warnings.simplefilter("ignore", DtypeWarning)  # texts among numbers are read, or refused by name, later
            rows = read_csv(
                io.BytesIO(data),
                sep=delimiter,
                encoding=encoding,
                decimal=options.decimal,
                header=None if options.header else 0,
                skiprows=comments,
                names=list(range(len(header))),
                index_col=False,
                dtype={k: object for k in range(len(header)) if k not in numbers},  # the text, also of 007
                skipinitialspace=True,
                keep_default_na=False,
                na_values=dict.fromkeys(numbers, _NO_NUMBER),
            )
        return rows[list(role_of)].rename(columns=role_of)

    return header, read


def _make_tracks(paths: list[Path], read: list[_FileRows], options: _Options, where: str) -> Tracks:
    names, timestamps = dict(read[-1].names), read[0].timestamps
    if any(file.names.keys() != names.keys() or file.timestamps != timestamps for file in read if file.counts["rows"]):
        named = ", ".join(quote(file.names) for file in read)
        raise ArgumentError(f"path must be files with the same columns and kind of times, got {named} in {where}.")
    count = Counter(label for file in read for label in file.rows["id"].unique())
    for path, file in zip(paths, read, strict=True):
        if file.for_itself and not options.pool:
            file.rows["id"] = [f"{name} ({path})" if count[name] > 1 else name for name in file.rows["id"]]
    rows = pd.concat([file.rows for file in read], ignore_index=True)
    counts = sum((file.counts for file in read), Counter())
    notes = []
    if empty := int(rows["z"].isna().sum()) if "z" in names else 0:
        notes.append(f"Column {names.pop('z')} (z) has no value in {empty} of {len(rows)} rows and is left out.")
        rows = rows.drop(columns="z")
    notes.insert(0, f"Columns: {', '.join(f'{role} = {name}' for role, name in names.items())}.")
    for kind, what in _SKIPPED.items():
        if counts[kind]:
            notes.append(f"{counts[kind]} of {counts['rows']} rows, {what}, skipped.")
    if "frame" in names and options.time_unit is None:
        notes.append("Times are numbers of frames; one frame counts as 1 s (a time unit gives its seconds).")
    codes, ids = number_labels(rows["id"])
    if len(ids) < 2:
        got = f"{where} with {counts['rows']} rows of {', '.join(map(quote, ids)) or 'no id'}"
        raise ArgumentError(f"path must hold the tracks of at least 2 ids, got {got}.")
    time = rows["frame" if "frame" in names else "t"].to_numpy()
    unit, why = options.time_unit, ""
    if unit is None and not timestamps:
        unit, why = guess_time_unit(time, names)
    whole = bool((time == np.floor(time)).all())
    clock = Clock(unit=unit or 1.0, timestamps=timestamps, whole=whole, guessed=why)
    if timestamps:
        if options.time_unit is not None:
            raise ArgumentError(f"time_unit must be left out for timestamps, got {options.time_unit:g} (--time-unit).")
        start = float(time.min())  # whole microseconds: their differences are exact
        time, clock = (time - start) / 1e6, replace(clock, origin=start / 1e6)
    if options.pool:
        time, clock = _pool(time, clock, [(path.name, len(file.rows)) for path, file in zip(paths, read, strict=True)])
    axes, origin, frame = project_positions(scale_lengths(rows, names, options.length_unit))
    leader = None
    if "leader" in rows:
        leader, sentences = match_leaders(*number_labels(rows["leader"]), codes, ids, f" in column {names['leader']}")
        notes += sentences
    others: Any = {"clock": clock, "origin": origin, "leader": leader, "notes": notes, "duplicates": options.duplicates}
    frame = "pixels" if options.length_unit == "px" and frame == "metres" else frame
    tracks = Tracks(**sort_samples(ids, codes, time, axes, **others), frame=frame)
    return tracks if options.split_gap is None else split_gaps(tracks, options.split_gap)


def _pool(time: Floats, clock: Clock, files: Sequence[tuple[str, int]]) -> tuple[Floats, Clock]:
    """Times with each recording after the one before, and their clock; ``files`` are the names and numbers of rows.

    Between two, there is as much time as in the longest, which is no gap that could be interpolated.
    """
    parts = np.split(time, np.cumsum([rows for _, rows in files])[:-1])
    filled = [(name, times) for (name, _), times in zip(files, parts, strict=True) if len(times)]
    pause, begin, pooled, recordings = max(float(np.ptp(times)) for _, times in filled) or 1.0, 0.0, [], []
    for name, times in filled:
        start, length = float(times.min()), float(np.ptp(times))
        pooled.append(times - start + begin)
        of_file = replace(clock, origin=clock.origin + start)
        recordings.append((name, begin * clock.unit, (begin + length) * clock.unit, of_file))
        begin += length + pause
    return np.concatenate(pooled), replace(clock, origin=0.0, recordings=tuple(recordings))

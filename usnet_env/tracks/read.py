"""Read tracks from files: tables of pandas become columns of numbers, sorted by id and time."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError, format_count, how_to_install, quote
from usnet_env.files import as_path, describe_fault
from usnet_env.tracks import columns as roles
from usnet_env.tracks.readers import read_dataset
from usnet_env.tracks.samples import Clock, match_leaders, number_labels, sort_samples, split_gaps
from usnet_env.tracks.tables import Options, open_table, read_text
from usnet_env.tracks.tracks import Tracks
from usnet_env.tracks.units import guess_time_unit, project_positions, scale_lengths

_MAX_REPEATED_SHARE = 0.05  # of the rows
_CHUNK = 2**16  # bytes that are read at once, or as many as there are
_TIME_OF_DAY = r"\d{1,2}:\d\d"
_SKIP_REASONS = {
    "skipped": "without a time, place or id that can be read",
    "marked": "marked as outliers in the file",
    "unsure": "with less than the least confidence",
}


def read_tracks(
    path: Any,
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
    pool_by: str | None = None,
    max_size: float = 256,
    encoding: str = "utf-8",
    decimal: Literal[".", ","] = ".",
) -> Tracks:
    """Read recorded tracks from files with the same clock and coordinates, a data frame, or a dataset of xarray.

    The format follows from the suffix, if it is the name of a reader (:mod:`usnet_env.tracks.readers`), such as
    ``.parquet`` or ``.h5``; any other file is read as CSV. Files may be compressed: gzip, or zip with one text in it.

    Args:
        path: the file or files; or a frame with a row for each sample, of which a named index is a column; or a dataset
            with a ``position`` over time, space and individuals, as movement makes it. ULog files hold one track each,
            whose id is the name of the file. The tracks of one name in several GPX or ULog files are different ids,
            which have the path added.
        format: the name of a reader, or ``"csv"``, where the suffix isn't enough.
        columns: names of columns by role, where they can't be guessed: ``id``, ``t`` (seconds or timestamps) or
            ``frame``, ``x`` and ``y`` (metres) or ``lon`` and ``lat`` (degrees), ``z``, ``leader``. ``""`` leaves one
            out. If heights are missing in some rows, all are left out unless their column is named here.
        header: names of the columns of a CSV file whose row 1 holds values.
        time_unit: seconds in one unit of the time column, such as 0.001 for milliseconds or 1 / 30 for frames of a
            video; ``None``: the unit in its name (``time_ms``), that of numbers that count from 1970, or of a
            spreadsheet's days, or else 1.
        time_format: of timestamps, as ``strftime`` writes it; ``None``: ISO 8601, or days and months in plain order.
        length_unit: of x, y and z (with degrees, of z only); ``None``: that in the name (``x_cm``), or metres.
        missing: ``"refuse"`` a row without a time, place or id that can be read, or ``"skip"`` it. Such rows of a
            Movebank file, which are missed fixes, are always skipped; so are those that Movebank marks as outliers, and
            empty cells of a table with a column for each id (``x1, y1, x2, y2``).
        missing_place: a place that stands for a missing one, such as (0, 0).
        min_confidence: leaves out rows with a smaller number, or none, in the column of the role ``confidence``.
        split_gap: seconds; after a longer gap, an id is another one: ``a`` is ``a/2``, and then ``a/3``.
        duplicates: of several places of an id at one time, keep the ``"first"`` or the ``"mean"``, or refuse them.
        pool: whether the files are recordings of the same ids, each with a time of its own; no window has two of them.
        pool_by: the name of a column, such as ``period``, of the recordings in one file.
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
    arguments = {name: value for name, value in locals().items() if name != "path"}
    source, options = "the frame", Options(**arguments)
    try:
        if "position" in getattr(path, "data_vars", ()):
            path, source = read_dataset(path), "the dataset"
        if isinstance(path, pd.DataFrame):
            frame = path.reset_index() if any(path.index.names) else path
            table = roles.as_long(roles.as_table(frame.rename(columns=str)), options.columns)
            return _make_tracks([source], [_read_rows(table, options, source, None)], options, source)
        path_list = path if isinstance(path, list | tuple) else [path]
        if not path_list or not isinstance(path_list[0], str | os.PathLike):
            kinds = "a file of tracks, a list of such files, a pandas.DataFrame, or an xarray.Dataset of positions"
            raise ArgumentError(f"path must be {kinds}, got {quote(path)}.")
        files = [as_path("path", file) for file in path_list]
        paths = list({file.resolve(): file for file in reversed(files)}.values())[::-1]  # two paths may be of one file
        source = ", ".join(quote(os.fspath(file)) for file in paths[:3])
        file_rows = [_read_file(file, options, len(paths) > 1) for file in paths]
        return _make_tracks([*map(str, paths)], file_rows, options, source)
    except ImportError as error:
        raise ArgumentError(f"{source} needs {error.name}; {how_to_install('tracks')}.") from None


def read_stream(stream: Any, **reading: Any) -> Iterator[tuple[float, Floats, list[str | int], Clock]]:
    """Read a CSV text from a binary stream while it comes: for each time, the fixes of some ids.

    The unit of the times and the origin of degrees follow from what comes first. ``reading`` is all that
    :func:`read_tracks` takes but for the path.

    Yields:
        Seconds; positions ``(n, 2)`` or ``(n, 3)`` in metres; the n ids; and what writes seconds as times of the text.
    """
    options, source, header_lines, text = Options(**reading), "standard input", b"", b""
    clock: Clock | None = None
    origin: Floats | None = None
    while chunk := stream.read1(_CHUNK):
        complete, newline, text = (text + chunk).rpartition(b"\n")
        lines = (complete + newline).splitlines(keepends=True)
        if not header_lines:
            header_count = sum(line.startswith(b"#") for line in lines) + (options.header is None)
            if len(lines) <= header_count:
                text = complete + newline + text
                continue
            header_lines, lines = b"".join(lines[:header_count]), lines[header_count:]
        if not b"".join(lines).strip():
            continue
        table = roles.as_long(read_text(header_lines + b"".join(lines), options), options.columns)
        if clock is None:  # each id may come once at first, as if it numbered the rows
            guessed = roles.choose_columns(table.header, options.columns or {}, source)
            options = options.model_copy(update={"columns": {"id": guessed["id"], **(options.columns or {})}})
        file = _read_rows(table, options, source, None)
        time = file.rows["frame" if "frame" in file.names else "t"].to_numpy()
        if clock is None:
            unit = 1e-6 if file.timestamps else options.time_unit or guess_time_unit(time, file.names)[0]
            clock = Clock(unit=unit, timestamps=file.timestamps, whole=bool((time == np.floor(time)).all()))
        axes, middle, _ = project_positions(scale_lengths(file.rows, file.names, options.length_unit), origin)
        origin, position, ids = middle, np.stack(axes, axis=1), file.rows["id"].to_numpy()
        for moment in np.unique(time):
            is_present = time == moment
            yield float(moment * clock.unit), position[is_present], ids[is_present].tolist(), clock


@dataclass
class _FileRows:
    """The rows of a file: columns of numbers by role, and the labels in ``id`` and ``leader``, where ``""`` is none."""

    names: dict[str, str]  # of the columns by role
    rows: pd.DataFrame
    counts: Counter[str]  # of all "rows", and of those of _SKIPPED
    timestamps: bool  # in microseconds since 1970
    zone: Any  # of these
    details: Mapping[str, Any]  # as in Table


def _read_file(path: Path, options: Options, one_of_several: bool) -> _FileRows:
    """Read a file; one of several may be the track of one id, that of its name."""
    source = quote(os.fspath(path))
    try:
        return _read_rows(open_table(path, options), options, source, path.stem if one_of_several else None)
    except (ArgumentError, ImportError, MemoryError):
        raise
    except Exception as error:  # libraries raise many kinds for damaged files
        hint = "; encoding= names another one" * isinstance(error, UnicodeError | LookupError)
        raise ArgumentError(describe_fault(path, "file of tracks", error, hint)) from error


def _read_rows(table_of_file: roles.Table, options: Options, source: str, stem: str | None) -> _FileRows:
    """Read the columns of a table; ``stem`` is its id if it has none."""
    names, table, details = _read_columns(table_of_file, options, source, stem)
    count = len(table)
    may_join = options.time_format is None or "date" in table
    if "t" in names and count and may_join and re.match(_TIME_OF_DAY, roles.to_text(table["t"].iloc[0])):
        table["t"] = _join_date(table["t"].astype(str), table.get("date"))
        names["t"] += " + date" * ("date" in table)
    if "visible" in table:
        table = table[~table["visible"].astype(str).str.strip().str.lower().isin({"false", "f", "no", "0"})]
    rows, is_valid = table[["recording"] if "recording" in table else []].copy(), np.ones(len(table), bool)
    for role, name in names.items():
        column = table[role].rename(name)
        if role in roles.LABELS:
            rows[role] = roles.read_labels(column)
        else:
            reading = options.decimal, options.time_format
            rows[role] = roles.read_numbers(column, role, source, *reading, skip_few=options.missing == "skip")
        if role in ("leader", "confidence") or (role == "z" and not (options.columns or {}).get("z")):
            continue
        is_missing = (rows[role].isna() | (rows[role] == "")).to_numpy()
        if is_missing.any() and options.missing == "refuse" and not details.get("movebank"):
            roles.refuse_cell(role, column, "", source)
        is_valid &= ~is_missing
    if options.missing_place is not None:
        plane = [role for role in names if role in ("lon", "lat", "x", "y")]
        is_valid &= (rows[plane].to_numpy() != options.missing_place).any(axis=1)
    is_kept = is_valid
    if "confidence" in names:
        is_kept = is_valid & (rows["confidence"] >= options.min_confidence).to_numpy()
    skipped, unsure = int((~is_valid).sum()), int((is_valid & ~is_kept).sum())
    counts = Counter(rows=count, marked=count - len(rows), skipped=skipped, unsure=unsure)
    time = table["frame" if "frame" in names else "t"]
    timestamps = roles.has_timestamps(time) or options.time_format is not None
    zone = roles.find_zone(time) if timestamps else None
    return _FileRows(names, rows if is_kept.all() else rows[is_kept], counts, timestamps, zone, details)


def _read_columns(
    table: roles.Table, options: Options, source: str, stem: str | None
) -> tuple[dict[str, str], pd.DataFrame, dict[str, Any]]:
    """The names of the columns by role, their cells, those of marks, dates and recordings, and the table's details."""
    header, mapping, details = table.header, options.columns or {}, dict(table.details)
    required: Any = {"confidence": options.min_confidence is not None}
    try:
        names = roles.choose_columns(header, mapping, source, one_id=stem is not None, **required)
    except ArgumentError as error:
        if "suffix" not in details:
            raise
        reason = f"was read as CSV, as no format has the suffix {details['suffix']} (--format names one)"
        raise ArgumentError(f"{str(error)[:-1]}; it {reason}.") from None
    details["movebank"] = bool(roles.MOVEBANK & {name.replace("_", "-") for name in header})
    others = {"visible": "visible"} if details["movebank"] and "visible" in header else {}
    if "t" in names and (dates := [name for name in header if name.strip().lower() == "date"]):
        others["date"] = dates[0]
    other_names = [name for name in header if name not in names.values()]
    recording = roles.find_recording(other_names) if options.pool_by is None else options.pool_by
    if recording is not None:
        others["recording"] = details["recording"] = recording
        if other_names.count(recording) != 1:
            got = f"{quote(recording)}; it has {', '.join(header)}"
            rule = f"a column of {source} other than {', '.join(names.values())}"
            raise ArgumentError(f"pool_by (--pool-by) must be {rule}, got {got}.")
    cells = table.read(names | others)
    if "id" in names and not mapping.get("id") and len(cells) > 1 and cells["id"].is_unique:
        other_names = [name for name in header if name != names["id"]]  # it numbers the rows
        chosen = roles.choose_columns(other_names, mapping, source, one_id=True, **required)
        if "id" in chosen:
            return chosen, table.read(chosen | others), details
    if "id" not in names:
        return {"id": "file", **names}, cells.assign(id=stem), details | {"for_itself": True}
    return names, cells, details


def _join_date(clock: pd.Series[Any], date: pd.Series[Any] | None) -> pd.Series[Any]:
    """Times of day with their dates, or as seconds after midnight; if some are none, as they are."""
    if date is not None:
        return date.astype(str) + " " + clock
    seconds = pd.to_timedelta(clock, errors="coerce").dt.total_seconds()
    return seconds if seconds.notna().all() else clock


def _make_tracks(paths: list[str], files: list[_FileRows], options: Options, source: str) -> Tracks:
    names, timestamps, pool = dict(files[-1].names), files[0].timestamps, options.pool or options.pool_by is not None
    if any(file.names.keys() != names.keys() or file.timestamps != timestamps for file in files if file.counts["rows"]):
        got = ", ".join(quote(file.names) for file in files)
        raise ArgumentError(f"path must be files with the same columns and kind of times, got {got} in {source}.")
    file_counts = Counter(label for file in files for label in file.rows["id"].unique())
    for path, file in zip(paths, files, strict=True):
        if file.details.get("for_itself") and not pool:
            file.rows["id"] = [f"{name} ({path})" if file_counts[name] > 1 else name for name in file.rows["id"]]
    parts = [(path, file.rows) for path, file in zip(paths, files, strict=True)]
    if options.pool_by is not None:
        parts = [
            (f"{Path(path).name} " * (len(paths) > 1) + f"{options.pool_by} {label}", part)
            for path, rows in parts
            for label, part in rows.groupby("recording", sort=False, dropna=False)
        ]
    rows = pd.concat([part for _, part in parts], ignore_index=True)
    counts = sum((file.counts for file in files), Counter())
    notes = []
    if "z" in names and (missing := int(rows["z"].isna().sum())):
        notes.append(f"Column {names.pop('z')} (z) has no value in {missing} of {len(rows)} rows and is left out.")
        rows = rows.drop(columns="z")
    notes.insert(0, f"Columns: {', '.join(f'{role} = {name}' for role, name in names.items())}.")
    for kind, meaning in _SKIP_REASONS.items():
        if counts[kind]:
            notes.append(f"{counts[kind]} of {counts['rows']} rows, {meaning}, skipped.")
    notes += dict.fromkeys(note for file in files for note in file.details.get("notes", ()))
    doubts = tuple(dict.fromkeys(doubt for file in files for doubt in file.details.get("doubts", ())))
    rate, unit = files[0].details.get("rate"), options.time_unit
    if "frame" in names and unit is None:
        meaning = "one frame counts as 1 s (a time unit gives its seconds)"
        notes.append(f"Times are numbers of frames; {f'the file has {rate:g} in a second' if rate else meaning}.")
        unit = 1 / rate if rate else None
    codes, ids = number_labels(rows["id"])
    if len(ids) < 2:
        found = f" with {format_count(counts['rows'], 'row')} of {', '.join(map(quote, ids)) or 'no id'}"
        got = source + (found if counts["rows"] else ", which is empty")
        raise ArgumentError(f"path must hold the tracks of at least 2 ids, got {got}.")
    time = rows["frame" if "frame" in names else "t"].to_numpy()
    clock = Clock(unit=unit or 1.0, whole=bool((time == np.floor(time)).all()))
    if timestamps:
        if options.time_unit is not None:
            raise ArgumentError(f"time_unit must be left out for timestamps, got {options.time_unit:g} (--time-unit).")
        start = float(time.min())  # whole microseconds: their differences are exact
        clock = replace(clock, origin=start / 1e6, timestamps=True, zone=files[0].zone)
        time = (time - start) / 1e6
    elif unit is None:
        unit, guess = guess_time_unit(time, names)
        clock = replace(clock, unit=unit, guessed=guess)
    if pool:
        time, clock = _join_recordings(time, clock, [(Path(name).name, len(part)) for name, part in parts])
    elif "recording" in rows and options.duplicates == "error":
        _refuse_recordings(rows[["id", "recording"]].assign(time=time), files[0].details["recording"], source)
    axes, origin, frame = project_positions(scale_lengths(rows, names, options.length_unit))
    leader = None
    if "leader" in rows:
        leader, sentences = match_leaders(*number_labels(rows["leader"]), codes, ids, f" in column {names['leader']}")
        notes += sentences
    fields: Any = {"clock": clock, "origin": origin, "leader": leader, "notes": notes, "duplicates": options.duplicates}
    is_pixels = frame == "metres" and (options.length_unit or roles.split_unit(names["x"])[1]) in roles.PIXELS
    frame = "pixels" if is_pixels else frame
    tracks = Tracks(**sort_samples(ids, codes, time, axes, **fields), frame=frame, doubts=doubts)
    return tracks if options.split_gap is None else split_gaps(tracks, options.split_gap)


def _refuse_recordings(keys: pd.DataFrame, column: str, source: str) -> None:
    """Refuse rows of which many have the id and the time of another, if the column ``recording`` tells them apart."""
    count = int(keys.duplicated(["id", "time"]).sum())
    if count > _MAX_REPEATED_SHARE * len(keys) and not keys.duplicated().any():
        got = f"{count} of {len(keys)} rows of {source} with the id and the time of another"
        hint = f"column {column!r} tells them apart: pool_by={column!r}, or --pool-by {column}, reads recordings"
        raise ArgumentError(f"time must differ between samples of an id, got {got} ({hint}).")


def _join_recordings(time: Floats, clock: Clock, files: Sequence[tuple[str, int]]) -> tuple[Floats, Clock]:
    """Times with each recording after the one before, and their clock; ``files`` are the names and numbers of rows.

    Between two, there is as much time as in the longest, which is no gap that could be interpolated.
    """
    parts = np.split(time, np.cumsum([rows for _, rows in files])[:-1])
    filled = [(name, times) for (name, _), times in zip(files, parts, strict=True) if len(times)]
    pause, begin, pooled, recordings = max(float(np.ptp(times)) for _, times in filled) or 1.0, 0.0, [], []
    for name, times in filled:
        start, length = float(times.min()), float(np.ptp(times))
        pooled.append(times - start + begin)
        recording_clock = replace(clock, origin=clock.origin + start)
        recordings.append((name, begin * clock.unit, (begin + length) * clock.unit, recording_clock))
        begin += length + pause
    return np.concatenate(pooled), replace(clock, origin=0.0, recordings=tuple(recordings))

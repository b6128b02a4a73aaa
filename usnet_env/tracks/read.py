"""Read tracks from files: tables of pandas become columns of numbers, sorted by id and time."""

from __future__ import annotations

import csv
import gzip
import io
import os
import re
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pandas.errors import ParserWarning
from pydantic import Field

from usnet_env.arrays import Floats, Indices
from usnet_env.config import ArgumentError, Config, how_to_install, quote
from usnet_env.files import as_path
from usnet_env.tracks import columns as roles
from usnet_env.tracks import formats
from usnet_env.tracks.samples import Clock, is_epoch, match_leaders, sort_samples
from usnet_env.tracks.tracks import Tracks

_DELIMITERS = ",;\t|"
_TEXTS = (".csv", ".tsv", ".txt", ".gpx")  # in zip archives
_SAMPLE = 50_000  # rows that tell whether commas are decimal signs
_NO_NUMBER = ["", "NA", "na", "N/A", "n/a", "NaN", "nan", "NULL", "null", "None", "none"]  # others are read one by one
_UNITS = {  # of times, in seconds, with the words that names of columns end with
    1e-3: {"ms", "msec", "msecs", "millis", "millisecond", "milliseconds"},
    1e-6: {"us", "µs", "usec", "usecs", "micros", "microsecond", "microseconds"},
    1e-9: {"ns", "nsec", "nsecs", "nanos", "nanosecond", "nanoseconds"},
}
_TOGETHER = (["z"], ["vx", "vy", "vz"])  # the optional numbers; one without the others of its group is of no use


class _Options(Config):
    """The arguments of :func:`read_tracks` but for the files."""

    columns: Mapping[roles.Role, str] | None
    time_unit: Annotated[float, Field(ge=1e-12, le=1e9)] | None
    missing: Literal["refuse", "skip"]
    encoding: str
    decimal: Literal[".", ","] | None
    max_bytes: Annotated[int, Field(ge=1)] | None


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
    read as CSV. CSV and GPX may be compressed (gzip, or zip with one file in it). A row takes 32 bytes of memory in the
    end (40 with leaders, 24 more with velocities), and about 100 while rows are sorted.

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
            an id has two places at one time, or there are fewer than two ids.
    """
    options = _Options(
        columns=columns,  # type: ignore[arg-type]  # checked there
        time_unit=time_unit,
        missing=missing,
        encoding=encoding,
        decimal=decimal,
        max_bytes=max_bytes,
    )
    roles.check_mapping(options.columns or {})
    given = [as_path("path", file) for file in (path if isinstance(path, list | tuple) else [path])]
    paths = list({file.resolve(): file for file in reversed(given)}.values())[::-1]  # two paths may be of one file
    where = ", ".join(quote(os.fspath(file)) for file in paths[:3])
    parts: list[_Part] = []
    try:
        for file in paths:
            parts.append(_read_file(file, options))
            if progress is not None:
                progress(sum(part.count for part in parts))
        return _make_tracks(paths, parts, options, where)
    except ImportError as error:
        needs = f"which needs {error.name}; {how_to_install('tracks')}"
        raise ArgumentError(f"path must be in a format that can be read, got {where}, {needs}.") from None


@dataclass
class _Part:
    """The rows of a file: columns of numbers by role, and the labels in ``id`` and ``leader``, where ``""`` is none."""

    names: dict[str, str]  # of the columns by role
    rows: pd.DataFrame
    count: int  # of all rows in the file
    marked: int  # as outliers
    skipped: int  # others without a time, place or id
    timestamps: bool  # in microseconds since 1970
    commas: bool  # are decimal signs
    for_itself: bool  # an id means nothing in another file


def _read_file(path: Path, options: _Options) -> _Part:
    """Read a file.

    Raises:
        ArgumentError: the file can't be read, a column or a value is missing, or a value is no number.
    """
    where, mapping = quote(os.fspath(path)), options.columns or {}
    try:
        (header, read_columns), for_itself = _open_table(path, options)
        names, marks = roles.choose_columns(header, mapping, where)
        table = read_columns(names | marks)
        count, decimal = len(table), table.attrs.get("decimal", ".")
        if marks:
            table = table[~roles.read_marks(table)]
        rows = pd.DataFrame(index=table.index)
        skip = options.missing == "skip" or roles.is_movebank(header)
        good = np.ones(len(rows), bool)
        for role, name in names.items():
            column = table[role].rename(name)
            is_number = role in roles.NUMBERS
            rows[role] = roles.read_numbers(column, role, where, decimal) if is_number else _clean_labels(column)
            if role in roles.OPTIONAL and not (role == "z" and mapping.get("z")):
                continue
            none = rows[role].isna() if is_number else rows[role] == ""
            if none.any() and not skip:
                roles.refuse_cell(role, column, "", where)
            good &= ~none.to_numpy()
        timestamps = any(roles.has_timestamps(table[role]) for role in roles.TIMES if role in names)
        skipped = len(rows) - int(good.sum())
        rows = rows[good] if skipped else rows
        return _Part(names, rows, count, count - len(table), skipped, timestamps, decimal == ",", for_itself)
    except (ArgumentError, ImportError, MemoryError):
        raise
    except Exception as error:  # libraries raise many kinds for damaged files
        reason = error.strerror or str(error) if isinstance(error, OSError) else str(error)
        reason = " ".join(reason.split()).rstrip(".") or type(error).__name__
        hint = " (encoding= names another one)" * isinstance(error, UnicodeError | LookupError)
        raise ArgumentError(
            f"path must be an intact file of tracks, got {where}, not readable: {reason}{hint}."
        ) from error


def _open_table(path: Path, options: _Options) -> tuple[formats.Table, bool]:
    """The table of a file, and whether its ids, such as the names of tracks, mean nothing in other files."""
    suffix, mapping = path.suffix.lower(), options.columns or {}
    if suffix in (".parquet", ".pq"):
        return formats.read_parquet(path, options.max_bytes), False
    if suffix == ".npz":
        return formats.read_npz(path, options.max_bytes, mapping), False
    if suffix == ".ulg":
        return formats.read_ulog(path), True
    data, name = _expand(path, options.max_bytes)
    if name.lower().endswith(".gpx"):
        return formats.read_gpx(data, Path(name).stem), True
    return _read_csv(data, options), False


def _expand(path: Path, max_bytes: int | None) -> tuple[bytes, str]:
    """The content of a text file, which gzip, or zip with one text file in it, may have compressed, and its name."""
    data = path.read_bytes()
    limit = max(2**28, 20 * len(data)) if max_bytes is None else max_bytes
    if data[:2] == b"\x1f\x8b":
        with gzip.open(io.BytesIO(data)) as file:
            expanded, name = file.read(limit + 1), path.stem
    elif data[:4] == b"PK\x03\x04":
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = archive.namelist()
            texts = [name for name in names if name.lower().endswith(_TEXTS) and not name.startswith("__MACOSX/")]
            if len(texts) != 1:
                holds = f"got {quote(str(path))} with {quote(names)}"
                raise ArgumentError(f"path must be a zip archive with one file of {', '.join(_TEXTS)}, {holds}.")
            with archive.open(texts[0]) as file:
                expanded, name = file.read(limit + 1), texts[0]
    else:
        return data, path.name
    formats.check_size(path, len(expanded), max_bytes)
    return expanded, name


def _read_csv(data: bytes, options: _Options) -> formats.Table:
    """Read a CSV file with names in row 1, separated by commas, semicolons, tabs or bars."""
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else options.encoding
    with io.TextIOWrapper(io.BytesIO(data), encoding) as lines:
        first = lines.readline(2**20).removeprefix("\ufeff")
    delimiter = max(_DELIMITERS, key=first.count)
    header = [name.strip() for name in next(csv.reader([first], delimiter=delimiter), [])]

    def read(names: Mapping[str, str]) -> pd.DataFrame:
        places = {header.index(name): role for role, name in names.items()}
        numbers = [place for place, role in places.items() if role in roles.NUMBERS]
        form: dict[str, Any] = {
            "sep": delimiter, "encoding": encoding, "header": 0, "names": list(range(len(header))), "index_col": False,
            "skipinitialspace": True, "keep_default_na": False,
        }  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("error", ParserWarning)  # a row has more cells than the header
            sample = pd.read_csv(io.BytesIO(data), nrows=_SAMPLE, dtype=str, **form)[numbers]
        decimal = options.decimal or ("," if roles.has_decimal_commas({*sample.to_numpy().ravel()}) else ".")
        rows = pd.read_csv(
            io.BytesIO(data),
            dtype={place: "category" for place in range(len(header)) if place not in numbers},
            na_values=dict.fromkeys(numbers, _NO_NUMBER),
            decimal=decimal,
            float_precision="round_trip",
            low_memory=False,
            **form,
        )
        rows = rows[list(places)].rename(columns=places)
        rows.attrs["decimal"] = decimal
        return rows

    return header, read


def _clean_labels(column: pd.Series[Any]) -> pd.Categorical:
    """Labels as texts without spaces around them, or as whole numbers; ``""`` is none."""
    codes, cells = pd.factorize(column)
    labels = []
    for cell in pd.Series(cells).tolist():
        whole = isinstance(cell, int | float) and not isinstance(cell, bool) and float(cell).is_integer()
        labels.append(int(cell) if whole else roles.to_text(cell))
    different = dict.fromkeys([*labels, ""])
    place = {label: k for k, label in enumerate(different)}
    return pd.Categorical.from_codes(np.array([place[label] for label in [*labels, ""]])[codes], list(different))


def _make_tracks(paths: list[Path], parts: list[_Part], options: _Options, where: str) -> Tracks:
    """Make tracks of the rows of files.

    Raises:
        ArgumentError: files differ in their columns, there are fewer than two ids, or an id has two places at one time.
    """
    names, timestamps = dict(parts[-1].names), parts[0].timestamps
    if any(part.names.keys() != names.keys() or part.timestamps != timestamps for part in parts if part.count):
        raise ArgumentError(
            "path must be files with the same columns and kind of times, got "
            f"{', '.join(quote(part.names) for part in parts)} in {where}."
        )
    _name_tracks(paths, parts)
    rows = pd.concat([part.rows for part in parts], ignore_index=True)
    notes = _leave_out_gaps(rows, names)
    count, skipped, marked = (sum(getattr(part, kind) for part in parts) for kind in ("count", "skipped", "marked"))
    notes = [f"Columns: {', '.join(f'{role} = {name}' for role, name in names.items())}.", *notes]
    if any(part.commas for part in parts):
        notes.append("The commas in numbers are decimal signs.")
    if skipped:
        notes.append(f"{skipped} of {count} rows had no time, place or id and are skipped.")
    if marked:
        verb = "is marked as an outlier" if marked == 1 else "are marked as outliers"
        notes.append(f"{marked} of {count} rows {verb} in the file and skipped.")
    if "frame" in names and options.time_unit is None:
        notes.append("Times are numbers of frames; one frame counts as 1 s (a time unit gives its seconds).")
    codes, ids = _number(rows["id"])
    if len(ids) < 2:
        raise ArgumentError(
            f"path must hold the tracks of at least 2 ids, got {where} with {count} rows of "
            f"{', '.join(map(quote, ids)) or 'no id'}."
        )
    time, clock = _read_clock(rows, names, timestamps, options.time_unit)
    axes, origin, frame = _place(rows)
    velocity = leader = None
    if "vx" in rows:
        velocity = rows.reindex(columns=["vx", "vy", "vz"], fill_value=0.0).to_numpy()
    if "leader" in rows:
        leader, sentences = match_leaders(*_number(rows["leader"]), codes, ids, f" in column {names['leader']}")
        notes += sentences
    fields = sort_samples(
        ids, codes, time, axes, clock=clock, origin=origin, velocity=velocity, leader=leader, notes=notes
    )
    return Tracks(**fields, frame=frame)


def _name_tracks(paths: list[Path], parts: list[_Part]) -> None:
    """Add the name of the file to an id that other files have too, where ids of different files are different ids."""
    count = Counter(label for part in parts if part.for_itself for label in part.rows["id"].unique())
    count.update({label for part in parts if not part.for_itself for label in part.rows["id"].unique()})
    taken = set(count)
    for path, part in zip(paths, parts, strict=True):
        ending = path.name if [file.name for file in paths].count(path.name) == 1 else path.as_posix()
        names = {}
        for label in part.rows["id"].unique() if part.for_itself else ():
            names[label] = label
            while count[label] > 1 and names[label] in taken:
                names[label] += f" ({ending})"
            taken.add(names[label])
        if names:
            part.rows["id"] = part.rows["id"].cat.rename_categories(names)


def _number(labels: pd.Series[Any]) -> tuple[Indices, tuple[str | int, ...]]:
    """Which of the different labels each row has, in the order in which they come: whole numbers, or else texts."""
    if len({type(label) for label in labels.unique()}) > 1:
        labels = labels.astype(str)
    codes, different = pd.factorize(labels)
    return codes.astype(np.int64), tuple(pd.Series(different).tolist())


def _leave_out_gaps(rows: pd.DataFrame, names: dict[str, str]) -> list[str]:
    """Leave out heights, or velocities, that have no value in some rows; a sentence about each."""
    sentences = []
    for group in _TOGETHER:
        found = [role for role in group if role in rows]
        empty = int(rows[found].isna().any(axis=1).sum())
        if empty:
            named = ", ".join(f"{names.pop(role)} ({role})" for role in found)
            verbs = f"Column {named} has no value" if len(found) == 1 else f"Columns {named} lack a value"
            are = "is" if len(found) == 1 else "are"
            sentences.append(f"{verbs} in {empty} of {len(rows)} rows and {are} left out.")
            rows.drop(columns=found, inplace=True)
    return sentences


def _read_clock(
    rows: pd.DataFrame, names: Mapping[str, str], timestamps: bool, unit: float | None
) -> tuple[Floats, Clock]:
    """``(S,)`` times in the clock's unit, or in seconds for timestamps."""
    role = "t" if "t" in names else "frame"
    time = rows[role].to_numpy()
    whole = bool((time == np.floor(time)).all())
    if not timestamps:
        likely = _guess_time_unit(names["t"], time) if role == "t" and unit is None else None
        return time, Clock(0.0, unit or 1.0, False, whole, role == "frame", likely)
    if unit is not None:
        raise ArgumentError(f"time_unit (--time-unit) must be left out for timestamps, got {unit:g}.")
    start = float(time.min())  # whole microseconds: their differences are exact
    return (time - start) / 1e6, Clock(start / 1e6, 1.0, True, whole)


def _guess_time_unit(name: str, times: Floats) -> float | None:
    """The unit of times, 0.001, 1e-6 or 1e-9 seconds, if their numbers or the name of their column say one of them.

    Args:
        name: of the column; its last word may be a unit, as in ``time_ms``, ``Time [ms]`` or ``timeMs``.
        times: ``(S,)`` numbers; those of a time since 1970 are dates from 1980 to 2100 in one of these units.
    """
    for unit in _UNITS:
        if is_epoch(float(times.min()), unit) and is_epoch(float(times.max()), unit):
            return unit
    words = re.findall(r"[a-zµ]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower().replace("μ", "µ"))
    return next((unit for unit, names in _UNITS.items() if words and words[-1] in names), None)


def _place(rows: pd.DataFrame) -> tuple[list[Floats], Floats | None, str]:
    """The two or three coordinates, ``(S,)`` metres each, their origin if it is known, and what they are.

    Degrees (WGS 84) are projected to metres east and north of the middle of the tracks by the azimuthal equidistant
    projection. The middle is that of the 1st and the 99th percentiles, so that a wrong fix far away doesn't move it.
    """
    if "lon" not in rows:
        return [rows[axis].to_numpy() for axis in ("x", "y", "z") if axis in rows], None, "metres"
    import pyproj

    longitude, latitude = rows["lon"].to_numpy(), rows["lat"].to_numpy()
    east = (longitude - longitude[0] + 180.0) % 360.0 - 180.0  # tracks may cross the 180th meridian
    middle = [float(np.quantile(degrees, (0.01, 0.99)).mean()) for degrees in (east, latitude)]
    middle[0] = (float(longitude[0]) + middle[0] + 180.0) % 360.0 - 180.0
    local = f"+proj=aeqd +lon_0={middle[0]!r} +lat_0={middle[1]!r} +datum=WGS84 +units=m"
    axes = list(pyproj.Transformer.from_crs("EPSG:4326", local, always_xy=True).transform(longitude, latitude))
    height = 0.0
    if "z" in rows:
        height = float(np.round(rows["z"].mean()))
        axes.append(rows["z"].to_numpy() - height)
    frame = "metres in a local azimuthal equidistant frame (pyproj), from degrees"
    return axes, np.array([*middle, height]), frame

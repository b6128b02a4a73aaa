"""Tables of files: which column has which role, mapped by the caller or guessed by its name, and the values in it."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, NoReturn

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError, list_names, quote
from usnet_env.tracks.samples import is_none


class Table(NamedTuple):
    """The names of the columns, and what reads some of them: it takes names by role, and its columns are the roles.

    ``details`` may have the ``rate`` of frames a second, lists of ``notes`` and ``doubts``, and ``for_itself``: whether
    an id, such as the name of a track, means nothing in another file.
    """

    header: list[str]
    read: Callable[[Mapping[str, str]], pd.DataFrame]
    details: Mapping[str, Any] = {}


Role = Literal["id", "t", "frame", "lon", "lat", "x", "y", "z", "leader", "confidence"]
#: The roles of columns, with the names that are guessed, the preferred one first: small letters and digits only. A unit
#: may follow (``time_ms``).
ROLES: dict[str, tuple[str, ...]] = {
    "id": (
        "individuallocalidentifier", "id", "ids", "trackid", "trackuuid", "trajectoryid", "animal", "animalid", "agent",
        "agentid", "uav", "uavid", "drone", "droneid", "vehicle", "vehicleid", "individual", "individuals",
        "individualid", "ind", "bird", "birdid", "pedid", "pedestrianid", "persid", "personid", "playerid", "objectid",
        "userid", "uid", "tagid", "tag", "collarid", "deviceid", "mmsi", "icao24", "icao", "hex", "callsign", "track",
        "name",
    ),
    "t": (
        "t", "time", "timestamp", "seconds", "sec", "datetime", "utc", "timestamputc", "timeutc", "basedatetime",
        "fixtime", "trackedat", "simtime", "positiont", "gameclock", "date", "now",
    ),
    "frame": (
        "frame", "frameid", "framenumber", "framenr", "frameindex", "frameidx", "framenum", "framecount", "timestep",
        "fr",
    ),
    "lon": ("lon", "longitude", "locationlong", "lng", "long"),
    "lat": ("lat", "latitude", "locationlat"),
    "x": (
        "x", "posx", "positionx", "xposition", "easting", "utmeasting", "tx", "prsrx", "xcenter", "startxpid1",
        "xwcentroid",
    ),
    "y": (
        "y", "posy", "positiony", "yposition", "northing", "utmnorthing", "ty", "prsry", "ycenter", "startypid1",
        "ywcentroid",
    ),
    "z": (
        "z", "posz", "positionz", "tz", "prsrz", "altitude", "alt", "height", "elevation", "ele",
        "heightaboveellipsoid", "heightabovemsl", "geoaltitude", "baroaltitude",
    ),
    "leader": ("leader", "leaderid", "head", "follows"),
    "confidence": ("confidence", "conf", "likelihood", "score", "instancescore", "probability"),
}  # fmt: skip
#: Columns that tell recordings apart, as :data:`ROLES`.
RECORDINGS = ("recording", "period", "periodid", "half", "trial", "video", "session", "sequence", "run", "scenario")
TIME_UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # seconds
LENGTH_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "ft": 0.3048, "px": 1.0}  # metres
PIXELS = ("px", "pixel", "pixels")
LENGTH_UNITS |= dict.fromkeys(("um", "micron", "\u00b5m", "\u03bcm"), 1e-6) | dict.fromkeys(PIXELS, 1.0)
LABELS = ("id", "leader")
NUMBERS = ROLES.keys() - set(LABELS)
TIMES = ("t", "frame")
MOVEBANK = {"individual-local-identifier", "tag-local-identifier"}  # one of these is in each of its files
_MAX_LISTED = 40  # names in a message
_MAX_NUMBER = 1e15  # of a number in a file: float64 has no fractions beyond
_LIMITS = {"lon": 360.0, "lat": 90.0, "t": 1e19, "frame": 1e19}  # degrees; nanoseconds since 1970 until 2286
_SWAP_SIGNS = str.maketrans(",.", ".,")
_DAY_AND_MONTH = re.compile(r"(\d{1,2})[/.-](\d{1,2})[/.-]\d{4}\b")  # and months, or the reverse
_DATE = re.compile(
    r"\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/. ](\d{1,2}|[A-Za-z]{3,})[-/. ]\d{4}|[A-Za-z]{3,} \d{1,2},? \d{4}"
)
_ZONE_NAME = re.compile(  # after a time of day; pandas leaves names out, and reads UTC+2 as UTC-2
    r"(:\d\d[\d:.,]*|\d ?[AaPp][Mm])\s*(?!(AM|PM|(UTC|GMT)(?!\s*[+-]))\b)[A-Z]{2,}"
)
_WHOLE_NUMBER = re.compile(r"([+-]?\d+)(\.0+)?")
_AXIS_NAME = re.compile(r"(?P<axis>[xyz])_?(?P<id>\w+)|(?P<name>\w+?)_(?P<last>[xyz])")
_DECIMAL_COMMA = re.compile(r"\s*[+-]?(\d*,\d+|\d+,)([eE][+-]?\d+)?\s*")


def as_table(frame: pd.DataFrame) -> Table:
    """The columns of a data frame."""
    return Table(list(frame), lambda names: frame[[*names.values()]].set_axis([*names], axis=1), frame.attrs)


def as_long(table: Table, mapping: Mapping[Any, str] | None) -> Table:
    """A table with a row for each time, such as ``t, x1, y1, x2, y2``, as one with a row for each sample of an id.

    Other tables, and those of whose columns the caller's ``mapping`` names an id or positions, stay as they are.
    """
    header, read, details = table
    guessed, axes_of = guess_columns(header), find_wide(header)
    is_mapped = {"id", "x", "lon"} & (mapping or {}).keys()
    if is_mapped or len(axes_of) < 2 or {"x", "y"} <= guessed.keys() or "id" in guessed:
        return table
    other_names = [name for name in header if not any(name in axes.values() for axes in axes_of.values())]
    if not guessed.keys() & {*TIMES}:
        other_names.append("frame")  # the number of the row

    def read_long(names: Mapping[str, str]) -> pd.DataFrame:
        wide = {f"{axis}:{label}": axes[axis] for label, axes in axes_of.items() for axis in names if axis in axes}
        times = {role: name for role, name in names.items() if name in header}
        rows = read(times | wide)
        frame = rows[list(times)] if times else pd.DataFrame({"frame": np.arange(len(rows))})
        parts = [
            frame.assign(id=label, **{axis: rows[f"{axis}:{label}"] for axis in axes if f"{axis}:{label}" in rows})
            for label, axes in axes_of.items()
        ]
        return pd.concat(parts, ignore_index=True).dropna(subset=["x", "y"], ignore_index=True)

    height = ["z"] if all("z" in axes for axes in axes_of.values()) else []
    return Table(["id", *other_names, "x", "y", *height], read_long, details)


def guess_columns(header: Sequence[str]) -> dict[str, str]:
    """The name of the column of each role that has a usual name."""
    name_of = {_reduce_name(name): name for name in reversed(header)}
    guesses = {role: [name_of[name] for name in names if name in name_of] for role, names in ROLES.items()}
    return {role: names[0] for role, names in guesses.items() if names}


def find_recording(header: Sequence[str]) -> str | None:
    """The column that probably tells recordings apart."""
    return next((name for name in header if _reduce_name(name) in RECORDINGS and header.count(name) == 1), None)


def _reduce_name(name: str) -> str:
    return split_unit(name)[0].replace("_", "")


def choose_columns(
    header: Sequence[str], mapping: Mapping[Any, str], source: str, *, one_id: bool = False, confidence: bool = False
) -> dict[str, str]:
    """Choose the name of the column of each role: x and y or lon and lat, t or frame, and others.

    Degrees, which name their datum, go before x and y, unless the caller's ``mapping`` has these. ``one_id``: the file
    may have no id, as all of it is one track. ``confidence``: it must have that column, which is otherwise left out.
    """

    def find_with_unit(name: str) -> str:
        matches = [column for column in header if column.partition(" (")[0] == name]
        return matches[0] if name not in header and len(matches) == 1 else name

    chosen = {role: find_with_unit(name) for role, name in mapping.items() if name}
    mapped = set(chosen)
    for role, name in guess_columns(header).items():
        if role not in mapping and name not in chosen.values():
            chosen[role] = name
    degrees = bool(mapped & {"lon", "lat"}) or {"lon", "lat"} <= chosen.keys()
    plane = ("lon", "lat") if degrees and not mapped & {"x", "y"} else ("x", "y")
    time = "frame" if "frame" in chosen and ("frame" in mapped or "t" not in chosen) else "t"
    needed = ["id", time, *plane, *["confidence"] * confidence]
    chosen = {role: name for role, name in chosen.items() if role in (*needed, "z", "leader")}
    if not any(header):
        raise ArgumentError(f"path must hold the tracks of at least 2 ids, got {source}, which is empty.")
    missing = [role for role in needed if role not in chosen and not (one_id and role == "id")]
    if missing and any(map(is_number, header)):
        first = quote(" ".join(header)[:80])
        hint = f"header=, or --columns, names its {len(header)} columns in order: id, t or frame, x, y, and others"
        raise ArgumentError(f"row 1 of {source} must name its columns, got values: {first} ({hint}).")
    listed = list_names(header, _MAX_LISTED, ", …")
    if missing:
        subject = f"column of {source} is" if len(missing) == 1 else f"columns of {source} are"
        hint = " (several files may be the tracks of one id each)" * (missing == ["id"])
        hint = " (min_confidence needs it)" if "confidence" in missing else hint
        advice = f"name {'it' if len(missing) == 1 else 'them'} with --column {missing[0]}=NAME (columns= in Python)"
        raise ArgumentError(f"which {subject} {', '.join(missing)}? It has {listed}; {advice}{hint}.")
    names = list(chosen.values())
    for role, name in chosen.items():
        if (header.count(name), names.count(name)) != (1, 1):
            found = f"{header.count(name) or 'no'} column{'s' * (header.count(name) > 1)} {name!r}"
            roles = " and ".join(other for other in chosen if chosen[other] == name)
            raise ArgumentError(f"{source} has {found} for {roles} (--column {role}=NAME); its columns are {listed}.")
    return chosen


def _normalise_name(name: str) -> str:
    return re.sub(r"\W+", "_", name.lower()).strip("_")


def split_unit(name: str) -> tuple[str, str]:
    """The plain name of a column, and the unit behind it, or ``""``: ``"X (cm)"`` is ``"x"`` in ``"cm"``."""
    name_only, _, unit = _normalise_name(name).rpartition("_")
    return (name_only, unit) if name_only and unit in TIME_UNITS | LENGTH_UNITS else (_normalise_name(name), "")


def find_wide(header: Sequence[str]) -> dict[str, dict[str, str]]:
    """The columns x, y and perhaps z of each id of a table with a row for each time, such as ``x1, y1, x2, y2``."""
    axes_of: dict[str, dict[str, str]] = {}
    for name in header:
        if match := _AXIS_NAME.fullmatch(_normalise_name(name)):
            axes_of.setdefault(match["id"] or match["name"], {})[match["axis"] or match["last"]] = name
    return {label: axes for label, axes in axes_of.items() if {"x", "y"} <= axes.keys()}


def is_number(cell: str) -> bool:
    """Whether a cell holds a number."""
    return not math.isnan(_parse_number(cell, "."))


def read_numbers(
    column: pd.Series[Any], role: str, source: str, decimal: str, time_format: str | None, *, skip_few: bool
) -> Floats:
    """The numbers of a column, or its timestamps as microseconds since 1970; NaN where there is none, or no end.

    A cell that can't be read is refused, or is NaN with ``skip_few``, if fewer than half of the different ones are so.
    """
    formatted = role in TIMES and time_format is not None
    column = column.dt.total_seconds() if column.dtype.kind == "m" else column
    if column.dtype.kind in "fiu" and not formatted:
        numbers = column.to_numpy(np.float64)
    else:
        codes, distinct = pd.factorize(column)
        cells = pd.Series(distinct)
        is_time = formatted or (role in TIMES and has_timestamps(column))
        numbers = [] if is_time else [_parse_number(cell, decimal) for cell in cells]
        values = _parse_timestamps(cells, time_format) if is_time else np.array(numbers, np.float64)
        is_wrong = np.isnan(values) & ~cells.map(is_none).to_numpy(bool)
        if is_wrong.any() and not (skip_few and is_wrong.mean() < 0.5):
            if formatted:
                got = f"{quote(time_format)} for {quote(to_text(cells[is_wrong].iloc[0]))} in column {column.name!r}"
                raise ArgumentError(f"time_format (--time-format) must be that of all times of {source}, got {got}.")
            refuse_cell(role, column, cells[is_wrong].iloc[0], source)
        numbers = np.append(values, math.nan)[codes]
        if is_time:
            return numbers
    numbers = np.where(np.isinf(numbers), math.nan, numbers)
    is_wild = np.abs(numbers) > _LIMITS.get(role, _MAX_NUMBER)
    if is_wild.any():
        refuse_cell(role, column, numbers[is_wild][0].item(), source)
    return numbers


def has_timestamps(column: pd.Series[Any]) -> bool:
    """Whether a column of times holds timestamps: its first value is no number."""
    if column.dtype.kind in "fiumM":
        return bool(column.dtype.kind == "M")
    return math.isnan(_parse_number(next((cell for cell in column if not is_none(cell)), "0"), "."))


def find_zone(column: pd.Series[Any]) -> Any:
    """The time zone of timestamps, that of the first, or ``None``."""
    if column.dtype.kind == "M":
        return getattr(column.dtype, "tz", None)
    text = next((to_text(cell) for cell in column if not is_none(cell)), "")
    return getattr(pd.to_datetime(text, format="ISO8601", errors="coerce"), "tz", None)


def to_text(cell: Any) -> str:
    """A cell as a text; some formats hold texts as bytes."""
    return (cell.decode("utf-8", "backslashreplace") if isinstance(cell, bytes) else str(cell)).strip()


def _parse_number(cell: Any, decimal: str) -> float:
    """The number in a cell, or NaN."""
    text = to_text(cell)
    try:
        return float(text.translate(_SWAP_SIGNS) if decimal == "," else text)
    except ValueError:
        return math.nan


def _write_times(cells: pd.Series[Any], time_format: str | None) -> pd.Series[Any]:
    """Times as texts; a number gets the zeros at its front back: in the format ``%H%M%S``, 507 is ``000507``."""
    texts = cells.map(to_text).astype(str)
    if time_format is None:
        return texts.str.replace(",", ".")
    texts = texts.str.removesuffix(".0") if cells.dtype.kind == "f" else texts
    return texts.where(~texts.str.isdigit(), texts.str.zfill(len(pd.Timestamp(0).strftime(time_format))))


def _parse_timestamps(cells: pd.Series[Any], time_format: str | None) -> Floats:
    """Microseconds from 1970 to dates, or to texts (in UTC if they have no time zone); NaN for others.

    Texts are in the given format or in ISO 8601. Others with a year of four digits are read too, if it is plain from
    all of them whether days or months come first.
    """
    texts = cells if cells.dtype.kind == "M" else _write_times(cells, time_format)
    try:
        moments = pd.to_datetime(texts, format=time_format or "ISO8601", utc=True, errors="coerce")
    except ValueError:  # the format has a directive that does not exist
        return np.full(len(cells), math.nan)
    if not time_format and moments.isna().any() and texts.dtype.kind != "M":
        pairs = texts.str.extract(_DAY_AND_MONTH).dropna().astype(int)
        day_first, month_first = (bool((pairs[k] > 12).any()) for k in (0, 1))
        is_clear = texts.map(lambda text: bool(_DATE.search(text) and not _ZONE_NAME.search(text)))
        is_clear &= pairs.empty | (day_first != month_first)
        with warnings.catch_warnings(action="ignore"):  # of days and months
            texts = texts.where(is_clear)
            parsed = pd.to_datetime(texts, format="mixed", dayfirst=day_first, utc=True, errors="coerce")
        moments = moments.fillna(parsed)
    moments = moments.dt.tz_localize(None).dt.round("us")
    return np.where(moments.isna(), math.nan, moments.to_numpy("datetime64[us]").astype(np.float64))


def read_labels(column: pd.Series[Any]) -> NDArray[np.object_]:
    """Labels as texts, or as whole numbers; ``""`` is none. Where all are whole numbers, 1.0 is 1."""
    codes, cells = pd.factorize(column)
    labels: list[str | int] = []
    for cell in pd.Series(cells).tolist():
        is_whole = isinstance(cell, int | float) and not isinstance(cell, bool) and float(cell).is_integer()
        labels.append(int(cell) if is_whole else to_text(cell))
    matches = [_WHOLE_NUMBER.fullmatch(label) for label in labels if isinstance(label, str) and not is_none(label)]
    integers = [label if isinstance(label, int) else label.partition(".")[0] for label in labels]
    labels = integers if matches and all(matches) and len(set(integers)) == len(set(labels)) else labels
    return np.array([*labels, ""], object)[codes]


def refuse_cell(role: str, column: pd.Series[Any], cell: Any, source: str) -> NoReturn:
    """Refuse a value of a column; the sentence says which option may help."""
    limit = _LIMITS.get(role, _MAX_NUMBER)
    rule = "a text or a number" if role == "id" else f"a number from {-limit:g} to {limit:g}"
    rule += ", or a timestamp throughout," * (role in TIMES)
    got, hint = quote(cell), ""
    if is_none(cell):
        got, hint = "none", " (missing='skip', or --skip-missing, skips such rows)"
    elif _DECIMAL_COMMA.fullmatch(str(cell)):
        hint = " (decimal=',', or --decimal , reads decimal commas)"
    elif role in TIMES and _ZONE_NAME.search(str(cell)):
        hint = " (its time zone must be an offset such as +02:00, or Z, UTC or GMT; other names are not read)"
    elif role in TIMES and re.search(r"\d\D\d", str(cell)):
        advice = "names another format; missing='skip', or --skip-missing, skips a few that can't be read"
        hint = f" (time_format='%d/%m/%Y %H:%M:%S', or --time-format, {advice})"
    raise ArgumentError(f"{role} must be {rule} in every row of {source}, got {got} in column {column.name!r}{hint}.")

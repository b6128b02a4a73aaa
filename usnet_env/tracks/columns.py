"""Columns of files: which one has which role, mapped by the caller or guessed by its name, and the numbers in it."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, Literal, NoReturn

import numpy as np
import pandas as pd

from usnet_env.arrays import Floats, Mask
from usnet_env.config import ArgumentError, quote
from usnet_env.tracks.samples import is_none

Role = Literal["id", "t", "frame", "lon", "lat", "x", "y", "z", "vx", "vy", "vz", "leader"]
#: The roles of columns, with the names that are guessed, the preferred one first.
ROLES: dict[str, tuple[str, ...]] = {
    "id": (
        "individual-local-identifier", "id", "ids", "track_id", "trackid", "track", "animal", "animal_id", "agent",
        "agent_id", "uav", "uav_id", "drone", "drone_id", "vehicle", "vehicle_id", "individual", "individual_id",
        "bird", "bird_id", "ped_id", "pedestrian_id", "name",
    ),
    "t": ("t", "time", "time_s", "timestamp", "seconds", "datetime", "date_time", "utc"),
    "frame": ("frame", "frame_id", "frame_number", "frame_nr"),
    "lon": ("lon", "longitude", "location-long", "lng", "long"),
    "lat": ("lat", "latitude", "location-lat"),
    "x": ("x", "x_m", "pos_x", "position_x", "easting", "utm-easting", "utm_easting"),
    "y": ("y", "y_m", "pos_y", "position_y", "northing", "utm-northing", "utm_northing"),
    "z": (
        "z", "z_m", "pos_z", "position_z", "altitude", "alt", "height", "elevation", "ele",
        "height-above-ellipsoid", "height-above-msl",
    ),
    "vx": ("vx", "v_x", "vel_x", "velocity_x"),
    "vy": ("vy", "v_y", "vel_y", "velocity_y"),
    "vz": ("vz", "v_z", "vel_z", "velocity_z"),
    "leader": ("leader", "leader_id", "head", "follows"),
}  # fmt: skip
#: The roles that tracks can be without.
OPTIONAL = ("z", "vx", "vy", "vz", "leader")
TIMES = ("t", "frame")
NUMBERS = (*TIMES, "x", "y", "lon", "lat", "z", "vx", "vy", "vz")
_VELOCITIES = {"vx", "vy", "vz"}
_ALTERNATIVES = (("x", "y"), ("lon", "lat")), (("t",), ("frame",))
_OUTLIERS = ("algorithm_marked_outlier", "import_marked_outlier", "manually_marked_outlier")
_MARKS = ("visible", *_OUTLIERS, "manually_marked_valid")
_MOVEBANK = {"individual_local_identifier", "tag_local_identifier", *_OUTLIERS}  # one of these is in each of its files
_LARGEST = 1e15  # of a number in a file: float64 has no fractions beyond
_LIMITS = {"lon": 360.0, "lat": 90.0, "t": 1e19, "frame": 1e19}  # degrees; nanoseconds since 1970 until 2286
_EPOCH, _MICROSECOND = datetime(1970, 1, 1, tzinfo=UTC), timedelta(microseconds=1)
_SWAP = str.maketrans(",.", ".,")
_COMMA = re.compile(r"\s*[+-]?(\d*,\d+|\d+,)([eE][+-]?\d+)?\s*")
_POINT = re.compile(r"\s*[+-]?(\d*\.\d+|\d+\.)([eE][+-]?\d+)?\s*")
_THOUSANDS = re.compile(r"\s*[+-]?[1-9]\d{0,2},\d{3}\s*")  # 1,234 may be a whole number with a separator
_TRUE, _FALSE = {"true", "t", "yes", "1", "1.0"}, {"false", "f", "no", "0", "0.0"}


def check_mapping(columns: Mapping[Any, str]) -> None:
    """Check that the columns that the caller has mapped to roles can be read together.

    Raises:
        ArgumentError: two roles have one column, or both of two alternatives are mapped.
    """
    names = [name for name in columns.values() if name]
    both = any(
        all(any(columns.get(role) for role in roles) for roles in alternatives) for alternatives in _ALTERNATIVES
    )
    if both or len(set(names)) < len(names):
        raise ArgumentError(
            "columns (--column) must give each role a column of its own, and name x and y or lon and lat, and t or "
            f"frame, not both, got {quote(dict(columns))}."
        )


def choose_columns(
    header: Sequence[str], mapping: Mapping[Any, str], where: str
) -> tuple[dict[str, str], dict[str, str]]:
    """Choose the column of each role, and those in which Movebank marks outliers.

    Args:
        header: the names of the columns.
        mapping: the names of columns by role that the caller has given; ``""`` leaves out a role.
        where: the file, for messages.

    Returns:
        The name of the column by role: either ``x`` and ``y`` or ``lon`` and ``lat``, and ``t`` or ``frame``. Then the
        name of the column by mark, with underscores; none in a file that is not of Movebank.

    Raises:
        ArgumentError: a column is missing, or its name stands twice in the header.
    """
    given = {role: name for role, name in mapping.items() if name}
    found: dict[str, str] = dict(given)
    plain = {_normalise(name): name for name in reversed(header)}
    for role, names in ROLES.items():
        guess = next((plain[name] for name in map(_normalise, names) if name in plain), None)
        if role not in mapping and guess is not None and guess not in found.values():
            found[role] = guess
    pair = _choose_pair(found, given)
    unused = {"x", "y", "lon", "lat"} - {*pair}
    if "t" in found and "frame" in found:
        unused.add("t" if "frame" in given else "frame")
    moves = bool(_VELOCITIES & given.keys())  # of two velocities, one tells nothing without the other
    if not {"vx", "vy"} <= found.keys() and not moves:
        unused |= _VELOCITIES
    found = {role: name for role, name in found.items() if role not in unused}
    needed = ["id", "frame" if "frame" in found else "t", *(("vx", "vy") if moves else ()), *pair]
    missing = ["t (or frame)" if role == "t" else role for role in needed if role not in found]
    if missing:
        raise ArgumentError(
            f"columns (--column) must name the columns of {where} for {', '.join(missing)}"
            f"{' (or lon and lat)' if {'x', 'y'} <= {*missing} else ''}; row 1 names {quote(list(header))}, of which "
            f"{quote(found)} {'are' if len(found) > 1 else 'is'} known."
        )
    for role, name in found.items():
        if header.count(name) != 1:
            raise ArgumentError(
                f"columns (--column) must name a column that {where} has once for {role}, got {quote(name)}; it has "
                f"{quote(list(header))}."
            )
    return found, {mark: plain[mark] for mark in _MARKS if mark in plain} if is_movebank(header) else {}


def _choose_pair(found: Collection[str], given: Collection[str]) -> tuple[str, str]:
    """The coordinates to read: those that the caller has given, or degrees, which name their datum, or x and y."""
    if "x" in given or "y" in given:
        return "x", "y"
    geographic = "lon" in given or "lat" in given or ("lon" in found and "lat" in found)
    return ("lon", "lat") if geographic else ("x", "y")


def is_movebank(header: Sequence[str]) -> bool:
    """Whether the names of the columns are those of Movebank."""
    return bool(_MOVEBANK & set(map(_normalise, header)))


def read_marks(rows: pd.DataFrame) -> Mask:
    """Which of some rows of a Movebank file are marked as outliers, ``(rows,)`` bool.

    By Movebank's attribute dictionary, ``visible`` is false where one of the outlier columns is true, unless
    ``manually_marked_valid`` is true. A file may hold some of these columns only; an empty cell marks nothing.

    Args:
        rows: the marks by their names with underscores, and other columns.
    """

    def says(name: str, words: set[str]) -> Mask:
        cells = rows.get(name, pd.Series("", rows.index)).astype(str)
        return np.asarray(cells.str.strip().str.lower().isin(words))

    outlier = says("visible", _FALSE)
    for name in _OUTLIERS:
        outlier |= says(name, _TRUE)
    return outlier & ~says("manually_marked_valid", _TRUE)


def _normalise(name: str) -> str:
    return name.strip().lower().replace(" ", "_").replace("-", "_")


def has_decimal_commas(cells: Collection[Any]) -> bool:
    """Whether the commas in cells of numbers or times can only be decimal signs.

    They can where no number has a point, and one of them has another number of digits than 3 after its comma, or more
    than 3 digits or a 0 before it.
    """
    texts = set(map(str, cells))
    commas = [text for text in texts if "," in text and _COMMA.fullmatch(text)]
    sure = any(not _THOUSANDS.fullmatch(text) for text in commas)
    return sure and not any(_POINT.fullmatch(text) for text in texts if "." in text)


def read_numbers(column: pd.Series[Any], role: str, where: str, decimal: str = ".") -> Floats:
    """The numbers of a column, ``(rows,)``, or its timestamps as microseconds since 1970; NaN where there is none.

    Args:
        column: what the file holds; its name is that of the column.
        role: of the column.
        where: the file, for messages.
        decimal: the decimal sign in texts.

    Raises:
        ArgumentError: a value is no number, or too large.
    """
    if column.dtype.kind == "M":
        moments = pd.to_datetime(column, utc=True).dt.tz_localize(None).to_numpy()
        rounded = (moments + np.timedelta64(500, "ns")).astype("datetime64[us]").astype(np.float64)
        return np.where(np.isnat(moments), math.nan, rounded)
    dated = role in TIMES and has_timestamps(column)
    if column.dtype.kind in "fiu":
        numbers = column.to_numpy(np.float64)
    else:
        codes, cells = pd.factorize(column)
        parsed = [_parse_timestamp(to_text(cell)) if dated else _parse(to_text(cell), decimal) for cell in cells]
        if None in parsed:
            refuse_cell(role, column, cells[parsed.index(None)], where)
        numbers = np.array([*parsed, math.nan], np.float64)[codes]
    wild = np.abs(numbers) > (math.inf if dated else _LIMITS.get(role, _LARGEST))
    if wild.any():
        refuse_cell(role, column, numbers[wild][0], where)
    return numbers


def has_timestamps(column: pd.Series[Any]) -> bool:
    """Whether a column of times holds timestamps: its first value is no number."""
    if column.dtype.kind in "fiuM":
        return bool(column.dtype.kind == "M")
    return _parse(to_text(next((cell for cell in column if not is_none(cell)), "0")), ".") is None


def to_text(cell: Any) -> str:
    """A cell as a text without spaces around it; some formats hold texts as bytes."""
    return (cell.decode("utf-8", "backslashreplace") if isinstance(cell, bytes) else str(cell)).strip()


def _parse(text: str, decimal: str) -> float | None:
    """The number in a cell: NaN if it is empty, ``None`` if it is something else."""
    try:
        return math.nan if is_none(text) else float(text.translate(_SWAP) if decimal == "," else text)
    except ValueError:
        return None


def _parse_timestamp(text: str) -> float | None:
    """The microseconds from 1970 to an ISO 8601 timestamp, in UTC if it has no time zone; NaN and ``None`` as above."""
    try:
        moment = datetime.fromisoformat(text)
        return ((moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - _EPOCH) // _MICROSECOND
    except ValueError:
        return math.nan if is_none(text) else None


def refuse_cell(role: str, column: pd.Series[Any], cell: Any, where: str) -> NoReturn:
    """Refuse a value of a column.

    Raises:
        ArgumentError: always; the sentence says what the values must be, and which option may help.
    """
    limit = _LIMITS.get(role, _LARGEST)
    must = "a text or a number" if role == "id" else f"a number from {-limit:g} to {limit:g}"
    if role in TIMES:
        must += ", or an ISO 8601 timestamp throughout,"
    got, hint = quote(cell), ""
    if is_none(cell):
        got, hint = "none", " (missing='skip', or --skip-missing, skips such rows)"
    elif _COMMA.fullmatch(str(cell)):
        hint = " (decimal=',', or --decimal , reads decimal commas)"
    raise ArgumentError(f"{role} must be {must} in every row of {where}, got {got} in column {column.name!r}{hint}.")

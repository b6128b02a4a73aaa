"""Columns of files: which one has which role, mapped by the caller or guessed by its name, and the values in it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NoReturn

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError, quote
from usnet_env.tracks.samples import is_none

Role = Literal["id", "t", "frame", "lon", "lat", "x", "y", "z", "leader"]
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
    "leader": ("leader", "leader_id", "head", "follows"),
}  # fmt: skip
LABELS = ("id", "leader")  # all others are numbers
TIMES = ("t", "frame")
MOVEBANK = {"individual-local-identifier", "tag-local-identifier"}  # one of these is in each of its files
_LARGEST = 1e15  # of a number in a file: float64 has no fractions beyond
_LIMITS = {"lon": 360.0, "lat": 90.0, "t": 1e19, "frame": 1e19}  # degrees; nanoseconds since 1970 until 2286
_SWAP = str.maketrans(",.", ".,")
_COMMA = re.compile(r"\s*[+-]?(\d*,\d+|\d+,)([eE][+-]?\d+)?\s*")


def choose_columns(header: Sequence[str], mapping: Mapping[Any, str], where: str) -> dict[str, str]:
    """Choose the name of the column of each role: x and y or lon and lat, t or frame, and others.

    Degrees, which name their datum, go before x and y, unless the caller's ``mapping`` has these.
    """
    found = {role: name for role, name in mapping.items() if name}
    given = set(found)
    plain = {_normalise(name): name for name in reversed(header)}
    for role, names in ROLES.items():
        guess = next((plain[name] for name in map(_normalise, names) if name in plain), None)
        if role not in mapping and guess is not None and guess not in found.values():
            found[role] = guess
    degrees = bool(given & {"lon", "lat"}) or {"lon", "lat"} <= found.keys()
    plane = ("lon", "lat") if degrees and not given & {"x", "y"} else ("x", "y")
    time = "frame" if "frame" in found and ("frame" in given or "t" not in found) else "t"
    found = {role: name for role, name in found.items() if role in ("id", time, *plane, "z", "leader")}
    must, chosen = "", list(found.values())
    if missing := [role for role in ("id", time, *plane) if role not in found]:
        must = f"name those of {where} for {', '.join(missing)}"
    elif len(set(chosen)) < len(chosen) or any(header.count(name) != 1 for name in chosen):
        must = f"give each role a column that {where} has once"
    if must:
        raise ArgumentError(f"columns (--column) must {must}, got {quote(found)}; row 1 names {quote(list(header))}.")
    return found


def _normalise(name: str) -> str:
    return name.strip().lower().replace(" ", "_").replace("-", "_")


def read_numbers(column: pd.Series[Any], role: str, where: str, decimal: str = ".") -> Floats:
    """The numbers of a column, or its timestamps as microseconds since 1970; NaN where there is none."""
    if column.dtype.kind in "fiu":
        numbers = column.to_numpy(np.float64)
    else:
        codes, different = pd.factorize(column)
        cells = pd.Series(different)
        dated = role in TIMES and has_timestamps(column)
        values = _parse_timestamps(cells) if dated else np.array([_parse(cell, decimal) for cell in cells], np.float64)
        wrong = np.isnan(values) & ~cells.map(is_none).to_numpy(bool)
        if wrong.any():
            refuse_cell(role, column, cells[wrong].iloc[0], where)
        numbers = np.append(values, math.nan)[codes]
        if dated:
            return numbers
    wild = np.abs(numbers) > _LIMITS.get(role, _LARGEST)
    if wild.any():
        refuse_cell(role, column, numbers[wild][0], where)
    return numbers


def has_timestamps(column: pd.Series[Any]) -> bool:
    """Whether a column of times holds timestamps: its first value is no number."""
    if column.dtype.kind in "fiuM":
        return bool(column.dtype.kind == "M")
    return math.isnan(_parse(next((cell for cell in column if not is_none(cell)), "0"), "."))


def to_text(cell: Any) -> str:
    """A cell as a text; some formats hold texts as bytes."""
    return (cell.decode("utf-8", "backslashreplace") if isinstance(cell, bytes) else str(cell)).strip()


def _parse(cell: Any, decimal: str) -> float:
    """The number in a cell, or NaN."""
    text = to_text(cell)
    try:
        return float(text.translate(_SWAP) if decimal == "," else text)
    except ValueError:
        return math.nan


def _parse_timestamps(cells: pd.Series[Any]) -> Floats:
    """Microseconds from 1970 to dates, or to texts in ISO 8601 (in UTC if they have no time zone); NaN for others."""
    texts = cells if cells.dtype.kind == "M" else cells.map(to_text).str.replace(",", ".")
    moments = pd.to_datetime(texts, format="ISO8601", utc=True, errors="coerce").dt.tz_localize(None).dt.round("us")
    return np.where(moments.isna(), math.nan, moments.to_numpy("datetime64[us]").astype(np.float64))


def read_labels(column: pd.Series[Any]) -> NDArray[np.object_]:
    """Labels as texts, or as whole numbers; ``""`` is none."""
    codes, cells = pd.factorize(column)
    labels: list[str | int] = []
    for cell in pd.Series(cells).tolist():
        whole = isinstance(cell, int | float) and not isinstance(cell, bool) and float(cell).is_integer()
        labels.append(int(cell) if whole else to_text(cell))
    return np.array([*labels, ""], object)[codes]


def refuse_cell(role: str, column: pd.Series[Any], cell: Any, where: str) -> NoReturn:
    """Refuse a value of a column; the sentence says which option may help."""
    limit = _LIMITS.get(role, _LARGEST)
    must = "a text or a number" if role == "id" else f"a number from {-limit:g} to {limit:g}"
    must += ", or an ISO 8601 timestamp throughout," * (role in TIMES)
    got, hint = quote(cell), ""
    if is_none(cell):
        got, hint = "none", " (missing='skip', or --skip-missing, skips such rows)"
    elif _COMMA.fullmatch(str(cell)):
        hint = " (decimal=',', or --decimal , reads decimal commas)"
    raise ArgumentError(f"{role} must be {must} in every row of {where}, got {got} in column {column.name!r}{hint}.")

"""Which column of a file has which role: mapped by the caller, or guessed where the names are plain."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from usnet_env.arrays import Mask
from usnet_env.config import ArgumentError, quote, unknown_name

__all__ = ["ROLES", "check_mapping", "choose_columns", "find_marks", "is_movebank", "read_marks"]

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
_OUTLIERS = ("algorithm_marked_outlier", "import_marked_outlier", "manually_marked_outlier")
_MOVEBANK = {"individual_local_identifier", "tag_local_identifier", *_OUTLIERS}  # one of these is in each of its files
_TRUE, _FALSE = {"true", "t", "yes", "1", "1.0"}, {"false", "f", "no", "0", "0.0"}
_NUMBER_SIGNS = set("0123456789.+-eE \t")


def check_mapping(columns: Any) -> dict[str, str]:
    """Check the argument ``columns``, which maps roles to names of columns.

    Raises:
        ArgumentError: it is no mapping of known roles to texts.
    """
    if columns is None:
        return {}
    if not isinstance(columns, Mapping) or not all(isinstance(each, str) for each in columns.values()):
        raise ArgumentError(f"columns must map roles to names of columns, got {quote(columns)}.")
    for role in columns:
        if role not in ROLES:
            raise unknown_name("columns", role, ROLES)
    return dict(columns)


def choose_columns(
    header: Sequence[str], mapping: Mapping[str, str], where: str, needs_id: bool = True
) -> dict[str, str]:
    """Choose the column of each role.

    Args:
        header: the names of the columns.
        mapping: roles that the caller has given.
        where: the file, for messages.
        needs_id: whether the file must have a column of ids.

    Returns:
        The name of the column by role. There are either ``x`` and ``y`` or ``lon`` and ``lat``, and ``t`` or ``frame``.

    Raises:
        ArgumentError: a column is missing; the sentence names it and lists those that are there.
    """
    if header and all(name.strip() and set(name.strip()) <= _NUMBER_SIGNS for name in header):
        raise ArgumentError(f"path must name its columns in row 1, got {where}, whose row 1 is {quote(list(header))}.")
    found = dict(mapping)
    for role, name in mapping.items():
        if name not in header:
            raise ArgumentError(
                f"columns must name a column of {where} for {role}, got {quote(name)}; it has {_list(header)}."
            )
    plain = {_normalise(name): name for name in reversed(header)}
    for role, names in ROLES.items():
        guess = next((plain[name] for name in map(_normalise, names) if name in plain), None)
        if role not in found and guess is not None and guess not in found.values():
            found[role] = guess
    if "t" in found and "frame" in found:
        del found["t" if "frame" in mapping and "t" not in mapping else "frame"]
    planar, geographic = {"x", "y"} <= found.keys(), {"lon", "lat"} <= found.keys()
    if planar and geographic:  # a file with both: what the caller has mapped, otherwise degrees, which name their datum
        dropped = ("lon", "lat") if {"x", "y"} & mapping.keys() else ("x", "y")
        found = {role: name for role, name in found.items() if role not in dropped}
    wanted = ["id"] if needs_id else []
    for role in (*wanted, *(() if planar or geographic else ("x", "y"))):
        if role not in found:
            raise _missing(role, where, header)
    if "t" not in found and "frame" not in found:
        raise _missing("t", where, header)
    if not planar or geographic:
        found = {role: name for role, name in found.items() if role not in ("x", "y")}
    for role, name in found.items():
        if header.count(name) > 1:
            raise ArgumentError(
                f"path must name each column once, got {where} with {header.count(name)} columns {quote(name)} for "
                f"{role}."
            )
    return found


def is_movebank(header: Iterable[str]) -> bool:
    """Whether the names of the columns are those of Movebank."""
    return bool(_MOVEBANK & set(map(_normalise, header)))


def find_marks(header: Sequence[str]) -> dict[str, str]:
    """The columns in which Movebank marks outliers, by their names with underscores; none in another file."""
    plain = {_normalise(name): name for name in header} if is_movebank(header) else {}
    return {mark: plain[mark] for mark in ("visible", *_OUTLIERS, "manually_marked_valid") if mark in plain}


def read_marks(values: Mapping[str, Iterable[Any]], rows: int) -> Mask:
    """Which of some rows of a Movebank file are marked as outliers, ``(rows,)`` bool.

    By Movebank's attribute dictionary, ``visible`` is false where one of the outlier columns is true, unless
    ``manually_marked_valid`` is true. A file may hold some of these columns only; an empty cell marks nothing.

    Args:
        values: the values by the names that :func:`find_marks` gives, and others.
        rows: number of rows.
    """

    def says(name: str, words: set[str]) -> Mask:
        return np.array([str(each).strip().lower() in words for each in values.get(name, ())] or [False] * rows, bool)

    outlier = says("visible", _FALSE)
    for name in _OUTLIERS:
        outlier |= says(name, _TRUE)
    return outlier & ~says("manually_marked_valid", _TRUE)


def _normalise(name: str) -> str:
    return name.strip().lower().replace(" ", "_").replace("-", "_")


def _list(header: Iterable[str]) -> str:
    return quote(list(header))


def _missing(role: str, where: str, header: Sequence[str]) -> ArgumentError:
    takes = "x and y, or lon and lat" if role in ("x", "y") else "t or frame" if role == "t" else role
    return ArgumentError(f"columns must name the column {role} of {where} ({takes}), which is none of {_list(header)}.")

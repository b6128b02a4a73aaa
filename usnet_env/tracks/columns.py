"""Which column of a file has which role: mapped by the caller, or guessed where the names are plain."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from usnet_env.arrays import Mask
from usnet_env.config import ArgumentError, quote, unknown_name

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
_VELOCITIES = ("vx", "vy", "vz")
OPTIONAL = ("z", "vx", "vy", "vz", "leader")
_PAIRS = (("x", "y"), ("lon", "lat"))
_ALTERNATIVES = (_PAIRS, (("t",), ("frame",)))
_OUTLIERS = ("algorithm_marked_outlier", "import_marked_outlier", "manually_marked_outlier")
_MOVEBANK = {"individual_local_identifier", "tag_local_identifier", *_OUTLIERS}  # one of these is in each of its files
_TRUE, _FALSE = {"true", "t", "yes", "1", "1.0"}, {"false", "f", "no", "0", "0.0"}
_NUMBER_SIGNS = set("0123456789.+-eE \t")


def check_mapping(columns: Any) -> dict[str, str]:
    """Check the argument ``columns``, which maps roles to names of columns; ``""`` leaves a role out.

    Raises:
        ArgumentError: it is no mapping of known roles to texts, gives two roles one column, or names columns of which
            only some can be read.
    """
    if columns is None:
        return {}
    if not isinstance(columns, Mapping) or not all(isinstance(each, str) for each in columns.values()):
        raise ArgumentError(f"columns must map roles to names of columns, got {quote(columns)}.")
    role_of: dict[str, str] = {}
    for role, name in columns.items():
        if role not in ROLES:
            raise unknown_name("columns", role, ROLES)
        if name and role_of.setdefault(name, role) != role:
            raise ArgumentError(
                f"columns must give each role a column of its own, got {quote(name)} for {role_of[name]} and {role}."
            )
    for one, other in _ALTERNATIVES:
        named = [
            [f"{quote(columns[role])} for {role}" for role in roles if columns.get(role)] for roles in (one, other)
        ]
        if all(named):
            raise ArgumentError(
                f"columns must name {' and '.join(one)} or {' and '.join(other)}, not both, got "
                f"{', '.join(named[0] + named[1])}."
            )
    return dict(columns)


def check_names(header: Sequence[str], mapping: Mapping[str, str], where: str) -> dict[str, str]:
    """The columns that the caller has mapped, by role, without the roles that are left out.

    Raises:
        ArgumentError: a column is not in the file.
    """
    for role, name in mapping.items():
        if name and name not in header:
            raise ArgumentError(
                f"columns must name a column of {where} for {role}, got {quote(name)}; it has {quote(list(header))}."
            )
    return {role: name for role, name in mapping.items() if name}


def keep_fixed(names: Mapping[str, str], mapping: Mapping[str, str], where: str) -> dict[str, str]:
    """The columns of a format in which each has its role, without those that the caller leaves out.

    Args:
        names: the names of the columns by role.
        mapping: roles that the caller has given.
        where: the file, for messages.

    Raises:
        ArgumentError: the caller gives a role another column, or leaves out a role that the tracks need.
    """
    for role, name in mapping.items():
        if name != names.get(role, "") and (name or role not in OPTIONAL):
            have = ", ".join(f"{each} = {column}" for each, column in names.items())
            raise ArgumentError(f"columns must fit those of {where} ({have}), got {quote(name)} for {role}.")
    return {role: name for role, name in names.items() if mapping.get(role, name)}


def choose_columns(
    header: Sequence[str], mapping: Mapping[str, str], where: str
) -> tuple[dict[str, str], dict[str, str]]:
    """Choose the column of each role, and those in which Movebank marks outliers.

    Args:
        header: the names of the columns.
        mapping: roles that the caller has given.
        where: the file, for messages.

    Returns:
        The name of the column by role: either ``x`` and ``y`` or ``lon`` and ``lat``, and ``t`` or ``frame``. Then the
        name of the column by mark, with underscores; none in a file that is not of Movebank.

    Raises:
        ArgumentError: a column is missing, and the sentence lists those that are there, or another one has its name.
    """
    numbers = sum(bool(name.strip()) and set(name.strip()) <= _NUMBER_SIGNS for name in header)
    if numbers > 1 and numbers >= len(header) - 1:  # all but the id are numbers: a row of values
        raise ArgumentError(f"path must name its columns in row 1, got {where}, whose row 1 is {quote(list(header))}.")
    given = check_names(header, mapping, where)
    found = dict(given)
    plain = {_normalise(name): name for name in reversed(header)}
    for role, names in ROLES.items():
        guess = next((plain[name] for name in map(_normalise, names) if name in plain), None)
        if role not in mapping and guess is not None and guess not in found.values():
            found[role] = guess
    pair = _choose_pair(found, given)
    unused = {*_PAIRS[0], *_PAIRS[1]} - {*pair}
    if "t" in found and "frame" in found:
        unused.add("t" if "frame" in given and "t" not in given else "frame")
    moves = [role for role in _VELOCITIES if role in given]  # of two velocities, one tells nothing without the other
    if not {"vx", "vy"} <= found.keys() and not moves:
        unused |= {*_VELOCITIES}
    found = {role: name for role, name in found.items() if role not in unused}
    needed = ["id", *([] if "frame" in found else ["t"]), *(("vx", "vy") if moves else ()), *pair]
    if missing := [role for role in needed if role not in found]:
        raise _missing(missing, where, header, mapping)
    marks = ("visible", *_OUTLIERS, "manually_marked_valid") if is_movebank(header) else ()
    spelled = {_normalise(name): name for name in header}
    marked = {mark: spelled[mark] for mark in marks if mark in spelled}
    for role, name in (found | marked).items():
        if header.count(name) > 1:
            raise ArgumentError(
                f"path must name each column once, got {where} with {header.count(name)} columns {quote(name)} for "
                f"{role}."
            )
    return found, marked


def _choose_pair(found: Mapping[str, str], given: Mapping[str, str]) -> tuple[str, str]:
    """The coordinates to read: those that the caller has given, or degrees, which name their datum, or x and y."""
    planar, geographic = _PAIRS
    if {*planar} & given.keys():
        return planar
    return geographic if {*geographic} & given.keys() or {*geographic} <= found.keys() else planar


def is_movebank(header: Iterable[str]) -> bool:
    """Whether the names of the columns are those of Movebank."""
    return bool(_MOVEBANK & set(map(_normalise, header)))


def read_marks(values: Mapping[str, Iterable[Any]], rows: int) -> Mask:
    """Which of some rows of a Movebank file are marked as outliers, ``(rows,)`` bool.

    By Movebank's attribute dictionary, ``visible`` is false where one of the outlier columns is true, unless
    ``manually_marked_valid`` is true. A file may hold some of these columns only; an empty cell marks nothing.

    Args:
        values: the values by the names of the marks, and others.
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


def _missing(roles: Sequence[str], where: str, header: Sequence[str], mapping: Mapping[str, str]) -> ArgumentError:
    """The error for a file in which no column has these roles."""
    for role in roles:
        if role in mapping:
            return ArgumentError(f"columns must not leave out {role}, which is needed, got '' for {role}.")
    words = ["t (or frame)" if role == "t" else role for role in roles]
    named = " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
    if {*_PAIRS[0]} <= {*roles}:
        named += " (or lon and lat)"
    what, them = ("column", "it") if len(roles) == 1 else ("columns", "them")
    free = [name for name in header if name not in mapping.values()]
    known = {_normalise(each) for names in ROLES.values() for each in names}
    unknown = [name for name in free if name and _normalise(name) not in known]
    example = f", such as columns={{{roles[0]!r}: {unknown[0]!r}}}" if unknown else ""
    given = ", ".join(f"{quote(name)} is given to {role}" for role, name in mapping.items() if name in header)
    return ArgumentError(
        f"columns must name the {what} of {where} for {named}{example}; no name among {quote(free)} is known for {them}"
        f"{f', because {given}' if given else ''}."
    )

"""Read Parquet, NPZ, GPX and ULog files as tables of pandas; libraries say by exceptions what is wrong with a file."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from usnet_env.tracks import columns as roles

#: The names of the columns, and what reads some of them: it takes names by role, and its columns are the roles.
Table = tuple[list[str], Callable[[Mapping[str, str]], pd.DataFrame]]
NUMBERS = roles.ROLES.keys() - set(roles.LABELS)
_TOPICS = {
    "vehicle_global_position": {"lon": "lon", "lat": "lat", "z": "alt"},
    "vehicle_local_position": {"x": "y", "y": "x", "z": "z"},  # its columns are north, east and down
}


def as_table(frame: pd.DataFrame) -> Table:
    """The columns of a data frame."""
    return list(frame), lambda names: frame[list(names.values())].set_axis(list(names), axis=1)


def as_long(table: Table) -> Table:
    """A table with a row for each time, such as ``t, x1, y1, x2, y2``, as one with a row for each sample of an id."""
    header, read = table
    plain, wide = {roles.split_unit(name)[0] for name in header}, roles.find_wide(header)
    if len(wide) < 2 or plain & {name.replace("-", "_") for name in roles.ROLES["id"]}:
        return table
    rest = [name for name in header if not any(name in axes.values() for axes in wide.values())]
    if not plain & {*roles.ROLES["t"], *roles.ROLES["frame"]}:
        rest.append("frame")  # the number of the row

    def read_long(names: Mapping[str, str]) -> pd.DataFrame:
        own = {f"{axis}:{label}": axes[axis] for label, axes in wide.items() for axis in names if axis in axes}
        times = {role: name for role, name in names.items() if name in header}
        rows = read(times | own)
        frame = rows[list(times)] if times else pd.DataFrame({"frame": np.arange(len(rows))})
        parts = [
            frame.assign(id=label, **{axis: rows[f"{axis}:{label}"] for axis in axes if f"{axis}:{label}" in rows})
            for label, axes in wide.items()
        ]
        return pd.concat(parts, ignore_index=True).dropna(subset=["x", "y"], ignore_index=True)

    return ["id", *rest, "x", "y", *(["z"] if all("z" in axes for axes in wide.values()) else [])], read_long


def read_json(data: bytes, *, lines: bool) -> Table:
    """Read records, or one on each line."""
    return as_table(pd.read_json(io.BytesIO(data), lines=lines, convert_dates=False))


def read_parquet(path: Path) -> Table:
    """Read a Parquet file; an index that pandas has written into it is a column like others."""
    import pyarrow.parquet

    return as_table(pyarrow.parquet.read_table(path).to_pandas(ignore_metadata=True))


def read_npz(path: Path, mapping: Mapping[Any, str]) -> Table:
    """Read an NPZ file: 1-D arrays of one length, or ``position`` ``(T, N, 2 or 3)`` and arrays beside it.

    Beside ``position`` there may be ``t`` ``(T,)`` (otherwise the numbers of the instants count), ``id`` ``(N,)``
    (otherwise they are numbered), ``leader`` ``(N,)`` or ``(T, N)`` and ``seen`` ``(T, N)``; NaN is unseen as well.
    """
    with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    if arrays.get("position", np.empty(0)).ndim != 3:
        return as_table(pd.DataFrame(arrays))
    place = arrays.pop("position")
    seen = np.isfinite(place).all(axis=2) & arrays.pop("seen", np.ones((), bool)).astype(bool)
    who, when = np.nonzero(seen.T)
    columns: dict[str, Any] = {"xyz"[axis]: place[when, who, axis] for axis in range(place.shape[2])}
    for_ids = {"id", "ids", "leader", mapping.get("id"), mapping.get("leader")}
    for name, values in arrays.items():
        of_times = values.shape == seen.shape[:1] and name not in for_ids
        columns[name] = np.broadcast_to(values[:, None] if of_times else values, seen.shape)[when, who]
    if not {"id", "ids", mapping.get("id")} & arrays.keys():
        columns["id"] = who
    if not {"t", "time", "frame", mapping.get("t"), mapping.get("frame")} & arrays.keys():
        columns["frame"] = when
    return as_table(pd.DataFrame(columns))


def read_gpx(data: bytes, stem: str) -> Table:
    """Read the track points of a GPX file; the ids are the names of the tracks.

    A name that several tracks share has the number of the track added, as has ``stem``, for a track without a name.
    """
    tracks = list(ElementTree.fromstring(data).iterfind(".//{*}trk"))
    names = [(track.findtext("{*}name") or "").strip() for track in tracks]
    count = Counter(names)
    points: list[dict[str, Any]] = []
    for number, (name, track) in enumerate(zip(names, tracks, strict=True), start=1):
        label = name if name and count[name] == 1 else f"{name or stem}-{number}"
        for point in track.iterfind(".//{*}trkpt"):
            cells = {role: (point.findtext(f"{{*}}{role}") or "").strip() for role in ("ele", "time")}
            points.append({"name": label, "lon": point.get("lon"), "lat": point.get("lat"), **cells})
    return as_table(pd.DataFrame(points, columns=["name", "lon", "lat", "ele", "time"]))


def read_ulog(path: Path) -> Table:
    """Read the estimated positions of a PX4 ULog file: ``vehicle_global_position``, or else the local one."""
    import pyulog

    log = pyulog.ULog(io.BytesIO(path.read_bytes()), list(_TOPICS))
    found = {dataset.name: dataset.data for dataset in reversed(log.data_list)}
    topic = next((name for name in _TOPICS if name in found), "")
    data = found.get(topic, {"timestamp": []})
    frame = pd.DataFrame({role: np.asarray(data[name], float) for role, name in _TOPICS.get(topic, {}).items()})
    if topic == "vehicle_local_position":
        frame["z"] *= -1
    return as_table(frame.assign(t=np.asarray(data["timestamp"], float) / 1e6, id=path.stem))

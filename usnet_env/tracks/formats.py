"""Read Parquet, NPZ, GPX and ULog files as tables of pandas.

Each function returns the names of the columns, and a function that reads some of them. What is wrong
with a file, libraries say by exceptions of their own.
"""

from __future__ import annotations

import io
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from usnet_env.config import ArgumentError, quote

#: The names of the columns, and what reads some of them: it takes names by role, and its columns are the roles.
Table = tuple[list[str], Callable[[Mapping[str, str]], pd.DataFrame]]
_IDS, _TIMES = {"id", "ids", "leader"}, {"t", "time", "frame"}  # arrays beside ``position``
_TOPICS = {
    "vehicle_global_position": {"lon": "lon", "lat": "lat", "z": "alt"},
    # The columns of a local position are north, east and down.
    "vehicle_local_position": {"x": "y", "y": "x", "z": "z", "vx": "vy", "vy": "vx", "vz": "vz"},
}


def check_size(path: Path, needed: int, max_bytes: int | None) -> None:
    """Refuse a file that expands to more than ``max_bytes``, or else than 256 MiB and 20 times its size."""
    most = max(2**28, 20 * path.stat().st_size) if max_bytes is None else max_bytes
    if needed > most:
        raise ArgumentError(
            f"max_bytes (--max-bytes) must be at least the size that {quote(str(path))} expands to, got {most}."
        )


def _as_table(frame: pd.DataFrame) -> Table:
    return list(frame), lambda names: frame[list(names.values())].set_axis(list(names), axis=1)


def read_parquet(path: Path, max_bytes: int | None) -> Table:
    """Read the columns of a Parquet file."""
    import pyarrow.parquet

    with pyarrow.parquet.ParquetFile(path) as file:
        rows, schema = file.metadata.num_rows, file.schema_arrow

    def read(names: Mapping[str, str]) -> pd.DataFrame:
        check_size(path, 8 * rows * len(names), max_bytes)
        found = [*names.values()]
        texts = [name for name in found if str(schema.field(name).type) in ("string", "large_string")]
        table = pyarrow.parquet.read_table(path, columns=found, read_dictionary=texts)
        return table.to_pandas()[found].set_axis(list(names), axis=1)

    return schema.names, read


def read_npz(path: Path, max_bytes: int | None, mapping: Mapping[Any, str]) -> Table:
    """Read an NPZ file: 1-D arrays of one length, or ``position`` ``(T, N, 2 or 3)`` and arrays beside it.

    Beside ``position`` there may be ``t`` ``(T,)`` (otherwise the numbers of the instants count), ``id`` ``(N,)``
    (otherwise they are numbered), ``leader`` ``(N,)`` or ``(T, N)`` and ``seen`` ``(T, N)``; NaN is unseen as well.

    Raises:
        ArgumentError: the file needs too much memory, or an array beside ``position`` has another shape.
    """
    with zipfile.ZipFile(path) as archive:
        check_size(path, sum(member.file_size for member in archive.infolist()), max_bytes)
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    place = arrays.get("position", np.empty(0))
    if place.ndim != 3:
        return _as_table(pd.DataFrame(arrays))
    del arrays["position"]
    seen = np.isfinite(place).all(axis=2) & arrays.pop("seen", np.ones((), bool)).astype(bool)
    who, when = np.nonzero(seen.T)
    columns: dict[str, Any] = {"xyz"[axis]: place[when, who, axis] for axis in range(place.shape[2])}
    named = {role: name for role, name in mapping.items() if name}
    for_ids = {named.get("id"), named.get("leader"), *_IDS}
    for_times = {named.get("t"), named.get("frame"), *_TIMES}
    for name, values in arrays.items():
        if values.shape == seen.shape and name not in for_times:
            columns[name] = values[when, who]
        elif name in for_ids and values.shape == seen.shape[1:]:
            columns[name] = values[who]
        elif name in for_times and values.shape == seen.shape[:1]:
            columns[name] = values[when]
        elif name in for_ids | for_times:
            raise ArgumentError(f"{name} must fit position {place.shape} in {quote(str(path))}, got {values.shape}.")
    if not {named.get("id", "id"), "ids"} & columns.keys():
        columns["id"] = who
    if not for_times & columns.keys():
        columns["frame"] = when
    return _as_table(pd.DataFrame(columns))


def read_gpx(data: bytes, stem: str) -> Table:
    """Read the track points of a GPX file; the ids are the names of the tracks.

    Where several tracks share a name, each has its number in the file added; a track without a name has that of the
    file, with its number.

    Args:
        data: the content of the file.
        stem: the name of the file.
    """
    points: list[dict[str, Any]] = []
    names: list[str] = []
    for number, track in enumerate(ElementTree.fromstring(data).iterfind(".//{*}trk"), start=1):
        name = (track.findtext("{*}name") or "").strip() or f"{stem}-{number}"
        found = list(track.iterfind(".//{*}trkpt"))
        names += [name] if found else []
        for point in found:
            cells = {role: (point.findtext(f"{{*}}{role}") or "").strip() for role in ("ele", "time")}
            points.append({"name": (name, number), "lon": point.get("lon"), "lat": point.get("lat"), **cells})
    count, taken = Counter(names), set(names)
    ids: dict[tuple[str, int], str] = {}
    for key in dict.fromkeys(point["name"] for point in points):
        name, number = key
        while count[key[0]] > 1 and name in taken:
            name += f"-{number}"
        taken.add(name)
        ids[key] = name
    frame = pd.DataFrame(points, columns=["name", "lon", "lat", "ele", "time"])
    return _as_table(frame.assign(name=[ids[point["name"]] for point in points]))


def read_ulog(path: Path) -> Table:
    """Read the estimated positions of a PX4 ULog file: ``vehicle_global_position``, or else the local one."""
    import pyulog

    log = pyulog.ULog(io.BytesIO(path.read_bytes()), list(_TOPICS))
    found = {dataset.name: dataset.data for dataset in reversed(log.data_list)}
    topic = next((name for name in _TOPICS if name in found), "")
    data, roles = found.get(topic, {"timestamp": []}), _TOPICS.get(topic, {})
    frame = pd.DataFrame({role: np.asarray(data[name], float) for role, name in roles.items() if name in data})
    if topic == "vehicle_local_position":
        frame[list({"z", "vz"} & {*frame})] *= -1
    frame["t"] = np.asarray(data["timestamp"], float) / 1e6
    return _as_table(frame.assign(id=path.stem))

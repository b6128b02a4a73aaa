"""Archives, and readers of other formats than CSV: functions from a path to a frame, whose exceptions tell the fault.

The frame has a row for each sample, and columns that are named as those of a CSV file. An installed distribution adds a
reader by an entry point of the group ``usnet.readers``. A reader is taken for files with its name as their suffix, or
where ``format`` (``--format``) names it.
"""

from __future__ import annotations

import gzip
import io
import json
import os
import sqlite3
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from operator import attrgetter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from usnet_env.arrays import Floats
from usnet_env.config import quote
from usnet_env.files import read_csv
from usnet_env.parts import Registry, check_factory

Reader = Callable[[Path], pd.DataFrame]
_TOPICS = {  # of ULog
    "vehicle_global_position": {"lon": "lon", "lat": "lat", "z": "alt"},
    "vehicle_local_position": {"x": "y", "y": "x", "z": "z"},  # its columns are north, east and down
}
_RECEIVERS = ("vehicle_gps_position", "sensor_gps")  # the last one that is there counts
_MESSAGES = {  # of MAVLink and of ArduPilot's logs: the fields, and units in a degree and in a metre
    "GLOBAL_POSITION_INT": ("lon", "lat", "alt", 1e7, 1e3),
    "POS": ("Lng", "Lat", "Alt", 1.0, 1.0),
}
_POSITION = "{0}.x {0}.y {0}.z"
_POSITIONS = {  # in messages of ROS: the columns, and where they are
    "nav_msgs/msg/Odometry": ("x y z", _POSITION.format("pose.pose.position")),
    "geometry_msgs/msg/PoseStamped": ("x y z", _POSITION.format("pose.position")),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("x y z", _POSITION.format("pose.pose.position")),
    "geometry_msgs/msg/TransformStamped": ("x y z", _POSITION.format("transform.translation")),
    "geometry_msgs/msg/PointStamped": ("x y z", _POSITION.format("point")),
    "sensor_msgs/msg/NavSatFix": ("lon lat z", "longitude latitude altitude"),
    (_TRANSFORMS := "tf2_msgs/msg/TFMessage"): ("x y z", _POSITION.format("transform.translation")),
}
_TEXT_SUFFIXES = (".csv", ".tsv", ".gpx", ".json", ".txt")  # in zip archives; one of the last only if there is no other
_SLEAP = {"tracks": '["track", "xy", "node", "frame"]', "instance_scores": '["track", "frame"]'}  # the usual axes
_MOVEMENT = ("position", "confidence")
_VECTOR_AXES = {"coordinates": ("lon", "lat", "z"), "xyz": ("x", "y", "z")}  # lists in JSON
_GEOJSON = ("properties", "geometry")  # whose names are those of a record
_FROM_START = "Times of ULog files without UTC are those since each drone's own start: "
_FROM_START += "leaders are right only if all started at one time."
_NO_STAMPS = "Times are those of the bag's log, as messages have no stamps; a late connection makes a leader late."


def unpack(path: Path, max_size: float) -> tuple[bytes, str]:
    """The content of a text file, unpacked to at most so many MiB, and its name."""
    data = path.read_bytes()
    if data[:2] == b"\x1f\x8b":
        with gzip.open(io.BytesIO(data)) as packed:
            data = packed.read(int(max_size * 2**20) + 1)
        _check_size(len(data), max_size)
        return data, path.stem
    if data[:4] != b"PK\x03\x04":
        return data, path.name
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = archive.namelist()
        texts = [name for name in names if name.lower().endswith(_TEXT_SUFFIXES) and not name.startswith("__MACOSX/")]
        texts = [name for name in texts if not name.lower().endswith(".txt")] or texts
        if len(texts) != 1:
            raise ValueError(f"the archive must hold one file of {', '.join(_TEXT_SUFFIXES)}, not {quote(names)}")
        _check_size(archive.getinfo(texts[0]).file_size, max_size)
        return archive.read(texts[0]), texts[0]


def check_archive(path: Path, max_size: float) -> None:
    """Refuse a zip archive, as NPZ is one, whose files unpack to more MiB."""
    if path.is_file() and zipfile.is_zipfile(path):  # a pipe can be read once
        with zipfile.ZipFile(path) as archive:
            _check_size(sum(info.file_size for info in archive.infolist()), max_size)


def _check_size(size: int, max_size: float) -> None:
    if size > max_size * 2**20:
        raise ValueError(f"it unpacks to more than {max_size:g} MiB (max_size, or --max-size, allows more)")


def read_json(path: Path) -> pd.DataFrame:
    """A list of records, GeoJSON, or an object with lists of records, whose other values are those of each record."""
    data = json.loads(path.read_bytes())  # pandas.read_json would take the text 007 for a number
    if isinstance(data, dict) and not _list_nested(data):
        if len({len(cell) if isinstance(cell, list) else -1 for cell in data.values()} - {0}) != 1:
            raise ValueError(f"it holds neither records nor columns, but {quote(list(data))}")
        return pd.DataFrame(data)
    return _tabulate_records(data if isinstance(data, list) else [data])


def read_lines(path: Path) -> pd.DataFrame:
    """A JSON record on each line, perhaps with lists of records in it, or the tracks of Trajnet++."""
    records = [json.loads(line) for line in path.read_bytes().splitlines() if line.strip()]
    tracks = [record["track"] for record in records if isinstance(record.get("track"), dict)]
    return pd.DataFrame(tracks).rename(columns={"f": "frame", "p": "id"}) if tracks else _tabulate_records(records)


def _list_nested(record: Mapping[str, Any]) -> list[str]:
    return [name for name, cell in record.items() if isinstance(cell, list) and cell and isinstance(cell[0], dict)]


def _tabulate_records(records: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """A frame of records, in which a list of coordinates is a column for each."""
    frame = pd.DataFrame([row for record in records for row in _flatten_record(record, {})])
    for name, axes in _VECTOR_AXES.items():
        if name in frame:
            vectors = frame.pop(name)
            columns = {axis: vectors.str[k] for k, axis in enumerate(axes) if vectors.str[k].notna().any()}
            frame = frame.drop(columns=[*axes], errors="ignore").assign(**columns)
    return frame


def _flatten_record(record: Mapping[str, Any], outer: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The rows of a record: itself, or one for each record in its lists, but for those of a ball."""
    nested, row = _list_nested(record), dict(outer)
    for name, cell in record.items():
        if name not in nested:
            row |= cell if name in _GEOJSON and isinstance(cell, dict) else {name: cell}
    for name in nested:
        for inner_row in record[name] if not name.lower().startswith("ball") else ():
            yield from _flatten_record(inner_row, row)
    if not nested:
        yield row


def read_parquet(path: Path) -> pd.DataFrame:
    """Parquet; an index that pandas has written into it is a column like others, and GeoParquet's points are two."""
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(path)
    frame = table.to_pandas(ignore_metadata=True)
    geo = json.loads((table.schema.metadata or {}).get(b"geo", "{}"))
    if name := geo.get("primary_column"):
        points = np.frombuffer(b"".join(frame.pop(name)), [("kind", "V5"), ("x", "<f8"), ("y", "<f8")])
        system = geo["columns"][name].get("crs") or {"type": "GeographicCRS"}
        axes = ("lon", "lat") if system["type"] == "GeographicCRS" else ("x", "y")
        frame = frame.assign(**dict(zip(axes, (points["x"], points["y"]), strict=True)))
    return frame


def read_sqlite(path: Path) -> pd.DataFrame:
    """Trajectories of JuPedSim."""
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
        frame = pd.read_sql("SELECT * FROM trajectory_data", database)
        rate = database.execute("SELECT value FROM metadata WHERE key = 'fps'").fetchone()
    frame.attrs["rate"] = float(rate[0])
    return frame


def read_npz(path: Path) -> pd.DataFrame:
    """NumPy or TRex: 1-D arrays of one length; or ``position`` ``(T, N, 2 or 3)`` and arrays beside it.

    Beside ``position`` there may be ``t`` ``(T,)`` (otherwise the numbers of the instants count), ``id`` ``(N,)``
    (otherwise they are numbered), ``leader`` ``(N,)`` or ``(T, N)`` and ``seen`` ``(T, N)``; NaN is unseen as well.
    """
    with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
        arrays: dict[str, NDArray[Any]] = {name: file[name] for name in file.files}
    if arrays.get("position", np.empty(0)).ndim == 3:
        position = arrays.pop("position").astype(np.float64)
        position[~arrays.pop("seen", np.ones((), bool)).astype(bool) & np.ones(position.shape[:2], bool)] = np.nan
        return _list_samples(position, arrays, arrays.pop("ids", None))
    length = max((values.size for values in arrays.values() if values.ndim == 1), default=0)
    same_length = {name: values for name, values in arrays.items() if values.size == 1 or values.shape == (length,)}
    return pd.DataFrame({k: v.item() if v.size == 1 else v for k, v in same_length.items()}, index=range(length))


def read_hdf5(path: Path) -> pd.DataFrame:
    """SLEAP's analysis files, netCDF files of movement, and trajectories of idtracker.ai and of pedestrians (PedPy).

    The place of an animal is the mean of the parts that are seen; a time is in seconds if the file has a frame rate.
    """
    import h5py

    with h5py.File(path) as file:
        if "trajectories" in file:
            position, rate = file["trajectories"][()], file.attrs.get("frames_per_second")
            arrays = {} if rate is None else {"t": np.arange(len(position)) / float(rate)}
            if "id_probabilities" in file:
                arrays["confidence"] = file["id_probabilities"][()].reshape(position.shape[:2])
            return _list_samples(position, arrays)
        if "tracks" in file:
            axes = {name: json.loads(file[name].attrs.get("dims", _SLEAP[name])) for name in _SLEAP if name in file}
            arrays = {name: _arrange_axes(file[name], axes[name], ("frame", "track", "xy")) for name in axes}
            names = file["track_names"]
            return _list_samples(arrays.pop("tracks"), arrays, names.asstr()[()] if len(names) else None)
        if "trajectory" in file:
            frame = pd.DataFrame(file["trajectory"][()])
            frame.attrs["rate"] = float(file["trajectory"].attrs["fps"])
            return frame
        if "position" not in file:
            names_read = "trajectories, tracks, trajectory nor position"
            raise ValueError(f"it has neither {names_read}, but {', '.join(file) or 'nothing'}")
        axes = {name: [scales[0].name.strip("/") for scales in file[name].dims] for name in _MOVEMENT if name in file}
        individuals = next(name for name in axes["position"] if name.startswith("individual"))
        arrays = {name: _arrange_axes(file[name], axes[name], ("time", individuals, "space")) for name in axes}
        time = "frame" if file.attrs.get("time_unit") in ("frames", b"frames") else "t"
        position, names = arrays.pop("position"), file[individuals].asstr()[()]
        return _list_samples(position, arrays | {time: file["time"][()]}, names)


def read_dataset(dataset: Any) -> pd.DataFrame:
    """A dataset of xarray as movement makes it; the place of an animal is the mean of its parts."""
    position = dataset["position"]
    other_axes = [name for name in position.dims if name not in ("time", "space") and not name.startswith("individual")]
    frame = position.mean(other_axes).to_dataset("space")
    if "confidence" in dataset:
        confidence = dataset["confidence"]
        frame = frame.assign(confidence=confidence.mean([name for name in other_axes if name in confidence.dims]))
    time = "frame" if dataset.attrs.get("time_unit") == "frames" else "t"
    return frame.to_dataframe().dropna(subset=["x", "y"]).reset_index().rename(columns={"time": time})


def _arrange_axes(values: Any, axes: Sequence[str], order: Sequence[str]) -> Floats:
    """An array with its axes in this order; over those that are not named, the mean is taken."""
    averaged = tuple(k for k, name in enumerate(axes) if name not in order)
    remaining = [name for name in axes if name in order]
    with warnings.catch_warnings(action="ignore"):  # of places where no part is seen
        mean = np.nanmean(np.asarray(values, np.float64), axis=averaged)
    return np.transpose(mean, [remaining.index(name) for name in order if name in remaining])


def _list_samples(position: NDArray[Any], columns: Mapping[str, Any], names: Any = None) -> pd.DataFrame:
    """A row for each seen position ``(time, individuals, space)``; others are over time, individuals or both."""
    times, ids, axes = position.shape
    individual, instant = np.nonzero(np.isfinite(position).all(axis=2).T)
    labels = np.arange(ids) if names is None else np.asarray(names)
    rows: dict[str, Any] = {"id": labels[individual], "frame": instant}
    for name, values in columns.items():
        of_times = values.shape == (times,) and name not in ("id", "leader")
        rows[name] = np.broadcast_to(values[:, None] if of_times else values, (times, ids))[instant, individual]
    return pd.DataFrame(rows | {"xyz"[axis]: position[instant, individual, axis] for axis in range(axes)})


def read_deeplabcut(path: Path) -> pd.DataFrame:
    """CSV of DeepLabCut, a file for one animal or for several; a place is the mean of the parts of the body."""
    with open(path, encoding="utf-8") as file:
        has_individuals = [file.readline(), file.readline()][1].startswith("individuals")
    table = read_csv(path, header=[1, 2, 3] if has_individuals else [1, 2], index_col=0)
    table.columns = table.columns.set_names(["id", "part", "axis"] if has_individuals else ["part", "axis"])
    mean = table.T.groupby(level=["id", "axis"] if has_individuals else ["axis"], sort=False).mean().T
    mean = mean.rename_axis("frame")
    return (mean.stack("id", future_stack=True) if has_individuals else mean).dropna(subset=["x", "y"]).reset_index()


def read_mot(path: Path) -> pd.DataFrame:
    """Boxes of the MOT challenge: frame, id, left, top, width, height, confidence; a place is the middle of a box."""
    rows = read_csv(path, header=None).iloc[:, :7]
    frame, name, left, top, width, height, confidence = (rows[k] for k in rows)
    middle = {"x": left + width / 2, "y": top + height / 2}
    return pd.DataFrame({"frame": frame, "id": name, **middle, "confidence": confidence})


def read_gpx(path: Path) -> pd.DataFrame:
    """Track points of GPX; the ids are the names of the tracks.

    A name that several tracks share has the number of the track added, as has the file's, for a track without a name.
    """
    tracks = list(ElementTree.parse(path).iterfind(".//{*}trk"))
    names = [(track.findtext("{*}name") or "").strip() for track in tracks]
    count = Counter(names)
    points: list[dict[str, Any]] = []
    for number, (name, track) in enumerate(zip(names, tracks, strict=True), start=1):
        label = name if name and count[name] == 1 else f"{name or path.stem}-{number}"
        for point in track.iterfind(".//{*}trkpt"):
            cells = {role: (point.findtext(f"{{*}}{role}") or "").strip() for role in ("ele", "time")}
            points.append({"name": label, "lon": point.get("lon"), "lat": point.get("lat"), **cells})
    frame = pd.DataFrame(points, columns=["name", "lon", "lat", "ele", "time"])
    frame.attrs["for_itself"] = True
    return frame


def read_ulog(path: Path) -> pd.DataFrame:
    """Estimated positions of a PX4 ULog file: ``vehicle_global_position``, or else the local one.

    Times are in UTC if the log has a GPS receiver's, or that of the start; otherwise since the start.
    """
    import pyulog

    log = pyulog.ULog(io.BytesIO(path.read_bytes()), [*_TOPICS, *_RECEIVERS])
    datasets = {dataset.name: dataset.data for dataset in reversed(log.data_list)}
    topic = next((name for name in _TOPICS if name in datasets), "")
    data = datasets.get(topic, {"timestamp": []})
    frame = pd.DataFrame({role: np.asarray(data[name], float) for role, name in _TOPICS.get(topic, {}).items()})
    if topic == "vehicle_local_position":
        frame["z"] *= -1
    frame = frame.assign(t=np.asarray(data["timestamp"], float) / 1e6, id=path.stem)
    starts = [log.msg_info_dict.get("boot_time_utc_us", 0)]  # microseconds since 1970
    for receiver in (datasets[name] for name in _RECEIVERS if name in datasets):
        utc = np.asarray(receiver["time_utc_usec"], np.int64)
        starts += [np.median((utc - np.asarray(receiver["timestamp"], np.int64))[utc > 0])] * bool((utc > 0).any())
    if start := int(starts[-1]):
        frame["t"] = pd.to_datetime(np.asarray(data["timestamp"], np.int64) + start, unit="us", utc=True)
    frame.attrs |= {"for_itself": True} | ({} if start else {"doubts": [_FROM_START]})
    return frame


def read_mavlink(path: Path) -> pd.DataFrame:
    """Estimated positions in a MAVLink or ArduPilot log; the ids are the numbers of the systems, or the file's name."""
    from pymavlink import mavutil

    rows = []
    with closing(mavutil.mavlink_connection(os.fspath(path))) as log:
        while (message := log.recv_match(type=list(_MESSAGES))) is not None:
            *fields, degree, metre = _MESSAGES[message.get_type()]
            lon, lat, z = (getattr(message, str(name)) for name in fields)
            name = message.get_srcSystem() if hasattr(message, "get_srcSystem") else path.stem
            rows.append((name, message._timestamp, lon / degree, lat / degree, z / metre))
    return pd.DataFrame(rows, columns=["id", "t", "lon", "lat", "z"])


def read_ros(path: Path) -> pd.DataFrame:
    """Places in a bag of ROS 1 or 2; the ids are the topics with the first kind of message in which it has places.

    Of transforms, the ids are those whose parent has none, such as ``map``. Times are the stamps of the messages, or
    those of the bag's log if some have none.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
        kinds = dict.fromkeys(topic.msgtype for topic in bag.connections)
        kind = next((kind for kind in _POSITIONS if kind in kinds), "")
        if not kind:
            raise ValueError(f"it has no places in {', '.join(_POSITIONS)}, but {', '.join(kinds) or 'nothing'}")
        names, fields = _POSITIONS[kind]
        read_fields = attrgetter("header.stamp.sec", "header.stamp.nanosec", "header.frame_id", *fields.split())
        rows = []
        for topic, time, raw in bag.messages([topic for topic in bag.connections if topic.msgtype == kind]):
            message = bag.deserialize(raw, kind)
            for part in getattr(message, "transforms", [message]):
                name = part.child_frame_id if kind == _TRANSFORMS else topic.topic
                rows.append((name, time / 1e9, *read_fields(part)))
    frame = pd.DataFrame(rows, columns=["id", "t", "sec", "nanosec", "parent", *names.split()])
    if kind == _TRANSFORMS:
        frame = frame[~frame["parent"].isin(frame["id"])]
    stamps = frame.pop("sec") + frame.pop("nanosec") / 1e9
    if (stamps > 0).all():
        frame["t"] = stamps
    else:
        frame.attrs["doubts"] = [_NO_STAMPS]
    return frame.drop(columns="parent")


_BUILT_IN: dict[str, Reader] = {
    **dict.fromkeys(("parquet", "pq"), read_parquet),
    **dict.fromkeys(("feather", "arrow"), pd.read_feather),
    **dict.fromkeys(("sqlite", "sqlite3"), read_sqlite),
    **dict.fromkeys(("json", "geojson"), read_json),
    **dict.fromkeys(("jsonl", "ndjson"), read_lines),
    **dict.fromkeys(("h5", "hdf5", "nc"), read_hdf5),
    **dict.fromkeys(("tlog", "bin"), read_mavlink),
    **dict.fromkeys(("bag", "mcap", "db3"), read_ros),
    "npz": read_npz,
    "gpx": read_gpx,
    "ulg": read_ulog,
    "deeplabcut": read_deeplabcut,
    "mot": read_mot,
}
READERS = Registry(
    "reader", "format", "usnet.readers", __name__, check_factory, own=_BUILT_IN, reserved=("csv",), classes=True
)

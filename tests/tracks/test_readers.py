"""Formats of trackers, and those of strangers: each is read as the plain CSV of the same tracks."""

import itertools
import json
import sqlite3
import struct
from contextlib import closing

import numpy as np
import pytest
from track_files import HEADER, refusal, rows_of, straight, write_csv

from usnet_env import ArgumentError
from usnet_env.tracks import read_tracks

PLACES = straight()[..., :2]  # (20, 3, 2)
PARTS = np.array([[-1.0, 0.0], [1.0, 0.0]])  # of a body, about its middle
BODIES = PLACES[:, :, None] + PARTS  # (20, 3, 2 parts, 2)
FRAMES = [[row[0], round(row[1] * 2), *row[2:]] for row in rows_of(straight())]


def write_hdf5(path, name, values, attributes, **others):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file[name] = values
        for owner in (file, file[name]):
            owner.attrs.update(attributes)
        for other, array in others.items():
            file[other] = array
    return path


def write_sleap(path, names, **axes):
    order = axes.get("order", ("track", "xy", "node", "frame"))
    values = BODIES.transpose([("frame", "track", "node", "xy").index(name) for name in order])
    dims = {"dims": json.dumps(order)} if axes else {}
    return write_hdf5(path, "tracks", values, dims, track_names=names, instance_scores=np.full((3, 20), 0.9))


def write_movement(path):
    h5py = pytest.importorskip("h5py")
    axes = {"time": np.arange(20) / 2, "space": ["x", "y"], "keypoints": ["nose", "tail"], "individuals": list("abc")}
    with h5py.File(path, "w") as file:
        file["position"] = BODIES.transpose(0, 3, 2, 1)
        for k, (name, values) in enumerate(axes.items()):
            file[name] = values
            file[name].make_scale(name)
            file["position"].dims[k].attach_scale(file[name])
        file.attrs["time_unit"] = "seconds"
    return path


def write_idtracker(path):
    return write_hdf5(path, "trajectories", PLACES, {"frames_per_second": 2.0}, id_probabilities=np.ones((20, 3, 1)))


def write_archive(path):
    kinds = [("id", "S1"), ("frame", int), ("x", float), ("y", float)]
    return write_hdf5(path, "trajectory", np.array([tuple(row) for row in FRAMES], kinds), {"fps": 2.0})


def write_jupedsim(path):
    with closing(sqlite3.connect(path)) as base:
        base.execute("CREATE TABLE trajectory_data (id, frame, pos_x, pos_y)")
        base.executemany("INSERT INTO trajectory_data VALUES (?, ?, ?, ?)", FRAMES)
        base.execute("CREATE TABLE metadata AS SELECT 'fps' AS key, '2.0' AS value")
        base.commit()
    return path


def write_deeplabcut(path):
    names = [["scorer", *["net"] * 18], ["individuals", *np.repeat(list("abc"), 6)]]
    names += [["bodyparts", *np.tile(np.repeat(["nose", "tail"], 3), 3)], ["coords", *["x", "y", "likelihood"] * 6]]
    sure = np.concatenate([BODIES, np.full((20, 3, 2, 1), 0.9)], axis=3)
    return write_csv(path, [*names[1:], *([k, *now.ravel()] for k, now in enumerate(sure))], names[0])


def write_mot(path):
    rows = [[frame, "abc".index(name), x - 2, y - 1, 4, 2, 1, -1, -1, -1] for name, frame, x, y in FRAMES]
    return write_csv(path, rows[1:], rows[0])


def write_trajnet(path):
    lines = [{"scene": {"id": 0, "p": 0, "s": 0, "e": 19}}]
    lines += [{"track": {"f": frame, "p": name, "x": x, "y": y}} for name, frame, x, y in FRAMES]
    path.write_text("\n".join(map(json.dumps, lines)))
    return path


@pytest.mark.parametrize(
    ("write", "options"),
    [
        (lambda folder: write_sleap(folder / "s.analysis.h5", ["a", "b", "c"]), {"time_unit": 0.5}),
        (lambda folder: write_sleap(folder / "s.h5", [], order=("frame", "track", "node", "xy")), {"time_unit": 0.5}),
        (lambda folder: write_movement(folder / "m.nc"), {}),
        (lambda folder: write_idtracker(folder / "trajectories.h5"), {}),
        (lambda folder: write_archive(folder / "p.h5"), {}),
        (lambda folder: write_jupedsim(folder / "j.sqlite"), {}),
        (lambda folder: write_deeplabcut(folder / "d.csv"), {"format": "deeplabcut", "time_unit": 0.5}),
        (lambda folder: write_mot(folder / "gt.txt"), {"format": "mot", "time_unit": 0.5}),
        (lambda folder: write_trajnet(folder / "t.ndjson"), {"time_unit": 0.5}),
    ],
    ids=["sleap", "sleap-axes", "movement", "idtracker", "archive", "jupedsim", "deeplabcut", "mot", "trajnet"],
)
def test_trackers_files_are_read(tmp_path, write, options):
    read = read_tracks(write(tmp_path), **options)
    assert (len(read.ids), read.duration) == (3, 9.5)
    np.testing.assert_allclose((read.position + read.origin)[:, :2], PLACES.transpose(1, 0, 2).reshape(-1, 2))


def test_datasets_of_xarray_are_read_and_made():
    xarray = pytest.importorskip("xarray")
    axes = {"time": np.arange(20) / 2, "space": ["x", "y"], "keypoints": ["nose", "tail"], "individuals": list("abc")}
    position = BODIES.transpose(0, 3, 2, 1).copy()
    position[5, :, :, 1] = np.nan
    read = read_tracks(xarray.Dataset({"position": ([*axes], position)}, axes, {"time_unit": "seconds"}))
    assert (read.ids, read.samples, read.duration) == (("a", "b", "c"), 59, 9.5)
    made = read.resample(0.5, max_gap=0.5).to_dataset()
    assert (made.position.dims, made.attrs["fps"]) == (("time", "space", "individuals"), 2.0)
    np.testing.assert_allclose(made.position, np.where(np.isnan(position[:, :, 0]), np.nan, PLACES.transpose(0, 2, 1)))
    with pytest.raises(ArgumentError, match=r"xarray\.Dataset of positions"):
        read_tracks(made.drop_vars("position"))


def test_a_file_for_each_animal(tmp_path):
    for k, name in enumerate("ab"):
        place = PLACES[:, k]
        np.savez(
            tmp_path / f"trex_{name}.npz",
            **{"X#wcentroid": place[:, 0], "Y#wcentroid": place[:, 1]},
            time=np.arange(20) / 2,
            id=np.array([k]),
            other=np.zeros((3, 2)),
        )
        names = [["scorer", *["net"] * 3], ["bodyparts", *["nose"] * 3], ["coords", "x", "y", "likelihood"]]
        rows = [[k, *place, 0.9] for k, place in enumerate(place)]
        write_csv(tmp_path / f"dlc_{name}.csv", [*names[1:], *rows], names[0])
    for files, options, ids in (
        ("trex_{}.npz", {}, ("0", "1")),
        ("dlc_{}.csv", {"format": "deeplabcut"}, ("dlc_a", "dlc_b")),
    ):
        read = read_tracks([tmp_path / files.format(name) for name in "ab"], **options)
        assert tuple(map(str, read.ids)) == ids
        np.testing.assert_allclose((read.position + read.origin)[:20, :2], PLACES[:, 0])


def test_mavlink_logs_have_an_id_for_each_system(tmp_path):
    dialect = pytest.importorskip("pymavlink.dialects.v20.common")
    with open(tmp_path / "log.tlog", "wb") as file:
        for k, system in itertools.product(range(4), (1, 2)):
            link = dialect.MAVLink(None, srcSystem=system)
            place = (500_000_000 + 1000 * k, 100_000_000 + 1000 * system, 120_000, 20_000, 0, 0, 0, 0)
            message = link.global_position_int_encode(1000 * k, *place).pack(link)
            file.write(struct.pack(">Q", 1_700_000_000_000_000 + 500_000 * k) + message)
    read = read_tracks(tmp_path / "log.tlog")
    assert (read.ids, read.samples, read.duration, read.origin[2]) == ((1, 2), 8, 1.5, 120.0)
    np.testing.assert_allclose(np.diff(read.position[:4, 1]), 11.1, atol=0.1)


def test_geoparquet_has_degrees_or_metres(tmp_path):
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    columns = {"animal": [row[0] for row in FRAMES], "frame": [row[1] for row in FRAMES]}
    columns["geometry"] = [struct.pack("<BIdd", 1, 1, x, y / 2) for _, _, x, y in FRAMES]
    for system, frame in (("ProjectedCRS", "metres"), ("GeographicCRS", "from degrees")):
        about = {"primary_column": "geometry", "columns": {"geometry": {"encoding": "WKB", "crs": {"type": system}}}}
        table = pyarrow.table(columns).replace_schema_metadata({"geo": json.dumps(about)})
        parquet.write_table(table, tmp_path / "geo.parquet")
        read = read_tracks(tmp_path / "geo.parquet", time_unit=0.5)
        assert read.frame.endswith(frame)
        if system == "ProjectedCRS":
            places = PLACES.transpose(1, 0, 2).reshape(-1, 2) * [1, 0.5]
            np.testing.assert_allclose((read.position + read.origin)[:, :2], places)


def write_bag(folder, suffix, topics="abc", kind="PointStamped", stamped=True):
    """A bag with a message at each place, beside a topic of texts; the log has those of ``c`` 3 s late."""
    typesys = pytest.importorskip("rosbags.typesys")
    from rosbags import rosbag1, rosbag2

    first = suffix == ".bag"
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if first else typesys.Stores.LATEST)
    kinds = {name.rpartition("/")[2]: kind for name, kind in store.types.items()}

    def tell_place(name, frame, x, y, parent="map"):
        time = store.types["builtin_interfaces/msg/Time"](stamped * (1000 + frame // 2), frame % 2 * 500_000_000)
        header = kinds["Header"](stamp=time, frame_id=parent, **{"seq": 0} if first else {})
        if kind == "PointStamped":
            return kinds[kind](header, kinds["Point"](x, y, 0.0))
        transform = kinds["Transform"](kinds["Vector3"](x, y, 0.0), kinds["Quaternion"](0.0, 0.0, 0.0, 1.0))
        return kinds["TransformStamped"](header, name, transform)

    path = folder / f"bag{suffix}" if first else folder / suffix[1:]
    plugin = rosbag2.StoragePlugin.MCAP if suffix == ".mcap" else rosbag2.StoragePlugin.SQLITE3
    with rosbag1.Writer(path) if first else rosbag2.Writer(path, version=9, storage_plugin=plugin) as bag:
        said = [("/rosout", 0, kinds["String"]("ready"))]
        places = [(name, frame, tell_place(name, frame, x, y)) for name, frame, x, y in FRAMES if name in topics]
        if kind == "TFMessage":
            places = [
                ("tf", frame, kinds[kind]([each, tell_place("leg", 0, 1.0, 0.0, "a")])) for _, frame, each in places
            ]
        said += [(f"/{name}", frame, message) for name, frame, message in places]
        kind_of = {name: message.__msgtype__ for name, _, message in said}
        topic_of = {name: bag.add_connection(name, kind, typestore=store) for name, kind in kind_of.items()}
        for name, frame, message in said:
            write = store.serialize_ros1 if first else store.serialize_cdr
            time = int((1e9 + frame / 2 + 3 * (name == "/c")) * 1e9)
            bag.write(topic_of[name], time, write(message, kind_of[name]))
    return path if first else path / f"{path.name}{suffix}"


@pytest.mark.parametrize(
    ("suffix", "kind", "stamped"),
    [
        (".bag", "PointStamped", True),
        (".mcap", "PointStamped", True),
        (".db3", "PointStamped", False),
        (".db3", "TFMessage", True),
    ],
)
def test_bags_have_an_id_for_each_topic_with_places(tmp_path, suffix, kind, stamped):
    path = write_bag(tmp_path, suffix, kind=kind, stamped=stamped)
    read = read_tracks(path.parent if suffix == ".mcap" else path)
    assert read.ids == (("a", "b", "c") if kind == "TFMessage" else ("/a", "/b", "/c"))
    assert (read.duration, read.time[40]) == ((9.5, 0.0) if stamped else (12.5, 3.0))
    assert ["no stamps" in each for each in read.report().warnings] == [True] * (not stamped)
    np.testing.assert_allclose((read.position + read.origin)[:, :2], PLACES.transpose(1, 0, 2).reshape(-1, 2))


def test_a_bag_without_places_is_refused(tmp_path):
    assert "it has no places in nav_msgs/msg/Odometry" in refusal(write_bag(tmp_path, ".mcap", topics=""))


def test_a_strangers_reader_is_found_by_the_suffix_or_by_its_name(tmp_path, declare):
    """One of ``.two``, beside one that gives no frame."""
    program = "import pandas as pd\ndef two(path): return pd.read_csv(path, sep='/', names=['id', 't', 'x', 'y'])\n"
    module = "stranger_reader", f"{program}def none(path): ...\n"
    declare("usnet.readers", module, two="stranger_reader:two", none="stranger_reader:none")
    text = "\n".join("/".join(map(str, row)) for row in rows_of(straight()))
    for name, options in (("tracks.two", {}), ("tracks.txt", {"format": "two"})):
        (tmp_path / name).write_text(text)
        assert read_tracks(tmp_path / name, **options).ids == ("a", "b", "c")
    assert "must return a pandas.DataFrame" in refusal(tmp_path / "tracks.txt", format="none")


def test_an_unknown_format_is_refused_and_csv_can_be_named(tmp_path):
    path = write_csv(tmp_path / "tracks.npz", rows_of(straight()), HEADER)
    assert read_tracks(path, format="csv").ids == ("a", "b", "c")
    assert refusal(path, format="excel").startswith("format must be one of")

"""Tracks from files: every format, guessed and mapped columns, and files that are refused in one sentence."""

import gzip
import os
import struct
import sys
import threading
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from track_files import HEADER, rows_of, straight, write_csv

from usnet_env import ArgumentError
from usnet_env.tracks import Tracks, read_tracks

pyarrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")


def refusal(path, **options):
    with pytest.raises(ArgumentError) as caught:
        read_tracks(path, **options)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert sentence.endswith(".")
    return sentence


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
@pytest.mark.parametrize("order", ["time", "id", "shuffled"])
def test_a_csv_in_any_order_gives_the_same_tracks(tmp_path, delimiter, order):
    rows = rows_of(straight())
    if order == "id":
        rows.sort()
    elif order == "shuffled":
        rows = [rows[k] for k in np.random.default_rng(0).permutation(len(rows))]
    read = read_tracks(write_csv(tmp_path / "tracks.csv", rows, delimiter=delimiter))
    assert sorted(read.ids) == ["a", "b", "c"]
    for k, name in enumerate("abc"):
        part = slice(*read.offsets[[read.ids.index(name), read.ids.index(name) + 1]])
        np.testing.assert_allclose(read.time[part], np.arange(20) * 0.5)
        np.testing.assert_allclose(read.position[part] + read.origin, straight()[:, k], atol=1e-9)


@pytest.mark.parametrize(
    ("header", "options"),
    [
        (["Track ID", "Time", "X", "Y"], {}),
        (["animal", "frame", "easting", "northing"], {}),
        (["who", "when", "a", "b"], {"columns": {"id": "who", "t": "when", "x": "a", "y": "b"}}),
    ],
)
def test_names_of_columns_are_guessed_or_mapped(tmp_path, header, options):
    rows = [row[:4] for row in rows_of(straight())]
    read = read_tracks(write_csv(tmp_path / "tracks.csv", rows, header), **options)
    assert read.samples == 60
    assert f"id = {header[0]}" in str(read.report())


def test_two_dimensions_three_and_a_leader(tmp_path):
    rows = [[*row, "a" if row[0] != "a" else ""] for row in rows_of(straight(height=True))]
    read = read_tracks(write_csv(tmp_path / "tracks.csv", rows, [*HEADER, "z", "leader"]))
    assert read.dimensions == 3
    leader = [read.ids[i] if i >= 0 else None for i in read.leader[read.offsets[:-1]]]
    assert dict(zip(read.ids, leader, strict=True)) == {"a": None, "b": "a", "c": "a"}
    assert read_tracks(write_csv(tmp_path / "flat.csv", rows_of(straight()))).dimensions == 2


def test_times_are_written_as_in_the_file(tmp_path):
    frames = read_tracks(
        write_csv(tmp_path / "f.csv", rows_of(straight(), step=3, first=100), ["id", "frame", "x", "y"])
    )
    assert frames.file_time(6.0) == 106
    assert isinstance(frames.file_time(6.0), int)
    assert "frames" in str(frames.report())
    seconds = read_tracks(tmp_path / "f.csv", time_unit=0.1)
    assert (seconds.duration, seconds.file_time(0.6)) == (pytest.approx(5.7), 106)
    rows = [[row[0], f"2024-05-01T12:00:{row[1]:06.3f}+02:00", *row[2:]] for row in rows_of(straight())]
    dated = read_tracks(write_csv(tmp_path / "d.csv", rows))
    assert dated.duration == pytest.approx(9.5)
    assert dated.file_time(1.5) == "2024-05-01T10:00:01.500Z"


def test_gzip_zip_and_several_files(tmp_path):
    path = write_csv(tmp_path / "tracks.csv", rows_of(straight()))
    with gzip.open(tmp_path / "tracks.csv.gz", "wb") as file:
        file.write(path.read_bytes())
    with zipfile.ZipFile(tmp_path / "tracks.zip", "w") as archive:
        archive.write(path, "tracks.csv")
    for name in ("tracks.csv.gz", "tracks.zip"):
        np.testing.assert_array_equal(read_tracks(tmp_path / name).position, read_tracks(path).position)
    parts = [write_csv(tmp_path / f"{k}.csv", rows_of(straight())[k::3]) for k in range(3)]
    assert read_tracks(parts).samples == 60


def test_parquet_and_npz_hold_the_same_tracks(tmp_path):
    rows = rows_of(straight())
    columns = {name: [row[k] for row in rows] for k, name in enumerate(HEADER)}
    parquet.write_table(pyarrow.table(columns), tmp_path / "tracks.parquet")
    np.savez(tmp_path / "long.npz", **{name: np.array(values) for name, values in columns.items()})
    np.savez(tmp_path / "dense.npz", position=straight()[..., :2], t=np.arange(20) * 0.5, id=np.array(["a", "b", "c"]))
    expected = read_tracks(write_csv(tmp_path / "tracks.csv", rows))
    for name in ("tracks.parquet", "long.npz", "dense.npz"):
        read = read_tracks(tmp_path / name)
        assert sorted(read.ids) == ["a", "b", "c"]
        np.testing.assert_allclose(np.sort(read.position, axis=0), np.sort(expected.position, axis=0), atol=1e-9)


def test_ids_and_times_of_parquet_keep_their_types(tmp_path):
    times = np.datetime64("2024-05-01T00:00:00.000000") + np.arange(4) * np.timedelta64(500, "ms")
    table = pyarrow.table({"id": [7, 7, 8, 8], "timestamp": times, "x": [0, 1, 2, 3], "y": [0.5, 1, 1, 1]})
    parquet.write_table(table, tmp_path / "tracks.parquet")
    read = read_tracks(tmp_path / "tracks.parquet")
    assert read.ids == (7, 8)
    assert read.file_time(read.duration) == "2024-05-01T00:00:01.500Z"


def test_movebank_files_are_known_and_missed_fixes_skipped(tmp_path):
    header = [
        "event-id",
        "timestamp",
        "location-long",
        "location-lat",
        "individual-local-identifier",
        "tag-local-identifier",
    ]
    rows = [
        [k, f"2012-07-28 00:00:0{k}.000", "" if k == 2 else 10.0 + 1e-5 * k, 50.0, name, "9"]
        for k in range(5)
        for name in ("goose", "gander")
    ]
    read = read_tracks(write_csv(tmp_path / "movebank.csv", rows, header))
    assert (set(read.ids), read.samples) == ({"goose", "gander"}, 8)
    assert "2 of 10 rows" in str(read.report())
    step = np.diff(read.position[:2], axis=0)[0]
    np.testing.assert_allclose(step, [0.7172, 0, 0], atol=1e-3)  # metres in 1e-5 degrees of longitude at 50°


@pytest.mark.parametrize("projected", [False, True])
def test_degrees_become_metres_also_across_the_180th_meridian(tmp_path, monkeypatch, projected):
    if projected:
        pytest.importorskip("pyproj")
    else:
        monkeypatch.setitem(sys.modules, "pyproj", None)
    rows = [[name, t, (179.999 + 0.001 * t + 180) % 360 - 180, 60.0] for t in range(3) for name in "ab"]
    rows = [[name, t, lon, lat + (0.001 if name == "b" else 0)] for name, t, lon, lat in rows]
    read = read_tracks(write_csv(tmp_path / "tracks.csv", rows, ["id", "t", "lon", "lat"]))
    np.testing.assert_allclose(np.diff(read.position[:3, 0]), 55.8, atol=0.1)  # metres in 0.001° at 60° N
    assert read.position[3, 1] - read.position[0, 1] == pytest.approx(111.4, abs=0.1)
    assert ("pyproj" in read.frame) == projected


def test_gpx_without_entities(tmp_path):
    points = "".join(
        f'<trkpt lat="50.0" lon="{10 + 1e-5 * k}"><ele>120</ele><time>2024-05-01T00:00:0{k}Z</time></trkpt>'
        for k in range(4)
    )
    tracks = "".join(f"<trk><name>{name}</name><trkseg>{points}</trkseg></trk>" for name in ("one", "two"))
    (tmp_path / "tracks.gpx").write_text(f'<?xml version="1.0"?><gpx xmlns="http://x">{tracks}</gpx>')
    read = read_tracks(tmp_path / "tracks.gpx")
    assert (read.ids, read.samples, read.duration) == (("one", "two"), 8, 3.0)
    bomb = '<!DOCTYPE g [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    (tmp_path / "bomb.gpx").write_text(f'<?xml version="1.0"?>{bomb}<gpx><trk><name>&b;</name></trk></gpx>')
    assert "document type" in refusal(tmp_path / "bomb.gpx")
    (tmp_path / "cut.gpx").write_text('<gpx><trk><trkseg><trkpt lat="1" lon="2">')
    assert "intact GPX" in refusal(tmp_path / "cut.gpx")
    (tmp_path / "none.gpx").write_text("<gpx></gpx>")
    assert "track points" in refusal(tmp_path / "none.gpx")


@pytest.mark.parametrize(
    ("encoding", "why"),
    [("foo", "unknown encoding: foo"), ("big5", "multi-byte encodings are not supported"), ("rot13", "'rot13' is not")],
)
def test_gpx_in_an_encoding_that_is_not_read(tmp_path, encoding, why):
    path = tmp_path / "tracks.gpx"
    path.write_text(f'<?xml version="1.0" encoding="{encoding}"?><gpx></gpx>')
    sentence = refusal(path)
    assert sentence.startswith("path must be an intact GPX file, got")
    assert f"not readable: {why}" in sentence


def write_ulog(path, north):
    """A ULog file with four samples of ``vehicle_local_position``, 0.5 s apart: north, east 2 m, up 10 m."""

    def message(kind, payload):
        return struct.pack("<HB", len(payload), ord(kind)) + payload

    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)]
    parts.append(message("B", bytes(40)))
    parts.append(message("F", b"vehicle_local_position:uint64_t timestamp;float x;float y;float z;"))
    parts.append(message("A", struct.pack("<BH", 0, 0) + b"vehicle_local_position"))
    for k in range(4):
        parts.append(message("D", struct.pack("<HQfff", 0, 500_000 * k, north + k, 2.0, -10.0 - k)))
    path.write_bytes(b"".join(parts))
    return path


def test_ulog_files_are_one_track_each(tmp_path):
    pytest.importorskip("pyulog")
    places = {"first": 0.0, "second": 50.0}
    read = read_tracks([write_ulog(tmp_path / f"{name}.ulg", north) for name, north in places.items()])
    assert (read.ids, read.duration) == (("first", "second"), 1.5)
    place = read.position + read.origin
    np.testing.assert_allclose(place[:4], [[2, k, 10 + k] for k in range(4)], atol=1e-5)
    np.testing.assert_allclose(place[4:, 1], np.arange(4) + 50, atol=1e-5)
    (tmp_path / "later").mkdir()
    same = [tmp_path / "first.ulg", write_ulog(tmp_path / "later" / "first.ulg", 80.0)]
    folder = tmp_path.name
    assert read_tracks(same).ids == (f"first ({folder}/first.ulg)", "first (later/first.ulg)")
    assert read_tracks(same, columns={"z": ""}).dimensions == 2
    assert "columns must fit those of" in refusal(same, columns={"x": "north"})
    assert "at least 2 ids" in refusal(tmp_path / "first.ulg")
    (tmp_path / "cut.ulg").write_bytes(b"ULog")
    assert "intact ULog" in refusal(tmp_path / "cut.ulg")


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    (tmp_path / "flight.ulg").write_bytes(b"ULog\x01\x12\x35")
    monkeypatch.setitem(sys.modules, "pyulog", None)
    assert "pyulog; `pip install 'usnet[tracks]'`" in refusal(tmp_path / "flight.ulg")
    (tmp_path / "tracks.parquet").write_bytes(b"PAR1")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert "pyarrow; `pip install 'usnet[tracks]'`" in refusal(tmp_path / "tracks.parquet")


BAD = {
    "no id": ("t,x,y\n0,1,2\n", "for id;"),
    "no x": ("id,t,y\na,1,2\n", "for x;"),
    "no time": ("id,x,y\na,1,2\n", "for t (or frame);"),
    "no names": ("1,0,1,2\n1,1,2,3\n", "row 1"),
    "ids but no names": ("a,0,1,2\nb,0,2,3\n", "must name its columns in row 1"),
    "NaN": ("id,t,x,y\na,0,1,2\nb,0,nan,2\n", "row 3 of column 'x'"),
    "empty cell": ("id,t,x,y\na,0,1,2\nb,0,1,\n", "row 3 of column 'y'"),
    "empty id": ("id,t,x,y\na,0,1,2\n,0,1,3\n", "row 3 of column 'id'"),
    "infinity": ("id,t,x,y\na,0,1,2\nb,0,inf,2\n", "row 3 of column 'x'"),
    "one id": ("id,t,x,y\na,0,1,2\na,1,1,2\n", "at least 2 ids"),
    "duplicate times": ("id,t,x,y\na,0,1,2\nb,0,1,2\na,0,5,5\n", "rows 2 and 4"),
    "text in numbers": ("id,t,x,y\na,0,1,2\nb,0,east,2\n", "'east' in row 3 of column 'x'"),
    "text in times": ("id,t,x,y\na,0,1,2\nb,noon,1,2\n", "'noon' in row 3 of column 't'"),
    "numbers in timestamps": ("id,t,x,y\na,2024-05-01,1,2\nb,7x,1,2\n", "row 3 of column 't'"),
    "latitude": ("id,t,lon,lat\na,0,1,2\nb,0,1,95\n", "from -90 to 90"),
    "a row too short": ("id,t,x,y\na,0,1,2\nb,0,1\n", "row 3"),
    "only names": ("id,t,x,y\n", "without rows"),
    "spaces": ("  \n", "empty"),
}


@pytest.mark.parametrize("what", BAD)
def test_a_bad_csv_is_refused_by_row_or_column(tmp_path, what):
    text, expected = BAD[what]
    path = tmp_path / "tracks.csv"
    path.write_text(text)
    assert expected in refusal(path)


def test_rows_without_values_can_be_skipped(tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_text("id,t,x,y\na,0,1,2\nb,0,nan,2\n,1,1,1\nb,1,1,2\n\nb,2,,2\n")
    read = read_tracks(path, missing="skip")
    assert (read.samples, read.ids) == (2, ("a", "b"))
    assert "3 of 5 rows" in str(read.report())


def test_repeated_rows_are_reported_and_left_out(tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_text("id,t,x,y\na,0,1,2\nb,0,1,2\na,0,1,2\na,1,1,2\n")
    read = read_tracks(path)
    assert read.samples == 3
    assert "Left out as repetitions (same id, time and place): 1 sample." in str(read.report())


def test_empty_missing_and_foreign_files(tmp_path):
    (tmp_path / "empty.csv").touch()
    assert "empty" in refusal(tmp_path / "empty.csv")
    assert "does not exist" in refusal(tmp_path / "none.csv")
    assert "folder" in refusal(tmp_path)
    with zipfile.ZipFile(tmp_path / "two.zip", "w") as archive:
        archive.writestr("a.csv", "id")
        archive.writestr("b.csv", "id")
    assert "one file" in refusal(tmp_path / "two.zip")


def test_wrong_encodings_are_refused_by_row(tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_bytes("id,t,x,y\nmöwe,0,1,2\nb,0,1,2\n".encode("latin-1"))
    assert "row 2 holds the byte 0xF6" in refusal(path)
    assert read_tracks(path, encoding="latin-1").ids == ("möwe", "b")
    path.write_text("id,t,x,y\na,0,1,2\nb,0,1,2\n", encoding="utf-16")
    assert refusal(path).endswith("in UTF-16; save it as UTF-8.")
    path.write_text("id,t,x,y\na,0,1,2\nb,0,1,2\n", encoding="utf-8-sig")
    assert read_tracks(path, encoding="utf-8-sig").ids == read_tracks(path).ids
    assert read_tracks(path).samples == 2
    assert refusal(path, encoding="utf-16").startswith("encoding must be one in which plain letters take one byte")
    assert refusal(path, encoding="foo").startswith("encoding must be one that Python knows")


def test_damaged_binary_files(tmp_path):
    table = pyarrow.table({"id": ["a", "b"] * 50, "t": np.arange(100.0), "x": np.arange(100.0), "y": np.arange(100.0)})
    parquet.write_table(table, tmp_path / "tracks.parquet")
    whole = (tmp_path / "tracks.parquet").read_bytes()
    (tmp_path / "cut.parquet").write_bytes(whole[: len(whole) // 2])
    assert "intact Parquet" in refusal(tmp_path / "cut.parquet")
    np.savez(tmp_path / "tracks.npz", id=np.array(["a", "b"]), t=np.zeros(2), x=np.zeros(2), y=np.zeros(2))
    whole = (tmp_path / "tracks.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    assert "intact NPZ" in refusal(tmp_path / "cut.npz")
    np.savez(tmp_path / "objects.npz", id=np.array([{}, {}]), t=np.zeros(2), x=np.zeros(2), y=np.zeros(2))
    assert "intact NPZ" in refusal(tmp_path / "objects.npz")
    with gzip.open(tmp_path / "tracks.csv.gz", "wb") as file:
        file.write(b"id,t,x,y\n" + b"a,0,1,2\n" * 1000)
    whole = (tmp_path / "tracks.csv.gz").read_bytes()
    (tmp_path / "cut.csv.gz").write_bytes(whole[:-20])
    assert "intact file" in refusal(tmp_path / "cut.csv.gz")


def test_files_that_expand_without_bound_are_refused(tmp_path):
    with gzip.open(tmp_path / "zeros.csv.gz", "wb") as file:
        for _ in range(50):
            file.write(bytes(2**20))
    assert "row 1" in refusal(tmp_path / "zeros.csv.gz")
    with zipfile.ZipFile(tmp_path / "rows.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("rows.csv", "id,t,x,y\n" + "a,0,1,2\n" * 200_000)
    assert "max_bytes" in refusal(tmp_path / "rows.zip", max_bytes=10**6)
    np.savez_compressed(tmp_path / "zeros.npz", position=np.zeros((1000, 50, 3)))
    assert "max_bytes" in refusal(tmp_path / "zeros.npz", max_bytes=10**6)
    table = pyarrow.table({"id": ["a"] * 10**5, "t": np.zeros(10**5), "x": np.zeros(10**5), "y": np.zeros(10**5)})
    parquet.write_table(table, tmp_path / "zeros.parquet")
    assert "max_bytes" in refusal(tmp_path / "zeros.parquet", max_bytes=10**6)


def test_a_gzip_bomb_is_refused_before_its_rows_are_read(tmp_path):
    path, blocks = tmp_path / "rows.csv.gz", []
    with gzip.open(path, "wb") as file:
        file.write(b"id,t,x,y\n" + b"a,0,1,2\n" * 200_000)
    assert "max_bytes must be at least" in refusal(path, max_bytes=10**6, progress=blocks.append)
    assert blocks == []


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_a_pipe_is_read(tmp_path, pack):
    path = write_csv(tmp_path / "tracks.csv", rows_of(straight()))
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=(tmp_path / "pipe").write_bytes, args=(pack(path.read_bytes()),))
    writer.start()
    read = read_tracks(tmp_path / "pipe")
    writer.join()
    np.testing.assert_array_equal(read.position, read_tracks(path).position)


@pytest.mark.parametrize(
    "options",
    [
        {"columns": {"who": "id"}},
        {"columns": {"id": "none"}},
        {"columns": [1]},
        {"time_unit": 0},
        {"missing": "guess"},
        {"encoding": "klingon"},
        {"max_bytes": 0},
        {"progress": 3},
    ],
)
def test_a_bad_argument_is_named(tmp_path, options):
    path = write_csv(tmp_path / "tracks.csv", rows_of(straight()))
    assert refusal(path, **options).startswith(next(iter(options)))


coordinates = st.floats(-1e6, 1e6).map(lambda value: round(value, 4))


@settings(max_examples=25)
@given(st.lists(st.tuples(st.sampled_from("abc"), coordinates, coordinates), min_size=2, max_size=30))
def test_what_is_written_is_read(tmp_path_factory, samples):
    rows = [[name, k / 8, x, y] for k, (name, x, y) in enumerate(samples)] + [["d", 0, 0, 0], ["e", 1, 1, 1]]
    path = write_csv(tmp_path_factory.mktemp("files") / "tracks.csv", rows)
    read = read_tracks(path)
    made = Tracks.from_samples([row[0] for row in rows], [row[1] for row in rows], [row[2:] for row in rows])
    assert read.ids == made.ids
    for name in ("offsets", "time", "position", "origin"):
        np.testing.assert_array_equal(getattr(read, name), getattr(made, name))

"""Tracks from files: every format, the texts of archives and encodings, times, degrees, and files that are refused."""

import gzip
import os
import struct
import sys
import threading
import zipfile

import numpy as np
import pandas as pd
import pytest
from track_files import HEADER, refusal, rows_of, straight, tracks_of, write_csv, write_gpx, write_parquet

from usnet_env.tracks import read_tracks

pyarrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")
ROWS = rows_of(straight())


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
@pytest.mark.parametrize("order", ["time", "id", "shuffled"])
def test_a_csv_in_any_order_gives_the_same_tracks(tmp_path, delimiter, order):
    rows = sorted(ROWS) if order == "id" else ROWS
    if order == "shuffled":
        rows = [rows[k] for k in np.random.default_rng(0).permutation(len(rows))]
    read = read_tracks(write_csv(tmp_path / "tracks.csv", rows, delimiter=delimiter))
    assert sorted(read.ids) == ["a", "b", "c"]
    order = np.argsort(read.ids)
    np.testing.assert_allclose(read.time.reshape(3, 20), np.tile(np.arange(20) * 0.5, (3, 1)))
    places = (read.position + read.origin).reshape(3, 20, 3)[order]
    np.testing.assert_allclose(places, straight().swapaxes(0, 1), rtol=0, atol=1e-9)


def test_times_are_written_as_in_the_file(tmp_path):
    frames = read_tracks(
        write_csv(tmp_path / "f.csv", rows_of(straight(), step=3, first=100), ["id", "frame", "x", "y"]), time_unit=0.04
    )
    assert (frames.file_time(0.0), frames.file_time(0.12)) == (100, 103)
    rows = [[row[0], f"2024-05-01T12:00:{row[1]:06.3f}+02:00", *row[2:]] for row in ROWS]
    dated = read_tracks(write_csv(tmp_path / "d.csv", rows))
    assert dated.duration == pytest.approx(9.5)
    assert dated.file_time(1.5) == "2024-05-01T10:00:01.500Z"
    assert "time_unit" in refusal(tmp_path / "d.csv", time_unit=2)


def test_archives_pipes_parquet_npz_and_several_files_hold_the_same_tracks(tmp_path):
    path = write_csv(tmp_path / "tracks.csv", ROWS)
    (tmp_path / "tracks.csv.gz").write_bytes(gzip.compress(path.read_bytes()))
    with zipfile.ZipFile(tmp_path / "mac.zip", "w") as archive:
        archive.write(path, "tracks.csv")
        archive.writestr("__MACOSX/._tracks.csv", b"\0\5\x16\7")
    columns = {name: np.array([row[k] for row in ROWS]) for k, name in enumerate(HEADER)}
    write_parquet(tmp_path / "tracks.parquet", ROWS)
    np.savez_compressed(tmp_path / "tracks.npz", **columns)
    np.savez(tmp_path / "dense.npz", position=straight()[..., :2], t=np.arange(20) * 0.5, id=np.array(["a", "b", "c"]))
    expected = read_tracks(path).position
    for name in ("tracks.csv.gz", "mac.zip", "tracks.parquet", "tracks.npz", "dense.npz"):
        read = read_tracks(tmp_path / name)
        assert read.ids == ("a", "b", "c")
        np.testing.assert_array_equal(read.position, expected)
    parts = [write_csv(tmp_path / f"{k}.csv", ROWS[30 * k : 30 * k + 30]) for k in range(2)]
    np.testing.assert_array_equal(read_tracks(parts).position, expected)
    gpx = write_gpx(tmp_path / "tracks.gpx", 0, "a", "b")
    (tmp_path / "tracks.gpx.gz").write_bytes(gzip.compress(gpx.read_bytes()))
    with zipfile.ZipFile(tmp_path / "gpx.zip", "w") as archive:
        archive.write(gpx, "tracks.gpx")
    for name in ("tracks.gpx.gz", "gpx.zip"):
        assert read_tracks(tmp_path / name).ids == ("a", "b")
    for name in ("tracks.csv.gz", "mac.zip", "tracks.npz"):
        assert read_tracks(tmp_path / name, max_size=0.01).samples == len(ROWS)
        assert "unpacks to more than 0.0005 MiB" in refusal(tmp_path / name, max_size=0.0005)
    assert read_tracks(path, max_size=0.0005).samples == len(ROWS)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        writer = threading.Thread(target=(tmp_path / "pipe").write_bytes, args=(path.read_bytes(),))
        writer.start()
        np.testing.assert_array_equal(read_tracks(tmp_path / "pipe").position, expected)
        writer.join()


def test_encodings(tmp_path):
    path = tmp_path / "tracks.csv"
    text = "id,t,x,y\nmöwe,0,1,2\nb,0,1,2\n"
    path.write_bytes(text.encode("latin-1"))
    assert "0xf6" in refusal(path)
    assert read_tracks(path, encoding="latin-1").ids == ("möwe", "b")
    for encoding in ("utf-16", "utf-8-sig", "utf-8"):  # the first two begin with a mark
        path.write_text(text, encoding=encoding)
        assert read_tracks(path).ids == ("möwe", "b")
    assert "encoding" in refusal(path, encoding="klingon")


def test_arrays_beside_positions(tmp_path):
    def write(**arrays):
        np.savez(tmp_path / "tracks.npz", position=straight()[..., :2], **arrays)
        return tmp_path / "tracks.npz"

    path = write(when=np.arange(20) * 0.5, who=np.array(["a", "b", "c"]))
    read = read_tracks(path, columns={"t": "when", "id": "who"})
    assert (read.ids, read.duration) == (("a", "b", "c"), 9.5)
    assert read_tracks(path, columns={"frame": "when"}, time_unit=2).duration == 19
    assert "'noon'" in refusal(path, columns={"t": "noon"})
    assert "two places" in refusal(path, columns={"id": "when"})
    read = read_tracks(write(id=np.array(["a", "b", "c"]), leader=np.array(["", "a", "a"])))
    assert read.leader.reshape(3, 20)[:, 0].tolist() == [-1, 0, 0]
    leader = np.where(np.arange(20)[:, None] < 5, [[-1, 0, 0]], [[1, -1, 1]])
    seen = np.ones((20, 3), bool)
    seen[4, 1] = False
    read = read_tracks(write(leader=leader, seen=seen))
    assert (read.ids, read.samples) == ((0, 1, 2), 59)
    np.testing.assert_array_equal(read.leader[:20], leader[:, 0])
    times = np.array([f"2024-05-01T00:00:{k:02}" for k in range(20)])
    assert read_tracks(write(t=times)).file_time(19.0) == "2024-05-01T00:00:19Z"
    assert "time must differ" in refusal(write(t=np.full(20, b"2020-01-01")))
    assert "broadcast" in refusal(write(leader=np.zeros(7)))


def test_times_of_parquet_keep_their_types(tmp_path):
    times = np.datetime64("2010-07-08T09:12:00", "ns") + np.arange(4) * np.timedelta64(33_333_333, "ns")
    columns = {"id": list("aabb"), "timestamp": times[[0, 3, 1, 2]], "x": [0, 3, 1, 2], "y": [0, 1, 1, 0]}
    parquet.write_table(pyarrow.table(columns), tmp_path / "tracks.parquet")
    read = read_tracks(tmp_path / "tracks.parquet")
    np.testing.assert_array_equal(read.time, [0, 0.1, 0.033333, 0.066667])
    assert read.file_time(read.duration) == "2010-07-08T09:12:00.100Z"


def test_movebank_files_are_known_and_missed_fixes_skipped(tmp_path):
    header = ["timestamp", "location-long", "location-lat", "height-above-ellipsoid", "individual-local-identifier"]
    rows = [
        [f"2012-07-28 00:00:0{k}.000", "" if k == 2 else 10.0 + 1e-5 * k, 50.0, 12.5 if k == 3 else "", name]
        for k in range(5)
        for name in ("goose", "gander")
    ]
    read = read_tracks(write_csv(tmp_path / "movebank.csv", rows, header))
    assert (set(read.ids), read.samples, read.dimensions) == ({"goose", "gander"}, 8, 2)
    assert "2 of 10 rows" in str(read.report())
    assert "has no value in 6 of 8 rows" in str(read.report())
    step = np.diff(read.position[:2], axis=0)[0]
    np.testing.assert_allclose(step, [0.7172, 0, 0], atol=1e-3)  # metres in 1e-5 degrees of longitude at 50°


def test_degrees_become_metres_also_across_the_180th_meridian(tmp_path, monkeypatch):
    rows = [[name, t, (359.999 + 0.001 * t) % 360 - 180, 60.0] for t in range(3) for name in "ab"]
    rows = [[name, t, lon, lat + (0.001 if name == "b" else 0)] for name, t, lon, lat in rows]
    path = write_csv(tmp_path / "tracks.csv", rows, ["id", "t", "lon", "lat"])
    read = read_tracks(path)
    np.testing.assert_allclose(np.diff(read.position[:3, 0]), 55.8, atol=0.1)  # metres in 0.001° at 60° N
    assert read.position[3, 1] - read.position[0, 1] == pytest.approx(111.4, abs=0.1)
    monkeypatch.setitem(sys.modules, "pyproj", None)
    for source in (path, pd.read_csv(path)):
        assert "needs pyproj" in refusal(source)


def test_x_and_y_that_may_be_degrees_are_doubted(tmp_path):
    rows = [[name, t, 8.5 + 1e-4 * t, 47.0 + k] for t in range(4) for k, name in enumerate("ab")]
    doubts = {}
    for names, scale in (("xy", 1), (("lon", "lat"), 1), ("xy", 1000)):
        table = [[*row[:2], *(scale * place for place in row[2:])] for row in rows]
        read = read_tracks(write_csv(tmp_path / "tracks.csv", table, ["id", "t", *names]))
        doubts[names, scale] = ["may be degrees" in each for each in read.report().warnings]
    assert [*doubts.values()] == [[True], [], []]


def test_ids_that_may_be_one_body_are_doubted():
    rng = np.random.default_rng(0)
    way, other = rng.normal(0, 1, (2, 400, 2)).cumsum(axis=1).cumsum(axis=1)
    drift = rng.normal(0, 0.01, way.shape).cumsum(axis=0)
    beside = {"estimates": way + drift, "tags": way + rng.normal(0, 1, way.shape), "behind": np.roll(way, 2, axis=0)}
    for name, each in beside.items():
        tracks = tracks_of(np.stack([way, each, other], axis=1)[2:], names="abc")
        doubts = [sentence for sentence in tracks.report().warnings if "one body" in sentence]
        assert [sentence[:12] for sentence in doubts] == ["2 ids (a, b)"] * (name != "behind")


def test_gpx_files(tmp_path):
    read = read_tracks(write_gpx(tmp_path / "log.gpx", 0, "Walk", "Rex", "Walk", "", "Run", height=120))
    assert read.ids == ("Walk-1", "Rex", "Walk-3", "log-4", "Run")
    assert np.diff(read.offsets).tolist() == [4] * 5
    assert (read.duration, read.origin[2], read.dimensions) == (3.0, 122.0, 3)
    assert read_tracks(tmp_path / "log.gpx", columns={"z": ""}).dimensions == 2
    bomb = '<!DOCTYPE g [<!ENTITY a "aaaaaaaaaa">' + "".join(
        f'<!ENTITY {name} "{f"&{before};" * 20}">' for before, name in zip("abcdefg", "bcdefgh", strict=True)
    )
    for name, text in {
        "bomb": f"{bomb}]><gpx><trk><name>&h;</name></trk></gpx>",
        "cut": '<gpx><trk><trkseg><trkpt lat="1" lon="2">',
        "encoding": '<?xml version="1.0" encoding="foo"?><gpx></gpx>',
    }.items():
        (tmp_path / f"{name}.gpx").write_text(text)
        assert "not an intact file" in refusal(tmp_path / f"{name}.gpx")
    (tmp_path / "none.gpx").write_text("<gpx></gpx>")
    assert "at least 2 ids" in refusal(tmp_path / "none.gpx")


def write_ulog(path, north, start=0):
    """A ULog file with four samples of ``vehicle_local_position``, 0.5 s apart: north, east 2 m, up 10 m."""

    def message(kind, payload):
        return struct.pack("<HB", len(payload), ord(kind)) + payload

    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)]
    parts.append(message("B", bytes(40)))
    if start:
        key = b"uint64_t boot_time_utc_us"
        parts.append(message("I", bytes([len(key)]) + key + struct.pack("<Q", start * 1_000_000)))
    parts.append(message("F", b"vehicle_local_position:uint64_t timestamp;float x;float y;float z;"))
    parts.append(message("A", struct.pack("<BH", 0, 0) + b"vehicle_local_position"))
    for k in range(4):
        parts.append(message("D", struct.pack("<HQfff", 0, 500_000 * k, north + k, 2.0, -10.0 - k)))
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"".join(parts))
    return path


def test_ulog_files_are_one_track_each(tmp_path):
    pytest.importorskip("pyulog")
    read = read_tracks([write_ulog(tmp_path / name, north) for name, north in (("one.ulg", 0), ("two.ulg", 50))])
    assert (read.ids, read.duration) == (("one", "two"), 1.5)
    assert any("each drone's own start" in each for each in read.report().warnings)
    clocks = read_tracks([write_ulog(tmp_path / f"{k}.ulg", 9 * k, 1_700_000_000 + k) for k in range(2)])
    assert (clocks.duration, clocks.time[4], clocks.file_time(0.0)) == (2.5, 1.0, "2023-11-14T22:13:20Z")
    assert not any("start" in each for each in clocks.report().warnings)
    place = read.position + read.origin
    np.testing.assert_allclose(place[:4], [[2, k, 10 + k] for k in range(4)], atol=1e-5)
    np.testing.assert_allclose(place[4:, 1], np.arange(4) + 50, atol=1e-5)
    same = [tmp_path / "one.ulg", write_ulog(tmp_path / "later" / "one.ulg", 80.0)]
    assert read_tracks(same).ids == tuple(f"one ({path.as_posix()})" for path in same)
    assert read_tracks(same, columns={"z": ""}).dimensions == 2
    assert "columns" in refusal(same, columns={"x": "north"})
    assert "at least 2 ids" in refusal(tmp_path / "one.ulg")
    (tmp_path / "cut.ulg").write_bytes(b"ULog")
    assert "not an intact file" in refusal(tmp_path / "cut.ulg")


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    for suffix, package in (("ulg", "pyulog"), ("parquet", "pyarrow")):
        (tmp_path / f"tracks.{suffix}").write_bytes(b"PAR1")
        monkeypatch.setitem(sys.modules, package, None)
        assert f"needs {package}" in refusal(tmp_path / f"tracks.{suffix}")


BAD = {
    "no id": ("t,x,y\n0,1,2\n", "is id? It has t, x, y; name it with --column id=NAME"),
    "no x": ("id,t,y\na,1,2\n", "is x?"),
    "no time": ("id,x,y\na,1,2\n", "is t?"),
    "a column twice": ("id,t,x,x,y\na,0,1,1,2\n", "'x'"),
    "no names": ("a,0,1,2\nb,0,2,3\n", "must name its columns"),
    "NaN": ("id,t,x,y\na,0,1,2\nb,0,nan,2\n", "x must be a number"),
    "empty cell": ("id,t,x,y\na,0,1,2\nb,0,1,\n", "got none in column 'y'"),
    "empty id": ("id,t,x,y\na,0,1,2\n,0,1,3\n", "got none in column 'id'"),
    "infinity": ("id,t,x,y\na,0,1,2\nb,0,inf,2\n", "in column 'x'"),
    "one id": ("id,t,x,y\na,0,1,2\n", "with 1 row of 'a'"),
    "two places": ("id,t,x,y\na,0,1,2\nb,0,1,2\na,0,5,5\n", "two places for id 'a'"),
    "text in numbers": ("id,t,x,y\na,0,1,2\nb,0,east,2\n", "'east' in column 'x'"),
    "truth values": ("id,t,x,y\na,0,True,2\nb,0,False,2\n", "True"),
    "text in times": ("id,t,x,y\na,0,1,2\nb,noon,1,2\n", "'noon' in column 't'"),
    "numbers in timestamps": ("id,t,x,y\na,2024-05-01,1,2\nb,7x,1,2\n", "'7x' in column 't'"),
    "a late time": ("id,t,x,y\na,0,1,2\nb,2e19,1,2\n", "1e+19"),
    "latitude": ("id,t,lon,lat\na,0,1,2\nb,0,1,95\n", "from -90 to 90"),
    "a row too short": ("id,t,x,y\na,0,1,2\nb,0,1\n", "got none in column 'y'"),
    "a row too long": ("id,t,x,y\na,0,1,2\nb,0,1,2,3\n", "line 3"),
    "rows too long": ("id,t,x,y\na,0,1,2,4\nb,0,1,2,3\n", "Length of header"),
    "an open quote": ('id,t,x,y\n"a,0,1,2\nb,0,1,2\n', "not an intact file"),
    "only names": ("id,t,x,y\n", ", which is empty."),
    "nothing": ("", ", which is empty."),
    "blank lines": ("\n\n", "which is empty."),
    "zeros": ("\0" * 2**21, "not an intact file"),
}


@pytest.mark.parametrize("what", BAD)
def test_a_bad_csv_is_refused_in_one_sentence(tmp_path, what):
    text, expected = BAD[what]
    (tmp_path / "tracks.csv").write_text(text)
    assert expected.format(path=tmp_path / "tracks.csv") in refusal(tmp_path / "tracks.csv")


def test_rows_without_values_can_be_skipped_and_repetitions_are(tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_text("id,t,x,y\na,0,1,2\nb,0,nan,2\n,1,1,1\nb,1,1,2\n\nb,2,,2\n")
    read = read_tracks(path, missing="skip")
    assert (read.samples, read.ids) == (2, ("a", "b"))
    assert "3 of 5 rows" in str(read.report())
    path.write_text("id,t,x,y\na,0,1,2\na,1,2,2\nb,0,?,2\nb,25:00,1,2\nb,1,1,2\nb,2,1,2\n")
    assert read_tracks(path, missing="skip").samples == 4
    assert "got '25:00' in column 't'" in refusal(path)
    path.write_text("id,t,x,y\na,0,1;5,2\na,1,2;5,2\nb,0,3;5,2\nb,1,1,2\n")  # most of the numbers
    assert "got '1;5' in column 'x'" in refusal(path, missing="skip")
    path.write_text("id,t,x,y\na,0,1,2\nb,0,1,2\na,0,1,2\na,1,1,2\n")
    assert read_tracks(path).samples == 3
    assert "Left out as repetitions (same id, time and place): 1 sample." in str(read_tracks(path).report())


def test_files_that_cannot_be_read(tmp_path):
    assert refusal(tmp_path / "none.csv") == f"{tmp_path}/none.csv: no such file."
    assert refusal([]).startswith("path must")
    assert "directory" in refusal(tmp_path)
    with zipfile.ZipFile(tmp_path / "two.zip", "w") as archive:
        archive.writestr("a.csv", "id")
        archive.writestr("b.csv", "id")
    assert "one file" in refusal(tmp_path / "two.zip")
    write_parquet(tmp_path / "tracks.parquet", ROWS)
    np.savez(tmp_path / "tracks.npz", **{name: np.zeros(2) for name in HEADER})
    (tmp_path / "tracks.csv.gz").write_bytes(gzip.compress(b"id,t,x,y\n" + b"a,0,1,2\n" * 1000))
    (tmp_path / "tracks.zip").write_bytes((tmp_path / "two.zip").read_bytes())
    for suffix in ("parquet", "npz", "csv.gz", "zip"):
        whole = (tmp_path / f"tracks.{suffix}").read_bytes()
        (tmp_path / f"cut.{suffix}").write_bytes(whole[: len(whole) // 2])
        assert "not an intact file" in refusal(tmp_path / f"cut.{suffix}")
    np.savez(tmp_path / "objects.npz", id=np.array([{}, {}]), t=np.zeros(2), x=np.zeros(2), y=np.zeros(2))
    assert "not an intact file" in refusal(tmp_path / "objects.npz")


@pytest.mark.parametrize(
    ("name", "value"),
    [("columns", {"who": "id"}), ("columns", [1]), ("time_unit", 0), ("missing", "guess"), ("decimal", ";")],
)
def test_a_bad_argument_is_named(tmp_path, name, value):
    assert refusal(write_csv(tmp_path / "tracks.csv", ROWS), **{name: value}).startswith(name)

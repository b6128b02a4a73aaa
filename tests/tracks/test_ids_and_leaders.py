"""Ids and leaders of files: one type over all files, numbers that pandas has changed, and tracks of one name."""

import numpy as np
import pytest
from track_files import HEADER, rows_of, straight, write_csv

from usnet_env import ArgumentError, evaluate
from usnet_env.tracks import read_tracks

pyarrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")
ROWS = rows_of(straight())


def write_parquet(path, **columns):
    values = {name: [row[k] for row in ROWS] for k, name in enumerate(HEADER)} | columns
    parquet.write_table(pyarrow.table(values), path)
    return path


def number(rows, of="abc"):
    return [of.index(row[0]) for row in rows]


def led(tracks):
    """The leader of each id at its first sample, as indices."""
    return tracks.leader[tracks.offsets[:-1]].tolist()


@pytest.mark.parametrize(
    ("ids", "leaders"),
    [
        (["0", "1", "2"], ["", "0.0", "0.0"]),
        (["0.0", "1.0", "2.0"], ["", "0", "0"]),
        (["007", "8", "9"], ["", "7", "7.00"]),
        (["1", "1.0", "9"], ["", "1", "1"]),
    ],
)
def test_leaders_are_the_same_text_or_an_equal_number(tmp_path, ids, leaders):
    rows = [[ids[k], *row[1:], leaders[k]] for k, row in zip(number(ROWS), ROWS, strict=True)]
    assert led(read_tracks(write_csv(tmp_path / "tracks.csv", rows, [*HEADER, "leader"]))) == [-1, 0, 0]


def test_the_texts_na_and_nan_are_ids_but_no_values_elsewhere(tmp_path):
    ids = ["NA", "nan", "b"]
    rows = [[ids[k], *row[1:], ["", "null", "NA"][k]] for k, row in zip(number(ROWS), ROWS, strict=True)]
    read = read_tracks(write_csv(tmp_path / "tracks.csv", rows, [*HEADER, "leader"]))
    assert (read.ids, led(read)) == (("NA", "nan", "b"), [-1, -1, 0])
    assert not any("without a track" in note for note in read.notes)
    rows[0][2] = "NA"
    with pytest.raises(
        ArgumentError, match=r"^x must be a number in every row unless missing='skip', got none in row 2"
    ):
        read_tracks(write_csv(tmp_path / "gap.csv", rows, [*HEADER, "leader"]))


@pytest.mark.parametrize("kind", ["int64", "string", "double"])
@pytest.mark.parametrize("leader", ["int64", "string", "double"])
def test_leaders_of_parquet_may_have_another_type(tmp_path, kind, leader):
    ids = pyarrow.array(number(ROWS)).cast(kind)
    leaders = pyarrow.array([0 if k else None for k in number(ROWS)]).cast(leader)
    assert led(read_tracks(write_parquet(tmp_path / "tracks.parquet", id=ids, leader=leaders))) == [-1, 0, 0]


def test_a_number_that_equals_two_ids_is_none_of_them(tmp_path):
    ids = ["01", "1", "b"]
    rows = [[ids[k], *row[1:], "1.0" if k == 2 else "b"] for k, row in zip(number(ROWS), ROWS, strict=True)]
    assert led(read_tracks(write_csv(tmp_path / "tracks.csv", rows, [*HEADER, "leader"]))) == [2, 2, -1]


def test_leaders_of_which_none_has_a_track_are_not_scored(tmp_path):
    rows = [[*row, "A" if row[0] != "a" else ""] for row in rows_of(straight(steps=60))]
    path = write_csv(tmp_path / "tracks.csv", rows, [*HEADER, "leader"])
    read = read_tracks(path)
    assert read.leader is None
    assert "Leaders without a track: 1 (A)." in read.notes
    assert "No leader in column leader has a track: it is not known who leads." in read.notes
    with pytest.raises(ArgumentError, match=r"^env must know the leaders"):
        evaluate("USNET/Tracks-v0", "none", episodes=1, env_kwargs={"path": str(path), "window": 10})


def test_ids_of_files_with_several_types_are_texts(run, tmp_path):
    numbers = write_parquet(tmp_path / "numbers.parquet", id=number(ROWS))
    assert read_tracks(numbers).ids == (0, 1, 2)
    later = [[str(k), row[1] + 10, *row[2:]] for k, row in zip(number(ROWS), ROWS, strict=True)]
    texts = write_csv(tmp_path / "texts.csv", [*later, ["x", 0, 1, 2], ["x", 1, 2, 3]])
    assert read_tracks([numbers, texts]).ids == ("0", "1", "2", "x")
    halves = write_parquet(tmp_path / "halves.parquet", id=[k + 0.5 * (k == 1) for k in number(ROWS)])
    assert read_tracks(halves).ids == ("0", "1.5", "2")
    words = ("--detector", "lagged-correlation", "--window", "5", "--out", tmp_path / "out")
    assert run("detect", numbers, texts, *words)[0] == 0
    assert (tmp_path / "out" / "windows.parquet").exists()


def test_ids_beyond_int64_are_texts_in_the_tables(run, tmp_path):
    least = 2**63 - 1  # of the three ids, one fits into int64
    ids = pyarrow.array([least + k for k in number(ROWS)], "uint64")
    path = write_parquet(tmp_path / "tracks.parquet", id=ids)
    assert read_tracks(path).ids == (least, least + 1, least + 2)
    words = ("--detector", "lagged-correlation", "--window", "10", "--unconfirmed", "--out", tmp_path / "out")
    assert run("detect", path, *words)[0] == 0
    leaders = parquet.read_table(tmp_path / "out" / "leaders.parquet").to_pylist()
    assert leaders
    assert {name for row in leaders for name in (row["id"], *row["followers"])} <= {str(least + k) for k in range(3)}


@pytest.mark.parametrize(
    ("ids", "expected"),
    [([3, 4, 5], (3, 4, 5)), ([b"a", b"b", b"c"], ("a", "b", "c")), ([0.0, 1.0, 2.0], (0, 1, 2))],
)
def test_ids_of_npz_and_parquet_keep_their_types(tmp_path, ids, expected):
    np.savez(tmp_path / "dense.npz", position=straight()[..., :2], id=np.array(ids))
    assert read_tracks(tmp_path / "dense.npz").ids == expected
    each = [ids[k] for k in number(ROWS)]
    np.savez(tmp_path / "long.npz", **{n: np.array([r[k] for r in ROWS]) for k, n in enumerate(HEADER)} | {"id": each})
    assert read_tracks(tmp_path / "long.npz").ids == expected
    assert read_tracks(write_parquet(tmp_path / "tracks.parquet", id=each)).ids == expected


def write_gpx(path, north, *names):
    points = "".join(
        f'<trkpt lat="{50 + north * 1e-4}" lon="{10 + 1e-5 * k}"><time>2024-05-01T00:00:0{k}Z</time></trkpt>'
        for k in range(4)
    )
    tracks = [f"<trk>{f'<name>{name}</name>' if name else ''}<trkseg>{points}</trkseg></trk>" for name in names]
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"<gpx>{''.join(tracks)}</gpx>")
    return path


def test_tracks_of_one_name_in_a_gpx_file_are_several_ids(tmp_path):
    read = read_tracks(write_gpx(tmp_path / "log.gpx", 0, "Walk", "Rex", "Walk", "", "Walk-3"))
    assert read.ids == ("Walk-1", "Rex", "Walk-3-3", "log-4", "Walk-3")
    assert np.diff(read.offsets).tolist() == [4] * 5
    unnamed = write_gpx(tmp_path / "log.gpx", 0, "", "log-1")
    assert read_tracks(unnamed).ids == ("log-1-1", "log-1-2")
    several = [unnamed, write_gpx(tmp_path / "new.gpx", 1, "Rex", "Rex"), write_gpx(tmp_path / "old.gpx", 2, "Rex-2")]
    assert read_tracks(several).ids == ("log-1-1", "log-1-2", "Rex-1", "Rex-2 (new.gpx)", "Rex-2 (old.gpx)")


def test_tracks_of_one_name_in_several_gpx_files_are_several_ids(tmp_path):
    logs = [write_gpx(tmp_path / f"log{k}.gpx", k, "ACTIVE LOG", *["Rex"][:k]) for k in range(2)]
    assert read_tracks(logs).ids == ("ACTIVE LOG (log0.gpx)", "ACTIVE LOG (log1.gpx)", "Rex")
    folders = [write_gpx(tmp_path / str(k) / "track.gpx", k, "") for k in range(2)]
    assert read_tracks(folders).ids == ("track-1 (0/track.gpx)", "track-1 (1/track.gpx)")
    assert read_tracks([logs[1], logs[1]]).ids == ("ACTIVE LOG", "Rex")


def test_a_track_may_have_the_name_that_another_one_gets(tmp_path):
    logs = [write_gpx(tmp_path / f"{name}.gpx", k, "A" if k < 2 else "A (y.gpx)") for k, name in enumerate("yzw")]
    assert read_tracks(logs).ids == ("A (y.gpx) (y.gpx)", "A (z.gpx)", "A (y.gpx)")
    own = write_gpx(tmp_path / "y.gpx", 0, "A", "A (y.gpx)")
    assert read_tracks([own, logs[1]]).ids == ("A (y.gpx) (y.gpx)", "A (y.gpx)", "A (z.gpx)")


def test_a_file_that_is_given_by_two_paths_is_one_file(tmp_path):
    path = write_gpx(tmp_path / "x1" / "a.gpx", 0, "A", "B")
    (tmp_path / "x2").mkdir()
    paths = [path, tmp_path / "x2" / ".." / "x1" / "a.gpx"]
    read = read_tracks(paths)
    assert (read.ids, read.samples) == (("A", "B"), 8)
    (tmp_path / "b.gpx").symlink_to(path)
    other = write_gpx(tmp_path / "c.gpx", 1, "A")
    assert read_tracks([tmp_path / "b.gpx", other]).ids == ("A (b.gpx)", "B", "A (c.gpx)")


def test_a_csv_file_continues_the_tracks_of_another(tmp_path):
    parts = [write_csv(tmp_path / f"{k}.csv", ROWS[30 * k : 30 * k + 30]) for k in range(2)]
    read = read_tracks(parts)
    assert (read.ids, read.samples) == (("a", "b", "c"), 60)

"""Which columns are read, decimal commas, ids and leaders, and rows that are marked as outliers."""

import json

import numpy as np
import pytest
from track_files import HEADER, refusal, rows_of, straight, write_csv, write_gpx, write_parquet

from usnet_env.tracks import read_tracks

pyarrow = pytest.importorskip("pyarrow")
ROWS = rows_of(straight())
HIGH = rows_of(straight(height=True))  # with z
NUMBER = ["abc".index(row[0]) for row in ROWS]
QUICK = ("--detector", "directional-delays")


def test_places_of_parts_of_one_animal_and_headings_are_no_ids(tmp_path):
    header = ["frame", "X (cm)", "Y (cm)", "midline_x", "midline_y", "X#wcentroid (cm)", "Y#wcentroid (cm)"]
    path = write_csv(tmp_path / "beetle.csv", [[t, *[t + k for k in range(6)]] for t in range(9)], header)
    assert "is id? It has frame" in refusal(path)
    assert "several files may be the tracks of one id each" in refusal(path)
    other = write_csv(tmp_path / "ant.csv", [[t, *[t - k for k in range(6)]] for t in range(9)], header)
    assert read_tracks([path, other]).ids == ("beetle", "ant")
    rows = [[*row, 7.5 * k] for k, row in enumerate(ROWS)]
    read = read_tracks(write_csv(tmp_path / "flights.csv", rows, ["icao24", "timestamp", "x", "y", "track"]))
    assert read.ids == ("a", "b", "c")
    assert "id = icao24" in str(read.report())


def test_the_columns_that_the_caller_names_are_read(tmp_path):
    path = write_csv(tmp_path / "both.csv", [[*row, 10.0, 50.0] for row in HIGH], [*HEADER, "z", "lon", "lat"])
    assert read_tracks(path).frame != "metres"
    assert read_tracks(path, columns={"x": "x"}).frame == "metres"
    assert read_tracks(path, columns={"x": "x", "z": "", "lon": ""}).dimensions == 2
    for columns, sentence in (
        ({"x": "x", "y": "x"}, "has 1 column 'x' for x and y (--column x=NAME); its columns are "),
        ({"id": ""}, "which column of "),
        ({"id": "z1"}, "has no column 'z1' for id (--column id=NAME); its columns are "),
    ):
        assert sentence in refusal(path, columns=columns)


@pytest.mark.parametrize("gaps", [1, 60])
def test_a_height_that_is_missing_in_some_rows_is_left_out(run, tmp_path, gaps):
    rows = [[*row[:4], "" if k < gaps else row[4]] for k, row in enumerate(HIGH)]
    path = write_csv(tmp_path / "tracks.csv", rows, [*HEADER, "altitude"])
    read = read_tracks(path)
    assert (read.samples, read.dimensions) == (60, 2)
    assert f"Column altitude (z) has no value in {gaps} of 60 rows and is left out." in read.notes
    assert "z = altitude" not in str(read.report())
    status, out, err = run("detect", path, *QUICK, "--window", "10")
    assert (status, err) == (0, "")
    assert "Column altitude (z) has no value in" in out
    assert "got none in column 'altitude'" in refusal(path, columns={"z": "altitude"})
    if gaps == 1:
        named = read_tracks(path, columns={"z": "altitude"}, missing="skip")
        assert (named.samples, named.dimensions) == (59, 3)


def comma(number):
    return f"{number:.3f}".replace(".", ",")


@pytest.mark.parametrize("delimiter", [";", "\t", ","])  # cells with commas are quoted where they separate
def test_decimal_commas_are_read(run, tmp_path, delimiter):
    expected = read_tracks(write_csv(tmp_path / "points.csv", ROWS))
    path = write_csv(tmp_path / "commas.csv", [[row[0], *map(comma, row[1:])] for row in ROWS], delimiter=delimiter)
    read = read_tracks(path, decimal=",")
    np.testing.assert_array_equal(read.position, expected.position)
    np.testing.assert_array_equal(read.time, expected.time)
    assert "--decimal ," in run("detect", path, *QUICK)[2]
    assert run("detect", path, "--decimal", ",", "--window", "10", *QUICK)[0] == 0


@pytest.mark.parametrize(("decimal", "refused"), [(".", "1,5"), (",", "2.5")])
def test_mixed_signs_are_refused(tmp_path, decimal, refused):
    path = write_csv(tmp_path / "tracks.csv", [["a", 0, "1,5", 0], ["b", 1, "2.5", 0]], HEADER, delimiter=";")
    assert f"got '{refused}' in column 'x'" in refusal(path, decimal=decimal)


def first_leaders(tracks):
    """The leader of each id at its first sample, as indices."""
    return tracks.leader[tracks.offsets[:-1]].tolist()


@pytest.mark.parametrize(
    ("ids", "leaders", "expected"),
    [
        (["0", "1", "2"], ["", "0.0", "0.0"], [-1, 0, 0]),
        (["0.0", "1.5", "2.0"], ["", "0", "0"], [-1, 0, 0]),
        (["007", "8", "9"], ["", "7", "7.00"], [-1, 0, 0]),
        (["007", "7", "12"], ["", "007", "7"], [-1, 0, 1]),
        (["1", "1.0", "9"], ["", "1", "1"], [-1, 0, 0]),
        (["NA", "nan", "b"], ["", "null", "NA"], [-1, -1, 0]),  # texts like others, but no leader unless an id
        (["01", "1", "b"], ["b", "b", "1.0"], [2, 2, -1]),  # a number that equals two ids is none of them
    ],
)
def test_leaders_are_the_same_text_or_an_equal_number(tmp_path, ids, leaders, expected):
    rows = [[ids[k], *row[1:], leaders[k]] for k, row in zip(NUMBER, ROWS, strict=True)]
    header = [*HEADER, "leader"]
    records = tmp_path / "tracks.json"
    records.write_text(json.dumps([dict(zip(header, row, strict=True)) for row in rows]))
    for path in (write_csv(tmp_path / "tracks.csv", rows, header), records):
        read = read_tracks(path)
        assert (read.ids, first_leaders(read)) == (tuple(ids), expected)


@pytest.mark.parametrize("kind", ["int64", "string", "double"])
@pytest.mark.parametrize("leader", ["int64", "string", "double"])
def test_leaders_of_parquet_may_have_another_type(tmp_path, kind, leader):
    ids = pyarrow.array(NUMBER).cast(kind)
    leaders = pyarrow.array([0 if k else None for k in NUMBER]).cast(leader)
    assert first_leaders(read_tracks(write_parquet(tmp_path / "a.parquet", ROWS, id=ids, leader=leaders))) == [-1, 0, 0]


def test_leaders_of_which_none_has_a_track_are_not_scored(tmp_path):
    rows = [[*row, "A" if row[0] != "a" else ""] for row in rows_of(straight(steps=60))]
    path = write_csv(tmp_path / "tracks.csv", rows, [*HEADER, "leader"])
    read = read_tracks(path)
    assert read.leader is None
    assert "Leaders without a track: 1 (A)." in read.notes
    assert "No leader in column leader has a track: it is not known who leads." in read.notes


def test_ids_of_files_with_several_types_are_texts(tmp_path):
    numbers = write_parquet(tmp_path / "numbers.parquet", ROWS, id=NUMBER)
    assert read_tracks(numbers).ids == (0, 1, 2)
    later = [[str(k), row[1] + 10, *row[2:]] for k, row in zip(NUMBER, ROWS, strict=True)]
    texts = write_csv(tmp_path / "texts.csv", [*later, ["x", 0, 1, 2], ["x", 1, 2, 3]])
    assert read_tracks([numbers, texts]).ids == ("0", "1", "2", "x")
    halves = write_parquet(tmp_path / "halves.parquet", ROWS, id=[k + 0.5 * (k == 1) for k in NUMBER])
    assert read_tracks(halves).ids == ("0", "1.5", "2")
    least = 2**63 - 1  # of three ids, one fits into int64
    large = pyarrow.array([least + k for k in NUMBER], "uint64")
    path = write_parquet(tmp_path / "large.parquet", ROWS, id=large)
    assert read_tracks(path).ids == (least, least + 1, least + 2)


IDS = [([3, 4, 5], (3, 4, 5)), ([b"a", b"b", b"c"], ("a", "b", "c")), ([0.0, 1.0, 2.0], (0, 1, 2))]


@pytest.mark.parametrize(("ids", "expected"), IDS)
def test_ids_of_npz_and_parquet_keep_their_types(tmp_path, ids, expected):
    np.savez(tmp_path / "dense.npz", position=straight()[..., :2], id=np.array(ids))
    assert read_tracks(tmp_path / "dense.npz").ids == expected
    assert read_tracks(write_parquet(tmp_path / "tracks.parquet", ROWS, id=[ids[k] for k in NUMBER])).ids == expected


def test_tracks_of_one_name_in_several_gpx_files_are_several_ids(tmp_path):
    logs = [write_gpx(tmp_path / f"log{k}.gpx", k, "ACTIVE LOG", *["Rex"][:k]) for k in range(2)]
    assert read_tracks(logs).ids == (f"ACTIVE LOG ({logs[0]})", f"ACTIVE LOG ({logs[1]})", "Rex")
    assert read_tracks([logs[1], tmp_path / "folder" / ".." / "log1.gpx"]).ids == ("ACTIVE LOG", "Rex")  # one file
    folders = [write_gpx(tmp_path / str(k) / "track.gpx", k, "") for k in range(2)]
    assert len(set(read_tracks(folders).ids)) == 2


def test_files_with_other_columns_or_times_are_refused(tmp_path):
    plain = write_csv(tmp_path / "plain.csv", ROWS)
    high = write_csv(tmp_path / "high.csv", HIGH)
    dated = write_csv(tmp_path / "dated.csv", [[row[0], "2024-05-01", *row[2:]] for row in ROWS[:3]])
    assert "same columns" in refusal([plain, high])
    assert "kind of times" in refusal([plain, dated])


@pytest.mark.parametrize(("visible", "skipped"), [("false", True), ("FALSE", True), ("true", False), ("", False)])
def test_rows_that_movebank_marks_as_outliers_are_skipped_and_counted(tmp_path, visible, skipped):
    rows = [[f"2010-07-08 09:12:{t:02}.000", 19.0, 47.5 + 1e-5 * t, k, "true"] for k in "ab" for t in range(30)]
    rows[8][4] = visible
    if skipped:
        rows[8][1:3] = [0.0, 95.0]  # no latitude at all
    header = ["timestamp", "location-long", "location-lat", "individual-local-identifier", "visible"]
    read = read_tracks(write_csv(tmp_path / "marked.csv", rows, header))
    assert read.samples == len(rows) - skipped
    assert ("1 of 60 rows, marked as outliers" in str(read.report())) == skipped


def test_marks_of_parquet_are_read_and_other_files_have_none(tmp_path):
    visible = [k != 8 for k in range(60)]
    names = pyarrow.array([row[0] for row in ROWS])
    movebank = write_parquet(tmp_path / "a.parquet", ROWS, tag_local_identifier=names, visible=visible)
    assert read_tracks(movebank).samples == 59
    assert read_tracks(write_parquet(tmp_path / "b.parquet", ROWS, visible=visible)).samples == 60

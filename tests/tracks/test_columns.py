"""Which columns are read, decimal commas, ids and leaders of all types, and rows that are marked as outliers."""

import numpy as np
import pytest
from track_files import HEADER, refusal, rows_of, straight, write_csv, write_gpx, write_parquet

from usnet_env import ArgumentError, evaluate
from usnet_env.tracks import read_tracks

pyarrow = pytest.importorskip("pyarrow")
ROWS = rows_of(straight())
HIGH = rows_of(straight(height=True))  # with z
NUMBER = ["abc".index(row[0]) for row in ROWS]
QUICK = ("--detector", "lagged-correlation")


@pytest.mark.parametrize(
    ("header", "options"),
    [
        (["Track ID", "Time", "X", "Y"], {}),
        (["animal", "frame", "easting", "northing"], {}),
        (["who", "when", "a", "b"], {"columns": {"id": "who", "t": "when", "x": "a", "y": "b"}}),
    ],
)
def test_names_of_columns_are_guessed_or_mapped(tmp_path, header, options):
    read = read_tracks(write_csv(tmp_path / "tracks.csv", ROWS, header), **options)
    assert read.samples == 60
    assert f"id = {header[0]}" in str(read.report())


@pytest.mark.parametrize("lonely", ["lon", "lat"])
def test_half_a_pair_of_coordinates_is_not_read(tmp_path, lonely):
    plain = read_tracks(write_csv(tmp_path / "plain.csv", HIGH))
    read = read_tracks(write_csv(tmp_path / "tracks.csv", [[*row, 5.0] for row in HIGH], [*HEADER, "z", lonely]))
    np.testing.assert_array_equal(read.position, plain.position)
    assert (read.frame, read.dimensions) == ("metres", 3)


def test_the_columns_that_the_caller_names_are_read(tmp_path):
    path = write_csv(tmp_path / "both.csv", [[*row, 10.0, 50.0] for row in HIGH], [*HEADER, "z", "lon", "lat"])
    assert read_tracks(path).frame != "metres"
    assert read_tracks(path, columns={"x": "x"}).frame == "metres"
    assert read_tracks(path, columns={"x": "x", "z": "", "lon": ""}).dimensions == 2
    for columns in ({"x": "x", "lon": "lon"}, {"t": "t", "frame": "x"}, {"x": "x", "y": "x"}, {"id": ""}, {"id": "z1"}):
        assert refusal(path, columns=columns).startswith("columns")


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


@pytest.mark.parametrize("gap", [0, 1, 2])
def test_velocities_are_read_or_left_out_together(tmp_path, gap):
    rows = [[*row, 1.0, 2.0] for row in ROWS]
    read = read_tracks(write_csv(tmp_path / "flat.csv", rows, [*HEADER, "vx", "vy"]))
    np.testing.assert_array_equal(read.velocity, [[1, 2, 0]] * 60)
    velocities = [[1.0, 2.0, 3.0] for _ in ROWS]
    velocities[7][gap] = ""
    rows = [[*row, *velocity] for row, velocity in zip(HIGH, velocities, strict=True)]
    read = read_tracks(write_csv(tmp_path / "tracks.csv", rows, [*HEADER, "z", "vx", "vy", "velocity_z"]))
    assert (read.samples, read.velocity) == (60, None)
    assert "Columns vx (vx), vy (vy), velocity_z (vz) lack a value in 1 of 60 rows and are left out." in read.notes
    path = write_csv(tmp_path / "one.csv", [[*row, 1.0, 3.0] for row in ROWS], [*HEADER, "vx", "vz"])
    assert read_tracks(path).velocity is None
    assert refusal(path, columns={"vx": "vx"}).startswith("columns")


# Decimal commas


def comma(number):
    return f"{number:.3f}".replace(".", ",")


@pytest.mark.parametrize("delimiter", [";", "\t", ","])  # cells with commas are quoted where they separate
@pytest.mark.parametrize("options", [{}, {"decimal": ","}])
def test_decimal_commas_are_read(tmp_path, delimiter, options):
    expected = read_tracks(write_csv(tmp_path / "points.csv", ROWS))
    path = write_csv(tmp_path / "commas.csv", [[row[0], *map(comma, row[1:])] for row in ROWS], delimiter=delimiter)
    read = read_tracks(path, **options)
    np.testing.assert_array_equal(read.position, expected.position)
    np.testing.assert_array_equal(read.time, expected.time)
    assert ("The commas in numbers are decimal signs." in read.notes, len(expected.notes)) == (True, 1)


def test_ids_and_timestamps_keep_their_commas(tmp_path):
    rows = [[f"{row[0]},5", f"2024-05-01T12:00:{row[1]:06.3f}".replace(".", ","), *map(comma, row[2:])] for row in ROWS]
    read = read_tracks(write_csv(tmp_path / "tracks.csv", rows, delimiter=";"))
    assert (read.ids[0], read.duration) == ("a,5", 9.5)


def test_numbers_whose_commas_may_separate_thousands_need_the_option(run, tmp_path):
    rows = [[row[0], round(2 * row[1]), "1,512", f"{20 + k},125"] for k, row in enumerate(ROWS)]
    path = write_csv(tmp_path / "tracks.csv", rows, delimiter=";")
    assert "'1,512' in column 'x'" in refusal(path)
    assert "--decimal ," in run("detect", path)[2]
    assert np.ptp(read_tracks(path, decimal=",").position[:, 1]) == pytest.approx(59)
    assert run("detect", path, "--decimal", ",", "--window", "10", *QUICK)[0] == 0
    rows[5][2] = "0,512"  # no number of thousands begins with 0
    assert read_tracks(write_csv(path, rows, delimiter=";")).samples == 60


@pytest.mark.parametrize(
    ("cells", "options", "refused"),
    [
        (["1,5", "2.5"], {}, "1,5"),
        (["1,5", "2.5"], {"decimal": ","}, "2.5"),
        (["1.234,5", "2,5"], {}, "1.234,5"),
        (["1,5", "2,5"], {"decimal": "."}, "1,5"),
    ],
)
def test_mixed_signs_are_refused(tmp_path, cells, options, refused):
    rows = [["ab"[k], k, cell, 0] for k, cell in enumerate(cells)]
    path = write_csv(tmp_path / "tracks.csv", rows, HEADER, delimiter=";")
    assert f"got '{refused}' in column 'x'" in refusal(path, **options)


# Ids and leaders


def first_leaders(tracks):
    """The leader of each id at its first sample, as indices."""
    return tracks.leader[tracks.offsets[:-1]].tolist()


@pytest.mark.parametrize(
    ("ids", "leaders", "expected"),
    [
        (["0", "1", "2"], ["", "0.0", "0.0"], [-1, 0, 0]),
        (["0.0", "1.0", "2.0"], ["", "0", "0"], [-1, 0, 0]),
        (["007", "8", "9"], ["", "7", "7.00"], [-1, 0, 0]),
        (["1", "1.0", "9"], ["", "1", "1"], [-1, 0, 0]),
        (["NA", "nan", "b"], ["", "null", "NA"], [-1, -1, 0]),  # texts like others, but no leader unless an id
        (["01", "1", "b"], ["b", "b", "1.0"], [2, 2, -1]),  # a number that equals two ids is none of them
    ],
)
def test_leaders_are_the_same_text_or_an_equal_number(tmp_path, ids, leaders, expected):
    rows = [[ids[k], *row[1:], leaders[k]] for k, row in zip(NUMBER, ROWS, strict=True)]
    read = read_tracks(write_csv(tmp_path / "tracks.csv", rows, [*HEADER, "leader"]))
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
    with pytest.raises(ArgumentError, match="leader"):
        evaluate("USNET/Tracks-v0", "none", episodes=1, env_kwargs={"path": str(path), "window": 10})


def test_ids_of_files_with_several_types_are_texts(run, tmp_path):
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
    words = (*QUICK, "--window", "10", "--unconfirmed", "--out", tmp_path / "out")
    assert run("detect", path, *words)[0] == 0
    table = pytest.importorskip("pyarrow.parquet").read_table(tmp_path / "out" / "leaders.parquet").to_pylist()
    assert {row["id"] for row in table} <= {str(least + k) for k in range(3)}


@pytest.mark.parametrize(
    ("ids", "expected"),
    [([3, 4, 5], (3, 4, 5)), ([b"a", b"b", b"c"], ("a", "b", "c")), ([0.0, 1.0, 2.0], (0, 1, 2))],
)
def test_ids_of_npz_and_parquet_keep_their_types(tmp_path, ids, expected):
    np.savez(tmp_path / "dense.npz", position=straight()[..., :2], id=np.array(ids))
    assert read_tracks(tmp_path / "dense.npz").ids == expected
    assert read_tracks(write_parquet(tmp_path / "tracks.parquet", ROWS, id=[ids[k] for k in NUMBER])).ids == expected


def test_tracks_of_one_name_in_several_gpx_files_are_several_ids(tmp_path):
    logs = [write_gpx(tmp_path / f"log{k}.gpx", k, "ACTIVE LOG", *["Rex"][:k]) for k in range(2)]
    assert read_tracks(logs).ids == ("ACTIVE LOG (log0.gpx)", "ACTIVE LOG (log1.gpx)", "Rex")
    assert read_tracks([logs[1], tmp_path / "folder" / ".." / "log1.gpx"]).ids == ("ACTIVE LOG", "Rex")  # one file
    folders = [write_gpx(tmp_path / str(k) / "track.gpx", k, "") for k in range(2)]
    assert len(set(read_tracks(folders).ids)) == 2
    twins = [
        write_gpx(tmp_path / name, k, *names)
        for k, (name, *names) in enumerate((("y.gpx", "A", "A (y.gpx)"), ("z.gpx", "A")))
    ]
    assert read_tracks(twins).ids == ("A (y.gpx) (y.gpx)", "A (y.gpx)", "A (z.gpx)")


def test_files_with_other_columns_or_times_are_refused(tmp_path):
    plain = write_csv(tmp_path / "plain.csv", ROWS)
    high = write_csv(tmp_path / "high.csv", HIGH)
    dated = write_csv(tmp_path / "dated.csv", [[row[0], "2024-05-01", *row[2:]] for row in ROWS[:3]])
    assert "same columns" in refusal([plain, high])
    assert "kind of times" in refusal([plain, dated])


# Marks of outliers

MOVEBANK = ["timestamp", "location-long", "location-lat", "individual-local-identifier", "visible"]
MARKS = ["algorithm-marked-outlier", "import-marked-outlier", "manually-marked-outlier", "manually-marked-valid"]


@pytest.mark.parametrize(
    ("visible", "marks", "skipped"),
    [
        ("false", ["", "", "true", ""], True),
        ("FALSE", ["", "", "", ""], True),
        ("true", ["1", "", "", ""], True),
        ("true", ["", "TRUE", "", ""], True),
        ("true", ["", "", "true", "true"], False),
        ("true", ["", "", "false", ""], False),
        ("", ["", "", "", ""], False),
    ],
)
def test_rows_that_movebank_marks_as_outliers_are_skipped_and_counted(tmp_path, visible, marks, skipped):
    rows = [
        [f"2010-07-08 09:12:{t:02}.000", 19.04 + 1e-5 * t, 47.5, f"bird-{k}", "true", "", "", "", ""]
        for k in range(4)
        for t in range(30)
    ]
    rows[8][4:] = [visible, *marks]
    if skipped:
        rows[8][1:3] = [0.0, 95.0]  # no latitude at all
    read = read_tracks(write_csv(tmp_path / "marked.csv", rows, [*MOVEBANK, *MARKS]))
    assert read.samples == len(rows) - skipped
    assert ("1 of 120 rows is marked as an outlier in the file and skipped." in str(read.report())) == skipped


def test_marks_of_parquet_are_read_and_other_files_have_none(tmp_path):
    visible = [k != 8 for k in range(60)]
    names = pyarrow.array([row[0] for row in ROWS])
    movebank = write_parquet(tmp_path / "a.parquet", ROWS, tag_local_identifier=names, visible=visible)
    assert read_tracks(movebank).samples == 59
    assert read_tracks(write_parquet(tmp_path / "b.parquet", ROWS, visible=visible)).samples == 60

"""Which columns are read: pairs of coordinates, columns with gaps, and names that the caller gives."""

import numpy as np
import pytest
from track_files import HEADER, rows_of, straight, write_csv

from usnet_env import ArgumentError
from usnet_env.tracks import read_tracks

ROWS = rows_of(straight())
HIGH = rows_of(straight(height=True))  # with z


def refusal(path, **options):
    with pytest.raises(ArgumentError) as caught:
        read_tracks(path, **options)
    return str(caught.value)


@pytest.mark.parametrize("lonely", ["lon", "lat"])
@pytest.mark.parametrize("height", [False, True])
def test_half_a_pair_of_coordinates_is_not_read(tmp_path, lonely, height):
    rows = HIGH if height else ROWS
    header = [*HEADER, "z"][: len(rows[0])]
    plain = read_tracks(write_csv(tmp_path / "plain.csv", rows, header))
    read = read_tracks(write_csv(tmp_path / "tracks.csv", [[*row, 5.0] for row in rows], [*header, lonely]))
    np.testing.assert_array_equal(read.position, plain.position)
    assert (read.frame, read.dimensions) == ("metres", 3 if height else 2)


def test_the_pair_that_the_caller_names_is_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # messages shorten long paths
    path = write_csv(tmp_path / "both.csv", [[*row, 10.0, 50.0] for row in ROWS], [*HEADER, "lon", "lat"])
    assert read_tracks(path).frame != "metres"
    assert read_tracks(path, columns={"x": "x"}).frame == "metres"
    write_csv(tmp_path / "half.csv", [[*row, 10.0] for row in ROWS], [*HEADER, "lon"])
    assert refusal("half.csv", columns={"lon": "lon"}).endswith(
        "half.csv' for lat; no name among ['id', 't', 'x', 'y'] is known for it, because 'lon' is given to lon."
    )


@pytest.mark.parametrize("gaps", [1, 30, 60])
def test_a_height_that_is_missing_in_some_rows_is_left_out(run, tmp_path, gaps):
    rows = [[*row[:4], "" if k < gaps else row[4]] for k, row in enumerate(HIGH)]
    path = write_csv(tmp_path / "tracks.csv", rows, [*HEADER, "altitude"])
    for missing in ("refuse", "skip"):
        read = read_tracks(path, missing=missing)
        assert (read.samples, read.dimensions) == (60, 2)
        assert f"Column altitude (z) has no value in {gaps} of 60 rows and is left out." in read.notes
        assert "z = altitude" not in str(read.report())
    status, out, err = run("detect", path, "--detector", "lagged-correlation", "--window", "10")
    assert (status, err) == (0, "")
    assert "Column altitude (z) has no value in" in out


def test_a_height_that_the_caller_names_is_needed_in_every_row(tmp_path):
    rows = [[*row[:4], "" if k < 6 else row[4]] for k, row in enumerate(HIGH)]
    path = write_csv(tmp_path / "tracks.csv", rows, [*HEADER, "altitude"])
    assert "row 2 of column 'altitude'" in refusal(path, columns={"z": "altitude"})
    read = read_tracks(path, columns={"z": "altitude"}, missing="skip")
    assert (read.samples, read.dimensions) == (54, 3)


def test_a_movebank_file_with_few_heights_keeps_its_rows(tmp_path):
    header = ["timestamp", "location-long", "location-lat", "height-above-ellipsoid", "individual-local-identifier"]
    rows = [
        [f"2012-07-28 00:00:0{k}", 10.0 + 1e-5 * k, 50.0, 12.5 if k == 3 else "", name]
        for k in range(5)
        for name in ("goose", "gander")
    ]
    read = read_tracks(write_csv(tmp_path / "movebank.csv", rows, header))
    assert (read.samples, read.dimensions) == (10, 2)
    assert "has no value in 8 of 10 rows" in str(read.report())


def test_empty_velocities_are_left_out(tmp_path):
    path = write_csv(tmp_path / "tracks.csv", [[*row, "", "", ""] for row in ROWS], [*HEADER, "vx", "vy", "vz"])
    read = read_tracks(path)
    assert (read.samples, read.velocity) == (60, None)
    path = write_csv(tmp_path / "flat.csv", [[*row, 1.0, 2.0] for row in ROWS], [*HEADER, "vx", "vy"])
    np.testing.assert_array_equal(read_tracks(path).velocity, [[1, 2, 0]] * 60)


def test_one_velocity_without_the_other_is_not_read(tmp_path):
    path = write_csv(tmp_path / "tracks.csv", [[*row, 1.0, 3.0] for row in ROWS], [*HEADER, "vx", "vz"])
    read = read_tracks(path)
    assert read.velocity is None
    assert read.notes[0] == "Columns: id = id, t = t, x = x, y = y."
    assert refusal(path, columns={"vx": "vx"}).startswith("columns must name the column of")


@pytest.mark.parametrize("gap", [0, 1, 2])
def test_a_gap_in_one_velocity_leaves_out_all_of_them(tmp_path, gap):
    velocities = [[1.0, 2.0, 3.0] for _ in ROWS]
    velocities[7][gap] = ""
    rows = [[*row, *velocity] for row, velocity in zip(HIGH, velocities, strict=True)]
    read = read_tracks(write_csv(tmp_path / "tracks.csv", rows, [*HEADER, "z", "vx", "vy", "velocity_z"]))
    assert (read.samples, read.velocity) == (60, None)
    assert read.notes[:2] == (
        "Columns: id = id, t = t, x = x, y = y, z = z.",
        "Columns vx (vx), vy (vy), velocity_z (vz) lack a value in 1 of 60 rows and are left out.",
    )


def test_a_column_can_be_left_out(tmp_path):
    path = write_csv(tmp_path / "tracks.csv", HIGH)
    assert read_tracks(path, columns={"z": ""}).dimensions == 2
    assert refusal(path, columns={"x": ""}).endswith("must not leave out x, which is needed, got '' for x.")


def test_points_of_gpx_without_a_height_are_not_at_0(tmp_path):
    def write(name, height):
        points = [
            f'<trkpt lat="50" lon="{10 + 1e-5 * k}">{height(k)}<time>2024-05-01T00:00:0{k}Z</time></trkpt>'
            for k in range(4)
        ]
        tracks = "".join(f"<trk><name>{name}</name><trkseg>{''.join(points)}</trkseg></trk>" for name in "ab")
        (tmp_path / name).write_text(f"<gpx>{tracks}</gpx>")
        return read_tracks(tmp_path / name)

    some = write("some.gpx", lambda k: f"<ele>{120 + k}</ele>" if k else "")
    assert some.dimensions == 2
    assert "Column ele (z) has no value in 2 of 8 rows and is left out." in some.notes
    assert write("all.gpx", lambda k: f"<ele>{120 + k}</ele>").dimensions == 3
    assert write("none.gpx", lambda k: "").dimensions == 2
    assert read_tracks(tmp_path / "all.gpx", columns={"z": "", "id": "name"}).dimensions == 2
    expected = "(id = name, lon = lon, lat = lat, z = ele, t = time), got 'nope' for id."
    assert refusal(tmp_path / "all.gpx", columns={"id": "nope"}).endswith(expected)
    assert refusal(tmp_path / "all.gpx", columns={"lon": ""}).endswith("got '' for lon.")


def test_two_roles_on_one_column_are_refused(run, tmp_path):
    path = write_csv(tmp_path / "tracks.csv", ROWS)
    expected = "must give each role a column of its own, got 'x' for x and y."
    assert refusal(path, columns={"x": "x", "y": "x"}) == f"columns {expected}"
    status, _, err = run("detect", path, "--column", "x=x", "--column", "y=x")
    assert (status, err) == (2, f"usnet: --column {expected}\n")


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        (
            {"x": "x", "y": "y", "lon": "lon", "lat": "lat"},
            "x and y or lon and lat, not both, got 'x' for x, 'y' for y",
        ),
        ({"y": "y", "lon": "lon"}, "x and y or lon and lat, not both, got 'y' for y, 'lon' for lon."),
        ({"t": "t", "frame": "x"}, "t or frame, not both, got 't' for t, 'x' for frame."),
    ],
)
def test_named_columns_of_which_only_some_can_be_read_are_refused(tmp_path, columns, expected):
    path = write_csv(tmp_path / "tracks.csv", [[*row, 10.0, 50.0] for row in ROWS], [*HEADER, "lon", "lat"])
    assert refusal(path, columns=columns).startswith(f"columns must name {expected}")
    assert read_tracks(path, columns={"x": "x", "lon": "", "lat": ""}).frame == "metres"


def test_a_column_that_another_role_has_taken_is_not_offered(tmp_path):
    path = write_csv(tmp_path / "tracks.csv", ROWS)
    expected = "; no name among ['t', 'x', 'y'] is known for it, because 'id' is given to t."
    assert refusal(path, columns={"t": "id"}).endswith(expected)


def test_all_columns_that_are_missing_are_named_with_an_example(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_csv(tmp_path / "birds.csv", ROWS, ["bird's name", "clock", "pos_e", "pos_n"])
    needs = "must name the columns of 'birds.csv' for id, t (or frame), x and y (or lon and lat), such as"
    none = """; no name among ["bird's name", 'clock', 'pos_e', 'pos_n'] is known for them."""
    assert refusal("birds.csv") == f"""columns {needs} columns={{'id': "bird's name"}}{none}"""
    assert run("detect", "birds.csv")[2] == f"""usnet: --column {needs} --column id="bird's name"{none}\n"""
    words = [f"--column={role}={name}" for role, name in zip(HEADER, ["bird's name", "clock", "pos_e"], strict=False)]
    err = run("detect", "birds.csv", *words)[2]
    assert err.startswith("usnet: --column must name the column of 'birds.csv' for y, such as --column y='pos_n'; no")
    left_out = "usnet: --column must not leave out t, which is needed, got '' for t.\n"
    assert run("detect", "birds.csv", "--column", "t=")[2] == left_out


def write_positions(path, **arrays):
    np.savez(path, position=straight()[..., :2], **arrays)
    return path


def test_names_of_arrays_beside_positions(tmp_path):
    path = write_positions(tmp_path / "tracks.npz", when=np.arange(20) * 0.5, who=np.array(["a", "b", "c"]))
    read = read_tracks(path, columns={"t": "when", "id": "who"})
    assert (read.ids, read.duration) == (("a", "b", "c"), 9.5)
    assert read_tracks(path, columns={"frame": "when"}, time_unit=2).duration == 19
    for columns, expected in (
        ({"t": "noon"}, "for t, got 'noon'; it has ['position', 'when', 'who']."),
        ({"x": "when"}, "(x = position, y = position), got 'when' for x."),
        ({"id": "when"}, "id must have shape (3,)"),
    ):
        assert expected in refusal(path, columns=columns)


def test_leaders_beside_positions(tmp_path):
    ids = np.array(["a", "b", "c"])
    read = read_tracks(write_positions(tmp_path / "one.npz", id=ids, leader=np.array(["", "a", "a"])))
    assert read.leader.reshape(3, 20)[:, 0].tolist() == [-1, 0, 0]
    leader = np.where(np.arange(20)[:, None] < 5, [[-1, 0, 0]], [[1, -1, 1]])
    read = read_tracks(write_positions(tmp_path / "each.npz", leader=leader))
    assert read.ids == (0, 1, 2)
    np.testing.assert_array_equal(read.leader.reshape(3, 20), leader.T)
    wrong = write_positions(tmp_path / "wrong.npz", leader=np.zeros(7))
    assert refusal(wrong).startswith("leader must have shape (3,) or (20, 3) in")


@pytest.mark.parametrize(
    ("arrays", "expected"),
    [
        ({"t": np.full(20, "2020-01-01")}, "with two places for id 0 in instants 0 and 1 of"),
        ({"t": np.full(20, "noon")}, "t must be a number or an ISO 8601 timestamp"),
        ({"t": np.full(20, b"noon")}, "t must be a number or an ISO 8601 timestamp"),
        ({"id": np.array(["a", "a", "b"])}, "id must name each of the 3 tracks once"),
        ({"seen": np.full((20, 3), "x")}, "seen must hold truth values"),
    ],
)
def test_bad_arrays_beside_positions_are_refused(tmp_path, arrays, expected):
    assert expected in refusal(write_positions(tmp_path / "tracks.npz", **arrays))


def test_timestamps_beside_positions(tmp_path):
    times = np.array([f"2024-05-01T00:00:{k:02}" for k in range(20)])
    read = read_tracks(write_positions(tmp_path / "tracks.npz", t=times))
    assert read.file_time(read.duration) == "2024-05-01T00:00:19.000Z"

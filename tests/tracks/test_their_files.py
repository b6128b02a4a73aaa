"""Files as trackers, collars and spreadsheets write them: each is read as the plain CSV of the same tracks."""

import gzip
import json
import re

import numpy as np
import pytest
from track_files import HEADER, refusal, rows_of, straight, write_csv

from usnet_env.tracks import read_tracks

ROWS = rows_of(straight(), step=60)
IDS, TIMES = [row[0] for row in ROWS], [row[1] for row in ROWS]


def stamps(day="2024-03-31", hours="{:02}"):
    """The times as texts, from half past 7 on."""
    return [f"{day} {hours.format((450 + t // 60) // 60)}:{(450 + t // 60) % 60:02.0f}:00" for t in map(int, TIMES)]


def rows(times=TIMES, ids=IDS, places=None):
    return [
        [name, time, *(row[2:] if places is None else place)]
        for name, time, row, place in zip(ids, times, ROWS, places or ROWS, strict=True)
    ]


def table(names, *columns):
    return [[*names], *map(list, zip(*columns, strict=True))]


X, Y = ([row[k] for row in ROWS] for k in (2, 3))
MILLIS, DATES = [1000 * t for t in TIMES], [each.split() for each in stamps()]
CENTS, FEET, FRAMES = np.array(X) * 100, np.array(Y) / 0.3048, [int(t) // 10 for t in TIMES]
CASES = {  # rows of the file, delimiter, options
    "names": (table(["uid", "fixtime", "X", "Y"], IDS, TIMES, X, Y), ",", {}),
    "id of rows": (table(["id", "trajectory_id", "t", "x", "y"], range(60), IDS, TIMES, X, Y), ",", {}),
    "units": (table(["id", "time (ms)", "x_cm", "Y [ft]"], IDS, MILLIS, CENTS, FEET), ",", {}),
    "lengths": (table(HEADER, IDS, TIMES, np.array(X) / 0.3048, np.array(Y) / 0.3048), ",", {"length_unit": "ft"}),
    "blanks": (table(["t", "id", "x", "y"], TIMES, IDS, X, Y)[1:], " ", {"header": ["t", "id", "x", "y"]}),
    "comments": ([["# by a tracker"], HEADER, *rows()], ",", {}),
    "names in a comment": ([["#", "id", "t", "x", "y"], *rows()], " ", {}),
    "a rate": (
        [["#", "framerate:", "0.1", "fps"], *table(["#", "PersID", "FR", "x/cm", "y/ft"], IDS, FRAMES, CENTS, FEET)],
        " ",
        {},
    ),
    "units below": (
        [["ID", "TRACK_ID", "POSITION_T", "POSITION_X", "POSITION_Y"], ["Spot ID", "Track ID", "T", "X", "Y"],
         ["", "", "(ms)", "(cm)", "(ft)"], *table([], range(60), IDS, MILLIS, CENTS, FEET)[1:]],
        ",",
        {"columns": {"x": "POSITION_X"}},
    ),
    "one digit": ([HEADER, *rows(stamps(hours="{}"))], ",", {}),
    "days first": ([HEADER, *rows(stamps("31/03/2024"))], ",", {}),
    "months first": ([HEADER, *rows(stamps("3/31/2024"))], ";", {}),
    "AM": ([HEADER, *rows([f"{each} AM" for each in stamps(hours="{}")])], ",", {}),
    "a zone": ([HEADER, *rows([f"{each} UTC" for each in stamps()])], ",", {}),
    "a format": ([HEADER, *rows(stamps("03.04.2024"))], ",", {"time_format": "%d.%m.%Y %H:%M:%S"}),
    "digits": ([HEADER, *rows([re.sub(r"\D", "", each) for each in stamps()])], ",", {"time_format": "%Y%m%d%H%M%S"}),
    "zeros lost": ([HEADER, *rows([int(t) // 60 * 100 for t in TIMES])], ",", {"time_format": "%M%S"}),
    "date and time": (table(["id", "x", "y", "date", "time"], IDS, X, Y, *zip(*DATES, strict=True)), ",", {}),
    "times of day": ([HEADER, *rows([each.split()[1] for each in stamps(hours="{}")])], ",", {}),
    "microseconds": ([HEADER, *rows([int(1.7e15 + 1e6 * t) for t in TIMES])], ",", {}),
    "spreadsheet": ([HEADER, *rows([45382.3125 + t / 86400 for t in TIMES])], ",", {}),
    "two places": ([HEADER, *rows(), ["a", 60, 1e3, 1e3]], ",", {"duplicates": "first"}),
    "means": (
        [HEADER, *([*row[:2], row[2] + by, row[3] - by] for row in ROWS for by in (-1, 1))],
        ",",
        {"duplicates": "mean"},
    ),
    "no place": ([HEADER, *rows(), ["a", 5e3, 0, 0], ["a", 5e3, 0, 0.0]], ",", {"missing_place": (0, 0)}),
    "unsure": (
        [[*HEADER, "likelihood"], *([*row, 0.9] for row in ROWS), ["a", 99, 0, 1, 0.5], ["b", 99, 0, 1, ""]],
        ",",
        {"min_confidence": 0.6},
    ),
    "marks": ([HEADER, *rows(), ["a", 5e3, "-", 1], ["b", 5e3, "inf", "#N/A"]], ",", {"missing": "skip"}),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_other_ways_to_write_tracks_are_read(tmp_path, case):
    cells, delimiter, options = CASES[case]
    read = read_tracks(write_csv(tmp_path / "theirs.txt", cells[1:], cells[0], delimiter=delimiter), **options)
    plain = read_tracks(write_csv(tmp_path / "plain.csv", ROWS))
    assert (set(read.ids), read.samples) == (set(plain.ids), plain.samples)
    for k, name in enumerate(plain.ids):
        part, same = (slice(*each.offsets[[i, i + 1]]) for each, i in ((read, read.ids.index(name)), (plain, k)))
        np.testing.assert_allclose(read.time[part] - read.time[part][0], plain.time[same], atol=2e-3)
        place, known = (each.position + each.origin for each in (read, plain))
        np.testing.assert_allclose(place[part], known[same], atol=1e-6)


def test_wide_tables_and_a_file_for_each_id(tmp_path):
    places = straight()
    wide = [[t / 2, *place[:, :2].ravel()] for t, place in enumerate(places)]
    wide[3][1:3] = ["", ""]
    read = read_tracks(write_csv(tmp_path / "wide.csv", wide, ["seconds", "x1", "y1", "x2", "y2", "x3", "y3"]))
    assert (read.ids, read.samples, read.duration) == (("1", "2", "3"), 59, 9.5)
    np.testing.assert_allclose((read.position + read.origin)[:3], places[:3, 0], atol=1e-9)
    frames = [row[1:] for row in wide]
    read = read_tracks(write_csv(tmp_path / "w.csv", frames, ["a_x", "a_y", "b_x", "b_y", "c_x", "c_y"]), time_unit=0.5)
    assert (read.ids, read.samples, read.duration) == (("a", "b", "c"), 59, 9.5)
    of = {name: [row[1:] for row in ROWS if row[0] == name] for name in "ab"}
    files = [write_csv(tmp_path / f"{name}.csv", rows, HEADER[1:]) for name, rows in of.items()]
    assert read_tracks(files).ids == ("a", "b")
    assert "is id?" in refusal(files[0])


def records(name, *cells):
    return [dict(zip(name.split(), row, strict=True)) for row in zip(*cells, strict=True)]


POINTS = [
    {"properties": each, "geometry": {"type": "Point", "coordinates": place}}
    for each, place in zip(records("id t", IDS, TIMES), zip(X, np.array(Y) / 100, strict=True), strict=True)
]
FIELD = [
    {
        "frame": k,
        "period": 1,
        "ball": [{"x": 9}],
        "home": records("playerId xyz", IDS[:3], [[*row[2:], 0] for row in now]),
    }
    for k, now in enumerate(np.reshape(np.array(ROWS, object), (20, 3, 4)).tolist())
]


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("t.json", records("id t x y", IDS, TIMES, X, Y)),
        ("t.geojson", {"type": "FeatureCollection", "features": POINTS}),
        ("t.json", {"frames": FIELD}),
        ("t.jsonl", FIELD),
    ],
    ids=["records", "GeoJSON", "nested", "lines"],
)
def test_json_may_nest_records(tmp_path, name, content):
    lines = [json.dumps(each) for each in (content if name.endswith("l") else [content])]
    (tmp_path / f"{name}.gz").write_bytes(gzip.compress("\n".join(lines).encode()))
    read = read_tracks(tmp_path / f"{name}.gz")
    assert (read.ids, read.samples, read.dimensions) == (("a", "b", "c"), 60, 2)
    assert read.frame.endswith("degrees") == ("geo" in name)
    if "geo" not in name:
        np.testing.assert_allclose((read.position + read.origin)[:20, :2], straight()[:, 0, :2], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("a.xml", "<?xml version='1.0'?><Positions/>", "kloppy"),
        ("a.igc", "AXSX004SKYTRAXX V1\r\nHFDTE010524\r\n", "GPSBabel"),
        ("a.txt", "!AIVDM,1,1,,A,15M67FC000G?ufbE`FepT@3n00Sa,0*5C\n", "pyais"),
        ("a.dat", "1848000:0,1,1,396,-1244,1.0;:0,0,0,0.0,H,Alive;:\n", "kloppy"),
        ("a.log", '{"id": 1}', "--format json"),
        ("a.json", '{"full_count": 9, "4b1": [1, 2]}', "neither records nor columns"),
        ("a.mine", "one two\n1 2\n", "no format has the suffix .mine"),
        ("a.csv", "a,b,c\n1,2,3\n", "It has a, b, c;"),
        ("a.txt", "0 0 1 2 9\n", "its 5 columns in order"),
    ],
)
def test_other_files_are_refused_by_their_name(tmp_path, name, text, expected):
    (tmp_path / name).write_bytes(text.encode())
    assert expected in refusal(tmp_path / name)


def test_what_cannot_be_known_is_refused_with_the_option_that_helps(tmp_path):
    assert "--time-format" in refusal(write_csv(tmp_path / "days.csv", rows(stamps("03/04/2024"))))
    for zone in ("CEST", "EST", "UTC+2", "AM PST"):
        zoned = write_csv(tmp_path / "zone.csv", rows([f"{each} {zone}" for each in stamps(hours="{}")]))
        assert "(its time zone must be an offset such as +02:00, or Z" in refusal(zoned)
    for no_format in ("nonsense", "%Q"):
        assert f"got {no_format!r} for '0'" in refusal(write_csv(tmp_path / "t.csv", ROWS), time_format=no_format)
    assert "--columns" in refusal(write_csv(tmp_path / "t.txt", ROWS[1:], list(map(str, ROWS[0])), delimiter=" "))
    assert "--duplicates" in refusal(write_csv(tmp_path / "two.csv", [*ROWS, ["a", 60, 1e3, 1e3]]))
    assert "(same id and time): 1 sample." in read_tracks(tmp_path / "two.csv", duplicates="first").notes[-1]
    (tmp_path / "tracks.xls").write_bytes(b"\xd0\xcf\x11\xe0" + bytes(99))
    assert "--format" in refusal(tmp_path / "tracks.xls")
    assert "names in header" in refusal(tmp_path / "two.csv", header=["id", "t"])


def test_an_id_that_is_used_again_is_another_one(tmp_path):
    rows = [["a", t, t, 0, ""] for t in (0, 1, 50, 51)] + [["b", t, t, 9, "a"] for t in (0, 1, 48, 49, 50)]
    read = read_tracks(write_csv(tmp_path / "again.csv", rows, [*HEADER, "leader"]), split_gap=20)
    assert (read.ids, read.offsets.tolist()) == (("a", "a/2", "b", "b/2"), [0, 2, 4, 6, 9])
    assert read.leader.tolist() == [-1, -1, -1, -1, 0, 0, 0, 0, 1]
    assert read_tracks(tmp_path / "again.csv", split_gap=60).ids == ("a", "b")
    assert "split_gap (--split-gap) must be longer than" in refusal(tmp_path / "again.csv", split_gap=0.5)


def test_no_window_has_parts_of_two_pooled_recordings(tmp_path):
    paths = [tmp_path / f"{k}.csv" for k in range(2)]
    both = [[[row[0], row[1] + 100 * k, *row[2:], k] for row in ROWS] for k in range(2)]
    for path, part in zip(paths, both, strict=True):
        write_csv(path, part, [*HEADER, "period"])
    read = read_tracks(paths, pool=True)
    halves = write_csv(tmp_path / "halves.csv", both[0] + both[1], [*HEADER, "period"])
    one = read_tracks(halves, pool_by="period")
    np.testing.assert_array_equal(one.time, read.time)
    assert [name for name, *_ in one.clock.recordings] == ["period 0", "period 1"]
    for wrong in ("half", "t", "id"):
        assert f"other than id, t, x, y, got {wrong!r}; it has" in refusal(halves, pool_by=wrong)
    assert read_tracks(halves, columns={"id": "period"}, duplicates="first").ids == ("0", "1")
    again = [[*row, 0] for row in ROWS] + [[*row[:2], row[2] + 1, row[3], 1] for row in ROWS]
    restarts = write_csv(tmp_path / "restarts.csv", again, [*HEADER, "period"])
    assert "60 of 120 rows" in refusal(restarts)
    assert "--pool-by period" in refusal(restarts)
    assert read_tracks(restarts, pool_by="period").duration == 3 * 19 * 60
    even = read.resample(60.0)
    assert (read.ids, read.report().warnings, even.choose_length()) == (("a", "b", "c"), (), 19)
    assert [(even.file_time(cut.start), even.file_time(cut.end)) for cut in even.windows(10)] == [
        ("0.csv: 0", "0.csv: 600"),
        ("0.csv: 540", "0.csv: 1140"),
        ("1.csv: 100", "1.csv: 700"),
        ("1.csv: 640", "1.csv: 1240"),
    ]

"""Times, delays and the files of ``usnet detect``: their fields, odd names, and folders that were used before."""

import json
import sys
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from track_files import Answers, Sure, answer_of, example, rows_of, straight, tracks_of, write_csv

from usnet_env.tracks import find_leaders, read_tracks

QUICK = ("--detector", "directional-delays")


def flying(lag, steps=600, seed=3):
    """Positions ``(steps, 3, 2)``: ids 1 and 2 copy the turns of id 0 after ``lag`` and ``lag + 1`` samples."""
    rng = np.random.default_rng(seed)
    turn = np.convolve(rng.normal(0, 1, steps), np.ones(4) / 4, "same")
    path = np.stack([np.cos(np.cumsum(turn)), np.sin(np.cumsum(turn))], axis=1)
    velocity = np.stack([path, np.roll(path, lag, axis=0), np.roll(path, lag + 1, axis=0)], axis=1)
    return np.cumsum(velocity + rng.normal(0, 0.05, velocity.shape), axis=0)


def stamp(t, epoch=False):
    seconds, tenth = divmod(t, 10)
    clock = f"2010-07-08T09:{12 + seconds // 60}:{seconds % 60:02}.{tenth}00"
    return f"{1278580320 + seconds}.{tenth}" if epoch else clock


@pytest.mark.parametrize("epoch", [False, True])
def test_times_every_tenth_of_a_second_are_exact(run, tmp_path, epoch):
    places = flying(lag=2)
    rows = [[f"b{k}", stamp(t, epoch), *map(float, places[t, k])] for t in range(600) for k in range(3)]
    path = write_csv(tmp_path / "tracks.csv", rows)
    read = read_tracks(path)
    np.testing.assert_array_equal(read.time[:600], np.arange(600) / 10)
    assert "one every 0.1 s;" in read.report().facts[0]
    status, out, _ = run("detect", path, *QUICK, "--step", "0.1", "--window", "100", "--json")
    assert status == 0
    windows = json.loads(out)["windows"]
    expected = [stamp(t, epoch) for t in range(0, 501, 100)]
    as_number = [float(each) if epoch else f"{each.removesuffix('.000')}Z" for each in expected]
    assert [(each["start"], each["end"]) for each in windows[:-1]] == list(pairwise(as_number))
    assert windows[-1]["end"] == (float(stamp(599, epoch)) if epoch else f"{stamp(599)}Z")
    delays = [link["delay"] for each in windows for link in each["links"] if link["delay"] is not None]
    assert delays
    assert all(min(abs(delay - true) for true in (0.1, 0.2, 0.3)) < 0.01 for delay in delays), delays


@pytest.mark.parametrize(("unit", "number"), [(1e3, "0.001"), (1e6, "1e-06"), (1e9, "1e-09")])
def test_times_that_count_from_1970_are_read_in_their_unit(run, tmp_path, unit, number):
    begin = 1714720000
    rows = [[row[0], int((begin + row[1]) * unit), *row[2:]] for row in rows_of(straight())]
    path = write_csv(tmp_path / "tracks.csv", rows)
    read = read_tracks(path)
    (found,) = read.report().warnings
    assert "since 1970, not as seconds (--time-unit 1 reads seconds)" in found
    assert (read.duration, read.file_time(0.0)) == (9.5, begin * unit)
    assert read_tracks(path, time_unit=1).duration == 9.5 * unit
    again = read_tracks(path, time_unit=float(number))
    assert (again.duration, again.report().warnings) == (9.5, ())
    assert "since 1970" in run("detect", path, "--window", "10", *QUICK)[2]


@pytest.mark.parametrize("unit", [10**6, 10**9])
def test_whole_numbers_since_1970_are_kept(unit):
    begin = 1717000000 * unit + unit // 10
    times = begin + np.repeat(np.arange(20), 2) * (unit // 10)
    frame = pd.DataFrame({"id": ["a", "b"] * 20, "t": times, "x": np.arange(40.0), "y": np.arange(40) % 2})
    read = read_tracks(frame, time_unit=1 / unit)
    np.testing.assert_allclose(read.time[:20], np.arange(20) / 10, rtol=1e-15)
    assert [read.file_time(k / 10) for k in (0, 3)] == [begin, begin + 3 * unit // 10]


def test_a_delay_of_less_than_a_step_is_left_empty():
    found = find_leaders(tracks_of(flying(lag=0), 0.5, names="abc").resample(0.5), Sure(0), confirm=False)
    for window in found.windows[1:]:
        assert {link.follower: link.delay for link in window.links} == {"b": None, "c": pytest.approx(0.5, abs=0.05)}
    assert found.tables()["links"]["delay"].isna().any()


@pytest.mark.parametrize(
    ("lag", "steps", "measured"), [(12, 100, True), (14, 100, False), (10, 40, True), (14, 40, False)]
)
def test_delays_are_measured_up_to_12_steps(lag, steps, measured):
    rng = np.random.default_rng(0)
    leader = rng.normal(0, 1, (2 * steps, 2))
    velocity = np.stack([leader, np.roll(leader, lag, axis=0)], axis=1)[-steps - 1 :]
    tracks = tracks_of(np.cumsum(velocity, axis=0)).resample(1.0)
    (window,) = find_leaders(tracks, Sure(0), length=steps, confirm=False).windows
    assert (window.links[0].delay == pytest.approx(lag, abs=0.1)) == measured


def test_tables_and_json_have_the_same_fields(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)  # a picture takes long
    names, places = ["a", "b;c", "d\\"], flying(lag=2)
    rows = [[names[k], t * 0.5, *map(float, places[t, k])] for t in range(600) for k in range(3)]
    path = write_csv(tmp_path / "tracks.csv", rows)
    status, out, _ = run("detect", path, *QUICK, "--step", "0.5", "--unconfirmed", "--out", tmp_path / "found")
    assert status == 0
    found = json.loads((tmp_path / "found" / "leaders.json").read_text(encoding="utf-8"))
    windows, leaders = (pd.read_csv(tmp_path / "found" / f"{name}.csv") for name in ("windows", "leaders"))
    assert {*leaders} == {*found["leaders"][0]}
    assert r"b\;c;d\\" in [*windows.followers]
    assert {*windows} == {*found["windows"][0], *found["windows"][0]["leaders"][0]} - {"leaders", "links"}
    led = sum(each["id"] == found["leaders"][0]["id"] for window in found["windows"] for each in window["leaders"])
    assert found["leaders"][0]["share"] == pytest.approx(led / len(found["windows"]))
    assert f"{led / len(found['windows']):.0%}" in out.partition("Over the file")[2]


def flock(path, rename=str, shift=0.0, move=0.0, scale=1.0):
    """A flock of 12 ids in which the first one leads; ``shift`` seconds later, and ``move`` metres away."""
    rows = [[rename(name), t + shift, scale * x + move, scale * y] for name, t, x, y, _ in example().flock()]
    return write_csv(path, rows)


def test_odd_ids_are_drawn_and_written_as_plain_text(run, tmp_path):
    """Formulas of Matplotlib, tags of Rich, characters that control a terminal or lack a glyph."""
    pytest.importorskip("matplotlib")
    names = {"bird-0": "=1+\u9e1f", "bird-1": "$\\foo$", "bird-2": "[/red]", "bird-3": "\x1b[31mred"}
    tracks = flock(tmp_path / "$x_{1$.csv", rename=lambda name: names.get(name, name))
    status, out, err = run("detect", tracks, *QUICK, "--out", tmp_path / "out")
    assert status == 0, err
    assert (tmp_path / "out" / "picture.png").exists()
    assert "\x1b" not in out + err
    assert err.count("The fonts of this machine lack some characters of the figure") == 1
    assert "Glyph" not in err
    for name in ("=1+\u9e1f", "$\\foo$", "[/red]", "[31mred"):
        assert name in out
    assert [*pd.read_csv(tmp_path / "out" / "leaders.csv").id] == ["=1+\u9e1f"]
    page = (tmp_path / "out" / "page.html").read_text(encoding="utf-8")
    assert "<title>Leaders in $x_{1$.csv</title>" in page
    assert "=1+\u9e1f leads" in page


def test_the_picture_has_the_coordinates_and_times_of_the_file(tmp_path):
    pytest.importorskip("matplotlib")
    path = flock(tmp_path / "flock.csv", shift=1_700_000_000.5, move=500_000.0)
    tracks = read_tracks(path, length_unit="px").resample()
    axes = find_leaders(tracks, "lagged-regression").plot_maps("flock.csv").axes[0]
    low, high = axes.get_xlim()
    places = [row[2] + 500_000.0 for row in example().flock() if row[1] <= 100]
    assert low < min(places) < max(places) < high
    assert axes.get_title(loc="left").startswith("1700000000.5 to 17000000")
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x in px", "y in px")


def test_a_detector_without_followers_has_no_confirmed_leaders(run, tmp_path):
    path = flock(tmp_path / "flock.csv")
    confirmed, all_named = (
        find_leaders(read_tracks(path), Answers(lambda uavs, _: answer_of(uavs, 0)), confirm=confirm).windows
        for confirm in (True, False)
    )
    assert not any(window.leaders for window in confirmed)
    assert {window.not_confirmed for window in confirmed} == {("bird-0",)}
    assert all_named[0].leaders[0].id == "bird-0"
    _, out, err = run("detect", path, "--detector", "destroy-all", "--json")
    assert "the detector names no followers, so no leader is confirmed" in err
    assert not any(window["leaders"] for window in json.loads(out)["windows"])
    assert "names no followers" not in run("detect", path, "--detector", "destroy-all", "--unconfirmed")[2]


def test_an_interrupted_run_leaves_the_files_of_an_earlier_one(run, tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    path, out = flock(tmp_path / "flock.csv"), tmp_path / "out"
    out.mkdir()
    for name in ("leaders.json", "windows.csv", "network.png", "page.html", "episode.npz"):
        (out / name).write_text("old")
    monkeypatch.setattr("usnet_env.tracks.result.write_figure", interrupt)
    assert run("detect", path, *QUICK, "--out", out)[0] == 130
    assert [file.read_text() for file in out.iterdir()] == ["old"] * 5


def test_windows_that_are_too_short_for_the_test_are_named(run, tmp_path):
    path = flock(tmp_path / "flock.csv")
    for length, words in (("15", ()), ("15", ("--unconfirmed",)), ("16", ())):
        _, out, _ = run("detect", path, *QUICK, "--window", length, *words)
        assert ("too short for the test that confirms leaders" in out) == (length == "15" and not words)


@pytest.mark.parametrize(("step", "warned"), [("0.1", True), ("0.25", False)])
def test_a_step_far_below_the_sampling_interval_is_warned_of(run, tmp_path, step, warned):
    path = write_csv(tmp_path / "tracks.csv", rows_of(straight(steps=80)))
    _, _, err = run("detect", path, "--detector", "none", "--step", step)
    assert err.count(f"warning: The step of {step} s is far below the sampling interval, 0.5 s: ") == warned

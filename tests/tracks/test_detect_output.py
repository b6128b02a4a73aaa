"""The files of ``usnet detect``: types, names and times that are hard to draw, and folders that were used before."""

import csv
import json

import pytest
from track_files import Answers, answer_of, example, write_csv

from usnet_env.tracks import find_leaders, read_tracks

QUICK = ("--detector", "lagged-correlation")


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
    with open(tmp_path / "out" / "leaders.csv", newline="", encoding="utf-8") as file:
        assert [row["id"] for row in csv.DictReader(file)] == ["=1+\u9e1f"]
    page = (tmp_path / "out" / "page.html").read_text(encoding="utf-8")
    assert "<title>Leaders in $x_{1$.csv</title>" in page
    assert "=1+\u9e1f leads" in page


def test_the_picture_has_the_coordinates_and_times_of_the_file(tmp_path):
    pytest.importorskip("matplotlib")
    tracks = read_tracks(flock(tmp_path / "flock.csv", shift=1_700_000_000.5, move=500_000.0)).resample()
    axes = find_leaders(tracks, "lagged-regression").plot_maps("flock.csv").axes[0]
    low, high = axes.get_xlim()
    places = [row[2] + 500_000.0 for row in example().flock() if row[1] <= 100]
    assert low < min(places) < max(places) < high
    assert axes.get_title(loc="left").startswith("1700000000.5 to 17000000")


def test_a_detector_without_followers_has_no_confirmed_leaders(run, tmp_path):
    path = flock(tmp_path / "flock.csv")
    found = find_leaders(read_tracks(path), Answers(lambda uavs, _: answer_of(uavs, 0)))
    assert not any(window.leaders for window in found.windows)
    assert {window.not_confirmed for window in found.windows} == {("bird-0",)}
    assert (
        find_leaders(read_tracks(path), Answers(lambda uavs, _: answer_of(uavs, 0)), confirm=False)
        .windows[0]
        .leaders[0]
        .id
        == "bird-0"
    )
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

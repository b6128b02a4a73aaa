"""Wrong fixes: marked ones are skipped, single ones are left out, and none of them chooses the step."""

import numpy as np
import pytest
from track_files import write_csv

from usnet_env import ArgumentError
from usnet_env.tracks import Tracks, read_tracks

HEADER = ["timestamp", "location-long", "location-lat", "individual-local-identifier", "visible"]
MARKS = ["algorithm-marked-outlier", "import-marked-outlier", "manually-marked-outlier", "manually-marked-valid"]
QUICK = ("--detector", "lagged-regression")


def pigeons(steps=300, ids=4):
    """Rows of a Movebank file: the others fly as the first did 2 s ago."""
    rng = np.random.default_rng(5)
    rate = np.convolve(rng.normal(0, 0.4, steps), np.ones(6) / 3, "same")
    flown = 12 * np.stack([np.cos(np.cumsum(rate)), np.sin(np.cumsum(rate))], axis=1)
    rows = []
    for k in range(ids):
        velocity = np.roll(flown, 2 * min(k, 1), axis=0) + rng.normal(0, 0.3, flown.shape)
        lon, lat = (np.cumsum(velocity, axis=0) + 20 * k).T / 111_000
        for t in range(steps):
            stamp = f"2010-07-08 09:{12 + t // 60:02}:{t % 60:02}.000"
            rows.append([stamp, 19.04 + float(lon[t]), 47.5 + float(lat[t]), f"bird-{k}", "true"])
    return rows


def write(path, rows, marks=()):
    return write_csv(path, rows, [*HEADER, *marks])


def test_one_fix_at_zero_degrees_is_left_out_and_changes_nothing_else(run, tmp_path):
    rows = pigeons()
    whole = read_tracks(write(tmp_path / "whole.csv", rows))
    rows[8][1:3] = [0.0, 0.0]
    glitch = read_tracks(write(tmp_path / "glitch.csv", rows))
    (found,) = glitch.report().warnings
    assert (found.kind, found.count) == ("spikes", 1)
    assert "at 2010-07-08T09:12:08.000Z (id bird-0)" in found.sentence
    even, without = whole.resample(), glitch.resample()
    assert without.step == even.step
    assert glitch.resample(1.0).samples == whole.resample(1.0).samples - 1
    there = {(int(owner), round(float(t), 6)): p for owner, t, p in samples_of(even)}
    for owner, t, place in samples_of(without):
        np.testing.assert_allclose(place, there[int(owner), round(float(t), 6)], atol=1.0)  # metres
    for words in ((), ("--keep-spikes", "--step", "1")):
        status, out, err = run("detect", tmp_path / "glitch.csv", *QUICK, *words)
        assert status == 0
        assert "1 sample is a spike" in err
        assert ("1 spike was left out, unless --keep-spikes is given." in out) == (not words)
        assert "bird-0" in out
    assert np.abs(glitch.resample(1.0, keep_spikes=True).position).max() > 1e6


def samples_of(tracks):
    owner = np.repeat(np.arange(len(tracks.ids)), np.diff(tracks.offsets))
    place = tracks.position - tracks.position[tracks.offsets[1]]  # the frames' middles differ
    return zip(owner, tracks.time, place, strict=True)


def test_fixes_at_zero_degrees_in_a_row_are_reported_and_do_not_choose_the_step(tmp_path):
    rows = pigeons()
    step = read_tracks(write(tmp_path / "whole.csv", rows)).resample().step
    for row in rows[8:12]:
        row[1:3] = [0.0, 0.0]
    glitch = read_tracks(write(tmp_path / "glitch.csv", rows))
    (found,) = glitch.report().warnings
    assert (found.kind, found.count) == ("jumps", 2)
    assert glitch.resample().step == step


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
    rows = [[*row, "", "", "", ""] for row in pigeons(30)]
    rows[8][4:] = [visible, *marks]
    if skipped:
        rows[8][1:3] = [0.0, 95.0]  # no latitude at all
    read = read_tracks(write(tmp_path / "marked.csv", rows, MARKS))
    assert read.samples == len(rows) - skipped
    assert ("1 of 120 rows is marked as an outlier in the file and skipped." in str(read.report())) == skipped
    assert read.report().warnings == ()


def test_marks_of_parquet_are_read_and_other_files_have_none(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = pigeons(30)
    columns = {name.replace("-", "_"): [row[k] for row in rows] for k, name in enumerate(HEADER)}
    columns["visible"] = [k != 8 for k in range(len(rows))]
    parquet.write_table(pyarrow.table(columns), tmp_path / "marked.parquet")
    assert read_tracks(tmp_path / "marked.parquet").samples == len(rows) - 1
    columns["name"] = columns.pop("individual_local_identifier")
    parquet.write_table(pyarrow.table(columns), tmp_path / "other.parquet")
    assert read_tracks(tmp_path / "other.parquet").samples == len(rows)


def test_a_row_after_marked_ones_is_named_by_its_number(tmp_path):
    rows = pigeons(30)
    rows[8][4], rows[20][1] = "false", "east"
    with pytest.raises(ArgumentError, match=r"'east' in row 22 of column 'location-long'"):
        read_tracks(write(tmp_path / "marked.csv", rows))


def test_the_refusal_of_a_window_names_the_option_of_the_step(run, tmp_path):
    write(tmp_path / "short.csv", pigeons(60))
    _, _, err = run("detect", tmp_path / "short.csv", *QUICK)
    assert err == "usnet: --window must be at most 59, the number of steps of 1 s in the tracks, got 100.\n"


def test_a_delay_that_is_shorter_than_the_step_is_warned_of():
    """At this step, noise hides the delay of 0.3 s of the follower, and only the turns show who leads."""
    rng = np.random.default_rng(1)
    rate = np.convolve(rng.normal(0, 0.15, 12_000), np.ones(20) / 20, "same")
    path = np.cumsum(np.stack([np.cos(np.cumsum(rate)), np.sin(np.cumsum(rate))], axis=1), axis=0)
    places = np.stack([path[6:], path[3:-3], path[:-6]], axis=1) + rng.normal(0, 3.0, (11_994, 3, 2))
    time, who = np.repeat(np.arange(11_994) * 0.1, 3), ["a", "b", "c"] * 11_994
    even = Tracks.from_samples(who, time, places.reshape(-1, 2)).resample()
    assert even.step > 0.6
    assert any("this delay is shorter than the step" in each for each in even.notes), even.notes


def test_a_bad_choice_of_spikes_is_refused(tmp_path):
    read = read_tracks(write(tmp_path / "tracks.csv", pigeons(30)))
    with pytest.raises(ArgumentError, match=r"^keep_spikes must be True or False"):
        read.resample(keep_spikes=1)

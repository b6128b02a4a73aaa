"""The files of ``usnet detect``: types, names and times that are hard to draw, and folders that were used before."""

import json

import numpy as np
import pytest
from track_files import example, rows_of, straight, write_csv

from usnet_env import Detection
from usnet_env.replay import EpisodeRecord, write_picture
from usnet_env.tracks import find_leaders, read_tracks

QUICK = ("--detector", "lagged-regression")


def flock(path, rename=str, shift=0.0, move=0.0, scale=1.0):
    """A flock of 12 ids in which the first one leads; ``shift`` seconds later, and ``move`` metres away."""
    rows = [[rename(name), t + shift, scale * x + move, scale * y] for name, t, x, y, _ in example().flock()]
    return write_csv(path, rows)


def leaderless(path):
    return write_csv(path, [row[:4] for row in example().leaderless()])


def test_a_folder_that_cannot_be_written_is_refused_before_the_work(run, tmp_path):
    tracks, taken = flock(tmp_path / "flock.csv"), tmp_path / "taken"
    taken.write_text("a file")
    for out in (taken, taken / "inside"):
        status, printed, err = run("detect", tracks, *QUICK, "--out", out)
        assert (status, printed) == (2, "")
        assert err.startswith("usnet: out must be a folder that can be written, got ")
    assert taken.read_text() == "a file"


def test_files_of_an_earlier_run_do_not_stay(run, tmp_path):
    out = tmp_path / "out"
    assert run("detect", flock(tmp_path / "flock.csv"), *QUICK, "--out", out, "--record")[0] == 0
    assert (out / "episode.npz").exists()
    assert run("detect", leaderless(tmp_path / "other.csv"), *QUICK, "--out", out)[0] == 0
    assert not [name for name in ("episode.npz", "replay.rrd") if (out / name).exists()]
    assert not [path.name for path in out.iterdir() if path.name.endswith(".lock")]


def test_parquet_files_with_and_without_leaders_have_the_same_schema(run, tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    for name, make in (("led", flock), ("not", leaderless)):
        assert run("detect", make(tmp_path / f"{name}.csv"), *QUICK, "--out", tmp_path / name)[0] == 0
    for table in ("windows", "leaders", "links"):
        both = [parquet.read_table(tmp_path / name / f"{table}.parquet") for name in ("led", "not")]
        assert both[0].schema == both[1].schema
        assert pyarrow.concat_tables(both).num_rows == both[0].num_rows + both[1].num_rows


@pytest.mark.parametrize("name", [r"$\foo$", "$x_{1$", "$5"])
def test_ids_with_dollar_signs_are_drawn(run, tmp_path, name):
    pytest.importorskip("matplotlib")
    tracks = flock(tmp_path / "$x_{1$.csv", rename=lambda each: f"{name}{each}")
    status, _, err = run("detect", tracks, *QUICK, "--out", tmp_path / "out")
    assert status == 0, err
    assert (tmp_path / "out" / "picture.png").exists()


def test_characters_without_a_glyph_are_one_sentence(run, tmp_path):
    pytest.importorskip("matplotlib")
    tracks = flock(tmp_path / "flock.csv", rename=lambda each: each.replace("bird-", "\u9e1f"))
    status, _, err = run("detect", tracks, *QUICK, "--out", tmp_path / "out")
    assert status == 0
    assert err.count("The fonts of this machine lack some characters of the figure") == 1
    assert "Glyph" not in err


def test_the_picture_has_the_coordinates_and_times_of_the_file(tmp_path):
    pytest.importorskip("matplotlib")
    from usnet_env.tracks.picture import draw_leaders

    tracks = read_tracks(flock(tmp_path / "flock.csv", shift=1_700_000_000.5, move=500_000.0)).resample()
    found = find_leaders(tracks, "lagged-regression")
    axes = draw_leaders(found, tracks.windows(), "flock.csv", tracks).axes[0]
    low, high = axes.get_xlim()
    places = [row[2] + 500_000.0 for row in example().flock() if row[1] <= 100]
    assert low < min(places) < max(places) < high
    assert axes.get_title(loc="left").startswith("1700000000.5 to 17000000")


@pytest.mark.parametrize("scale", [1.0, 1e-4])
def test_the_picture_of_recorded_tracks_names_no_missed_heads(run, tmp_path, scale):
    pytest.importorskip("matplotlib")
    from usnet_env.replay import draw_episode

    assert (
        run("detect", flock(tmp_path / "flock.csv", scale=scale), *QUICK, "--out", tmp_path / "out", "--record")[0] == 0
    )
    record = EpisodeRecord.load(tmp_path / "out" / "episode.npz")
    figure = draw_episode(record)
    legends = [text.get_text() for axes in figure.axes if axes.get_legend() for text in axes.get_legend().get_texts()]
    assert {"leader", "score of a leader"} <= set(legends)
    assert "head, not a candidate" not in legends
    first = figure.axes[0]
    seen = record.position[0][record.seen[0]]
    largest = max(np.ptp(record.position[r][record.seen[r]], axis=0).max() for r in range(len(record.position)))
    for axis, (low, high) in enumerate((first.get_xlim(), first.get_ylim())):
        assert low <= seen[:, axis].min()
        assert seen[:, axis].max() <= high
        assert high - low < 1.5 * largest
    assert write_picture(record, tmp_path / "episode.png").exists()


class Names:
    """A detector that names the first UAV, and says nothing about followers."""

    def reset(self, seed=None):
        pass

    def detect(self, window):
        candidates = np.arange(window.uavs) == 0
        return Detection(candidates, candidates * 1.0)


def test_a_detector_without_followers_has_no_confirmed_leaders(run, tmp_path):
    path = flock(tmp_path / "flock.csv")
    found = find_leaders(read_tracks(path), Names())
    assert not any(window.leaders for window in found.windows)
    assert {window.not_confirmed for window in found.windows} == {("bird-0",)}
    assert find_leaders(read_tracks(path), Names(), confirm=False).windows[0].leaders[0].id == "bird-0"
    _, out, err = run("detect", path, "--detector", "destroy-all", "--json")
    assert "the detector names no followers, so no leader is confirmed" in err
    assert not any(window["leaders"] for window in json.loads(out)["windows"])
    assert "names no followers" not in run("detect", path, "--detector", "destroy-all", "--unconfirmed")[2]


def test_ids_that_are_not_confirmed_are_named_beside_confirmed_leaders(run, tmp_path, monkeypatch):
    path = flock(tmp_path / "flock.csv")
    (tmp_path / "names_two.py").write_text(
        "import numpy as np\n"
        "from usnet_env import Detection\n"
        "class NamesTwo:\n"
        "    def reset(self, seed=None):\n"
        "        pass\n"
        "    def detect(self, window):\n"
        "        leader = np.where(np.arange(window.uavs) == 1, 1, 0)\n"
        "        return Detection(np.arange(window.uavs) < 2, np.zeros(window.uavs), leader=leader)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    code, out, _ = run("detect", path, "--detector", "names_two:NamesTwo")
    assert code == 0
    windows = json.loads(run("detect", path, "--detector", "names_two:NamesTwo", "--json")[1])["windows"]
    both = [window for window in windows if window["leaders"] and window["not_confirmed"] == ["bird-1"]]
    assert both
    assert out.count("Not confirmed: bird-1.") == sum("bird-1" in window["not_confirmed"] for window in windows)


def test_windows_that_are_too_short_for_the_test_are_named(run, tmp_path):
    path = flock(tmp_path / "flock.csv")
    for length, words in (("15", ()), ("15", ("--unconfirmed",)), ("16", ())):
        _, out, _ = run("detect", path, *QUICK, "--window", length, *words)
        assert ("too short for the test that confirms leaders" in out) == (length == "15" and not words)


def test_ids_that_are_all_sampled_unevenly_have_no_usual_rate(tmp_path):
    rng = np.random.default_rng(0)
    rows = rows_of(straight(steps=200, uavs=4))
    for k, row in enumerate(rows):
        row[1] += (0.2 + 0.1 * (k % 4)) * rng.random() + 0.1 * (k // 4) * (k % 4)
    sentences = [each.sentence for each in read_tracks(write_csv(tmp_path / "a.csv", rows)).report().warnings]
    assert any(sentence.startswith("The ids are sampled at different rates, every 0.") for sentence in sentences)
    assert not any("4 ids are sampled at another rate" in sentence for sentence in sentences)

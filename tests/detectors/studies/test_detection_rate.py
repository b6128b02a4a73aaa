"""Detection rates over a grid of cells: the same rows however they are made, and an interruption loses little."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from detectors import Detector
from detectors.studies import table2
from detectors.studies.table2 import Cell, Row, make_suite, make_tasks, play_games, rate_of
from usnet_env import ArgumentError, Detection, make_detector
from usnet_env.evaluation.suite import read_rows

HERE = __name__
SWARMS = [("f1", 2), ("f4", 5, 1)]  # follow strategy, followers, decoys
NAMES = ["lagged-regression(clusters=1)", "destroy-all"]


class Together(Detector):
    """Names a random UAV in each window; the draw depends on the whole batch."""

    side_by_side = True

    def detect_batch(self, windows):
        found = []
        for draw in self.rng.permutation(len(windows)):
            chosen = np.arange(windows[0].uavs) == draw % windows[0].uavs
            found.append(Detection(candidates=chosen, scores=chosen.astype(float), extras={"explained": len(windows)}))
        return found

    def detect(self, window):
        return self.detect_batch([window])[0]


class Apart(Together):
    """The same detector, but its answers do not depend on the batch."""

    side_by_side = False


def tasks(episodes=30, names=NAMES, swarms=SWARMS):
    return make_tasks([Cell(name, *swarm) for swarm in swarms for name in names], lambda cell: episodes)


def measure(games, seed, path, workers=1, progress=lambda done, total: None):
    return make_suite(seed).run(games, path, workers=workers, progress=progress)


def plain(rows):
    """Rows without what differs from run to run: the seconds, and NaN, which equals nothing."""
    return [replace(row, seconds=0.0, explained=0.0) for row in rows]


def test_batches_do_not_depend_on_how_many_episodes_are_asked_for():
    few, many = tasks(25), tasks(90)
    assert {task[0] for task in few} <= {task[0] for task in many}
    assert sum(map(len, few)) == 25 * 4


def test_rows_are_the_same_on_any_number_of_workers(tmp_path):
    one = measure(tasks(), 7, tmp_path / "one.csv", 1)
    two = measure(tasks(), 7, tmp_path / "two.csv", 2)
    assert plain(one) == plain(two)
    assert len(one) == 120


def test_another_seed_is_another_measurement(tmp_path):
    chance = tasks(60, ["random"])
    one, again, other = (
        [row.hit for row in measure(chance, seed, tmp_path / f"{number}.csv", 1)]
        for number, seed in enumerate((7, 7, 8))
    )
    assert one == again
    assert one != other


def test_a_hit_is_the_head_alone(tmp_path):
    rows = measure(tasks(10), 7, tmp_path / "rows.csv", 1)
    assert {row.hit for row in rows if row.detector == "destroy-all"} == {0}
    assert all(row.named for row in rows)
    n, interval = rate_of(row for row in rows if row.detector == NAMES[0] and row.follow == "f1")
    assert n == 10
    assert interval.mean == 1.0
    assert rate_of([]) is None


def test_an_interrupted_measurement_goes_on_without_repeating(tmp_path, monkeypatch):
    path = tmp_path / "rows.csv"
    played = []

    def stops(games, seed):
        if len(played) == 3:
            raise KeyboardInterrupt
        played.append(games)
        return play_games(games, seed)

    monkeypatch.setattr(table2, "play_games", stops)
    with pytest.raises(KeyboardInterrupt):
        measure(tasks(), 7, path, 1)
    kept = len(read_rows(path, Row))
    assert kept == sum(map(len, played))
    again = []
    monkeypatch.setattr(table2, "play_games", lambda games, seed: again.append(games) or play_games(games, seed))
    counted = []
    rows = measure(tasks(), 7, path, 1, lambda *count: counted.append(count))
    assert not [games for games in again if games in played]
    assert (counted[0], counted[-1]) == ((kept, 120), (120, 120))
    assert plain(rows) == plain(measure(tasks(), 7, tmp_path / "whole.csv", 1))


def test_rows_survive_the_file(tmp_path):
    rows = measure(tasks(5), 7, tmp_path / "rows.csv", 1)
    assert set(plain(read_rows(tmp_path / "rows.csv", Row))) == set(plain(rows))
    assert read_rows(tmp_path / "none.csv", Row) == []
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("text", ["something else\n1\n", "detector,follow\ngassl,f1\n", "\x00\n\x00"])
def test_another_file_is_refused(tmp_path, text):
    (tmp_path / "rows.csv").write_text(text, encoding="utf-8")
    with pytest.raises(
        ArgumentError, match=r"out must hold rows of this measurement, got something else in 'rows.csv'"
    ):
        read_rows(tmp_path / "rows.csv", Row)


def test_every_detector_meets_the_same_swarms(tmp_path):
    """Seeds of swarms depend on the cell and the episode, not on the detector; those of detectors differ from them."""
    here, there = (Cell(NAMES[0], *swarm) for swarm in SWARMS)
    seeds = [table2._make_seed(7, here, episode, 0) for episode in range(50)]
    assert seeds == [table2._make_seed(7, replace(here, detector=NAMES[1]), episode, 0) for episode in range(50)]
    assert len(set(seeds)) == 50
    assert not set(seeds) & {table2._make_seed(7, here, episode, 1) for episode in range(50)}
    assert not set(seeds) & {table2._make_seed(7, there, episode, 0) for episode in range(50)}


def test_a_fit_s_explained_share_is_kept(tmp_path):
    small = "gassl(steps=3)"
    rows = measure(tasks(3, [small], SWARMS[:1]), 7, tmp_path / "rows.csv", 1)
    assert np.isfinite([row.explained for row in rows]).all()
    with (tmp_path / "rows.csv").open(encoding="utf-8", newline="") as file:
        assert {row["detector"] for row in csv.DictReader(file)} == {small}


def test_a_detector_that_is_side_by_side_gets_batches_which_its_rows_record(tmp_path):
    # 3 UAVs: 64 // 3 = 21 windows in a batch
    rows = measure(tasks(50, [f"{HERE}:Together"], [("f1", 2)]), 7, tmp_path / "rows.csv", 1)
    assert [row.episode for row in rows] == list(range(50))
    assert [row.batch for row in rows] == ["0+21"] * 21 + ["21+21"] * 21 + ["42+8"] * 8
    assert [row.explained for row in rows] == [float(row.batch.partition("+")[2]) for row in rows]
    assert {row.batch for row in read_rows(tmp_path / "rows.csv", Row)} == {"0+21", "21+21", "42+8"}


def test_any_other_detector_answers_each_episode_alone(tmp_path):
    names = [f"{HERE}:Apart", "random"]
    rows = measure(tasks(25, names, [("f1", 2)]), 7, tmp_path / "rows.csv", 1)
    assert [row.batch for row in rows] == [f"{episode}+1" for episode in range(25)] * 2
    assert {row.explained for row in rows if row.detector == names[0]} == {1.0}


def test_answers_do_not_depend_on_how_many_episodes_are_asked_for(tmp_path):
    """That of a detector that is side_by_side may, in the last batch, which its rows show."""
    names = ["random", "gassl(steps=2)", f"{HERE}:Together"]

    def answers(episodes):
        rows = measure(tasks(episodes, names, [("f1", 20)]), 7, tmp_path / f"{episodes}.csv", 1)
        return {(row.detector, row.episode): (row.hit, row.named, row.explained, row.batch) for row in rows}

    few, many = answers(4), answers(11)
    different = {key for key in few if repr(few[key]) != repr(many[key])}
    assert different == {(names[2], 3)}
    assert (few[names[2], 3][-1], many[names[2], 3][-1]) == ("3+1", "3+3")


def test_the_detectors_that_train_windows_together_say_so():
    found = {name: getattr(make_detector(name), "side_by_side", False) for name in table2.DETECTORS}
    assert found == {"gassl": False, "neural-granger": True, "lagged-regression(clusters=1)": False}

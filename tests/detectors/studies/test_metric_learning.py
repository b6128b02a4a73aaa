"""The paper's figures of metric learning: rows, bands, table and pictures."""

import numpy as np
import pytest
from scipy import stats

from detectors.studies import metric_learning
from detectors.studies.common import FOLLOW
from detectors.studies.metric_learning import Row, collect_curves, compute_interval, report_losses
from usnet_env import ArgumentError

SMALL = {"trainings": 2, "strategies": 1, "episodes": 3, "steps": 2}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("losses")
    return folder, metric_learning.reproduce(folder, **SMALL, seed=7).rows


def test_every_start_has_its_losses(made):
    folder, rows = made
    assert {row.start for row in rows} == set(metric_learning.STARTS)
    for start, offline in (("random", 0), ("joint", 3), ("meta", 3)):
        for training in range(2):
            mine = [row for row in rows if (row.start, row.training) == (start, training)]
            assert sum(row.follow == "" for row in mine) == offline
            assert sorted((row.follow, row.step) for row in mine if row.follow) == [
                (follow, step) for follow in FOLLOW for step in range(2)
            ]
    assert all(np.isfinite(row.loss) and row.loss >= 0 for row in rows)
    assert {path.suffix for path in folder.iterdir()} == {".csv", ".md", ".png"}
    first = {(row.start, row.training): row.loss for row in rows if row.follow == "f1" and row.step == 0}
    assert len(set(first.values())) == 6, "starts and trainings differ"


def test_it_goes_on_where_it_stopped(made, tmp_path):
    folder, rows = made
    name = next(path.name for path in folder.iterdir() if path.suffix == ".csv")
    whole = (folder / name).read_text().splitlines(keepends=True)
    (tmp_path / name).write_text("".join(whole[: len(whole) // 2]))
    again = metric_learning.reproduce(tmp_path, **SMALL, seed=7).rows
    assert [row.loss for row in again] == pytest.approx([row.loss for row in rows], abs=6e-5)  # four digits are kept
    assert (tmp_path / name).read_text().splitlines(keepends=True) == whole


def test_curves_and_intervals_are_over_strategies_and_trainings():
    rows = [
        Row(training, "meta", follow, step=step, loss=10.0 * training + step + bonus)
        for training in range(3)
        for follow, bonus in (("f1", 0.0), ("f2", 1.0))
        for step in range(2)
    ]
    values = collect_curves(rows, "meta", True)
    np.testing.assert_allclose(values, [[0.5, 1.5], [10.5, 11.5], [20.5, 21.5]])
    assert not len(collect_curves(rows, "meta", False))
    mean, half = compute_interval(values)
    np.testing.assert_allclose(mean, [10.5, 11.5])
    low, high = stats.t.interval(0.95, 2, loc=10.5, scale=stats.sem(values[:, 0]))
    np.testing.assert_allclose([mean[0] - half[0], mean[0] + half[0]], [low, high])


def test_the_table_names_every_start_and_the_difference(made):
    text = report_losses(made[1])
    assert [line.split(" | ")[0] for line in text.splitlines()[2:5]] == ["| random", "| joint", "| meta"]
    assert "Meta minus joint" in text


def test_one_training_has_no_interval(tmp_path):
    with pytest.raises(ArgumentError, match="trainings must be at least 2"):
        metric_learning.reproduce(tmp_path, **{**SMALL, "trainings": 1})


def test_losses_are_drawn_off_line_and_on_line(made):
    figure = metric_learning.draw_losses(made[1])
    offline, online = figure.axes
    assert len(offline.lines) == 2 + 1  # joint, meta, and the paper's value
    assert len(online.lines) == 3
    values = collect_curves(made[1], "random", True).mean(axis=0)
    np.testing.assert_allclose(online.lines[0].get_ydata(), values)


def test_the_feature_space_is_drawn_before_and_after_training():
    figure = metric_learning.draw_feature_spaces(seed=3, follow="f3", clusters=3, uavs=24, steps=2)
    assert len(figure.axes) == 4
    titles = [axes.get_title() for axes in figure.axes]
    assert [title.partition("\n")[0] for title in titles] == [
        f"{start}, {when}"
        for start in ("random start", "meta-learned start")
        for when in ("before", "after 2 episodes")
    ]
    for axes in figure.axes:
        points = [len(collection.get_offsets()) for collection in axes.collections]
        assert sum(points) == 24
        assert "principal component 1" in axes.get_xlabel()
    before, after = (figure.axes[k].collections[0].get_offsets() for k in (0, 1))
    assert not np.allclose(before, after)

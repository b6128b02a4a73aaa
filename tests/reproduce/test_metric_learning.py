"""The paper's figures of metric learning: rows, bands, table and pictures."""

import numpy as np
import pytest
from scipy import stats

from usnet_env import ArgumentError
from usnet_env.reproduce import metric_learning
from usnet_env.reproduce.metric_learning import Row, band, curves, markdown

SMALL = {"trainings": 2, "strategies": 1, "episodes": 3, "steps": 2}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("losses")
    return folder, metric_learning.losses(folder, **SMALL, seed=7)


def test_every_start_has_its_losses(made):
    folder, rows = made
    assert {row.start for row in rows} == set(metric_learning.STARTS)
    for start, offline in (("random", 0), ("joint", 3), ("meta", 3)):
        for training in range(2):
            mine = [row for row in rows if (row.start, row.training) == (start, training)]
            assert sum(row.follow == "" for row in mine) == offline
            assert sorted((row.follow, row.step) for row in mine if row.follow) == [
                (follow, step) for follow in metric_learning.FOLLOW for step in range(2)
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
    again = metric_learning.losses(tmp_path, **SMALL, seed=7)
    assert [row.loss for row in again] == pytest.approx([row.loss for row in rows], abs=6e-5)  # four digits are kept
    assert (tmp_path / name).read_text().splitlines(keepends=True) == whole


def test_curves_and_bands_are_means_over_strategies_and_trainings():
    rows = [
        Row(training, "meta", follow, step, 10.0 * training + step + bonus)
        for training in range(3)
        for follow, bonus in (("f1", 0.0), ("f2", 1.0))
        for step in range(2)
    ]
    values = curves(rows, "meta", True)
    np.testing.assert_allclose(values, [[0.5, 1.5], [10.5, 11.5], [20.5, 21.5]])
    assert not len(curves(rows, "meta", False))
    mean, half = band(values)
    np.testing.assert_allclose(mean, [10.5, 11.5])
    low, high = stats.t.interval(0.95, 2, loc=10.5, scale=stats.sem(values[:, 0]))
    np.testing.assert_allclose([mean[0] - half[0], mean[0] + half[0]], [low, high])


def test_the_table_names_every_start_and_the_difference(made):
    text = markdown(made[1])
    assert [line.split(" | ")[0] for line in text.splitlines()[2:5]] == ["| random", "| joint", "| meta"]
    assert "Meta less joint" in text


def test_one_training_has_no_band(tmp_path):
    with pytest.raises(ArgumentError, match="trainings must be at least 2"):
        metric_learning.losses(tmp_path, **{**SMALL, "trainings": 1})


def test_the_feature_space_is_drawn(tmp_path):
    path = metric_learning.features(tmp_path, seed=3, follow="f3", steps=2)
    assert path.read_bytes()[:4] == b"\x89PNG"
    assert path.stat().st_size > 10_000

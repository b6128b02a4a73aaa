"""Which of the benchmarks' follow strategies a feature class of follow-mixture contains."""

import csv

import follow_mixture_strategies as named
import numpy as np
import pytest
import strategy_classes


def test_every_strategy_is_in_one_group() -> None:
    groups = (named.IN_A_CLASS, named.OUTSIDE_CLASSES)
    assert sorted(name for group in groups for name in group) == sorted(named.STRATEGIES)


@pytest.mark.parametrize("name", named.STRATEGIES)
def test_strategies_outside_the_classes_are_outside(name: str) -> None:
    rows = strategy_classes.measure(name)
    assert strategy_classes.contained(rows) == (name in named.IN_A_CLASS)
    with strategy_classes.FILE.open(newline="", encoding="utf-8") as file:
        recorded = [row for row in csv.DictReader(file) if row["strategy"] == name]
    for row, known in zip(rows, recorded, strict=True):
        assert row["class"] == known["class"]
        for kind in ("r2_shared", "r2_each"):
            assert float(row[kind]) == pytest.approx(float(known[kind]), abs=1e-3)


@pytest.mark.parametrize(("name", "library"), [("f1", "v(1)"), ("f3", "v(L)"), ("f5", "v²(L)")])
def test_the_paper_s_strategies_are_in_their_class(name: str, library: str) -> None:
    (row,) = (row for row in strategy_classes.measure(name) if row["class"] == library)
    assert float(row["r2_shared"]) > strategy_classes.CONTAINED


def test_noise_is_not_explained() -> None:
    rng = np.random.default_rng(0)
    features, direction = rng.standard_normal((500, 7)), rng.standard_normal((500, 3))
    assert strategy_classes.explained(features, direction) < 0.1
    assert strategy_classes.explained(features, features @ rng.standard_normal((7, 3))) == pytest.approx(1.0)
    assert strategy_classes.explained(features, features[:, :3] + direction) == pytest.approx(0.5, abs=0.05)

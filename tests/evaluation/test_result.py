"""Tables, comparisons and aggregates of an evaluation."""

from __future__ import annotations

import io

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from usnet_env import ArgumentError
from usnet_env.evaluation import EvaluationResult
from usnet_env.evaluation.folder import COLUMNS
from usnet_env.evaluation.stats import mean_interval, paired_test


def from_values(cell="USNET/Made-v0", config=None, **values):
    """A result whose detectors have these values of J, episode by episode; ``None``: failed."""
    rows = [
        dict.fromkeys(COLUMNS, 0.0 if value is not None else None)
        | {"cell": cell, "detector": name, "episode": episode, "swarm_seed": 100 + episode, "J": value}
        | {"detector_seed": 0, "uavs": 9, "heads": 3, "error": "" if value is not None else "round 1: no luck"}
        for name, found in values.items()
        for episode, value in enumerate(found)
    ]
    return EvaluationResult(pd.DataFrame(rows, columns=COLUMNS), {"cells": {cell: {}}, "seed": 0} | (config or {}))


def show(table, width=80):
    console = Console(width=width, file=io.StringIO())
    console.print(table)
    return console.file.getvalue()


def test_the_ranking_points_to_the_better_values_of_each_problem():
    text = show(from_values(a=[1.0, 1.0]).ranking())
    assert "J_m↓" in text
    text = show(from_values(a=[-2.0, -2.0], b=[-1.0, -1.0]).ranking())
    assert "J_s↑" in text
    assert text.index("\nb ") < text.index("\na ")


def test_a_detector_that_failed_comes_last_in_its_table_and_is_named():
    result = from_values(a=[1.0, None], b=[2.0, 3.0], c=[None, None])
    assert [(entry["episodes"], entry["failed"]) for entry in result.summary] == [(1, 1), (2, 0), (0, 2)]
    text = show(result.ranking())
    assert text.index("\nb ") < text.index("\na ") < text.index("\nc ")
    assert "failed" in text
    assert result.failures["a"] == (
        "detector 'a' failed in 1 of 2 episodes, first in USNET/Made-v0, episode 1, round 1: no luck."
    )
    assert "| c | 0 | 2 | – |" in result.to_markdown(["J"])


def test_markdown_holds_the_means_and_intervals():
    result = from_values(**{"a|b": [2.0, 2.0], "c_d(x=1)": [3.0, 3.0]})
    assert result.to_markdown(["J", "success"]) == (
        "| detector | episodes | J_m↓ | success↑ |\n"
        "| --- | ---: | ---: | ---: |\n"
        "| a\\|b | 2 | 2.000 | 0.000 (0.000 to 0.658) |\n"
        "| c_d(x=1) | 2 | 3.000 | 0.000 (0.000 to 0.658) |\n"
    )


def test_labels_are_no_markup_and_control_no_terminal():
    result = from_values(**{"[/red]": [1.0], "a\x1b[2J": [2.0, None]})
    for table in (result.ranking(), result.table(), result.table("J")):
        text = show(table)
        assert "[/red]" in text
        assert "\x1b[2J" not in text
    for text in (*result.failures.values(), result.to_markdown("J")):
        assert "\x1b" not in text


def test_a_comparison_pairs_the_episodes_that_both_have_played():
    rng = np.random.default_rng(0)
    swarm = rng.normal(5, 3, 40)  # differs much more between swarms than between detectors
    values = {"a": swarm, "b": swarm + rng.normal(0.5, 0.2, 40), "c": swarm + rng.normal(0, 0.2, 40)}
    result = from_values(a=[*values["a"], 1.0], b=values["b"], c=[*values["c"][:-1], None])
    found = result.compare("a", "b")
    differences = values["a"] - values["b"]
    assert (found.a, found.b, found.metric, found.episodes, found.comparisons) == ("a", "b", "J", 40, 1)
    assert (found.difference, found.low, found.high) == pytest.approx(mean_interval(differences))
    assert found.p == paired_test(differences) == pytest.approx(2e-4)
    assert str(found).startswith(f"J of a minus b: {found.difference:+.4g} (95 % interval ")
    several = result.compare("a")
    assert [(each.b, each.episodes, each.comparisons) for each in several] == [("b", 40, 2), ("c", 39, 2)]
    assert several[0].low < found.low < found.high < several[0].high
    assert several[0].p == pytest.approx(4e-4)
    assert several[1].low < 0 < several[1].high
    assert result.compare("a", ["b", "c"]) == several
    assert str(from_values(a=[2.0], b=[3.0]).compare("a", "b")) == "J of a minus b: -1 (p = 1) over 1 episode"


@pytest.mark.parametrize(
    ("argument", "given"),
    [("detector", ("a", "z")), ("detector", ("z",)), ("metric", ("a", "b", "j")), ("b", ("a", "c"))],
)
def test_what_cannot_be_compared_is_refused(argument, given):
    with pytest.raises(ArgumentError, match=rf"^{argument} must"):
        from_values(a=[1.0, None], b=[2.0, 1.0], c=[None, 1.0]).compare(*given)


def test_results_of_two_folders_are_merged_and_compared():
    first, second = from_values(a=[1.0, 2.0, 3.0]), from_values(b=[2.0, 2.0])
    both = first.merge(second)
    assert [(entry["detector"], entry["episodes"]) for entry in both.summary] == [("a", 3), ("b", 2)]
    assert both.compare("a", "b").difference == -0.5
    strange = from_values(b=[2.0, 2.0])
    strange.rows.loc[1, "swarm_seed"] = 7
    for other, word in (
        (strange, "swarm"),
        (from_values(a=[1.0]), "labels"),
        (from_values(cell="E", b=[1.0]), "cells"),
        (from_values(config={"seed": 1}, b=[1.0]), "seed"),
        (3, "EvaluationResult"),
    ):
        with pytest.raises(ArgumentError, match=rf"^other must .*{word}"):
            first.merge(other)
    with pytest.raises(ArgumentError, match=r"^detector must"):
        both["x"]


def test_cells_with_the_same_swarms_do_not_narrow_an_interval():
    rng = np.random.default_rng(0)
    values = {name: rng.normal(5, 2, 20).tolist() for name in "ab"}
    one = from_values(**values)
    cells = [from_values(cell, **values).rows for cell in ("USNET/Made-v0", "other", "third")]
    three = EvaluationResult(pd.concat(cells, ignore_index=True), {})
    assert three["a"]["J"] == pytest.approx(one["a"]["J"])
    lone, found = one.compare("a", "b"), three.compare("a", "b")
    assert (found.low, found.high, found.p) == pytest.approx((lone.low, lone.high, lone.p))


def test_aggregates_take_each_cell_as_a_stratum():
    first, second = from_values(a=[1.0, 2.0, 3.0, 40.0], b=[5.0] * 4), from_values("other", a=[2.0] * 4, b=[5.0] * 4)
    rows = pd.concat([first.rows, second.rows], ignore_index=True)
    both = EvaluationResult(rows, {"cells": {"USNET/Made-v0": {}, "other": {}}})
    lines = both.to_markdown("J").splitlines()
    assert lines[0] == "| J_m↓ | a | b |"
    assert lines[-2:] == ["| other | 2.000 | 5.000 |", lines[-1]]
    assert lines[-1].startswith("| all cells | 6.750 (")
    with pytest.raises(ArgumentError, match=r"^metrics must"):
        both.to_markdown("j")


def test_cells_that_were_drawn_at_random_are_the_unit_of_intervals():
    """A law is found nearly always or never, so 4 laws of 30 swarms tell less than 120 swarms."""
    values = {"easy": 1.0, "plain": 1.0, "fair": 1.0, "hard": 0.0}
    parts = [from_values(name, a=[value] * 29 + [0.5], b=[0.5] * 30).rows for name, value in values.items()]
    rows = pd.concat(parts, ignore_index=True)
    rows["exact"] = rows["J"].round()
    drawn, fixed = (EvaluationResult(rows, {"unit": unit}) for unit in ("cell", "swarm"))
    for metric in ("J", "exact"):
        wide, narrow = drawn["a"][metric], fixed["a"][metric]
        assert wide["mean"] == pytest.approx(narrow["mean"])
        assert wide["high"] - wide["low"] > 3 * (narrow["high"] - narrow["low"])
    assert fixed["a"]["J"]["high"] - fixed["a"]["J"]["low"] < 0.05  # but for one, each seed has the same mean
    wide, narrow = (result.compare("a", "b") for result in (drawn, fixed))
    assert narrow.high - narrow.low < 0.05
    assert narrow.p < 0.001 < 0.6 < wide.p
    assert wide.low < 0 < narrow.low
    lines, others = (result.to_markdown("J").splitlines() for result in (drawn, fixed))
    assert lines[2:-1] == others[2:-1]  # within a cell, the swarm is what was drawn
    assert lines[-1] != others[-1]

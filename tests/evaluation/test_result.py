"""Tables, comparisons and aggregates of an evaluation; intervals and tests against slow references."""

import io

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from scipy.stats import binomtest

from usnet_env import ArgumentError
from usnet_env.evaluation import EvaluationResult, stats
from usnet_env.evaluation.folder import COLUMNS
from usnet_env.evaluation.stats import holm, mean_interval, paired_test, rate_interval


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
    sentence = "detector 'a' failed in 1 of 2 episodes, first in USNET/Made-v0, episode 1, round 1: no luck."
    assert result.failures["a"] == sentence
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
    result = from_values(a=[1.0, None], b=[2.0, 1.0], c=[None, 1.0])
    with pytest.raises(ArgumentError, match=rf"^{argument} must"):
        result.compare(*given)
    with pytest.warns(UserWarning, match=r"^c is left out: it has no episode with J in common with a\.$"):
        assert result.compare("a") == [result.compare("a", "b")]


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


def test_wilson_is_scipy_s():
    for n in (1, 2, 7, 60, 1001):
        for hits in {0, 1, n // 3, n - 1, n}:
            theirs = binomtest(hits, n).proportion_ci(0.95, method="wilson")
            ours = rate_interval([1] * hits + [0] * (n - hits))
            assert ours[1:] == pytest.approx(tuple(theirs), rel=1e-12, abs=1e-15)


@pytest.mark.parametrize(("level", "low", "high"), [(0.95, 0.860, 1.403), (0.99, 0.793, 1.523)])
def test_the_interval_of_a_mean_is_that_of_the_bca_bootstrap(level, low, high):
    """Of 200,000 resamplings in loops (Efron and Tibshirani, 1993, chapter 14.3), at Hesterberg's level."""
    sample = np.random.default_rng(3).exponential(size=60)
    ours = mean_interval(sample, confidence=level)
    assert ours == pytest.approx((sample.mean(), low, high), abs=0.01)
    assert mean_interval(sample, confidence=level) == ours


def test_the_interval_of_a_large_sample_is_the_limit_of_the_bootstrap(monkeypatch):
    sample = np.random.default_rng(4).exponential(size=5_001)
    computed = mean_interval(sample)
    assert computed.high - computed.low == pytest.approx(2 * 1.96 * sample.std() / np.sqrt(5_001), rel=1e-3)
    monkeypatch.setattr(stats, "_MAX_RESAMPLED", len(sample))
    monkeypatch.setattr(stats, "_RESAMPLES", 2_000)
    drawn = mean_interval(sample)
    width = drawn.high - drawn.low
    assert computed.mean == drawn.mean
    assert computed.low == pytest.approx(drawn.low, abs=0.1 * width)
    assert computed.high == pytest.approx(drawn.high, abs=0.1 * width)


def test_the_interval_covers_the_mean_as_often_as_it_says(monkeypatch):
    """Also of few values: the plain bootstrap interval covers 82 % with 5."""
    monkeypatch.setattr(stats, "_RESAMPLES", 1_000)
    rng = np.random.default_rng(5)
    intervals = [mean_interval(rng.normal(size=5)) for _ in range(1_000)]
    assert 0.90 <= np.mean([interval.low <= 0 <= interval.high for interval in intervals]) <= 0.98


def test_intervals_of_groups_hold_where_those_of_single_values_are_too_narrow(monkeypatch):
    """30 groups of 20: the rate of a group is uniform, so that values of one group are alike; the true rate is 1/2."""
    monkeypatch.setattr(stats, "_RESAMPLES", 500)
    rng, groups = np.random.default_rng(0), np.repeat(np.arange(30), 20)
    held = np.zeros(3)
    for _ in range(200):
        values = (rng.random(600) < rng.random(30)[groups]).astype(float)
        found = rate_interval(values, groups), mean_interval(values, groups=groups), rate_interval(values)
        held += [interval.low <= 0.5 <= interval.high for interval in found]
    assert (held[:2] / 200 > 0.89).all()
    assert held[2] / 200 < 0.7


def test_groups_of_one_and_independent_values_change_nothing():
    values = (np.random.default_rng(1).random(200) < 0.3).astype(float)
    assert rate_interval(values, np.arange(200)[::-1]) == rate_interval(values)
    assert mean_interval(values, groups=np.arange(200)[::-1]) == mean_interval(values)
    alike = rate_interval(values, np.arange(200) // 4)  # groups by chance
    assert alike.high - alike.low < 1.4 * (rate_interval(values).high - rate_interval(values).low)
    assert rate_interval(np.ones(60), np.arange(60) % 6) == rate_interval(np.ones(6))  # a group counts as one value


@given(st.floats(-1e6, 1e6), st.lists(st.integers(1, 6), min_size=1, max_size=8))
def test_equal_values_in_groups_of_several_sizes_have_no_interval(value, sizes):
    groups = np.repeat(np.arange(len(sizes)), sizes)
    assert mean_interval([value] * len(groups), groups=groups) == (value, value, value)


@given(st.lists(st.integers(-3, 3), min_size=1, max_size=10))
def test_the_p_value_of_few_differences_is_exact(differences):
    sums = np.array([0])
    for each in differences:
        sums = np.concatenate([sums + each, sums - each])
    assert paired_test(differences) == pytest.approx(np.mean(np.abs(sums) >= abs(sum(differences))))


@pytest.mark.parametrize("shift", [0.0, 0.4])
def test_the_p_value_of_many_differences_is_that_of_random_signs(shift, monkeypatch):
    sample = np.random.default_rng(5).normal(shift, 1.0, 30)
    signs = np.random.default_rng(2).choice([-1.0, 1.0], size=(20_000, 30))
    slow = (np.abs(signs @ sample) >= abs(sample.sum())).mean()
    assert paired_test(sample) == pytest.approx(slow, abs=0.02)
    assert paired_test(-sample) == pytest.approx(paired_test(sample), abs=0.02)
    many = np.random.default_rng(6).normal(shift / 20, 1.0, 5_001)
    limit = paired_test(many)
    monkeypatch.setattr(stats, "_MAX_RESAMPLED", 5_001)
    monkeypatch.setattr(stats, "_RESAMPLES", 2_000)
    assert paired_test(many) == pytest.approx(limit, abs=0.04)


def test_no_p_value_is_zero_and_those_of_no_difference_and_of_one_are_one():
    assert paired_test(np.arange(1, 60)) == pytest.approx(2 / 10_000)  # as large as one of 9,999 and itself, two sides
    assert paired_test([0.0, 0.0]) == paired_test([2.0]) == 1.0
    assert paired_test([1.0, 1.0]) == 0.5  # two of four sign changes are as large


def test_holm_is_its_definition():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert (holm([0.7, 0.6]), holm([])) == ([1.0, 1.0], [])

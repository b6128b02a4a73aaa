"""Tables, comparisons and aggregates of an evaluation."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest
from rich.console import Console

from usnet_env import ArgumentError
from usnet_env.evaluation import METRICS, EvaluationResult, interquartile_means, performance_profiles
from usnet_env.evaluation.result import summarise
from usnet_env.evaluation.statistics import mean_interval, paired_test
from usnet_env.evaluation.store import COLUMNS
from usnet_env.evaluation.table import RowTable


def made_up(**objectives):
    """A result in which each detector has the mean, low and high of J that is given."""
    metrics = {name: {"mean": 0.5, "low": 0.5, "high": 0.5} for name in METRICS}
    summary = [
        {
            "detector": name,
            "episodes": 7,
            "metrics": metrics | {"J": dict(zip(("mean", "low", "high"), j, strict=True))},
        }
        for name, j in objectives.items()
    ]
    return EvaluationResult([], summary, {"env": "USNET/Made-v0"})


@pytest.mark.parametrize(
    ("objectives", "sentence"),
    [
        (
            {"a": (2.0, 1.5, 2.5), "b": (1.02, 1.0, 1.04)},
            "b has the lowest J_m: 1.020 (95 % interval 1.000–1.040).",
        ),
        (
            {"a": (2.0, 1.5, 2.5), "b": (1.8, 1.7, 1.9), "c": (9, 9, 9)},
            "b has the lowest J_m: 1.800 (95 % interval 1.700–1.900), which overlaps with the interval of a.",
        ),
        ({"a": (1, 1, 1), "b": (1, 1, 1), "c": (3, 2, 4)}, "a and b have the lowest J_m: 1.000 in every episode."),
        ({"a": (-1, -1, -1), "b": (0, 0, 0)}, "b has the highest J_s: 0.000 in every episode."),
        ({"a": (12.345, 11, 13)}, "a has a J_m of 12.35 (95 % interval 11.00–13.00)."),
    ],
)
def test_the_conclusion_names_the_best_and_what_the_episodes_do_not_separate(objectives, sentence):
    assert made_up(**objectives).conclusion() == sentence


def test_the_ranking_points_to_the_better_values_of_each_problem():
    def headings(result):
        return [str(column.header) for column in result.ranking().columns]

    assert headings(made_up(a=(1, 1, 1)))[1].startswith("J_m↓")
    single = made_up(a=(-2, -2, -2), b=(-1, -1, -1)).ranking()
    assert str(single.columns[1].header).startswith("J_s↑")
    assert [str(cell) for cell in single.columns[0].cells] == ["b", "a"]


def from_values(env="USNET/Made-v0", **values):
    """A result whose detectors have these values of J, episode by episode; ``None``: not played."""
    rows = RowTable(
        COLUMNS,
        [
            dict.fromkeys(COLUMNS, 0) | {"detector": name, "episode": episode, "swarm_seed": 100 + episode, "J": value}
            for name, own in values.items()
            for episode, value in enumerate(own)
            if value is not None
        ],
    )
    return EvaluationResult(rows, summarise(rows), {"env": env})


def test_the_repr_is_a_line_and_html_is_escaped():
    result = from_values(**{"a<b>": [1.0, 2.0], "c": [3.0, 4.0]})
    assert repr(result) == "<EvaluationResult of USNET/Made-v0: 2 detectors, 2 episodes each>"
    html = result._repr_html_()
    assert html.startswith("<table><caption>USNET/Made-v0: 2 detectors")
    assert html.index("a&lt;b&gt;") < html.index("<td>c</td>")
    assert "a<b>" not in html
    assert (
        EvaluationResult(RowTable(COLUMNS), [], {"env": "E"})._repr_html_() == "<p>E: 0 detectors, 0 episodes each</p>"
    )


def test_a_run_that_was_interrupted_says_how_many_episodes_are_missing():
    found = from_values(a=[1.0, 2.0], b=[1.0, None], c=[4.0, 5.0])
    config = {**found.config, "detectors": ["a", "b", "c", "d", "e"], "episodes": 3000, "failures": {"e": "e failed."}}
    result = EvaluationResult(found.rows, found.summary, config)
    assert repr(result).endswith(": 3 detectors, 1 to 2 of 3000 episodes each; 1 failed>")
    assert str(result.ranking().title).startswith("USNET/Made-v0, 1 to 2 of 3000 episodes of each detector")
    sentence = "<p>Episodes are missing: a has 2, b has 1, c has 2 and d has 0 of 3000.</p>"
    assert sentence in result._repr_html_()
    whole = EvaluationResult(found.rows, found.summary, {**config, "detectors": ["a", "c"], "episodes": 2})
    assert "missing" not in whole._repr_html_()
    assert "1 to 2 episodes each" in repr(whole)


def test_markdown_and_latex_hold_the_means_and_intervals():
    result = from_values(**{"a|b": [2.0, 2.0], "c_d(x=1)": [3.0, 3.0]})
    assert result.to_markdown(["J", "success"]) == (
        "| detector | episodes | J_m↓ | success↑ |\n"
        "| --- | ---: | ---: | ---: |\n"
        "| a\\|b | 2 | 2.000 | 0.000 (0.000 to 0.658) |\n"
        "| c_d(x=1) | 2 | 3.000 | 0.000 (0.000 to 0.658) |\n"
    )
    assert result.to_latex(["J"]).splitlines() == [
        r"\begin{tabular}{lrr}",
        r"\toprule",
        r"detector & episodes & J\_m$\downarrow$ \\",
        r"\midrule",
        r"a\textbar{}b & 2 & $2.000$ \\",
        r"c\_d(x=1) & 2 & $3.000$ \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]
    assert (
        from_values(a=[0, 9e-5])
        .to_latex(["J"])
        .splitlines()[4]
        .endswith(r"$4.5 \cdot 10^{-5}$ ($0.000$ to $9 \cdot 10^{-5}$) \\")
    )
    assert len(result.to_markdown().splitlines()[0].split("|")) == 2 + 2 + len(METRICS)
    with pytest.raises(ArgumentError, match=r"^metrics must be one of .*'j'"):
        result.to_markdown(["j"])


@pytest.mark.parametrize("width", [60, 80, 120])
def test_no_table_is_cut_or_breaks_a_name_where_the_terminal_is_narrow(width):
    labels = ["one-per-round", "lagged-regression"]
    metrics = {name: {"mean": 99.123, "low": 98.876, "high": 99.5} for name in METRICS}
    summary = [{"detector": label, "episodes": 100, "metrics": metrics} for label in labels]
    result = EvaluationResult(RowTable(COLUMNS), summary, {"env": "USNET/Made-v0"})
    for table, values in ((result.table(), len(METRICS)), (result.ranking(), 1)):
        console = Console(width=width, file=io.StringIO())
        console.print(table)
        text = console.file.getvalue()
        assert "…" not in text
        assert text.count("98.88") + text.count("98.876") == 2 * values
        parts = text.count("detector ")
        assert [text.count(label) for label in labels] == [parts, parts]
        assert max(map(len, text.splitlines())) <= width


def test_a_mean_of_equal_values_has_no_interval_and_the_objective_its_name_in_every_format():
    result = from_values(a=[-2.0, -2.0])
    found = [result.to_markdown(["J"]), result.to_latex(["J"]), result._repr_html_()]
    for table in (result.table(["J"]), result.ranking()):
        with (console := Console(width=80)).capture() as captured:
            console.print(table)
        found.append(captured.get())
    for text in found:
        assert "J_s" in text.replace("\\_", "_")
        assert "↑" in text or r"\uparrow" in text
        assert text.count("-2.000") == (2 if "every episode" in text else 1)


def test_a_result_is_read_as_a_mapping_of_labels_to_metrics():
    result = from_values(a=[1.0, 2.0], b=[3.0, 3.0])
    assert list(result) == ["a", "b"]
    assert ("a" in result, "x" in result, 0 in result) == (True, False, False)
    assert len(result) == 2
    for kind in (KeyError, ArgumentError):
        with pytest.raises(kind) as refused:
            result["x"]
        assert str(refused.value) == "detector must be one of a, b, got 'x'."


def test_a_frame_has_a_row_for_each_episode(monkeypatch):
    pytest.importorskip("pandas")
    result = from_values(a=[1.0, 2.0], b=[3.0])
    frame = result.to_frame()
    assert list(frame.columns) == list(COLUMNS)
    assert frame.groupby("detector")["J"].mean().to_dict() == {"a": 1.5, "b": 3.0}
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ArgumentError, match=r"^to_frame must find pandas, .*`pip install pandas`"):
        result.to_frame()


def test_a_comparison_pairs_the_episodes_that_both_have_played():
    rng = np.random.default_rng(0)
    swarm = rng.normal(5, 3, 40)  # differs much more between swarms than between detectors
    values = {"a": swarm, "b": swarm + rng.normal(0.5, 0.2, 40), "c": swarm + rng.normal(0, 0.2, 40)}
    result = from_values(a=[*values["a"], 1.0], b=values["b"], c=[*values["c"][:-1], None])
    found = result.compare("a", "b")
    differences = values["a"] - values["b"]
    assert (found.a, found.b, found.metric, found.episodes, found.comparisons) == ("a", "b", "J", 40, 1)
    assert (found.difference, found.low, found.high) == mean_interval(differences)
    assert found.p == paired_test(differences) == 1e-4
    assert str(found).startswith(f"J of a minus b: {found.difference:+.4g} (95 % interval ")
    several = result.compare("a")
    assert [(each.b, each.episodes, each.comparisons) for each in several] == [("b", 40, 2), ("c", 39, 2)]
    assert several[0].low < found.low < found.high < several[0].high
    assert several[0].p == 2e-4
    assert several[1].low < 0 < several[1].high
    assert result.compare("a", ["b", "c"]) == several
    assert result.compare("a", []) == []


def test_one_value_has_no_interval():
    result = from_values(a=[2.0], b=[3.0])
    assert result.to_markdown(["J", "success"]).splitlines()[2] == "| a | 1 | 2.000 | 0.000 (0.000 to 0.793) |"
    assert "$2.000$ \\\\" in result.to_latex(["J"])
    assert [str(cell) for cell in result.ranking().columns[1].cells] == ["2.000", "3.000"]
    assert str(result.compare("a", "b")) == "J of a minus b: -1 (p = 1) over 1 episode"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("a", "z"), ["detector must be one of a, b", "'z'"]),
        (("z",), ["detector", "'z'"]),
        (("a", "b", "j"), ["metric must be one of", "'j'"]),
        (("a", "b", "purity_first"), ["b must have episodes with purity_first in common"]),
    ],
)
def test_what_cannot_be_compared_is_one_sentence(arguments, words):
    result = from_values(a=[1.0], b=[2.0])
    rows = RowTable(COLUMNS, ({**row, "purity_first": None} for row in result.rows))
    with pytest.raises(ArgumentError) as refused:
        EvaluationResult(rows, summarise(rows), result.config).compare(*arguments)
    assert all(word in str(refused.value) for word in words), refused.value


def test_results_of_two_folders_are_merged_and_compared():
    first, second = from_values(a=[1.0, 2.0, 3.0]), from_values(b=[2.0, 2.0])
    both = first.merge(second)
    assert [(entry["detector"], entry["episodes"]) for entry in both.summary] == [("a", 3), ("b", 2)]
    assert both.compare("a", "b").difference == -0.5
    assert both.to_markdown(["J"]).splitlines()[2:] == [
        *first.to_markdown(["J"]).splitlines()[2:],
        *second.to_markdown(["J"]).splitlines()[2:],
    ]
    moved = RowTable(COLUMNS, ({**row, "swarm_seed": 7} for row in second.rows))
    for other, message in (
        (3, "other must be an EvaluationResult, got 3"),
        (from_values(a=[1.0]), "other must have other labels than this result, got 'a' in both"),
        (from_values(env="E", b=[1.0]), "other must have the arguments of this result, got different values of env"),
        (EvaluationResult(moved, summarise(moved), second.config), "other must have met the same swarms, got another"),
    ):
        with pytest.raises(ArgumentError, match=f"^{message}"):
            first.merge(other)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda result: result.compare("a", 3), "b must be a label, a list of labels or None, got 3"),
        (lambda result: interquartile_means(result), "results must be a list of results, got <EvaluationResult"),
        (lambda result: result.performance_profiles(thresholds=["a"]), r"thresholds must be .* got \['a'\]"),
        (lambda result: result.performance_profiles(thresholds=[]), r"thresholds must be .* got \[\]"),
        (lambda result: result.performance_profiles(thresholds="12"), "thresholds must be .* got '12'"),
    ],
)
def test_a_wrong_argument_is_one_sentence(call, message):
    with pytest.raises(ArgumentError, match=f"^{message}"):
        call(from_values(a=[1.0, 2.0], b=[2.0, 1.0]))


def test_aggregates_cover_several_environments():
    first, second = from_values(a=[1.0, 2.0, 3.0, 40.0], b=[5.0] * 4), from_values(a=[2.0] * 4, b=[5.0] * 4)
    assert first.interquartile_means()["a"].mean == 2.5
    assert interquartile_means([first, second])["a"].mean == 2.0
    assert interquartile_means([first, second])["b"] == (5.0, 5.0, 5.0)
    profile = performance_profiles([first, second], thresholds=[1.0, 2.5, 50.0])["a"]
    assert profile.share.tolist() == [0.0, 0.75, 1.0]  # lower J_m is better: (2/4 + 4/4) / 2 below 2.5
    assert first.performance_profiles("ap_first", [-0.5, 0.5])["a"].share.tolist() == [1.0, 0.0]
    assert len(first.performance_profiles()["b"].share) == 101
    with pytest.raises(ArgumentError, match=r"^results must hold J of the same detectors, got one without 'b'"):
        interquartile_means([first, from_values(a=[1.0])])
    with pytest.raises(ArgumentError, match=r"^results must hold at least one"):
        interquartile_means([])

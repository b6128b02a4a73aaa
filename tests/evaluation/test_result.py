"""The ranked table of an evaluation, and the sentence about the best detector."""

from __future__ import annotations

import pytest

from usnet_env.evaluation import METRICS, EvaluationResult


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

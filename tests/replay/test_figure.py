"""One picture of an episode."""

from __future__ import annotations

import numpy as np
import pytest
from small_episode import ROUNDS, UAVS, small_episode

from usnet_env import ArgumentError
from usnet_env.replay import draw_episode, write_picture
from usnet_env.replay.story import describe_outcome, describe_round

pytest.importorskip("matplotlib")


def titles(figure):
    return [axes.get_title(loc="left") for axes in figure.axes]


def long_episode(rounds):
    """``rounds`` rounds without candidates."""
    small = small_episode()
    repeated = ("position", "velocity", "seen", "leader", "scores", "clusters", "leader_estimate", "attention")
    return small_episode(
        **{name: np.repeat(getattr(small, name)[:1], rounds, axis=0) for name in repeated},
        alive=np.ones((rounds, UAVS), bool),
        candidates=np.zeros((rounds, UAVS), bool),
        objective=np.arange(rounds) + 1.0,
        over_budget=np.zeros(rounds, bool),
        seconds=np.zeros(rounds),
    )


def test_words_say_what_happened():
    episode = small_episode()
    assert describe_round(episode, 1) == "2 candidates (1 head hit, 1 redundant), 1 head left"
    assert describe_round(episode, 2) == "1 candidate (1 head hit, 0 redundant), 0 heads left"
    assert describe_outcome(episode) == (
        "All 2 heads found in 2 rounds with 1 redundant candidate: J = 2.083 (J_m, lower is better)."
    )
    assert describe_outcome(long_episode(4)).startswith(
        "0 of 2 heads found in 4 rounds with 0 redundant candidates: J = 4.000"
    )
    over = small_episode(over_budget=[True, False], alive=np.ones((ROUNDS, UAVS), bool))
    assert describe_round(over, 1) == "2 candidates, over the shot budget: no UAV destroyed, 2 heads left"


def test_a_panel_for_each_round_and_the_scores():
    first, second, scores = titles(draw_episode(small_episode()))
    assert first.startswith("Round 1: 2 candidates")
    assert second.startswith("Round 2: 1 candidate ")
    assert scores.startswith("Scores of the detector")


def test_many_rounds_are_cut_short_and_it_says_so():
    first, second, last, _ = titles(draw_episode(long_episode(7)))
    assert (first[:8], second[:8]) == ("Round 1:", "Round 2:")
    assert last.startswith("(rounds 3 to 6 are not shown)\nRound 7:")


def test_the_legend_covers_all_panels():
    """Redundant candidates and missed heads are in the first panel only; the legend stands beside the last."""
    panels = draw_episode(small_episode()).axes[:2]
    texts = {text.get_text() for text in panels[-1].get_legend().get_texts()}
    assert {"candidate: redundant", "head, not a candidate", "destroyed earlier", "decoy: has no followers"} <= texts
    assert panels[0].get_legend() is None


def test_bars_are_sorted_and_count_heads():
    episode = small_episode()
    scores = draw_episode(episode).axes[-1]
    heads, others = scores.containers
    assert len(heads) == 2
    assert len(others) == UAVS - 2
    bars = sorted([*heads, *others], key=lambda bar: bar.get_x())
    np.testing.assert_allclose([bar.get_height() for bar in bars], np.sort(episode.scores[0])[::-1])


@pytest.mark.parametrize("scores", [np.zeros((ROUNDS, UAVS)), -np.ones((ROUNDS, UAVS)), np.eye(ROUNDS, UAVS) * 1e30])
def test_any_scores_can_be_drawn(tmp_path, scores):
    assert write_picture(small_episode(scores=scores), tmp_path / "e.png").stat().st_size > 10_000


def test_the_file_is_a_png_and_whole(tmp_path):
    path = write_picture(small_episode(), tmp_path / "new" / "e.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    assert list(path.parent.iterdir()) == [path]
    with pytest.raises(ArgumentError, match=r"^path must be a file that can be written"):
        write_picture(small_episode(), tmp_path)

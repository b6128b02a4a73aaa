"""One picture of an episode."""

from __future__ import annotations

import numpy as np
import pytest
from small_episode import MIND, ROUNDS, UAVS, large_episode, small_episode

from usnet_env import ArgumentError
from usnet_env.replay import draw_episode, write_picture
from usnet_env.replay.story import describe_outcome, describe_round, rank_scores

pytest.importorskip("matplotlib")


def titles(figure):
    return [axes.get_title(loc="left") for axes in figure.axes]


def long_episode(rounds, **changes):
    """``rounds`` rounds without candidates."""
    small = small_episode()
    repeated = ("position", "velocity", "seen", "root", "scores", *MIND[:-1])
    values = {
        **{name: np.repeat(getattr(small, name)[:1], rounds, axis=0) for name in repeated},
        "alive": np.ones((rounds, UAVS), bool),
        "candidates": np.zeros((rounds, UAVS), bool),
        "objective": np.arange(rounds) + 1.0,
        "over_budget": np.zeros(rounds, bool),
        "seconds": np.zeros(rounds),
        "reasons": None,
    }
    return small_episode(**values | changes)


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


def maps(figure):
    """The axes of the maps, and of the scores."""
    return figure.axes[::2], figure.axes[1::2]


def test_a_map_and_the_scores_of_each_round():
    first, scores, second, _ = titles(draw_episode(small_episode()))
    assert first.startswith("Round 1: 2 candidates")
    assert second.startswith("Round 2: 1 candidate ")
    assert scores.startswith("Scores: all living UAVs")


def test_many_rounds_are_cut_short_and_it_says_so():
    """Of nine rounds, the first, the last and those with hits are shown."""
    candidates = np.zeros((9, UAVS), bool)
    candidates[6, 0] = candidates[7, 5] = True
    alive = np.ones((9, UAVS), bool)
    alive[7:, 0] = alive[8:, 5] = False
    figure = draw_episode(long_episode(9, candidates=candidates, alive=alive))
    assert [title.partition(":")[0] for title in titles(figure)[::2]] == [f"Round {n}" for n in (1, 2, 3, 7, 8, 9)]
    assert any("The picture shows 6 of 9 rounds." in text.get_text() for text in figure.texts)
    assert len(draw_episode(long_episode(6)).axes) == 12


def test_all_maps_have_one_scale():
    small = small_episode()
    spread = small.position.copy()
    spread[1] *= 3
    sizes = {np.ptp(axes.get_xlim()).round(3) for axes in maps(draw_episode(small_episode(position=spread)))[0]}
    assert len(sizes) == 1


def test_the_legend_covers_all_panels():
    """Redundant candidates and missed heads are in the first panel only; the legend is beside the last."""
    panels, _ = maps(draw_episode(small_episode()))
    legend = panels[-1].get_legend()
    texts = {text.get_text() for text in legend.get_texts()}
    assert {"candidate: redundant", "head, not a candidate", "destroyed earlier", "decoy: has no followers"} <= texts
    assert panels[0].get_legend() is None
    assert not any(line.get_linestyle() == "--" for line in legend.get_lines())  # on the map it is a circle


def test_bars_are_sorted_and_name_their_uavs():
    episode = small_episode()
    axes = maps(draw_episode(episode))[1][0]
    bars = sorted((bar for group in axes.containers for bar in group), key=lambda bar: bar.get_x())
    np.testing.assert_allclose([bar.get_height() for bar in bars], np.sort(episode.scores[0])[::-1])
    order = np.argsort(-episode.scores[0]).tolist()
    assert [int(text.get_text()) for text in axes.get_xticklabels()] == order
    ranks = {group.get_label(): [round(bar.get_x() + 0.4) for bar in group] for group in axes.containers}
    assert {name: sorted(order[rank] for rank in each) for name, each in ranks.items() if name != "other"} == {
        "hit": [0],
        "redundant": [3],
        "head, not a candidate": [5],
    }


def test_candidates_and_heads_are_in_the_chart_whatever_their_scores():
    """Without a score above 0, the chart has the candidates first and says that all scores are 0."""
    episode = large_episode(scores=np.zeros((1, 60)))
    assert rank_scores(episode, 1)[:2].tolist() == [40, 55]
    assert {40, 55, 30, 31} <= set(rank_scores(episode, 1).tolist())
    assert len(rank_scores(episode, 1)) == 12
    axes = draw_episode(episode).axes[1]
    assert axes.get_ylim() == (0, 1)
    assert [text.get_text() for text in axes.texts] == ["All scores are 0."]
    all_named = large_episode(candidates=np.ones((1, 60), bool))
    assert len(rank_scores(all_named, 1)) == 40
    assert {30, 31, 40} <= set(rank_scores(all_named, 1).tolist())


@pytest.mark.parametrize("scores", [np.zeros((ROUNDS, UAVS)), -np.ones((ROUNDS, UAVS)), np.eye(ROUNDS, UAVS) * 1e30])
def test_any_scores_can_be_drawn(tmp_path, scores):
    assert write_picture(small_episode(scores=scores), tmp_path / "e.png").stat().st_size > 10_000


def test_the_file_is_a_png_and_whole(tmp_path):
    path = write_picture(small_episode(), tmp_path / "new" / "e.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    assert list(path.parent.iterdir()) == [path]
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match=r"^path must be a file that can be written"):
        write_picture(small_episode(), tmp_path / "file" / "e.png")
    with pytest.raises(ArgumentError, match=r"^path must end in \.png or \.pdf, got"):
        write_picture(small_episode(), tmp_path)
    assert write_picture(small_episode(), path.with_name("e.pdf")).read_bytes().startswith(b"%PDF")

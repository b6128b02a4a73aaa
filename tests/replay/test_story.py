"""The words about an episode, and its picture."""

from __future__ import annotations

import numpy as np
import pytest
from small_episode import MIND, ROUNDS, UAVS, large_episode, small_episode

from usnet_env import ArgumentError
from usnet_env.replay import draw_episode, write_picture
from usnet_env.replay.story import annotated_uavs, describe_outcome, describe_round, explain_replay, tell_round

pytest.importorskip("matplotlib")


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
        "2 of 2 heads found in 2 rounds with 1 redundant candidate: J = 2.083 (J_m, lower is better)."
    )
    assert describe_outcome(long_episode(4)).startswith(
        "0 of 2 heads found in 4 rounds with 0 redundant candidates: J = 4.000"
    )
    over = small_episode(over_budget=[True, False], alive=np.ones((ROUNDS, UAVS), bool))
    assert describe_round(over, 1) == "2 candidates, over the shot budget: no UAV destroyed, 2 heads left"


def test_zero_is_the_best_score_of_p1():
    """J_s of P1 is 0 for the right answer and falls with every mistake; J_m of P2 is at least 1."""
    episode = small_episode(problem="P1", objective=[0.0, 0.0])
    assert describe_outcome(episode).endswith("J = 0.000 (J_s, 0 is best).")
    assert "lower is better" not in tell(episode)


def tell(record):
    names = [str(i) for i in range(record.uavs)]
    told = [text for number in range(1, record.rounds + 1) for text in tell_round(record, number, names)]
    return "\n".join([*told, explain_replay(record)])


def test_a_round_is_told_as_it_happens():
    watched, answered = tell_round(small_episode(), 1, [str(i) for i in range(UAVS)])
    assert watched == "**Round 1 of 2**"
    assert "2 candidates (1 head hit, 1 redundant), 1 head left." in answered
    assert "- **3** redundant, p 0.10, score" in answered
    assert "Adds 2 nats." in answered
    chosen = [{"head_0": "UAV 0: iid, jitter; price 0.1"}, {}]
    assert "- head_0, UAV 0: iid, jitter; price 0.1" in tell(small_episode(choices=chosen))


def test_reasons_are_the_detectors():
    episode = small_episode()
    marked = {i: (word, why) for i, word, why in annotated_uavs(episode, 1)}
    assert list(marked) == [i for i in np.argsort(-episode.scores[0]) if i in (0, 3, 5)]
    assert {i: word for i, (word, _) in marked.items()} == {0: "hit", 3: "redundant", 5: "missed"}
    assert marked[3][1].endswith(": Adds 2 nats.")
    assert marked[5][1] == f"p 0.90, score {episode.scores[0, 5]:.3g}"
    together = small_episode(clusters=np.zeros((ROUNDS, UAVS), int))
    assert {i: why for i, _, why in annotated_uavs(together, 1)}[5].endswith(": found in the group of UAV 0, UAV 3")
    assert annotated_uavs(small_episode(reasons=None, probability=None), 2)[0][2].startswith("score ")
    assert "… and 30 more" in tell(large_episode(candidates=np.ones((1, 60), bool)))


def unlabelled(**changes):
    """The small episode as tracks whose truth is not known: in each window, what was found."""
    small = small_episode()
    found = {"alive": np.ones((ROUNDS, UAVS), bool), "head": small.candidates.any(axis=0), "labelled": False}
    return small_episode(**found | {"over_budget": [True, True], "decoy": np.zeros(UAVS, bool)} | changes)


def test_what_is_true_of_tracks_is_said_of_tracks():
    record = unlabelled(
        config={"ids": [f"bird-{i}" for i in range(UAVS)], "start": ["0 s", "9 s"], "end": ["9 s", "18 s"]}
    )
    assert describe_outcome(record) == "In 2 windows, 3 of 12 ids lead at least once; the truth is unknown."
    assert describe_round(record, 1) == "0 s to 9 s: 2 leaders found"
    assert not record.destroyed.any()
    for word in ("UAV", "destroyed", "J =", "Round", "round"):
        assert word not in tell(record), word


# --- the picture -----------------------------------------------------------------------------------------------------


def titles(figure):
    return [axes.get_title(loc="left") for axes in figure.axes]


def test_a_map_of_each_round_in_one_scale():
    small = small_episode()
    spread = small.position.copy()
    spread[1] *= 3
    figure = draw_episode(small_episode(position=spread))
    assert [title.partition(":")[0] for title in titles(figure)] == ["Round 1", "Round 2"]
    assert len({np.ptp(axes.get_xlim()).round(3) for axes in figure.axes}) == 1
    assert "2 of 2 heads found in 2 rounds" in figure.get_suptitle()
    texts = {text.get_text() for text in figure.axes[-1].get_legend().get_texts()}
    assert {"candidate: redundant", "head, not a candidate", "destroyed earlier", "decoy: has no followers"} <= texts
    assert figure.axes[0].get_legend() is None


def test_many_rounds_are_cut_short_and_it_says_so():
    figure = draw_episode(long_episode(9))
    assert [title.partition(":")[0] for title in titles(figure)] == [f"Round {n}" for n in (1, 2, 3, 4, 5, 9)]
    assert "6 of 9 rounds" in " ".join(figure.get_suptitle().split())
    assert len(draw_episode(long_episode(4)).axes) == 4


def test_a_map_of_tracks_shows_what_was_found():
    figure = draw_episode(unlabelled(env_id="birds $ 3"))
    texts = {text.get_text() for text in figure.axes[-1].get_legend().get_texts()}
    assert texts == {"leader", "other (colour = leader)", "link from follower to leader", "other (no leader found)"}


def test_the_file_is_whole_and_of_the_kind_that_its_name_says(tmp_path):
    path = write_picture(small_episode(), tmp_path / "new" / "e.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    assert list(path.parent.iterdir()) == [path]
    assert write_picture(small_episode(), path.with_name("e.pdf")).read_bytes().startswith(b"%PDF")
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file" / "e.png", tmp_path / "e.jpg"):
        with pytest.raises(ArgumentError, match=r"^path must"):
            write_picture(small_episode(), place)

"""Runs of games: rows are those of single games, and are kept, resumed and joined like those of evaluations."""

from __future__ import annotations

import pytest

pytest.importorskip("pettingzoo")

from pandas.testing import assert_frame_equal
from sample_detectors import untimed

from usnet_env import ArgumentError, make_detector
from usnet_env.evaluation import METRICS, EvaluationResult, evaluate_games
from usnet_env.evaluation.play import episode_seeds
from usnet_env.multiagent import usnet_evasion_v0
from usnet_env.multiagent.play import play_game
from usnet_env.multiagent.policies import CamouflagedHead, DetectorObserver, RandomHead, RandomObserver, TruthfulHead

SMALL = {"clusters": 2, "uavs": 10, "observation_steps": 20, "max_rounds": 4}
PLAYERS = {
    "regression, truthful": {"observer": "lagged-regression", "head": TruthfulHead()},
    "random": {"observer": RandomObserver(), "head": RandomHead()},
}


def test_rows_are_those_of_single_games(tmp_path):
    result = evaluate_games("usnet_evasion_v0", PLAYERS, episodes=3, seed=5, game_kwargs=SMALL, out=tmp_path)
    assert list(result) == list(PLAYERS)
    assert set(result["random"]) == {*METRICS, "return_observer", "return_head", "price_observer", "price_head"} - {
        "purity_first",
        "head_in_cluster_first",
    }
    env = usnet_evasion_v0.parallel_env(**SMALL)
    for row in result.rows.to_dict("records"):
        seeds = episode_seeds(5, row["episode"])
        assert (row["swarm_seed"], row["detector_seed"]) == seeds
        policies = PLAYERS[row["detector"]]
        if row["detector"] != "random":
            policies = {**policies, "observer": DetectorObserver(make_detector("lagged-regression"))}
        game = play_game(env, policies, seeds[0], policy_seed=seeds[1])
        assert (row["J"], row["rounds"], row["success"]) == (pytest.approx(game.J), game.rounds, game.success)
        assert row["redundancy"] == pytest.approx(game.redundant / row["uavs"])
        first_hits = (game.record["candidates"][0] & game.record["head"]).sum()
        assert row["recall_first"] == pytest.approx(first_hits / row["heads"])
        assert row["return_observer"] == game.returns["observer_0"]
        heads = [value for name, value in game.prices.items() if name.startswith("head")]
        assert row["price_head"] == pytest.approx(sum(heads) / len(heads))
    assert EvaluationResult.load(tmp_path).summary == result.summary


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_games_resume_and_play_in_other_processes(tmp_path, workers):
    asked = {"seed": 2, "game_kwargs": SMALL}
    evaluate_games("usnet_evasion_v0", {"random": PLAYERS["random"]}, episodes=2, out=tmp_path, **asked)
    joined = evaluate_games("usnet_evasion_v0", PLAYERS, episodes=3, out=tmp_path, workers=workers, **asked)
    alone = evaluate_games("usnet_evasion_v0", PLAYERS, episodes=3, **asked)
    one, other = (untimed(each).sort_values(["detector", "episode"], ignore_index=True) for each in (joined, alone))
    assert_frame_equal(one, other)
    with pytest.raises(ArgumentError, match="in which usnet_evasion_v0 is "):
        evaluate_games("usnet_evasion_v0", PLAYERS, out=tmp_path, seed=2, game_kwargs={**SMALL, "uavs": 12})


class Broken(RandomObserver):
    def act(self, observation):
        raise ZeroDivisionError("no act")


def test_a_policy_that_fails_ends_no_other_team():
    players = {"broken": {"observer": Broken()}, "random": {"observer": RandomObserver()}}
    result = evaluate_games("usnet_observers_v0", players, episodes=2, game_kwargs=SMALL)
    assert [(entry["episodes"], entry["failed"]) for entry in result.summary] == [(0, 2), (2, 0)]
    assert "the game: ZeroDivisionError: no act (test_games.py, line " in result.failures["broken"]


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"game": "chess"}, "game must be one of usnet_evasion_v0, usnet_observers_v0"),
        ({"players": {}}, "players"),
        ({"players": {3: {}}}, "players"),
        ({"players": {"a": RandomObserver()}}, "players"),
        ({"players": {"a": {"observer": RandomObserver()}}}, "policies must hold a policy for head_0"),
        ({"players": {"a": {"observer": "randm", "head": CamouflagedHead()}}}, "'randm'"),
        ({"game_kwargs": {"uavs": 1}}, "uavs"),
        ({"game_kwargs": 5}, "game_kwargs"),
        ({"episodes": 0}, "episodes"),
    ],
)
def test_bad_arguments_are_one_sentence(changes, word):
    with pytest.raises(ArgumentError, match=word):
        evaluate_games(**({"game": "usnet_evasion_v0", "players": PLAYERS, "game_kwargs": SMALL} | changes))

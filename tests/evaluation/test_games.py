"""Runs of games: rows are those of single games, and are kept, resumed and joined like those of evaluations."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("pettingzoo")

from usnet_env import ArgumentError, make_detector
from usnet_env.evaluation import METRICS, EvaluationError, EvaluationResult, evaluate_games
from usnet_env.evaluation.episode import episode_seeds
from usnet_env.multiagent import usnet_evasion_v0
from usnet_env.multiagent.play import play_game
from usnet_env.multiagent.policies import CamouflagedHead, DetectorObserver, RandomHead, RandomObserver, TruthfulHead

SMALL = {"clusters": 2, "uavs": 10, "observation_steps": 20, "max_rounds": 4}
PLAYERS = {
    "regression, truthful": {"observer": "lagged-regression", "head": TruthfulHead()},
    "random": {"observer": RandomObserver(), "head": RandomHead()},
}


def untimed(rows):
    return [{name: value for name, value in row.items() if name != "seconds_per_round"} for row in rows]


def test_rows_are_those_of_single_games(tmp_path):
    result = evaluate_games("usnet_evasion_v0", PLAYERS, episodes=3, seed=5, game_kwargs=SMALL, out=tmp_path)
    assert [entry["detector"] for entry in result.summary] == list(PLAYERS)
    assert set(result["random"]) == {*METRICS, "return_observer", "return_head", "price_observer", "price_head"} - {
        "purity_first",
        "head_in_cluster_first",
    }
    env = usnet_evasion_v0.parallel_env(**SMALL)
    for row in result.rows:
        seeds = episode_seeds(5, row["episode"])
        assert (row["swarm_seed"], row["detector_seed"]) == seeds
        policies = PLAYERS[row["detector"]]
        if row["detector"] != "random":
            policies = {**policies, "observer": DetectorObserver(make_detector("lagged-regression"))}
        game = play_game(env, policies, seeds[0], policy_seed=seeds[1])
        assert (row["J"], row["rounds"], row["success"]) == (pytest.approx(game.J), game.rounds, game.success)
        assert row["redundancy"] == pytest.approx(game.redundant / row["uavs"])
        assert row["recall_first"] == pytest.approx(game.first_hits / row["heads"])
        assert row["return_observer"] == game.returns["observer_0"]
        heads = [value for name, value in game.prices.items() if name.startswith("head")]
        assert row["price_head"] == pytest.approx(sum(heads) / len(heads))
    assert EvaluationResult.load(tmp_path).summary == result.summary


def test_games_resume_join_and_play_in_other_processes(tmp_path):
    asked = {"seed": 2, "game_kwargs": SMALL}
    first = {"random": PLAYERS["random"]}
    evaluate_games("usnet_evasion_v0", first, episodes=2, out=tmp_path, **asked)
    joined = evaluate_games("usnet_evasion_v0", {**first, **PLAYERS}, episodes=3, out=tmp_path, workers=2, **asked)
    assert untimed(joined.rows) == untimed(
        evaluate_games("usnet_evasion_v0", {**first, **PLAYERS}, episodes=3, **asked).rows
    )
    assert json.loads((tmp_path / "run.json").read_text())["config"]["episodes"] == 3
    with pytest.raises(
        ArgumentError, match="in which detector 'random' has a policy for observer that has count = 1 instead of 2"
    ):
        evaluate_games(
            "usnet_evasion_v0",
            {"random": {"observer": RandomObserver(2), "head": RandomHead()}},
            episodes=3,
            out=tmp_path,
            **asked,
        )


class Broken(RandomObserver):
    def act(self, observation):
        raise ZeroDivisionError("no act")


def test_a_policy_that_fails_ends_no_other_team():
    players = {"broken": {"observer": Broken()}, "random": {"observer": RandomObserver()}}
    with pytest.raises(
        EvaluationError,
        match=r"^detector 'broken' failed in game 0: ZeroDivisionError: no act \(test_games\.py, line \d+, in act\)\.$",
    ) as e:
        evaluate_games("usnet_observers_v0", players, episodes=2, game_kwargs=SMALL)
    assert [entry["episodes"] for entry in e.value.result.summary] == [2]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"game": "chess"}, ["game must be one of usnet_observers_v0, usnet_evasion_v0", "'chess'"]),
        ({"players": {}}, ["players must be a mapping"]),
        ({"players": {3: {}}}, ["players must have labels"]),
        ({"players": {"a": RandomObserver()}}, ["players must map each label"]),
        ({"players": {"a": {"observer": RandomObserver()}}}, ["policies must hold a policy for head_0"]),
        ({"players": {"a": {"observer": "randm", "head": CamouflagedHead()}}}, ["'randm'"]),
        ({"game_kwargs": {"uavs": 1}}, ["uavs"]),
        ({"game_kwargs": 5}, ["game_kwargs must be a mapping of names to values, got 5"]),
        ({"game_kwargs": {3: 4}}, ["game_kwargs must be a mapping of names to values"]),
        ({"episodes": 0}, ["episodes", "0"]),
        ({"backend": "dask"}, ["backend"]),
    ],
)
def test_bad_arguments_are_one_sentence(changes, words):
    with pytest.raises(ArgumentError) as refused:
        evaluate_games(**({"game": "usnet_evasion_v0", "players": PLAYERS, "game_kwargs": SMALL} | changes))
    assert all(word in str(refused.value) for word in words), refused.value

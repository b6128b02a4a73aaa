"""Swarms and observers of evasion that learn from each other, at a tiny size."""

import evasion
import numpy as np
import pandas as pd
import pytest
from paper.shared import read_rows

pytest.importorskip("stable_baselines3")


def test_rock_paper_scissors_has_the_value_0():
    payoff = pd.DataFrame([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])
    value, mixtures = evasion.solve(payoff)
    assert value == pytest.approx(0)
    for mixture in mixtures.values():
        np.testing.assert_allclose(mixture, 1 / 3)


def test_nobody_gains_against_an_equilibrium():
    payoff = pd.DataFrame(np.random.default_rng(0).normal(size=(4, 6)))
    value, mixtures = evasion.solve(payoff)
    assert (payoff @ mixtures["observer"]).max() == pytest.approx(value)
    assert (mixtures["head"] @ payoff).min() == pytest.approx(value)


def test_whoever_names_all_uavs_ends_each_game_at_once():
    rows = evasion.play(evasion.choose(0, 0, 0, 2), evasion.detect("destroy-all"), 3)
    assert list(rows.J) == pytest.approx([1 + 10 / 12] * 3)
    assert list(rows.price) == pytest.approx([0.05 * 2 * 10 / 12] * 3)  # of the only window


@pytest.mark.parametrize("role", ["head", "observer"])
def test_the_swarm_gets_the_rounds_minus_the_price_and_the_observer_loses_them(role):
    swarm, observer = evasion.choose(0, 0, 0, 2), evasion.detect("destroy-all")
    own, other = {"head": (swarm, observer), "observer": (observer, swarm)}[role]
    games = evasion.OneSide(3, role, [other], [1.0], "SameStep")
    games.reset(seed=0)
    total, over = np.zeros(3), np.zeros(3, bool)
    while not over.all():
        _, reward, over, *_ = games.step(own(games._seen[role], np.arange(3)))
        total += reward
    assert total == pytest.approx([(1 + 10 / 12 - 0.05 * 2 * 10 / 12) * (1 if role == "head" else -1)] * 3)


def test_gains_are_of_games_that_tell_no_equilibrium():
    payoff = {"nothing": (2.0, 3.0, 1.0), "swarm 1": (4.0, 5.0, 3.0)}  # against each observer, in even games
    observers = (*evasion.SCRIPTED, "observer 1")
    pairs = [(head, name, value) for head, line in payoff.items() for name, value in zip(observers, line, strict=True)]
    rows = [
        {"head": head, "observer": name, "episode": game, "J": value * (1 + 9 * (game % 2)), "price": 0.0}
        for head, name, value in pairs
        for game in range(4)
    ]
    rows = pd.DataFrame(rows).eval("payoff = J - price")
    gains = evasion.find_gains(rows).set_index(["response", "episode"])[["value", "gain"]]
    assert gains.T.to_dict("list") == {
        ("swarm 1", 1): [20.0, 20.0],  # the best of the known observers is the first
        ("swarm 1", 3): [20.0, 20.0],
        ("observer 1", 1): [40.0, 10.0],
        ("observer 1", 3): [40.0, 10.0],
    }


def test_both_sides_learn_in_turn_and_meet_all_others(tmp_path, monkeypatch, capsys):
    path = tmp_path / "rows.csv"
    monkeypatch.setattr(evasion, "WEIGHTS", tmp_path / "players.safetensors")
    monkeypatch.setattr(evasion, "SCRIPTED", ("lagged-regression", "destroy-all"))
    words = ["--rows", str(path), "--length", "0.01", "--episodes", "3"]
    evasion.main([*words, "--rounds", "2"])
    rows = read_rows(path)
    assert list(rows["head"].unique()) == ["nothing", "swarm 1", "swarm 2"]
    assert list(rows.observer.unique()) == ["lagged-regression", "destroy-all", "observer 1", "observer 2"]
    assert (rows.groupby(["head", "observer"]).size() == 3).all()
    assert rows.J.between(1, 7).all()
    said = capsys.readouterr().out
    assert "| swarm 2 |" in said
    players = evasion.read_players()
    assert {role: list(found) for role, found in players.items()} == {
        "head": ["swarm 1", "swarm 2"],
        "observer": ["observer 1", "observer 2"],
    }
    again = evasion.play(evasion.choose(0, 0, 0, 0), players["observer"]["observer 2"], 3)
    known = rows[(rows["head"] == "nothing") & (rows.observer == "observer 2")]
    np.testing.assert_allclose(again[["J", "price"]], known[["J", "price"]], atol=1e-4)
    evasion.main([*words, "--rounds", "1", "--trainings", "2"])  # the first one is there already
    assert read_rows(path).groupby("training")["head"].nunique().to_dict() == {0: 3, 1: 2}

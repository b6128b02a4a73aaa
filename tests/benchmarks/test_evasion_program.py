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

"""Swarms and observers of evasion that learn from each other, at a tiny size."""

import evasion
import numpy as np
import pandas as pd
import pytest
from paper.shared import read_rows

pytest.importorskip("stable_baselines3")


def test_nobody_gains_against_an_equilibrium():
    payoff = pd.DataFrame(np.random.default_rng(0).normal(size=(4, 6)))
    value, mixtures = evasion.solve(payoff)
    assert (payoff @ mixtures["observer"]).max() == pytest.approx(value)
    assert (mixtures["head"] @ payoff).min() == pytest.approx(value)


@pytest.mark.parametrize("role", ["head", "observer"])
def test_the_swarm_gets_the_rounds_minus_the_price_and_the_observer_loses_them(role):
    swarm, observer = evasion.choose(0, 0, 0, 2), evasion.detect("destroy-all")
    rows = evasion.play(swarm, observer, 3)
    assert list(rows.J) == pytest.approx([1 + 10 / 12] * 3)  # all UAVs are named at once
    assert list(rows.price) == pytest.approx([0.05 * 2 * 10 / 12] * 3)  # of the only window
    own, other = {"head": (swarm, observer), "observer": (observer, swarm)}[role]
    games = evasion.OneSide(3, role, [other], [1.0], "SameStep")
    games.reset(seed=0)
    total, over = np.zeros(3), np.zeros(3, bool)
    while not over.all():
        _, reward, over, *_ = games.step(own(games._seen[role], np.arange(3)))
        total += reward
    assert total == pytest.approx((rows.J - rows.price) * (1 if role == "head" else -1))


def test_gains_are_of_games_that_tell_no_equilibrium():
    payoff = {"nothing": (2.0, 3.0, 1.0), "swarm 1": (4.0, 5.0, 3.0)}  # against each observer, in even games
    rows = [
        {"head": head, "observer": name, "episode": game, "J": value * (1 + 9 * (game % 2)), "price": 0.0}
        for head, line in payoff.items()
        for name, value in zip((*evasion.SCRIPTED, "observer 1"), line, strict=True)
        for game in range(4)
    ]
    gains = evasion.find_gains(pd.DataFrame(rows).eval("payoff = J - price")).set_index("response")
    assert set(gains.episode) == {1, 3}
    assert set(zip(gains.index, gains.value, gains.gain, strict=True)) == {
        ("swarm 1", 20.0, 20.0),  # the best of the known observers is the first
        ("observer 1", 40.0, 10.0),
    }


def test_both_sides_learn_in_turn_and_meet_all_others(tmp_path, monkeypatch, capsys):
    path = tmp_path / "rows.csv"
    monkeypatch.setattr(evasion, "WEIGHTS", tmp_path / "players.safetensors")
    monkeypatch.setattr(evasion, "SCRIPTED", ("lagged-regression", "destroy-all"))
    evasion.main(["--rows", str(path), "--length", "0.01", "--episodes", "3", "--rounds", "2"])
    assert "| swarm 2 |" in capsys.readouterr().out
    rows = read_rows(path)
    assert list(rows["head"].unique()) == ["nothing", "swarm 1", "swarm 2"]
    assert list(rows.observer.unique()) == ["lagged-regression", "destroy-all", "observer 1", "observer 2"]
    assert (rows.groupby(["head", "observer"]).size() == 3).all()
    assert rows.J.between(1, 7).all()
    again = evasion.play(evasion.choose(0, 0, 0, 0), evasion.read_players()["observer"]["observer 2"], 3)
    known = rows[(rows["head"] == "nothing") & (rows.observer == "observer 2")]
    np.testing.assert_allclose(again[["J", "price"]], known[["J", "price"]], atol=1e-4)

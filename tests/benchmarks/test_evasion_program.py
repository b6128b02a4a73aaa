"""Swarms and observers of evasion that learn from each other, at a tiny size."""

import evasion
import numpy as np
import pandas as pd
import pytest
from paper.shared import read_rows

pytest.importorskip("stable_baselines3")


def test_no_player_gains_against_an_equilibrium():
    known = pd.DataFrame(np.random.default_rng(0).normal(size=(4, 6))).stack().rename_axis(["head", "observer"])
    payoff = evasion.tabulate(known.add(0.5).reset_index(name="J").assign(price=0.5))
    assert payoff.stack().to_numpy() == pytest.approx(known.to_numpy())
    value, mixtures = evasion.solve(payoff)
    assert (payoff @ mixtures["observer"]).max() == pytest.approx(value)
    assert (mixtures["head"] @ payoff).min() == pytest.approx(value)


@pytest.mark.parametrize("role", ["head", "observer"])
def test_the_swarm_gets_the_rounds_minus_the_price_and_the_observer_loses_them(role):
    swarm, observer = evasion.choose(0, 0, 0, 2), evasion.detect("destroy-all")
    rows = evasion.play("usual", swarm, observer, 3)
    assert list(rows.J) == pytest.approx([1 + 10 / 12] * 3)  # all UAVs are named at once
    assert list(rows.price) == pytest.approx([0.05 * 2 * 10 / 12] * 3)  # of the only window
    own, other = {"head": (swarm, observer), "observer": (observer, swarm)}[role]
    games = evasion.OneSide(3, "usual", role, [other], [1.0], "SameStep")
    games.reset(seed=0)
    total, over = np.zeros(3), np.zeros(3, bool)
    while not over.all():
        _, reward, over, *_ = games.step(own(games._seen[role], np.arange(3)))
        total += reward
    assert total == pytest.approx((rows.J - rows.price) * (1 if role == "head" else -1))


def test_a_choice_in_the_cheap_game_costs_a_fifth_and_none_is_the_best_where_all_are_named():
    swarm, observer = evasion.choose(1, 1, 2, 1), evasion.detect("destroy-all")
    usual, cheap = (evasion.play(game, swarm, observer, 3) for game in ("usual", "cheap"))
    assert list(cheap.price) == pytest.approx(list(usual.price / 5))
    assert list(cheap.J) == list(usual.J)
    assert evasion.find_constant("usual", observer) == (0, 0, 0, 0)  # any other has a price for nothing


def test_a_mixture_plays_each_game_as_one_of_its_players():
    players = [evasion.choose(0, 0, 0, 0), evasion.choose(0, 0, 2, 1)]
    mixture, games = evasion.mix(players, np.array([0.5, 0.5])), np.arange(200)
    drawn = mixture({}, games)[:, 0, 2] // 2
    assert 60 < drawn.sum() < 140
    assert (mixture({}, games[::-1])[::-1, 0, 2] // 2 == drawn).all()  # in each window the same


def test_both_sides_learn_in_turn_and_the_last_mixtures_are_exploited(tmp_path, monkeypatch, capsys):
    path = tmp_path / "rows.csv"
    monkeypatch.setattr(evasion, "WEIGHTS", tmp_path / "players.safetensors")
    monkeypatch.setattr(evasion, "SCRIPTED", ("lagged-regression", "destroy-all"))
    monkeypatch.setattr(evasion, "BUDGETS", (1, 2))
    monkeypatch.setattr(evasion, "GAMES", {"usual": evasion.GAME})
    monkeypatch.setattr(evasion, "find_constant", lambda game, observer: (0, 0, 0, 1))  # of 90, which take seconds
    play, games = evasion.play, []

    def play_few(rules, head, observer, count, *seed):  # of 500 that choose a swarm, which take seconds too
        games.append((count, *seed))
        return play(rules, head, observer, min(count, 4), *seed)

    monkeypatch.setattr(evasion, "play", play_few)
    evasion.main(["--rows", str(path), "--length", "0.01", "--episodes", "3", "--rounds", "2", "--fresh", "4"])
    shown = capsys.readouterr().out
    assert "| PPO, 2 times | mixture |" in shown
    assert "| mixture | destroy-all |" in shown
    assert {how for how in games if how[0] == 4} == {(4, evasion.FRESH)}
    rows = read_rows(path)
    exploits = (rows["head"] == "mixture") | (rows.observer == "mixture")
    matrix = rows[~exploits]
    assert [name.partition(",")[0] for name in matrix["head"].unique()] == ["nothing", "swarm 1", "swarm 2"]
    assert list(matrix.observer.unique()) == ["lagged-regression", "destroy-all", "observer 1", "observer 2"]
    assert (matrix.groupby(["head", "observer"]).size() == 3).all()
    assert (rows[exploits].groupby(["head", "observer"]).size() == 4).all()
    assert rows.J.between(1, 7).all()
    again = evasion.play("usual", evasion.choose(0, 0, 0, 0), evasion.read_players()["observer"]["observer 2"], 3)
    known = rows[(rows["head"] == "nothing") & (rows.observer == "observer 2")]
    np.testing.assert_allclose(again[["J", "price"]], known[["J", "price"]], atol=1e-4)

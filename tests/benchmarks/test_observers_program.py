"""Observers that fly: what the patrols do, and that policies learn, at a tiny size."""

import numpy as np
import observers
import pytest
from paper.shared import read_rows

(CELL,) = observers.CELLS


@pytest.mark.parametrize("name", observers.PATROLS)
def test_observers_say_where_they_are_going_to_be_and_know_what_they_saw(name):
    search = observers.Search(4, CELL)
    search.reset(0)
    for _ in range(3):
        flight = observers.PATROLS[name](search)
        goals, over = search.reach_from(search.places, flight), search.step(flight)[1]
        said = (search.seen["messages"][:, 0] + 1) / 2 * observers.ARENA
        np.testing.assert_allclose(said[~over], goals[~over], atol=0.01)
        np.testing.assert_allclose(search.seen["place"][~over], goals[~over], atol=0.01)
        assert not np.isnan(search.last[search.seen["legal"] > 0]).any()
        assert np.isfinite(search.look()).all()


def test_the_rule_of_the_trainings_names_only_heads_that_are_seen():
    search = observers.Search(20, CELL)
    search.reset(0)
    search.step(observers.cover(search, heads=True))
    named = search.name()
    assert named.any()
    assert (named <= search.seen["legal"] * search.games.game.swarm.head[:, None]).all()


def test_rows_of_all_flights(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(observers, "DETECTOR", "lagged-regression")
    monkeypatch.setattr(observers, "BATCH", 4)
    how = ["--rows", str(tmp_path / "rows.csv"), "--trainings", "2", "--episodes", "5", "--decisions", "100"]
    observers.main(how)
    shown = capsys.readouterr().out
    rows = read_rows(tmp_path / "rows.csv")
    assert (rows.groupby(["flight", "training"]).size() == 5).all()
    assert set(rows.flight) == {"IPPO", "MAPPO", *observers.PATROLS}
    assert rows.J.between(1, 21).all()
    means = rows.groupby("flight")[["J", "coverage"]].mean()
    assert means.J["oracle of heads"] < means.J["stay"]
    assert means.coverage["oracle of coverage"] > means.coverage["stay"]
    observers.main(how)  # trains and plays nothing
    assert capsys.readouterr().out == shown

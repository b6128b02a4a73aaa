"""Observers that fly: what the patrols do, that policies learn, and the rows of both programs, at a tiny size."""

import learners
import numpy as np
import observers
import patrols
import protocol
import pytest
import teams
import torch
from paper.shared import isolate_torch, read_rows


@pytest.mark.parametrize("name", patrols.PATROLS)
def test_observers_say_where_they_are_going_to_be_and_know_what_they_saw(name):
    search = patrols.Search(4)
    search.reset(0)
    for _ in range(3):
        flight = patrols.PATROLS[name](search)
        goals, over = search.reach_from(search.places, flight), search.step(flight)[1]
        said = (search.seen["messages"][:, 0] + 1) / 2 * patrols.ARENA
        np.testing.assert_allclose(said[~over], goals[~over], atol=0.01)
        np.testing.assert_allclose(search.seen["place"][~over], goals[~over], atol=0.01)
        assert not np.isnan(search.last[search.seen["legal"] > 0]).any()
        assert np.isfinite(search.look()).all()


def test_the_rule_of_the_trainings_names_only_heads_that_are_seen():
    search = patrols.Search(20)
    search.reset(0)
    search.step(patrols.cover(search, heads=True))
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
    assert set(rows.flight) == {"IPPO", "MAPPO", *patrols.PATROLS}
    assert rows.J.between(1, 21).all()
    means = rows.groupby("flight")[["J", "coverage"]].mean()
    assert means.J["oracle of heads"] < means.J["stay"]
    assert means.coverage["oracle of coverage"] > means.coverage["stay"]
    observers.main(how)  # trains and plays nothing
    assert capsys.readouterr().out == shown


class OneGoodFlight:
    """A game in which one flight is paid and can be seen; it takes the place of :class:`patrols.Search`."""

    count, num_envs, good = 2, 16, 3

    def __init__(self):
        self.shown = np.zeros((self.num_envs, self.count, len(patrols.FLIGHTS), 1), np.float32)
        self.shown[:, :, self.good] = -1  # an untrained network flies another one

    def look(self):
        return self.shown

    def state(self):
        return self.shown[:, 0, 0]

    def step(self, flight):
        paid = (flight == patrols.FLIGHTS[self.good]).all(axis=2).sum(axis=1)
        return paid.astype(float), np.zeros(self.num_envs, bool), {"hits": paid}

    def redraw(self):
        pass


@pytest.mark.parametrize("learner", ["IPPO", "MAPPO", "QMIX"])
def test_learners_find_the_flight_that_is_paid(learner):
    with isolate_torch(0):
        game = OneGoodFlight()
        actor = torch.nn.Sequential(learners.make_network(1, 1, 8), torch.nn.Flatten(-2))
        if learner == "QMIX":
            learners.train_by_qmix(game, actor, decisions=2000)
        else:
            learners.train_by_ppo(game, actor, learner == "MAPPO", decisions=3000, rate=3e-3)
        flown = learners.fly_greedily(actor)(game)
    assert (flown == patrols.FLIGHTS[game.good]).all()


def test_one_who_is_alone_knows_the_same_but_not_where_the_others_are():
    team = teams.Team(3, observers=4)
    team.reset(0)
    team.step(patrols.sweep(team))
    together = team.look()
    team.alone = True
    differs = (team.look() != together).any(axis=(0, 1, 2))
    assert together.shape == (3, 4, 9, differs.size)
    assert differs.nonzero()[0].tolist() == [12, 13, 14, 15]  # the distances of four points to the next observer


def test_rows_of_the_protocol(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(protocol, "SCENARIOS", {"mates": protocol.Scenario({"observers": 2}, "stay", 1)})
    monkeypatch.setattr(teams, "GAMES", 4)
    how = ["--rows", str(tmp_path / "rows.csv"), "--trainings", "1", "--episodes", "3", "--decisions", "100"]
    protocol.main(how)
    shown = capsys.readouterr().out
    rows = read_rows(tmp_path / "rows.csv")
    assert (rows.groupby("flight").size() == 3).all()
    assert set(rows.flight) == {*protocol.LEARNERS, *protocol.SCRIPTED}
    assert "| oracle of heads | 1 | 1.00 (1.00–1.00) |" in shown
    assert "| random | 1 | 0.00 (0.00–0.00) |" in shown
    protocol.main(how)  # trains and plays nothing
    assert capsys.readouterr().out == shown


def test_team_mates_of_another_kind_fly_as_they_do():
    search = patrols.Search(5)
    search.reset(0)
    sweep, flight = patrols.sweep(search), protocol.fly_with_mates(patrols.sweep, "stay", 1)(search)
    np.testing.assert_array_equal(flight[:, 0], sweep[:, 0])
    assert not flight[:, 1:].any()

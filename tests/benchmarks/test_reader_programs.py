"""The programs that draw scenarios, probes, links and others' suites, or read recordings, each at a tiny size."""

import hacks
import numpy as np
import pandas as pd
import peers
import probing
import pytest
import recordings
import scenarios
import track_links
from paper.shared import read_rows
from sklearn.metrics import roc_auc_score

from usnet_env.tracks.found import DetectedWindow, Event, Link
from usnet_env.tracks.result import FoundLeaders


def test_no_code_that_draws_what_the_reader_learns_from_draws_its_tests():
    for program in (scenarios, peers):
        assert not [name for name, part in vars(program).items() if "detectors" in getattr(part, "__module__", "")]


def test_a_scenario_is_played_once_and_knows_its_leader(tmp_path):
    path = tmp_path / "rows.csv"
    words = ["--rows", str(path), "--files", "1", "--scenario", "star T100 1Hz N6", "chain of 6", "0 independent"]
    scenarios.main([*words, "--detector", "destroy-all"])
    rows, content = read_rows(path), path.read_bytes()
    led = rows[~rows.scenario.str.startswith("0")]
    assert set(led.due) == {1}
    assert (led.named_right == led.due).all()
    assert set(led.named_wrong) == {5}  # the relays of the chain too
    assert (rows[rows.scenario == "0 independent"].due == 0).all()
    scenarios.main([*words, "--detector", "destroy-all"])
    assert path.read_bytes() == content


@pytest.mark.parametrize("name", list(scenarios.SCENARIOS))
def test_every_scenario_flies(name):
    fly, *_ = scenarios.SCENARIOS[name]
    position, leader = fly((np.random.default_rng(0), 400, 0.1, 2))
    assert position.shape == (*leader.shape, 2)
    assert np.isfinite(position).all()
    assert (leader < 0).all() == name.startswith("0")


@pytest.mark.parametrize("name", list(peers.SUITES))
def test_every_suite_draws_links_without_loops(name):
    position, edges, leads = peers.SUITES[name](np.random.default_rng(1))
    assert position.shape[1] == len(edges) == len(leads)
    assert np.isfinite(position).all()
    assert not edges.diagonal().any()


def test_springs_pull_one_of_two_and_forces_find_them():
    position = peers.draw_springs(np.random.default_rng(0), np.array([[0.0, 1], [0, 0]]), 20)
    push = np.diff(position, n=2, axis=0)
    assert push[:, 1] == pytest.approx(0, abs=1e-12)  # nobody pulls it
    pull = position[1:-1, 1] - position[1:-1, 0]
    assert push[:, 0] == pytest.approx(0.1 * 0.1**2 * pull, rel=0.01, abs=1e-6)
    position, edges, _ = peers.SUITES["springs-5"](np.random.default_rng(5))
    off = ~np.eye(5, dtype=bool)
    assert roc_auc_score(edges[off], peers.fit_forces(position)[off]) > 0.7


def test_probers_are_played_and_listed_in_their_order(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(probing, "CELLS", {"short": {"observation_steps": 10}, "decoy": {"decoys": 1}})
    words = ["--rows", str(tmp_path / "rows.csv"), "--episodes", "1"]
    probing.main(words)
    capsys.readouterr()
    probing.main([*words, "--detector", "lagged-regression"])
    rows = read_rows(tmp_path / "rows.csv")
    assert set(rows.target) == {"guess", "none", "park", "random", "nearest", "oracle"}
    assert (rows[rows["cell"] == "short"].elapsed <= 10).all()
    assert rows.reward.between(-1.3, 0).all()
    assert capsys.readouterr().out.count("| short |") == 5 + 3


def walk(seed, count):
    turns = np.cumsum(np.random.default_rng(seed).normal(0, 0.06, count))
    return np.cumsum([np.cos(turns), np.sin(turns)], axis=1)


@pytest.fixture
def folder(tmp_path):
    films, parts = tmp_path / "termites/analysis/Rs/films", tmp_path / "platoons/data/OpenACC_data/mixed"
    films.mkdir(parents=True)
    parts.mkdir(parents=True)
    first, second = walk(1, 900)[:, 6:], walk(1, 900)[:, :-6]  # the second animal is where the first one was
    wide = pd.DataFrame({"position": range(894), "x0": first[0], "y0": first[1], "x1": second[0], "y1": second[1]})
    wide.to_csv(films / "a_tandem-position.csv", index=False)
    for name, cars in {"a_part1": (1, 2, 4), "a_part2": (2, 3)}.items():
        route, columns = walk(2, 1500), {"Time": np.arange(1400) / 10}
        for k, car in enumerate(cars):
            columns[f"E{car}"], columns[f"N{car}"] = route[:, 60 - 15 * k :][:, :1400]
        (parts / f"{name}.csv").write_text("Date,\n" * 5 + pd.DataFrame(columns).to_csv(index=False))
    return tmp_path


def test_who_leads_is_read_from_the_order_and_the_distance(folder):
    ((kind, _, pair),) = recordings.read_termites(folder / "termites")
    first, second = pair.drop_duplicates("id").id
    assert kind == "Rs"
    assert set(pair[pair.id == first].leader) == {""}
    assert set(pair[pair.id == second].leader) <= {first, ""}
    (seen, _, cars), (unseen, _, _) = recordings.read_platoons(folder / "platoons")
    assert (seen, unseen) == ("platoons", "platoons-unseen")
    order = cars.drop_duplicates("id")
    assert order.leader.tolist() == ["", *order.id[:2]]  # car 3 has no track: car 4 follows car 2


def test_rows_are_played_once_and_become_tables(folder, tmp_path):
    rows = tmp_path / "rows.csv.gz"
    call = [str(folder), "--rows", str(rows), "--detector", "lagged-network", "--detector"]
    recordings.main([*call, "destroy-all"])
    played = read_rows(rows)
    assert set(played["set"]) == {"Rs", "platoons", "platoons-unseen"}
    assert played.query("detector == 'destroy-all'").eval("named_right == heads").all()
    cars = played.query("set == 'platoons' and detector == 'lagged-network'")
    assert cars.named_right.mean() > 0.5
    recordings.main([*call, "reader"])
    again = read_rows(rows)
    pd.testing.assert_frame_equal(again[: len(played)], played)
    assert set(again[len(played) :].detector) == {"reader"}
    assert set(again[len(played) :].weights.str.len()) == {8}
    assert "| `reader` |" in recordings.report(again)


@pytest.mark.parametrize("kind", track_links.KINDS)
def test_a_follower_repeats_the_mean_velocity_of_the_ids_that_it_copies(kind):
    tracks, parents, delay = track_links.simulate_links(kind, 6, 10, False, 0)
    position = tracks.position.reshape(6, -1, 3)[..., :2]
    velocity, (leader, *_) = np.diff(position, axis=1), (i for i in range(6) if not parents[i])
    assert parents[leader] == []
    for i in (i for i in range(6) if parents[i]):
        lag = round(10 * delay[i])
        copied = velocity[parents[i]].mean(axis=0)
        assert np.corrcoef(velocity[i][lag:].ravel(), copied[:-lag].ravel())[0, 1] > 0.6


def test_links_are_counted_with_the_errors_of_their_delays():
    links = (
        Link(1, 0, 0, 1.1, 0.9, 1.3),  # right, and .1 s off
        Link(2, 0, 0, 2.0, 1.8, 2.2),  # wrong: it copies 1
        Link(3, 0, 0, None, direct=False),
    )
    found = FoundLeaders((DetectedWindow(0.0, 9.0, (), links=links),), (), "reader")
    counted = track_links.score_links(found, [[], [0], [1], [2]], np.array([0.0, 1.0, 1.0, 1.0]))
    assert counted == {
        "possible": 3, "links": 3, "drawn": 2, "right": 1,
        "delay_error": pytest.approx(0.1), "intervals": 1, "covered": 1,
    }  # fmt: skip


def test_a_change_is_found_once_in_time_and_with_both_leaders():
    events = [(62.0, 0, 1), (64.0, 0, 1), (130.0, 1, 0)]
    found = type("Found", (), {"events": [Event(time, "changes", (), old, new) for time, old, new in events]})
    counted = track_links.score_changes(found, [(range(8), [(0, 0), (60, 1), (120, 0)])])
    assert counted == {"changes": 2, "found": 1, "false": 2, "time_error": 2.0}


def test_the_tables_have_shares_of_links_with_the_file_as_unit(tmp_path, capsys):
    path = tmp_path / "rows.csv"
    rows = pd.DataFrame(
        {
            "kind": ["star", "star", "one change"], "ids": 6, "rate": 2, "strong": 0, "file": [0, 1, 0], "seed": 1,
            "possible": [10, 10, 0], "links": [10, 5, 0], "drawn": [5, 5, 0], "right": [4, 5, 0],
            "intervals": [4, 5, 0], "covered": [4, 5, 0],
            "delay_error": [0.1, 0.3, np.nan], "changes": [0, 0, 1], "found": [0, 0, 1],
            "false": [0, 0, 2], "time_error": [np.nan, np.nan, 1.0],
        }
    )  # fmt: skip
    rows.to_csv(path, index=False)
    track_links.main(["--rows", str(path), "--draw"])
    shown = capsys.readouterr().out
    assert "| star | 2 | 0.750 (" in shown
    assert "| 0.667 (" in shown
    assert "| one change | 1 | 1 | 1 | 2 | 1.0 |" in shown


def test_rules_without_links_earn_what_the_problem_says(monkeypatch):
    monkeypatch.setattr(hacks, "EPISODES", 6)

    def earn(game, rule):
        return [row["reward"] for row in hacks.play({"game": game, "rule": rule})]

    assert earn("P1 Tiny", "none") == [-1] * 6
    assert earn("P1 Tiny", "all") == [-7] * 6  # followers
    assert set(earn("P1 Tiny", "largest turns")) <= {0, -1}
    assert earn("evasion, heads choose at random", "all") == pytest.approx([-1 - 10 / 12] * 6)
    waited = [-0.2, -1.2]  # a rule that reads tracks watches until the window is full
    assert {round(reward, 6) for reward in earn("Probing, noise 1 m", "smallest turns")} <= set(waited)
    assert set(earn("Probing, noise 1 m", "one at random")) <= {0, -1}

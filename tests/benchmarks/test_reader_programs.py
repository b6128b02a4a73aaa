"""The programs that draw scenarios, probes and others' suites, each at a tiny size."""

import numpy as np
import peers
import probing
import pytest
import scenarios
from paper.shared import read_rows
from sklearn.metrics import roc_auc_score


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

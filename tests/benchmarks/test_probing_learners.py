"""What a network learns in probing: its belief, its actions, and by rewards."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import probing_learners as learners  # noqa: E402
from paper.shared import read_rows  # noqa: E402
from probing_network import ProbeNetwork, fly_nearest, measure  # noqa: E402


@pytest.fixture(scope="module")
def network():
    """A network with random weights in all layers."""
    network, rng = ProbeNetwork(), torch.Generator().manual_seed(0)
    for part in network.parameters():
        torch.nn.init.normal_(part, std=0.3, generator=rng)
    return network.requires_grad_(False)


@pytest.fixture(scope="module")
def looked():
    """Windows of 3 games after two looks, in which an intruder flew at UAVs, and the arguments."""
    envs = learners.make_games("the same, noise 1 m", 3, "Disabled")
    arguments, (seen, _) = envs.games[0].arguments, envs.reset(seed=0)
    for _ in range(9):
        seen, *_ = envs.step({"steer": fly_nearest(seen, np.full((3, 13), 1 / 13), arguments), "name": np.full(3, 13)})
    return seen, arguments


def test_a_belief_depends_on_neither_the_order_of_uavs_nor_the_orientation_nor_the_place(network, looked):
    seen, arguments = looked
    belief = network(*measure(seen, arguments))[0]
    assert belief.exp().sum(dim=1) == pytest.approx(1, abs=1e-5)
    assert belief.std(dim=1).min() > 0.01
    order, turn = (
        np.random.default_rng(0).permutation(13),
        np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0],
    )
    other = {name: part @ turn.astype(np.float32) for name, part in seen.items() if name != "elapsed"}
    other = {
        "elapsed": seen["elapsed"],
        "intruders": other["intruders"] + 50,
        "velocity": other["velocity"][:, :, order],
    }
    other["position"] = (seen["position"] @ turn.astype(np.float32) + 50)[:, :, order]
    np.testing.assert_allclose(network(*measure(other, arguments))[0], belief[:, order], atol=2e-3)


def test_a_full_window_is_answered_and_a_patient_agent_waits_until_then(network, looked):
    known, passed = measure(*looked)
    for share, named in ((0.9, 0), (1.0, 1)):
        passed[:, 1] = share
        chances = learners.weigh_actions(network, (known, passed), patient=True)[0].exp()
        assert chances.sum(dim=1) == pytest.approx(1, abs=1e-5)
        assert chances[:, :13].sum(dim=1) == pytest.approx(named, abs=1e-5)


def test_rewards_teach_a_policy_that_is_scored_in_fresh_games(monkeypatch, tmp_path, capsys):
    for name, value in {"PLAYED": 2, "SCORED": 2, "UPDATES": 3}.items():
        monkeypatch.setattr(learners, name, value)
    monkeypatch.setattr(learners, "OTHERS", {learners.CELL: {}, "5 followers": {"followers": 5}})
    learners.main(["--rows", str(tmp_path / "rows.csv"), "--trainings", "1"])
    rows = read_rows(tmp_path / "rows.csv")
    assert list(rows.decisions) == 2 * [0, 3 * 2 * 13, 3 * 2 * 13]
    assert rows.reward.between(-1.3, 0).all()
    assert rows[rows.start == "random"].elapsed.iloc[0] == 60  # a new policy waits
    envs = learners.make_games(learners.CELL, 2, "SameStep")
    nearest = learners.play_games(envs, learners.FRESH, learners.probe(learners.read_belief(), envs, True)).mean()
    assert rows[rows.start == "labels"].reward.iloc[0] == pytest.approx(nearest.reward, abs=1e-3)
    assert "| the belief | 5 followers | 1 |" in capsys.readouterr().out


def test_the_learned_belief_is_played_in_the_swarms_of_all_probers(network, monkeypatch):
    monkeypatch.setattr(learners, "SCORED", 2)
    monkeypatch.setattr(learners, "read_belief", lambda: network)
    rows = learners.play({"detector": "learned", "cell": "no noise", "target": "none"})
    assert [row["episode"] for row in rows] == [0, 1]
    assert set(rows[0]) == {"detector", "cell", "target", "episode", "right", "elapsed", "early", "belief", "reward"}
    assert all(row["reward"] == pytest.approx(row["right"] - 1 - 0.2 * row["elapsed"] / 60) for row in rows)

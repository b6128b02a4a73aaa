"""The programs that play suites, recorded tracks and speeds, each at a tiny size."""

import json
import re
import subprocess
from hashlib import sha256

import early
import learning
import numpy as np
import pandas as pd
import pytest
import small_field
import speed
import suites
import tracks
from paper.shared import RESULTS, read_rows

from usnet_env import results
from usnet_env.evaluation import load_suite
from usnet_env.evaluation.play import episode_seeds


@pytest.fixture
def suite():
    return load_suite("paper")


def make_rows(suite, detector, episodes=2, J=1.0):
    return pd.DataFrame(
        [
            {"cell": cell, "detector": detector, "episode": episode, "swarm_seed": 100 + episode, "J": J, "exact": 1}
            | {"f1_first": 1.0, "seconds_per_round": 0.1234567, "error": "", "rounds": 1}
            for cell in suite.cells
            for episode in range(episodes)
        ]
    )


def test_added_rows_replace_those_of_the_same_detector(suite, tmp_path):
    path = tmp_path / "paper.csv.gz"
    suites.pack(suite, [make_rows(suite, "b"), make_rows(suite, "a", J=3.0)], path)
    suites.pack(suite, [make_rows(suite, "a", episodes=1, J=2.0)], path)
    rows = read_rows(path)
    assert list(rows) == list(suites.COLUMNS)
    assert list(dict.fromkeys(rows["cell"])) == list(suite.cells)
    assert rows.groupby("detector").size().to_dict() == {"a": len(suite.cells), "b": 2 * len(suite.cells)}
    assert set(rows[rows.detector == "a"].J) == {2.0}
    assert set(rows.seconds_per_round) == {0.1235}


def test_a_failed_episode_keeps_its_reason(suite, tmp_path):
    path = tmp_path / "paper.csv.gz"
    rows = make_rows(suite, "a")
    rows.loc[0, ["J", "exact", "f1_first", "seconds_per_round"]] = float("nan")
    rows.loc[0, "error"] = "it took too long."
    suites.pack(suite, [rows], path)
    kept = read_rows(path)
    assert kept.error.notna().sum() == 1
    assert kept[kept.error.notna()][["J", "exact"]].isna().all().all()


def test_rows_of_other_swarms_or_with_gaps_are_refused(suite, tmp_path):
    path = tmp_path / "paper.csv.gz"
    suites.pack(suite, [make_rows(suite, "a")], path)
    content = path.read_bytes()
    with pytest.raises(ValueError, match="swarms"):
        suites.pack(suite, [make_rows(suite, "b").assign(swarm_seed=7)], path)
    with pytest.raises(ValueError, match="episodes"):
        suites.pack(suite, [make_rows(suite, "b").drop(index=0)], path)
    with pytest.raises(ValueError, match="all cells"):
        suites.pack(suite, [make_rows(suite, "b").query("cell == 'f1'")], path)
    assert path.read_bytes() == content


@pytest.mark.parametrize("path", sorted((RESULTS / "suites").glob("*-v*.csv.gz")), ids=lambda path: path.name)
def test_the_seed_of_published_rows_is_that_of_their_swarms(path, capsys):
    name, _, version = path.name.removesuffix(".csv.gz").rpartition("-v")
    assert int(version) == load_suite(name).version
    suites.main([name, "--print-seed"])
    seed, rows = int(capsys.readouterr().out), results(name).rows.drop_duplicates("episode")
    assert results(name).config["seed"] == seed
    assert [episode_seeds(seed, episode)[0] for episode in rows.episode] == list(rows.swarm_seed)


def test_a_seed_is_drawn_once_after_the_weights_were_committed(tmp_path):
    def git(*words):
        subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=a", *words], cwd=tmp_path, check=True)

    def commit(weights):
        path.write_text(re.sub("weights: .*", f"weights: {sha256(weights).hexdigest()}", path.read_text()))
        file.write_bytes(weights)
        git("add", ".")
        git("commit", "-qm", "weights")
        return int(load_suite(path).seed)

    path, file = tmp_path / "own.yaml", tmp_path / "reader.safetensors"
    path.write_text(
        "version: 1\npurpose: A.\nepisodes: 5\nseed: 5000\ntuning_seed: 7\nweights: none\n"
        "arguments: {follow_seed: 5000}\ncells: {a: {}}\n"
    )
    git("init", "-q")
    assert commit(b"1") == 5000
    drawn = suites.draw_seed(path, file)
    suite = load_suite(path)
    assert drawn == suite.seed == suite.cells["a"].arguments["follow_seed"] != 5000
    assert suite.tuning_seed == 7
    with pytest.raises(ValueError, match="must be committed"):
        suites.draw_seed(path, file)
    assert commit(b"1") == drawn
    with pytest.raises(ValueError, match="was drawn after these weights"):
        suites.draw_seed(path, file)
    file.write_bytes(b"2")
    with pytest.raises(ValueError, match=r"^weights in .* must be"):
        suites.draw_seed(path, file)
    assert commit(b"2") == drawn
    assert suites.draw_seed(path, file) == load_suite(path).seed != drawn


def test_a_suite_is_played_and_packed(tmp_path):
    words = ["--detector", "destroy-all", "--episodes", "1", "--out", str(tmp_path / "out"), "--results", str(tmp_path)]
    suites.main(["paper", *words, "--seed", "5"])
    (path,) = tmp_path.glob("*.csv.gz")
    rows = read_rows(path)
    assert len(rows) == len(load_suite("paper").cells)
    assert set(rows.swarm_seed) == {episode_seeds(5, 0)[0]}
    assert not rows.exact.any()
    assert rows.J.between(1, 2).all()
    (folder,) = (tmp_path / "out" / "paper").iterdir()
    suites.main(["paper", "--add", str(folder), "--results", str(tmp_path / "added")])
    assert (tmp_path / "added" / path.name).read_bytes() == path.read_bytes()


def test_recorded_tracks_are_compared_with_their_leaders(tmp_path):
    rng, lines = np.random.default_rng(0), ["id,t,x,y,leader"]
    flown = np.cumsum(rng.normal(0, 1, (400, 2)), axis=0)
    for k in range(1, 400):  # two ids repeat the flight of `lead` one sample later, 50 m away
        lines += [
            f"{name},{k / 2},{flown[k - 1][0]},{flown[k - 1][1] + away},lead" for name, away in (("a", 50), ("b", 90))
        ]
        lines.append(f"lead,{k / 2},{flown[k][0]},{flown[k][1]},")
    folder = tmp_path / "data" / "birds"
    folder.mkdir(parents=True)
    (folder / "flight.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    path = tmp_path / "tracks.csv.gz"
    words = [str(tmp_path / "data"), "--rows", str(path)]
    tracks.main([*words, "--detector", "destroy-all", "--detector", "lagged-regression"])
    rows = read_rows(path)
    assert set(rows["set"] + "/" + rows.recording) == {"birds/flight"}
    assert set(rows.chosen) == {0, 1}
    assert set(rows.heads) == {1}
    everyone, found = (rows[rows.detector == name] for name in ("destroy-all", "lagged-regression"))
    assert (set(everyone.named), set(everyone.named_heads)) == ({3}, {1})
    assert (found[found.chosen == 0].group_leader == 1).all()


def test_speed_keeps_the_parts_that_are_not_measured(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(speed, "EPISODES", 2)
    monkeypatch.setattr(speed, "DETECTORS", ("factions",))
    path = tmp_path / "speed.json"
    path.write_text(json.dumps({"field": {"kept": 1}}), encoding="utf-8")
    speed.main(["--parts", "kinematics", "detectors", "--turns", "1", "--out", str(path)])
    found = json.loads(path.read_text(encoding="utf-8"))
    assert found["field"] == {"kept": 1}
    assert set(found["kinematics"]) == {"varied_speed", "lagged", "limited", "layered"}
    assert all(row["ratio"] > 0 for row in found["kinematics"].values())
    assert set(found["detectors"]) == set(speed.DETECTORS)
    assert "kinematics" in capsys.readouterr().out


def test_detectors_are_compared_in_short_windows(tmp_path, monkeypatch):
    for name, value in {"EPISODES": 2, "STEPS": (10, 40), "DETECTORS": ("factions", "destroy-all")}.items():
        monkeypatch.setattr(early, name, value)
    monkeypatch.setattr(early, "PICTURE", tmp_path / "early.png")
    early.main(["--rows", str(tmp_path / "rows.csv")])
    rows = read_rows(tmp_path / "rows.csv")
    assert rows.groupby(["detector", "steps"]).size().to_dict() == dict.fromkeys(
        [(name, steps) for name in early.DETECTORS for steps in early.STEPS], 2
    )
    assert set(rows[(rows.detector == "factions") & (rows.steps == 40)].exact) == {1}
    assert (tmp_path / "early.png").stat().st_size


@pytest.mark.slow
def test_batches_race_single_environments(tmp_path, monkeypatch):
    pytest.importorskip("torchrl")
    pytest.importorskip("stable_baselines3")
    monkeypatch.setattr(speed, "GAMES", 2)
    monkeypatch.setattr(speed, "BATCHES", ("SingleCluster-Tiny-v0",))
    path = tmp_path / "speed.json"
    speed.main(["--parts", "batches", "--turns", "1", "--out", str(path)])
    rows = json.loads(path.read_text(encoding="utf-8"))["batches"]
    several = [*speed.SEVERAL, "usnet_evasion_v0, choices"]
    games = ["start of P1", "SingleCluster-Tiny-v0", "Field-v1, windows", *several, "Stable-Baselines3", "TorchRL"]
    assert list(rows) == games
    assert all(row["ratio"] > 0 and row["decisions_per_second"] > 0 for row in rows.values())


@pytest.mark.slow
def test_learning_trains_and_tests_agents_and_draws_their_curves(tmp_path, monkeypatch, capsys):
    pytest.importorskip("stable_baselines3")
    monkeypatch.setattr(learning, "EPISODES", 2)
    monkeypatch.setattr(learning, "PICTURE", tmp_path / "learning.png")
    short = learning.STUDIES["P1, f1, N = 8"]._replace(rounds=2 * learning.ROLLOUT, frameworks=(learning.SB3,))
    monkeypatch.setattr(learning, "STUDIES", {"short": short})
    learning.main(["--rows", str(tmp_path / "rows.csv"), "--seeds", "2"])
    rows = read_rows(tmp_path / "rows.csv")
    curves, tests = rows[rows.test.isna()], rows[rows.test.notna()]
    assert curves.groupby("seed").rounds.apply(list).tolist() == [[1024, 2048]] * 2
    assert curves.J.nunique() == 4  # the seeds differ
    assert tests.J.between(-8, 0).all()
    assert (tmp_path / "learning.png").stat().st_size
    assert "| short | Stable-Baselines3 | f1 | 2 | 2,048 |" in capsys.readouterr().out


@pytest.mark.slow
def test_ppo_and_detectors_play_the_same_small_field(tmp_path, monkeypatch, capsys):
    pytest.importorskip("stable_baselines3")
    monkeypatch.setattr(small_field, "EPISODES", 2)
    monkeypatch.setattr(small_field, "STUDY", small_field.STUDY._replace(rounds=learning.ROLLOUT))
    small_field.main(["--rows", str(tmp_path / "rows.csv"), "--trainings", "2", "--detector", "PPO", "destroy-all"])
    rows = read_rows(tmp_path / "rows.csv")
    assert rows.groupby(["detector", "training"]).size().to_dict() == {
        ("PPO", 0): 2,
        ("PPO", 1): 2,
        ("destroy-all", 0): 2,
    }
    assert "| `PPO` | 4 |" in capsys.readouterr().out

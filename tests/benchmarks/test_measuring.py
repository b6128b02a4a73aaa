"""The programs that play suites and their controls, recorded tracks and speeds, each at a tiny size."""

import json
import re
import subprocess
from hashlib import sha256

import leaks
import numpy as np
import pandas as pd
import pytest
import speed
import suites
import tracks
from paper import shared
from paper.shared import RESULTS, read_rows
from tables import suite_file

from usnet_env import results
from usnet_env.evaluation import evaluate_suite, list_suites, load_suite
from usnet_env.evaluation.play import episode_seeds

SUITE = load_suite("paper")


def make_rows(detector, episodes=2, J=1.0):
    return pd.DataFrame(
        [
            {"cell": cell, "detector": detector, "episode": episode, "swarm_seed": 100 + episode, "J": J, "exact": 1}
            | {"f1_first": 1.0, "seconds_per_round": 0.1234567, "error": "", "rounds": 1}
            for cell in SUITE.cells
            for episode in range(episodes)
        ]
    )


def test_rows_are_kept_when_a_game_fails(tmp_path):
    path, games = tmp_path / "rows.csv", [{"episode": number} for number in range(3)]

    def play(game):
        if game["episode"] == 2:
            raise KeyboardInterrupt
        return [{**game, "J": 1.0}]

    options = shared.make_parser(None, path).parse_args([])
    with pytest.raises(KeyboardInterrupt):
        shared.run_missing(options, games, play)
    assert list(read_rows(path).episode) == [0, 1]
    assert list(shared.run_missing(options, games, lambda game: [{**game, "J": 2.0}]).J) == [1.0, 1.0, 2.0]


def test_added_rows_replace_those_of_the_same_detector_and_keep_the_reasons_of_failures(tmp_path):
    path, failed = tmp_path / "paper.csv.gz", make_rows("a", episodes=1, J=2.0)
    failed.loc[0, ["J", "exact", "f1_first", "seconds_per_round"]] = float("nan")
    failed.loc[0, "error"] = "it took too long."
    suites.pack(SUITE, [make_rows("b"), make_rows("a", J=3.0)], path)
    suites.pack(SUITE, [failed], path)
    rows = read_rows(path)
    assert list(rows) == list(suites.COLUMNS)
    assert list(dict.fromkeys(rows["cell"])) == list(SUITE.cells)
    assert rows.groupby("detector").size().to_dict() == {"a": len(SUITE.cells), "b": 2 * len(SUITE.cells)}
    assert set(rows[rows.detector == "a"].J.dropna()) == {2.0}
    assert rows[rows.error.notna()][["J", "exact"]].isna().all().all()
    assert rows.error.notna().sum() == 1


def test_rows_of_other_swarms_or_with_gaps_are_refused(tmp_path):
    path, rows = tmp_path / "paper.csv.gz", make_rows("b")
    suites.pack(SUITE, [make_rows("a")], path)
    content = path.read_bytes()
    for wrong, reason in (
        (rows.assign(swarm_seed=7), "swarms"),
        (rows.drop(index=0), "episodes"),
        (rows.query("cell == 'f1'"), "cells"),
    ):
        with pytest.raises(ValueError, match=reason):
            suites.pack(SUITE, [wrong], path)
    assert path.read_bytes() == content


@pytest.mark.parametrize("path", sorted((RESULTS / "suites").glob("*-v*.csv.gz")), ids=lambda path: path.name)
def test_published_rows_are_of_all_cells_and_of_the_swarms_of_their_seed(path, capsys):
    name, _, version = path.name.removesuffix(".csv.gz").rpartition("-v")
    suite, published = load_suite(name), results(name)
    assert int(version) == suite.version
    suites.main([name, "--print-seed"])
    seed, rows = int(capsys.readouterr().out), published.rows
    assert (published.config["seed"], set(rows["cell"])) == (seed, set(suite.cells))
    assert (rows.groupby(["cell", "episode"]).swarm_seed.nunique() == 1).all()
    counts = rows.groupby(["detector", "cell"]).episode.agg(["size", "nunique", "max"])
    assert (counts["size"] == counts["nunique"]).all()
    assert (counts["size"] == counts["max"] + 1).all()
    first = rows.drop_duplicates("episode")
    assert [episode_seeds(seed, episode)[0] for episode in first.episode] == list(first.swarm_seed)


QUICK = ("sensing-v2", "tracker")
SUITES = "paper", "field-v3", "sensing-v2", "controls-v2"
OTHERS = {(name, cell) for name in SUITES for cell in load_suite(name).cells} - {QUICK}


@pytest.mark.parametrize(
    ("without", "name", "cell"),
    [
        ("gassl|neural", *QUICK),
        *(pytest.param("gassl|neural", *each, marks=pytest.mark.slow) for each in sorted(OTHERS)),
        pytest.param("mean", "paper", "f1", marks=pytest.mark.slow),
    ],
)
def test_published_rows_are_what_this_code_plays(without, name, cell):
    """The first episode of all detectors, but for those whose training takes too long."""
    published, columns = results(name), ["detector", "swarm_seed", "J", "exact", "f1_first"]
    known = published.rows.query("cell == @cell and episode == 0 and not detector.str.contains(@without)")
    known = known.assign(f1_first=known.f1_first.mask(known.exact == 1, 1.0))  # old rows have 0 for two empty sets
    seed, detectors = published.config["seed"], list(known.detector)
    played = evaluate_suite(name, detectors, cells=[cell], episodes=1, seed=seed).rows[columns]
    pd.testing.assert_frame_equal(played, known[columns].reset_index(drop=True), check_dtype=False, rtol=1e-3)


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
    with pytest.raises(ValueError, match="committed"):
        suites.draw_seed(path, file)
    assert commit(b"1") == drawn
    with pytest.raises(ValueError, match="weights"):
        suites.draw_seed(path, file)
    file.write_bytes(b"2")
    with pytest.raises(ValueError, match="weights"):
        suites.draw_seed(path, file)
    assert commit(b"2") == drawn
    assert suites.draw_seed(path, file) == load_suite(path).seed != drawn


def test_a_suite_is_played_and_packed(tmp_path):
    words = ["--detector", "destroy-all", "--episodes", "1", "--out", str(tmp_path / "out"), "--results", str(tmp_path)]
    suites.main(["paper", *words, "--seed", "5"])
    (path,) = tmp_path.glob("*.csv.gz")
    rows = read_rows(path)
    assert len(rows) == len(SUITE.cells)
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
        (x, y), away = flown[k - 1], {"a": 50, "b": 90}
        lines += [f"{name},{k / 2},{x},{y + far},lead" for name, far in away.items()]
        lines.append(f"lead,{k / 2},{flown[k][0]},{flown[k][1]},")
    folder, path = tmp_path / "data" / "birds", tmp_path / "tracks.csv.gz"
    folder.mkdir(parents=True)
    (folder / "flight.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = [str(tmp_path / "data"), "--rows", str(path), "--detector", "destroy-all"]
    tracks.main(words)
    kept = read_rows(path)
    tracks.main([*words, "lagged-regression"])
    rows = read_rows(path)
    everyone, found = (rows[rows.detector == name] for name in ("destroy-all", "lagged-regression"))
    assert list(everyone.seconds) == list(kept.seconds)  # they were not played again
    assert set(rows["set"] + "/" + rows.recording) == {"birds/flight"}
    assert set(rows.chosen) == {0, 1}
    assert set(rows.heads) == {1}
    assert (set(everyone.named), set(everyone.named_heads)) == ({3}, {1})
    assert (found[found.chosen == 0].group_leader == 1).all()


def test_speed_keeps_the_parts_that_are_not_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(speed, "EPISODES", 2)
    monkeypatch.setattr(speed, "TIMED", ("factions",))
    path = tmp_path / "speed.json"
    path.write_text(json.dumps({"field": {"kept": 1}}), encoding="utf-8")
    speed.main(["--parts", "kinematics", "detectors", "--turns", "1", "--out", str(path)])
    found = json.loads(path.read_text(encoding="utf-8"))
    assert found["field"] == {"kept": 1}
    assert all(row["ratio"] > 0 for row in found["kinematics"].values())
    assert set(found["detectors"]) == set(speed.TIMED)


CONTROLS = """
version: 1
purpose: A cell whose heads turn at random, and one whose heads, decoys and followers fly alike.
episodes: 1
seed: 1000
tuning_seed: 1
arguments: {clusters: 2, decoys: 1, uavs: 11, observation_steps: 40}
cells:
  told: {follow: f4, formation: around}
  hidden: {follow: f1, mobility: gauss_markov, head_jitter: true, formation: gathered, position_noise: 0.3}
  unled: {follow: reference, memory: 12}
"""


@pytest.fixture
def suite(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(CONTROLS, encoding="utf-8")
    return path


@pytest.mark.slow
def test_controls_tell_heads_where_something_gives_them_away(suite, tmp_path, capsys):
    words = ["--suite", str(suite), "--rows", str(tmp_path / "rows.csv")]
    leaks.main([*words, "--cell", "told", "--cell", "hidden", "--swarms", "24"])
    rows = read_rows(tmp_path / "rows.csv")
    found = rows.groupby("cell").mean(numeric_only=True)
    assert (rows.groupby("cell").size() == 24).all()
    assert found.auc_without_decoys["told"] > found.auc_track["told"] > 0.8  # decoys turn like heads
    assert found.auc_first["told"] > 0.7  # in the middle
    assert found.loc["hidden", leaks.AUCS].between(0.35, 0.65).all()
    assert found.all_track["told"] > found.all_track["hidden"]
    assert found.loc["hidden", ["strange_heads", "strange_followers"]].max() < 0.05  # tracks of strangers
    assert "| 2 | 1 |" in capsys.readouterr().out
    leaks.main([*words, "--cell", "told", "--cell", "unled", "--swarms", "3"])  # the first is there already
    again = read_rows(tmp_path / "rows.csv")
    assert again.groupby("cell").size().to_dict() == {"told": 24, "hidden": 24, "unled": 3}
    assert again[again.heads == 0][[*leaks.AUCS, "strange_heads"]].isna().all().all()


def test_strange_tracks_are_of_other_clusters_and_keep_their_roles(suite):
    env = leaks.shared.open_cell(str(suite), "hidden")
    for swarms, different in ((11, 11), (6, 6)):  # from a swarm at most one track, or from a cluster
        flown = leaks.observe_swarms(env, 1, swarms)
        window, role = leaks.meet_strangers(flown, 2)
        where = {
            window.position[:, i].tobytes(): (s, k)
            for s, (window, cluster) in enumerate(zip(flown.windows, flown.cluster, strict=True))
            for i, k in enumerate(cluster)
        }
        origins = [where[window.position[:, i].tobytes()] for i in range(window.uavs)]
        assert len(set(origins)) == window.uavs == 11
        assert len({swarm for swarm, _ in origins}) == different
        assert sorted(role) == sorted(flown.role[2])


def test_every_cell_of_every_suite_with_rows_has_controls():
    rows = read_rows(leaks.ROWS)
    known = set(rows[["suite", "version", "cell"]].itertuples(index=False, name=None))
    played = [suite for name, suite in list_suites().items() if suite_file(name).exists()]
    assert known == {(suite.name, suite.version, cell) for suite in played for cell in suite.cells}
    assert (rows.groupby(["suite", "cell"]).size() >= 24).all()
    hard = rows[rows.suite == "paper-hard"].groupby("cell").auc_track.mean()
    assert hard.max() < 0.6

"""Suites: their files do not change without a new version, and published rows load by name."""

import json
from hashlib import sha256
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from pandas.testing import assert_frame_equal
from sample_detectors import SUITE, Base, untimed

import usnet_env
from usnet_env import ArgumentError, Detection, evaluate
from usnet_env.evaluation import EvaluationResult, evaluate_suite, list_suites, load_suite
from usnet_env.evaluation.environments import make_environment
from usnet_env.swarm.open_follow import OPEN_LAWS
from usnet_env.swarm.second_follow import SECOND_LAWS

HASHES = json.loads((Path(__file__).parent / "data" / "suite_hashes.json").read_text())


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(SUITE)
    return path


def test_no_file_changed_without_a_new_version():
    """A change of what is played needs a new version, and a line in tests/evaluation/data/suite_hashes.json."""
    for name, suite in list_suites().items():
        played = json.dumps(suite.model_dump(exclude={"purpose", "unit", "weights"}), sort_keys=True)
        assert HASHES[name][str(suite.version)] == sha256(played.encode()).hexdigest()
        assert suite.version == max(map(int, HASHES[name]))


def test_every_cell_can_be_made_and_seeds_of_suites_differ():
    suites = list_suites().values()
    for suite in suites:
        for cell in suite.cells.values():
            make_environment(cell.env, cell.arguments).close()
    seeds = [seed for suite in suites for seed in (suite.seed, suite.tuning_seed)]
    assert len(set(seeds)) == len(seeds)


@pytest.mark.parametrize(("suite", "laws"), [("open", OPEN_LAWS), ("open-second", SECOND_LAWS)])
def test_a_suite_of_laws_has_all_of_them_with_the_constants_of_its_seed_and_names_the_weights(suite, laws):
    """New weights need a new draw: docs/suites.md, "The sealed draw", says how."""
    suite, shipped = load_suite(suite), files("detectors.reader").joinpath("data/reader.safetensors").read_bytes()
    assert sha256(shipped).hexdigest() == suite.weights, "new weights of the reader need a new draw"
    assert {name: cell.arguments["follow"] for name, cell in suite.cells.items()} == {name: name for name in laws}
    assert {cell.arguments["follow_seed"] for cell in suite.cells.values()} == {suite.seed}


def test_a_suite_extends_another_one(path, tmp_path):
    """What a file lacks is that of the other; arguments and cells are joined, and a cell's argument stays its own."""
    further = tmp_path / "further.yaml"
    more = "{purpose: More., seed: 5000, arguments: {clusters: 3, follow: f2}, cells: {last: {follow: f5}}}"
    further.write_text(f"{more[:-1]}, extends: {path}}}")
    base, suite = load_suite(path), load_suite(further)
    assert (suite.name, suite.purpose, suite.seed) == ("further", "More.", 5000)
    assert (suite.version, suite.episodes, suite.tuning_seed) == (base.version, base.episodes, base.tuning_seed)
    follow = {name: cell.arguments["follow"] for name, cell in suite.cells.items()}
    assert follow == {"plain": "f2", "run.json": "f4", "last": "f5"}
    assert {(cell.arguments["clusters"], cell.arguments["uavs"]) for cell in suite.cells.values()} == {(3, 12)}


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_suite_of_ones_own_is_played_kept_and_read(path, tmp_path, workers):
    detectors = ["lagged-regression", "none"]
    played = evaluate_suite(path, detectors, out=tmp_path / "run", workers=workers)
    assert repr(played) == "<EvaluationResult of own (version 2), 2 cells, 4 episodes of each detector>"
    assert played.cells == ["plain", "run.json"]
    for name, cell in load_suite(path).cells.items():  # the rows are those of the cell alone
        alone = evaluate(cell.env, detectors, env_kwargs=cell.arguments, episodes=2, seed=4711)
        rows = untimed(played)[played.rows["cell"] == name].drop(columns="cell").reset_index(drop=True)
        assert_frame_equal(rows, untimed(alone).drop(columns="cell"))
    assert "| plain | " in played.to_markdown("J")
    assert len(played.to_markdown("J").splitlines()) == 5
    assert_frame_equal(EvaluationResult.load(tmp_path / "run").rows, played.rows)
    more = evaluate_suite(path, "none", cells=["run.json"], episodes=3, out=tmp_path / "run")
    assert len(more.rows) == 9
    assert_frame_equal(untimed(evaluate_suite(path, detectors, out=tmp_path / "run")), untimed(more))
    with pytest.raises(ArgumentError, match=r"^out must be"):
        evaluate_suite("controls-v2", "none", out=tmp_path / "run")


class Sure(Base):
    """Names the first UAV, which leads."""

    def detect(self, window):
        first = np.arange(window.uavs) == 0
        return Detection(first, first * 1.0)


def test_a_suite_of_tracks_has_their_metrics_and_ranks_by_f1(path, tmp_path):
    rng = np.random.default_rng(1)
    place = np.cumsum(np.cumsum(rng.normal(0, 0.1, (400, 2)), axis=0), axis=0)
    rows = [f"b{i},{t},{place[t - 2 * i, 0]},{place[t - 2 * i, 1] + i},b0" for i in range(4) for t in range(10, 400)]
    (tmp_path / "tracks.csv").write_text("\n".join(["id,t,x,y,leader", *rows]))
    tracks = f"{{env: USNET/Tracks-v0, path: {tmp_path / 'tracks.csv'}, step: 1.0}}"
    path.write_text(
        SUITE.partition("arguments:")[0] + f"cells:\n  seen: {tracks}\n  made: {{env: USNET/SingleCluster-v0}}\n"
    )
    played = evaluate_suite(path, ["none", "destroy-all", Sure()], out=tmp_path / "run")
    means = played.rows.groupby(["cell", "detector"])["group_leader_first"].mean()
    assert means["seen", "Sure"] == 1.0
    assert np.isnan(means["made", "Sure"])
    assert [str(column.header) for column in played.ranking().columns][1] == "F1↑"
    assert_frame_equal(EvaluationResult.load(tmp_path / "run").rows, played.rows)
    (tmp_path / "unknown.csv").write_text("\n".join(["id,t,x,y", *(row.rpartition(",")[0] for row in rows)]))
    path.write_text(path.read_text() + f"  last: {tracks.replace('tracks.csv', 'unknown.csv')}\n")
    with pytest.raises(ArgumentError, match=r"^env must .*cell 'last'"):
        evaluate_suite(path, "none", out=tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_a_cell_that_was_drawn_at_random_has_swarms_of_its_own(path):
    """Otherwise an interval over the cells would leave out that they all met the same few swarms."""
    path.write_text(f"unit: cell{SUITE}")
    played = evaluate_suite(path, "none")
    assert (played.config["unit"], played.rows.swarm_seed.nunique()) == ("cell", 4)
    alone = untimed(evaluate_suite(path, "none", cells=["run.json"]))
    assert_frame_equal(alone, untimed(played)[2:].reset_index(drop=True))


@pytest.mark.parametrize(
    ("text", "argument"),
    [
        ("[1", "suite"),
        ("a: 1", "suite"),
        (SUITE + "  last: {follow: f99}\n", "follow"),
        (SUITE + "  last: {env: USNET/Multi}\n", "env"),
        (SUITE.replace("seed: 4711", "seed: 4"), "seed"),
        (SUITE.replace("purpose: A test.", ""), "purpose"),
        (SUITE + "extends: feld\n", "suite"),
        (SUITE + "name: mine\n", "suite"),
        (SUITE + "3: extra\n", "suite"),
        (SUITE + "extra: 3\n", "extra"),
    ],
)
def test_a_wrong_file_is_refused_in_one_sentence_before_anything_is_played(path, tmp_path, text, argument):
    path.write_text(text)
    with pytest.raises(ArgumentError, match=rf"^{argument} "):
        evaluate_suite(path, "none", out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_run_of_mine_joins_the_published_rows():
    published = usnet_env.results("paper")
    assert set(published.cells) == set(load_suite("paper").cells)
    mine = evaluate_suite("paper", {"mine": "none"}, seed=published.config["seed"], episodes=1)
    difference = published.merge(mine).compare("mine", "none", "J")
    assert (difference.episodes, difference.difference) == (len(published.cells), 0)


def test_a_suite_without_rows_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match=r"^suite must"):
        usnet_env.results("nowhere")
    (tmp_path / "own.yaml").write_text("extends: paper\nversion: 9999\n")
    with pytest.raises(ArgumentError, match=r"^suite must"):
        usnet_env.results(str(tmp_path / "own.yaml"))

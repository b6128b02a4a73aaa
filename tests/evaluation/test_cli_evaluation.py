"""The commands `usnet evaluate` and `usnet report`."""

import json
from pathlib import Path

import pytest
from sample_detectors import SUITE

from usnet_env.cli.options import parse_pairs
from usnet_env.evaluation import METRICS, EvaluationResult, evaluate
from usnet_env.replay import EpisodeRecord

HERE = Path(__file__).parent
SMALL = ["--set", "clusters=3", "uavs=20", "observation_steps=20", "max_rounds=5"]


@pytest.fixture
def played(run, tmp_path):
    words = ["evaluate", "--detector", "none", "--detector", "random(count=3)", "--trivial", "--episodes", "2", *SMALL]
    words += ["--out", tmp_path / "run"]
    assert run(*words)[0] == 0
    return words, tmp_path / "run"


def test_one_ranked_table_and_json_and_all_metrics(run, played):
    words, folder = played
    status, out, err = run(*words)
    assert (status, err) == (0, f"Rows and arguments are in {folder}.\n")
    lines = out.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines == [line.rstrip() for line in lines]
    assert next(line.split()[0] for line in lines[3:8]) == "destroy-all"
    status, out, err = run(*words, "--json")
    assert (status, err) == (0, "")
    summary = json.loads(out)
    labels = ["none", "random(count=3)", "destroy-all", "random", "one-per-round"]
    assert [entry["detector"] for entry in summary] == labels
    assert summary[2]["metrics"]["J"] == {"mean": 1.85, "low": 1.85, "high": 1.85}
    assert set(summary[1]["metrics"]) <= set(METRICS)
    settings = parse_pairs(SMALL[1:])
    (ours,) = evaluate("USNET/MultiCluster-v0", "random(count=3)", episodes=2, env_kwargs=settings).summary
    for entry in (ours, summary[1]):
        del entry["metrics"]["seconds_per_round"]
    assert ours == summary[1]
    out = run(*words, "--all")[1]
    for word in ("destroy-all", "J_m↓", "redundancy↓", "precision↑", "AP↑", "1.850"):
        assert word in out
    assert run(*words, "--seed", "9")[0] == 2


def test_pairs_may_stand_anywhere_and_stray_words_are_refused(run, refused, tmp_path):
    words = ["evaluate", "--detector", "none", "--episodes", "1", "--json"]
    one = run(*words, "--set", "clusters=2", "uavs=9", "--out", tmp_path, "--set=max_rounds=2")
    assert one[0] == 0, one
    (cell,) = json.loads((tmp_path / "run.json").read_text())["arguments"]["cells"].values()
    assert cell["arguments"] == {"clusters": 2, "uavs": 9, "max_rounds": 2}
    for bad in (["stray"], ["--set", "=f1"], ["--set", "uavs=9", "uavs=8"], ["--set", "follow=f99"]):
        refused(*words, *bad)


def test_a_suite_and_its_report(run, tmp_path):
    (tmp_path / "own.yaml").write_text(SUITE)
    words = ["evaluate", "--suite", tmp_path / "own.yaml", "--detector", "none", "--detector", "destroy-all"]
    status, out, _ = run(*words, "--out", tmp_path / "run", "--all")
    assert status == 0
    assert "own (version 2), 2 cells, 4 episodes of each detector" in " ".join(out.split())
    assert "run.json" in out
    status, out, err = run("report", tmp_path / "run", "--compare", "none", "--metric", "rounds")
    assert (status, err) == (0, "")
    assert "rounds of none minus destroy-all: +2 (" in out
    assert out.count("own (version 2), 2 cells") == 1
    markdown = run("report", tmp_path / "run", "--format", "markdown")[1]
    result = EvaluationResult.load(tmp_path / "run")
    assert markdown == f"{result.to_markdown()}\n{result.to_markdown('exact')}"
    status, _, err = run(*words, "--env", "USNET/SingleCluster-v0")
    assert status == 2
    assert "--suite" in err
    assert "--cell" in run("evaluate", "--detector", "none", "--cell", "plain")[2]
    assert "must be that of a run" in run("report", tmp_path)[2]


@pytest.mark.parametrize("suite", [False, True])
def test_a_detector_that_fails_everywhere_gives_status_2_and_one_sentence(run, monkeypatch, tmp_path, suite):
    monkeypatch.syspath_prepend(str(HERE))
    (tmp_path / "own.yaml").write_text(SUITE)
    words = ["evaluate", "--detector", "none", "--detector", "sample_detectors:FailingWithOne", "--episodes", "2"]
    words += ["--suite", tmp_path / "own.yaml"] if suite else SMALL
    status, out, err = run(*words)
    assert status == 2
    assert "\nnone " in out
    assert err.startswith("usnet: detector 'sample_detectors:FailingWithOne' failed in ")
    assert err.count("\n") == 1
    assert len(err) < 320
    words += ["--detector", "sample_detectors:AllAlive", "--out", tmp_path / "run"]
    status, out, err = run(*words, "--json")
    assert status == 2
    assert [entry["episodes"] for entry in json.loads(out)] == [4 if suite else 2, 0, 4 if suite else 2]
    status, out, err = run("report", tmp_path / "run", "--compare", "none")
    assert (status, out.count("J of none minus "), err.count(" is left out: it has no episode")) == (0, 1, 1)


def test_every_second_episode_is_recorded_as_it_was_played(run, tmp_path):
    words = ["evaluate", "--detector", "one-per-round", "--detector", "random(count=2)", "--episodes", "4", *SMALL]
    assert run(*words, "--out", tmp_path, "--record", "every=2")[0] == 0
    names = sorted(path.name for path in (tmp_path / "episodes").iterdir())
    assert names == [f"{name}-{number}.npz" for name in ("one-per-round", "random_count=2") for number in (0, 2)]
    record = EpisodeRecord.load(tmp_path / "episodes" / "one-per-round-2.npz")
    rows = EvaluationResult.load(tmp_path).rows
    (row,) = rows[(rows["detector"] == "one-per-round") & (rows["episode"] == 2)].to_dict("records")
    assert (record.seed, record.detector, record.rounds) == (row["swarm_seed"], "one-per-round", row["rounds"])
    assert run(*words, "--out", tmp_path / "worst", "--record", "worst")[0] == 0
    assert len(list((tmp_path / "worst" / "episodes").iterdir())) > 0
    for bad in (["--record", "some"], ["--record", "every=0", "--out", tmp_path], ["--record", "worst"]):
        assert "--record" in run(*words, *bad)[2]

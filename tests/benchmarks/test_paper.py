"""The programs of the paper's tables and figures, each at a tiny size."""

import numpy as np
import pandas as pd
import purity
import pytest
import rounds
import shared
import table2
from PIL import Image

from usnet_env.evaluation import evaluate
from usnet_env.objectives import purity as purity_of

REGRESSION = "lagged-regression(clusters=1)"
GAME = {"follow": "f1", "followers": 3, "decoys": 1, "mobility": "iid", "head_jitter": False}


@pytest.fixture
def run(tmp_path):
    """Runs a program with rows and pictures in a temporary folder, and returns its rows."""

    def run_program(program, *words):
        path = tmp_path / "rows.csv.gz"
        program.main([*words, "--rows", str(path), "--images", str(tmp_path)])
        return shared.read_rows(path)

    return run_program


def is_picture(path):
    with Image.open(path) as image:
        return image.width > 500 and len(image.convert("L").getcolors()) > 5


def test_detection_rates_go_on_where_they_stopped_and_are_the_committed_ones(run, tmp_path):
    words = ("--detector", REGRESSION, "--cells", "f6:2,f4:3")
    first = run(table2, *words, "--episodes", "2")
    whole = run(table2, *words, "--episodes", "3")
    assert (len(first), len(whole)) == (4, 6)
    kept = whole[whole.episode < 2].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, first)  # with their seconds: they were not played again
    assert is_picture(tmp_path / "detection-rates.png")
    keys = ["detector", *GAME, "episode"]
    known = shared.read_rows(shared.RESULTS / "paper" / "table2.csv.gz").merge(whole, on=keys, suffixes=("", "_again"))
    assert len(known) == 6
    assert (known.hit == known.hit_again).all()


@pytest.mark.parametrize(("detector", "named", "hit"), [("destroy-all", 1, 0), ("none", 0, 0), (REGRESSION, 1, 1)])
def test_a_hit_is_the_head_alone(detector, named, hit):
    for episode in range(2):
        (row,) = table2.play({"detector": detector, **GAME, "episode": episode}, seed=5)
        assert (row["named"], row["hit"]) == (named, hit)


def test_detectors_meet_the_same_swarms():
    game = GAME | {"episode": 1}
    seeds = {table2.make_seed(5, {"detector": name, **game}, 0) for name in ("a", "b")}
    assert len(seeds) == 1
    assert table2.make_seed(5, game, 1) not in seeds


def test_rounds_are_those_that_evaluate_plays(run, tmp_path):
    made = run(rounds, "--study", "example", "--detector", "random", "--episodes", "2").sort_values("episode")
    swarm = {"follow": "f1", "clusters": 8, "uavs": 185}
    played = evaluate("USNET/MultiCluster-v0", "random", env_kwargs=swarm, episodes=2, seed=2022).rows
    for metric in ("J", "rounds", "redundancy", "success", "ap_first"):
        np.testing.assert_allclose(made[metric], played[metric].astype(float), atol=1e-4)
    named, hits = (made[name].str.split().map(lambda counts: sum(map(int, counts))) for name in ("named", "hits"))
    assert ((named - hits) == made.redundant).all()
    assert is_picture(tmp_path / "rounds.png")


def test_the_paper_s_words_bound_the_metrics():
    words = pd.read_csv(rounds.WORDS, index_col="study")
    assert rounds.said("rounds", words.loc["follow"], 82) == (3, 4)
    assert rounds.said("J", words.loc["follow"], 82) == (pytest.approx(3 + 5 / 82), pytest.approx(4 + 5 / 82))
    assert rounds.said("rounds", words.loc["clusters"], 82) == (1, 7)  # the paper gives the largest value alone
    assert rounds.said("redundancy", words.loc["clusters"], 82) == (0, pytest.approx(18.2 / 82))


def test_purity_is_that_of_the_answered_clusters(run, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(purity, "purity", lambda root, labels: seen.append((root, labels)) or purity_of(root, labels))
    made = run(purity, "--clusterer", "kmeans", "--features", "scaled", "--follow", "f1", "--episodes", "2")
    assert set(made["count"]) == {"given", "gap"}
    assert (made[made["count"] == "given"].found == 5).all()
    assert sorted(made.purity) == pytest.approx(sorted(round(purity_of(*each), 4) for each in seen))
    assert is_picture(tmp_path / "purity.png")

"""The programs of the paper's tables and figures, each at a tiny size."""

import numpy as np
import pandas as pd
import pytest
import shared
from PIL import Image

from usnet_env.objectives import purity as purity_of

REGRESSION = "lagged-regression(clusters=1)"


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


def test_detection_rates_go_on_where_they_stopped(run, tmp_path):
    import table2

    words = ("--detector", REGRESSION, "--cells", "f1:2,f4:3")
    first = run(table2, *words, "--episodes", "2")
    assert len(first) == 4
    assert set(first.hit) == {1}
    whole = run(table2, *words, "--episodes", "3")
    assert len(whole) == 6
    kept = whole[whole.episode < 2].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, first)  # with their seconds: they were not played again
    assert is_picture(tmp_path / "detection-rates.png")


def test_committed_detection_rates_are_those_of_the_program(run):
    import table2

    keys = ["detector", "follow", "followers", "decoys", "mobility", "head_jitter", "episode"]
    made = run(table2, "--detector", REGRESSION, "--cells", "f6:2", "--episodes", "3")
    kept = shared.read_rows(shared.RESULTS / "paper" / "table2.csv.gz").merge(made, on=keys, suffixes=("", "_again"))
    assert len(kept) == 3
    assert (kept.hit == kept.hit_again).all()


@pytest.mark.parametrize(("detector", "named", "hit"), [("destroy-all", 1, 0), ("none", 0, 0), (REGRESSION, 1, 1)])
def test_a_hit_is_the_head_alone(detector, named, hit):
    import table2

    game = {"detector": detector, "follow": "f1", "followers": 3, "decoys": 1, "mobility": "iid", "head_jitter": False}
    for episode in range(2):
        (row,) = table2.play({**game, "episode": episode}, seed=5)
        assert (row["named"], row["hit"]) == (named, hit)


def test_rounds_are_those_that_evaluate_plays(run, tmp_path):
    import rounds

    from usnet_env.evaluation import evaluate

    made = run(rounds, "--study", "example", "--detector", "random", "--episodes", "2").sort_values("episode")
    how = {"env_kwargs": {"follow": "f1", "clusters": 8, "uavs": 185}, "episodes": 2, "seed": 2022}
    played = evaluate("USNET/MultiCluster-v0", "random", **how).rows
    for metric in ("J", "rounds", "redundancy", "success", "ap_first"):
        expected = [float(value) for value in played[metric]]
        np.testing.assert_allclose(made[metric], expected, atol=1e-4)
    named, hits = (made[name].str.split().map(lambda counts: sum(map(int, counts))) for name in ("named", "hits"))
    assert ((named - hits) == made.redundant).all()
    assert is_picture(tmp_path / "rounds.png")


def test_the_paper_s_words_bound_the_metrics():
    import rounds

    words = pd.read_csv(rounds.WORDS, index_col="study")
    assert rounds.said("rounds", words.loc["follow"], 82) == (3, 4)
    assert rounds.said("J", words.loc["follow"], 82) == (pytest.approx(3 + 5 / 82), pytest.approx(4 + 5 / 82))
    assert rounds.said("rounds", words.loc["clusters"], 82) == (1, 7)  # the paper gives the largest value alone
    assert rounds.said("redundancy", words.loc["clusters"], 82) == (0, pytest.approx(18.2 / 82))


def test_purity_is_that_of_the_answered_clusters(run, tmp_path, monkeypatch):
    import purity

    seen = []
    monkeypatch.setattr(purity, "purity", lambda root, labels: seen.append((root, labels)) or purity_of(root, labels))
    words = ("--clusterer", "kmeans", "--features", "scaled", "--follow", "f1", "--episodes", "2")
    made = run(purity, *words)
    assert set(made["count"]) == {"given", "gap"}
    assert (made[made["count"] == "given"].found == 5).all()
    assert sorted(made.purity) == pytest.approx(sorted(round(purity_of(*each), 4) for each in seen))
    assert is_picture(tmp_path / "purity.png")


def test_losses_have_a_curve_for_each_start(run, tmp_path, monkeypatch):
    pytest.importorskip("torch")
    import metric_learning

    monkeypatch.setattr(metric_learning, "FOLLOW", ("f1",))
    made = run(metric_learning, "--trainings", "2", "--strategies", "2", "--episodes", "2", "--steps", "2")
    counts = made.groupby(["start", "follow"]).size().unstack(fill_value=0)
    assert (counts.loc["random", "off-line"], counts.loc["meta", "off-line"]) == (0, 4)
    assert (counts["f1"] == 4).all()
    step, mean, half = metric_learning.curve_of(made, "joint", online=True)
    first = made[(made.start == "joint") & (made.follow != "off-line") & (made.step == 0)]
    by_training = first.groupby("training").loss.mean()
    assert list(step) == [0, 1]
    assert mean[0] == pytest.approx(by_training.mean())
    assert half[0] == pytest.approx(12.7062 * abs(by_training[0] - by_training[1]) / 2, rel=1e-4)
    assert is_picture(tmp_path / "meta-loss.png")


def test_attention_is_drawn_of_the_wanted_head(tmp_path):
    import attention

    scene = attention.find_scene("f1", 3, 2, seed=2022)
    assert scene.window.uavs == 4
    assert "Head: UAV 3" in scene.describe()
    attention.draw_heads(scene, tmp_path / "heads.png")
    attention.draw_hierarchy(scene, tmp_path / "hierarchy.png")
    assert is_picture(tmp_path / "heads.png")
    assert is_picture(tmp_path / "hierarchy.png")


def test_each_uav_is_below_the_one_it_attends_to_most():
    import attention

    weights = np.array([[0.9, 0.1, 0.0], [0.2, 0.5, 0.3], [0.0, 0.0, 1.0]])
    assert list(attention.list_leaders(weights)) == [1, 2, -1]  # not itself; no weight, no leader
    levels = attention.place_levels(np.array([False, True, False]))
    assert levels[1, 1] == 1
    assert (levels[[0, 2], 1] <= 0).all()


def test_the_example_is_drawn_round_by_round(tmp_path):
    import example

    example.main(["--detector", "one-per-round", "--clusters", "2", "--uavs", "12", "--images", str(tmp_path)])
    assert is_picture(tmp_path / "example-m2-n12.png")


def test_rows_are_kept_when_a_game_fails(tmp_path):
    path, games = tmp_path / "rows.csv", [{"episode": number} for number in range(3)]

    def play(game):
        if game["episode"] == 2:
            raise KeyboardInterrupt
        return [{**game, "J": 1.0}]

    given = shared.parse(None, path).parse_args([])
    with pytest.raises(KeyboardInterrupt):
        shared.measure(given, games, play)
    assert list(shared.read_rows(path).episode) == [0, 1]
    assert list(shared.measure(given, games, lambda game: [{**game, "J": 2.0}]).J) == [1.0, 1.0, 2.0]


def test_detectors_meet_the_same_swarms():
    import table2

    game = {"follow": "f1", "followers": 3, "decoys": 0, "mobility": "iid", "head_jitter": False, "episode": 1}
    seeds = {table2.make_seed(5, {"detector": name, **game}, 0) for name in ("a", "b")}
    assert len(seeds) == 1
    assert table2.make_seed(5, game, 1) not in seeds

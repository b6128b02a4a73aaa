"""Published tables say what the rows say; the programs of the paper's tables and figures at a tiny size."""

import re
import shutil

import numpy as np
import pandas as pd
import pivot
import purity
import pytest
import rounds
import shared
import table2
import tables
from paper.shared import ROOT, write_rows
from PIL import Image

from usnet_env.evaluation import evaluate, list_suites
from usnet_env.evaluation.stats import rate_interval
from usnet_env.objectives import purity as purity_of
from usnet_env.swarm.open_follow import OPEN_LAWS


def make_rows(**columns):
    return pd.DataFrame({"detector": ["b", "b", "a", "a"], "episode": [0, 1, 0, 1], **columns})


def test_a_table_has_a_line_for_each_group_in_the_order_of_the_rows():
    rows = make_rows(J=[1.0, 2.0, 3.0, np.nan], exact=[1, 1, 0, 1])
    columns = {"n": pivot.size, "J": pivot.mean("J", 1), "exact": pivot.rate("exact", count=True)}
    header, _, first, second = pivot.pivot(rows, {"detector": "detector"}, columns).splitlines()
    assert header == "| detector | n | J | exact |"
    assert first.startswith("| `b` | 2 | 1.5 (")
    assert first.endswith("| 100.0 % (34.2–100.0); 2 |")  # Wilson: 2 of 2
    assert second.startswith("| `a` | 2 | 3.0 | 50.0 % (")  # a single value has no interval


def test_a_cell_without_rows_or_values_is_a_dash():
    rows = make_rows(J=[1.0, 1.0, np.nan, np.nan], cell=["x", "x", "y", "y"])
    across = pivot.across("cell", ["x", "z"], pivot.mean("J"), "cell {}")
    assert list(across) == ["cell x", "cell z"]
    assert [say(rows) for say in across.values()] == ["1.00", "–"]
    assert pivot.mean("J")(rows[2:]) == pivot.median("J")(rows[2:]) == "–"


def test_only_the_blocks_of_a_page_are_replaced():
    page = "By hand.\n\n<!-- results:begin purity -->\nold\n<!-- results:end -->\n\nBy hand, too.\n"
    filled = tables.fill(page)
    assert filled.startswith("By hand.\n\n<!-- results:begin purity -->\n\n| clusterer | M |")
    assert filled.endswith("|\n\n<!-- results:end -->\n\nBy hand, too.\n")
    assert tables.fill(filled) == filled
    with pytest.raises(KeyError, match="unknown"):
        tables.fill("<!-- results:begin unknown -->\n<!-- results:end -->")


@pytest.fixture
def copy(tmp_path, monkeypatch):
    """A copy of a page whose tables are quick to make."""
    names = ("docs/results/tracks.md",)
    monkeypatch.setattr(tables, "PAGES", names)
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def test_a_changed_number_is_found_and_mended(copy, capsys):
    page = copy / "docs/results/tracks.md"
    text = page.read_text(encoding="utf-8")
    assert "`mflica` | 282; 27" in text
    page.write_text(text.replace("`mflica` | 282; 27", "`mflica` | 283; 27"), encoding="utf-8")
    assert tables.main(["--check"], copy) == 1
    assert "tracks.md" in capsys.readouterr().err
    assert tables.main([], copy) == 0
    assert page.read_text(encoding="utf-8") == text


def test_every_page_has_known_blocks_and_every_block_a_page():
    pages = [(ROOT / page).read_text(encoding="utf-8") for page in tables.PAGES]
    found = [name for page in pages for _, name in tables.BLOCK.findall(page)]
    assert sorted(found) == sorted(tables.BLOCKS)


def test_a_failed_episode_is_not_exact_and_has_no_other_metric():
    rows = tables.read_suite("scale")
    failed = rows[rows.error.notna()]
    assert len(failed)
    assert not failed.exact.any()
    assert failed.J.isna().all()
    (line,) = [line for line in tables.scale_block().splitlines() if "`gassl(" in line]
    assert line.endswith("| – | – | – | – |")


def test_laws_are_the_unit_of_the_tables_of_open(tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "RESULTS", tmp_path)
    monkeypatch.setattr(tables, "read_suite", tables.read_suite.__wrapped__)  # without its memory
    assert tables.suite_block("open") == "This version has no rows yet."
    suite = list_suites()["open"]
    games = [(cell, episode) for cell in suite.cells for episode in range(suite.episodes)]
    rows = pd.DataFrame(games, columns=["cell", "episode"]).assign(detector="reader", J=1.0, seconds_per_round=0.1)
    rows["exact"] = rows["f1_first"] = rows["cell"].map(lambda name: int(OPEN_LAWS[name].answers == "turns alike"))
    write_rows(tables.suite_file("open"), rows)
    lines = tables.suite_block("open").splitlines()
    low, high = (100 * end for end in rate_interval([1] * 12 + [0] * 71)[1:])
    assert lines[2].startswith(f"| `reader` | 415 | 14.5 % ({low:.1f}–{high:.1f}) |")
    assert "| turns alike | 12 | – | 100.0 % (75.8–100.0) | – |" in "\n".join(lines)
    counts = [int(line.split("|")[2]) for line in lines[3:] if re.match(r"\| [a-z ]+ \| \d", line)]
    assert (len(counts), sum(counts)) == (7 + 3 + 4 + 2, 4 * 83)  # the last table: given away or not


def test_the_paper_s_rates_are_rows_of_1000_runs():
    import paper_tables

    rows = paper_tables.read_table2()
    paper = rows[(rows.detector == "the paper") & (rows.follow == "f4") & (rows.followers == 2)]
    assert (len(paper), paper.hit.sum()) == (1000, 920)
    assert "70,000 | 98.9 % (98.8–98.9) |" in paper_tables.table2_block()  # Wilson's
    assert "| the paper | 98.9; 70,000 |" in paper_tables.paper_algorithms()
    assert "3.06–4.06; – |" in paper_tables.paper_algorithms()


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
    assert rounds.find_bounds("rounds", words.loc["follow"], 82) == (3, 4)
    assert rounds.find_bounds("J", words.loc["follow"], 82) == (pytest.approx(3 + 5 / 82), pytest.approx(4 + 5 / 82))
    assert rounds.find_bounds("rounds", words.loc["clusters"], 82) == (1, 7)  # the paper gives the largest value alone
    assert rounds.find_bounds("redundancy", words.loc["clusters"], 82) == (0, pytest.approx(18.2 / 82))


def test_purity_is_that_of_the_answered_clusters(run, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(purity, "purity", lambda root, labels: seen.append((root, labels)) or purity_of(root, labels))
    made = run(purity, "--clusterer", "kmeans", "--features", "scaled", "--follow", "f1", "--episodes", "2")
    assert set(made["count"]) == {"given", "gap"}
    assert (made[made["count"] == "given"].found == 5).all()
    assert sorted(made.purity) == pytest.approx(sorted(round(purity_of(*each), 4) for each in seen))
    assert is_picture(tmp_path / "purity.png")

"""Published tables: they say what the rows say, and a page that differs is found."""

import re
import shutil

import numpy as np
import pandas as pd
import pivot
import pytest
import tables
from paper.shared import ROOT, write_rows

from usnet_env.evaluation import list_suites
from usnet_env.evaluation.stats import rate_interval
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
    assert tables.main(["--check"], copy) == 0
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
    assert (len(counts), sum(counts)) == (7 + 3 + 4, 3 * 83)


def test_the_paper_s_rates_are_rows_of_1000_runs():
    import paper_tables

    rows = paper_tables.read_table2()
    paper = rows[(rows.detector == "the paper") & (rows.follow == "f4") & (rows.followers == 2)]
    assert (len(paper), paper.hit.sum()) == (1000, 920)
    assert "70,000 | 98.9 % (98.8–98.9) |" in paper_tables.table2_block()  # Wilson's
    assert "| the paper | 98.9; 70,000 |" in paper_tables.paper_algorithms()
    assert "3.06–4.06; – |" in paper_tables.paper_algorithms()

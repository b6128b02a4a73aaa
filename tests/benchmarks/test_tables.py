"""The published tables are those that the committed rows give."""

import sys
from pathlib import Path

import pytest
import tables
from result_pages import p1, real_tracks, tiers

from detectors.studies import table2
from usnet_env.evaluation import load_suite

ROOT = Path(__file__).parents[2]
LONG = {"docs/results/purity.md", "docs/results/p1.md", "docs/results/follow_mixture_cells.md"}
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n in LONG else []) for n in tables.PAGES])
def test_page_is_what_the_rows_give(name: str) -> None:
    assert (ROOT / name).read_text(encoding="utf-8") == tables.PAGES[name]()


@pytest.mark.skipif(tables.BEGIN not in README, reason="README.md has no table of results")
def test_readme_is_what_the_rows_give() -> None:
    assert tables.readme(README) == README


def test_readme_has_at_most_eight_detectors_with_trivial_policies_and_the_paper_in_its_own_table() -> None:
    _, suites, _, detectors, _, paper = tables.index.summary(short=True).split("\n\n")
    assert [line.split("|")[1].strip(" `") for line in suites.splitlines()[2:]] == list(tables.index.SUITES)
    lines = detectors.splitlines()[2:]
    assert len(lines) <= 8
    labels = ("follow-mixture`", "follow-mixture(policy='map')`", "learned(policy='map')`", "destroy-all`", "none`")
    for label in (*labels, "random`"):
        assert any(label in line for line in lines), label
    assert [line.split("|")[1].strip() for line in paper.splitlines()[2:]] == [
        "the paper",
        "`gassl` and `mc-gassl`, as printed",
        "`random`, one UAV a round",
        "`destroy-all`",
    ]


def test_trivial_rows_are_computed_from_what_the_rows_hold() -> None:
    swarms = [table2.Cell("gassl", "f1", m, d) for m, d in ((2, 0), (2, 1), (15, 1))]
    assert p1.chance(swarms) == pytest.approx((1 / 3 + 1 / 4 + 1 / 17) / 3)
    windows = [{"recording": "a", "uavs": "2", "heads": "1"}, {"recording": "b", "uavs": "4", "heads": "1"}]
    none, everything = real_tracks._computed(windows)
    assert none[:5] == ("`none`, computed", "2; 2", "0.38", "0.00", "–")
    assert everything[3].startswith("3.00")
    assert everything[4] == "33%"


def test_every_suite_says_how_many_settings_of_how_many_detectors_it_compares() -> None:
    names = {row["detector"] for row in tables.suites.read_suite(load_suite("field"))}
    detectors = {name.partition("(")[0] for name in names}
    assert f"best of {len(names)} settings of {len(detectors)} detectors" in README


def test_readme_without_markers_is_refused() -> None:
    with pytest.raises(ValueError, match="results:begin"):
        tables.readme("# A page\n")


def test_check_names_what_differs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    monkeypatch.setattr(tables, "PAGES", {"page.md": lambda: "as the rows say\n"})
    (tmp_path / "page.md").write_text("as somebody wrote\n")
    (tmp_path / "README.md").write_text(f"{tables.BEGIN}old\n{tables.END}")
    monkeypatch.setattr(sys, "argv", ["tables.py", "--check"])
    assert tables.main() == 1
    assert "page.md differs" in (errors := capsys.readouterr().err)
    assert "README.md differs" in errors
    assert (tmp_path / "page.md").read_text() == "as somebody wrote\n"
    monkeypatch.setattr(sys, "argv", ["tables.py"])
    assert tables.main() == 0
    monkeypatch.setattr(sys, "argv", ["tables.py", "--check"])
    assert tables.main() == 0


def test_labels_are_what_was_played() -> None:
    """Where the policy changes the answer, a row's label must say which policy played: `map` may name no UAV."""
    for tier in ("silence", "shifted"):
        for row in tiers.tier_rows(tier):
            if row["detector"] in ("follow-mixture", "learned"):
                assert int(row["named"]) >= 1, row
    default = {(r["cell"], r["episode"]): r for r in tiers.of(tiers.tier_rows("silence"), "follow-mixture")}
    most_likely = {(r["cell"], r["episode"]): r for r in tiers.of(tiers.tier_rows("silence"), tiers.MAP)}
    both = default.keys() & most_likely.keys()
    assert len(both) >= 30
    assert sum(default[key]["named"] != most_likely[key]["named"] for key in both) > 0.9 * len(both)


def test_check_of_the_command_line_knows_its_options(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["tables.py", "--help"])
    with pytest.raises(SystemExit, match=r"^0$"):
        tables.main()
    assert "--check" in capsys.readouterr().out

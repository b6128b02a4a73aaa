"""The page that compares both cores of follow-mixture is made of the rows that both have."""

import gzip
from pathlib import Path

import follow_mixture
import pytest
from result_pages import cores
from running import read_csv


def row(cell: str, episode: int, **values: object) -> dict[str, str]:
    known = {"tier": cell.partition(" ")[0], "cell": cell.partition(" ")[2], "detector": "follow-mixture"}
    known |= {"seed": "4242", "episode": episode, "uavs": 10, "heads": 1, "J": 1.0, "exact": 1, "seconds": 0.1}
    return dict.fromkeys(follow_mixture.COLUMNS, "") | {name: str(value) for name, value in (known | values).items()}


FORMER = [
    row("short f1-T8", 0, J=2.0, exact=0),
    row("short f2-T8", 0),
    row("short f1-T20", 0, seconds=0.3),
    row("paper f1", 0, seconds=0.5),
    row("paper f1", 1),
    row("P1 f1-m2-d0", 0, J=0.0),
]
PRESENT = [
    row("P1 f1-m2-d0", 0, J=-1.0, exact=0),
    row("paper f1", 0, seconds=0.25),
    row("short f1-T8", 0),
    row("short f2-T8", 0, J=1.5, exact=0),
    row("short f1-T20", 0),
    row("sizes f1-M2-N20", 0),
]


def cells_of(table: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]


def test_only_episodes_that_both_played_count_in_the_order_of_the_tiers() -> None:
    pairs = cores.paired(FORMER, PRESENT)
    assert [(old["tier"], old["cell"]) for old, _ in pairs] == [
        ("paper", "f1"), ("short", "f1-T8"), ("short", "f2-T8"), ("short", "f1-T20"), ("P1", "f1-m2-d0"),
    ]  # fmt: skip
    assert all(old["cell"] == new["cell"] for old, new in pairs)


def test_a_line_has_both_cores_and_the_cell_that_is_worse_by_most() -> None:
    paper, short, single = cells_of(cores.compare(cores.paired(FORMER, PRESENT), lambda row: (row["tier"],)))
    assert paper[:2] == ["paper", "1"]
    assert paper[6:] == ["1.900", "+0.000 (+0.000 to +0.000)", "0.500", "0.250", "none"]
    assert short[:2] == ["short", "3"]
    assert short[2].startswith("66.7 %")
    assert short[3].startswith("66.7 %")
    assert short[4:6] == ["1.333", "1.167"]
    assert short[7].startswith("-0.167")
    assert short[10] == "f2-T8: 0.500"
    assert single[10] == "f1-m2-d0: 1.000"  # J_s is better when higher


@pytest.mark.parametrize(
    ("cell", "heads", "cost"), [("paper f1", 5, 1.5), ("P1 f1-m8-d1", 1, -9.0), ("silence none-iid-jitter", 0, 10.0)]
)
def test_cost_of_destroying_all_follows_from_the_numbers_of_uavs_and_heads(cell: str, heads: int, cost: float) -> None:
    assert cores._cost_of_all(row(cell, 0, heads=heads)) == cost


def test_rows_of_all_tiers_are_packed_into_one_file(tmp_path: Path) -> None:
    for tier in ("short", "paper"):
        lines = [",".join(follow_mixture.COLUMNS)]
        lines += [",".join(one.values()) for one in FORMER if one["tier"] == tier]
        (tmp_path / f"{tier}.csv").write_text("\n".join([*lines, "paper,f1,follow-mixture,4242"]))
    for name in ("one.csv.gz", "two.csv.gz"):
        follow_mixture.pack_rows(tmp_path, tmp_path / name)
    assert (tmp_path / "one.csv.gz").read_bytes() == (tmp_path / "two.csv.gz").read_bytes()
    assert read_csv(tmp_path / "one.csv.gz") == [*FORMER[3:5], *FORMER[:3]]
    assert gzip.decompress((tmp_path / "one.csv.gz").read_bytes()).startswith(b"tier,cell,")


def test_the_page_is_made_of_both_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cores, "RESULTS", tmp_path)
    for rows, name in zip((FORMER, PRESENT), cores.FILES, strict=True):
        folder = tmp_path / name.partition("/")[0]
        folder.mkdir(exist_ok=True)
        lines = [",".join(follow_mixture.COLUMNS), *(",".join(one.values()) for one in rows)]
        (tmp_path / name).write_bytes(gzip.compress("\n".join(lines).encode()))
    text = cores.text()
    assert "| short (seed 4242) | 3 |" in text
    assert "| short T8 (seed 4242) | 2 |" in text
    assert "sizes" not in text.partition("## Raw rows")[0]

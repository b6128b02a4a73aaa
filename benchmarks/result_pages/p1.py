"""P1: detection rates over the cells of the paper's Table II (detection rate of GASSL)."""

from __future__ import annotations

from collections.abc import Iterable
from statistics import fmean

from detectors.studies.table2 import FOLLOWERS, Cell, Row, fill_table, rate_of, read_paper, report_rates
from running import RESULTS
from usnet_env.evaluation.report import group_rows
from usnet_env.evaluation.suite import read_rows

from result_pages.text import demoted, page, picture, row_files, share, table
from usnet_env.config import format_count

FILES = row_files(RESULTS / "table2", "episodes")
CHANCE = "one UAV at random, computed"


def heads(row: Row) -> str:
    """How the heads fly."""
    return row.mobility + (" with jitter" if row.head_jitter else "")


def chance(rows: Iterable[Cell]) -> float:
    """The probability that one UAV at random is the head, over the episodes of the rows."""
    return fmean(1 / row.uavs for row in rows)


def at_random() -> str:
    """The probability that one UAV at random is the head, by the number of decoys and followers."""
    lines = [
        (str(decoys), *(f"{100 / (followers + 1 + decoys):.1f} %" for followers in FOLLOWERS)) for decoys in (0, 1, 3)
    ]
    return table((f"decoys; {CHANCE}", *(f"m={followers}" for followers in FOLLOWERS)), lines)


def overview() -> str:
    """A line for each file and detector, over all its cells."""
    theirs = [rate.mean for rate in read_paper().values()]
    sizes = [1 / (followers + 1) for _, followers in read_paper()]
    mean, least = 100 * sum(theirs) / len(theirs), 100 * min(theirs)
    about = ("the paper's table", "iid", "0", "70", "70,000")
    lines = [(*about, f"{mean:.1f} %", f"{least:.1f} %, n = 1,000", f"{100 * fmean(sizes):.1f} %")]
    for path in FILES:
        rows = read_rows(path, Row)
        for detector, own in group_rows(rows, lambda row: row.detector).items():
            cells = group_rows(own, lambda row: (row.follow, row.followers))
            count, overall = rate_of(own)
            few, lowest = rate_of(min(cells.values(), key=lambda some: sum(row.hit for row in some) / len(some)))
            swarms = (heads(own[0]), str(own[0].decoys), str(len(cells)))
            rates = (share(overall), f"{share(lowest)}, n = {few}", f"{100 * chance(own):.1f} %")
            lines.append((f"`{detector}`", *swarms, f"{count:,}", *rates))
    return table(("detector", "heads", "decoys", "cells", "n", "head alone named", "lowest cell", CHANCE), lines)


def text() -> str:
    parts = []
    for path in FILES:
        rows = read_rows(path, Row)
        first = rows[0]
        parts += [
            f"## {heads(first)} heads, {format_count(first.decoys, 'decoy')}",
            demoted(report_rates(fill_table(rows), "", with_paper=path.name.startswith("episodes-seed"))),
        ]
        if path.with_suffix(".png").exists():  # of the files with several detectors
            parts.append(picture("Rates against the number of followers", f"table2/{path.stem}.png"))
    return page(
        "P1: detection rates",
        "One cluster, one window: how often the head is named, and no other UAV. The cells are those of the paper's "
        "table of detection rates (f1–f7, m = 2 to 50 followers). The paper gives 1,000 runs for each cell. Without a "
        "decoy the head is the only UAV that no other UAV resembles; a decoy is a second UAV of this kind. With m "
        "followers and d decoys, one UAV that is named at random is the head with probability 1 / (m + 1 + d); the "
        "last column is the mean over the episodes of the row. `none` and `destroy-all` never name the head alone.",
        overview(),
        at_random(),
        *parts,
        files=[f"table2/{path.name}" for path in FILES],
    )

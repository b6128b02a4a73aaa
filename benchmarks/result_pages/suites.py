"""Every detector in every cell of the frozen suites."""

from __future__ import annotations

import csv
import gzip
import io
from statistics import median

from result_pages.text import RESULTS, Row, mean_of, page, read_csv, share_of, source, table
from usnet_env.evaluation import TRIVIAL, FrozenSuite, list_suites
from usnet_env.evaluation.report import format_interval, group_rows
from usnet_env.evaluation.statistics import rate_interval

SOLVED = 0.95  # a suite is solved if every detector but the trivial policies is exact this often


def text() -> str:
    """The page."""
    parts, made = [], []
    for suite in list_suites().values():
        if rows := read_suite(suite):
            parts += _describe(suite, rows)
            made.append(_file(suite))
    return page(
        "Frozen suites",
        "[Frozen suites](../suites.md) are lists of environments with a version. All detectors met the same swarms, "
        "each in a process of its own; M was not given. *Exact* is the share of episodes in which round 1 names all "
        "heads and no other UAV. Seconds are the median of one answer on a shared machine. *One track* is the area "
        "under the curve of a classifier that sees the track of one UAV at a time: 0.5 is chance, and at 1 every head "
        "can be recognised without looking at any other UAV. A detector may then have learned how heads fly, and not "
        "who leads; no detector of this project is trained on these cells.",
        *parts,
        "## Raw rows and commands",
        source([*made, "leak_probe.csv"]),
    )


def read_suite(suite: FrozenSuite) -> list[Row]:
    """The committed rows of the suite's version; none if it was not played."""
    path = RESULTS / _file(suite)
    return list(csv.DictReader(io.StringIO(gzip.decompress(path.read_bytes()).decode()))) if path.exists() else []


def _file(suite: FrozenSuite) -> str:
    return f"suites/{suite.name}-v{suite.version}.csv.gz"


def is_solved(rows: list[Row]) -> bool:
    """Whether all detectors, the trivial policies apart, solve the suite."""
    rates = [
        _rate(own)
        for name, own in group_rows(rows, lambda row: row["detector"]).items()
        if name.split("(")[0] not in TRIVIAL
    ]
    return min(rates) >= SOLVED


def _describe(suite: FrozenSuite, rows: list[Row]) -> list[str]:
    """The summary of a suite, and its cells."""
    by_detector = group_rows(rows, lambda row: row["detector"])
    order = sorted(
        by_detector, key=lambda name: -sum(float(r["exact"]) for r in by_detector[name]) / len(by_detector[name])
    )
    lines = [
        (
            f"`{name}`",
            str(len(by_detector[name])),
            str(len({row["cell"] for row in by_detector[name]})),
            share_of([int(row["exact"]) for row in by_detector[name]]),
            mean_of(by_detector[name], "f1_first"),
            mean_of(by_detector[name], "J"),
            f"{median(float(row['seconds_per_round']) for row in by_detector[name]):.2g}",
        )
        for name in order
    ]
    cells = group_rows(rows, lambda row: (row["cell"], row["detector"]))
    leaks = _read_leaks()
    body = [
        (
            cell,
            leaks.get((suite.name, cell, str(suite.version)), "–"),
            *(_exact(cells.get((cell, name), [])) for name in order),
        )
        for cell in suite.cells
        if any((cell, name) in cells for name in order)
    ]
    solved = " This suite is *solved*: every detector but the trivial policies is exact in 95 % of the episodes."
    return [
        f"## {suite.label}",
        f"{suite.purpose} SHA-256 of the file: `{suite.digest[:16]}…`.{solved if is_solved(rows) else ''}",
        table(("detector", "n", "cells", "exact", "F1 in round 1", "J", "seconds"), lines),
        f"### {suite.name}: exact by cell, in percent",
        table(("cell", "one track", *(f"`{name}`" for name in order)), body),
    ]


def _rate(rows: list[Row]) -> float:
    """The share of exact episodes."""
    return sum(int(row["exact"]) for row in rows) / len(rows)


def _exact(rows: list[Row]) -> str:
    """The rate of a cell in percent with its interval, and n."""
    if not rows:
        return "–"
    return f"{format_interval(rate_interval([float(row['exact']) for row in rows]), '.0f', 100)}; {len(rows)}"


def _read_leaks() -> dict[tuple[str, str, str], str]:
    """The AUC of the leak probe by suite, cell and version; plus or minus twice its standard error."""
    return {
        (row["suite"], row["cell"], row["version"]): f"{float(row['auc']):.2f} ± {2 * float(row['error']):.2f}"
        for row in read_csv(RESULTS / "leak_probe.csv")
        if row["auc"]
    }

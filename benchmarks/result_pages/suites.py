"""Every detector in every cell of the frozen suites."""

from __future__ import annotations

from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import numpy as np
from running import RESULTS, read_csv
from usnet_env.evaluation.report import format_interval, group_rows, make_panels
from usnet_env.evaluation.statistics import rate_interval

from result_pages.text import Row, exact_of, mean_of, page, picture, table
from usnet_env.drawing import caption_figure
from usnet_env.evaluation import TRIVIAL, FrozenSuite, list_suites

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SOLVED = 0.95  # a suite is solved if every detector but the trivial policies is exact this often


def text() -> str:
    parts, files = [], []
    for suite, rows in _played():
        parts += describe_suite(suite, rows)
        files += [rows_file(suite), *([failures_file(suite)] if read_failures(suite) else []), _picture(suite)]
    return page(
        "Frozen suites",
        "[Frozen suites](../suites.md) are lists of environments with a version. All detectors met the same swarms, "
        "each in a separate process; M was not given. *Exact* is the share of episodes in which round 1 names all "
        "heads and no other UAV. Seconds are the median of one answer; the rows were played on several days, on shared "
        "machines of different speed, so seconds are rough. "
        "[Another page](suites_cells.md) has the numbers of each cell. The swarms are not new to `follow-mixture`: its "
        "rules were changed after looks at its rows of `field`, `controls` and `sensing`, and it then played the same "
        "swarms again.",
        *parts,
        files=files,
    )


def cells_text() -> str:
    parts = []
    for suite, rows in _played():
        parts += [f"## {suite.label}", _cells(suite, rows)]
    return page(
        "All cells of the frozen suites",
        "The share of episodes in which round 1 names all heads and no other UAV, in percent, with its 95 % interval, "
        "and after the semicolon n. *One track* is the area under the curve of a classifier that sees the track of one "
        "UAV at a time: 0.5 is chance, and at 1 every head can be recognised without looking at any other UAV. A "
        "detector may then have learned how heads fly, and not who leads; no detector of this project is trained on "
        "these cells. The classifier is trained and tested on swarms of the tuning seed of each suite, and not on "
        "those that the detectors met.",
        *parts,
        files=[*(rows_file(suite) for suite, _ in _played()), "leak_probe.csv"],
    )


def figures() -> dict[Path, Figure]:
    """A heat map of each suite, by file: cells, detectors, and how often a detector is exact."""
    return {RESULTS / _picture(suite): _heat_map(suite, rows) for suite, rows in _played()}


def _played() -> list[tuple[FrozenSuite, list[Row]]]:
    """The suites with committed rows."""
    return [(suite, rows) for suite in list_suites().values() if (rows := read_suite(suite))]


def read_suite(suite: FrozenSuite, results: Path = RESULTS) -> list[Row]:
    """The committed rows of the suite's version; none if it was not played."""
    path = results / rows_file(suite)
    return read_csv(path) if path.exists() else []


def read_failures(suite: FrozenSuite, results: Path = RESULTS) -> list[Row]:
    """Why detectors have no rows in some cells: columns ``cell``, ``detector`` and ``reason``."""
    path = results / failures_file(suite)
    return read_csv(path) if path.exists() else []


def rows_file(suite: FrozenSuite) -> str:
    """The file of rows, in the folder of results."""
    return f"suites/{suite.name}-v{suite.version}.csv.gz"


def failures_file(suite: FrozenSuite) -> str:
    """The file of the cells in which detectors failed, in the folder of results."""
    return f"suites/{suite.name}-v{suite.version}-failures.csv"


def _picture(suite: FrozenSuite) -> str:
    return f"suites/{suite.name}-v{suite.version}.png"


def _by_detector(suite: FrozenSuite, rows: list[Row]) -> dict[str, list[Row]]:
    """The rows of each detector; those that are exact most often come first."""
    found = group_rows(rows, lambda row: row["detector"])
    return dict(sorted(found.items(), key=lambda item: -_score(suite, item[1])))


def _score(suite: FrozenSuite, rows: list[Row]) -> float:
    """The share of exact episodes of a detector, over all cells of the suite; in a failed cell, none is exact."""
    return sum(int(row["exact"]) for row in rows) / (_episodes(rows) * len(suite.cells))


def _episodes(rows: list[Row]) -> int:
    """Number of episodes that a detector played in each cell."""
    return 1 + max(int(row["episode"]) for row in rows)


def describe_suite(suite: FrozenSuite, rows: list[Row]) -> list[str]:
    """The summary of a suite, and its picture."""
    found = _by_detector(suite, rows)
    lines = [
        (
            f"`{name}`",
            str(len(own)),
            str(len({row["cell"] for row in own})),
            exact_of(own),
            mean_of(own, "f1_first"),
            mean_of(own, "J"),
            f"{median(float(row['seconds_per_round']) for row in own):.2g}",
        )
        for name, own in found.items()
    ]
    solved = " This suite is *solved*: every detector but the trivial policies is exact in 95 % of the episodes."
    others = [own for name, own in found.items() if name.split("(")[0] not in TRIVIAL]
    is_solved = all(_score(suite, own) >= SOLVED for own in others)
    few = [f"`{name}` {count}" for name, own in found.items() if (count := _episodes(own)) < suite.episodes]
    short = f"These detectors are slow and played only the first episodes of each cell: {', '.join(few)} of "
    return [
        f"## {suite.label}",
        f"{suite.purpose} SHA-256 of the file: `{suite.digest[:16]}…`.{solved if is_solved else ''}",
        table(("detector", "n", "cells", "exact", "F1 in round 1", "J", "seconds"), lines),
        *([f"{short}{suite.episodes}."] if few else []),
        *_list_failures(suite),
        *_compare_sizes(suite, rows, list(found)),
        picture(f"Heat map of {suite.name}: how often each detector is exact in each cell", _picture(suite)),
    ]


def _list_failures(suite: FrozenSuite) -> list[str]:
    """In which cells detectors have no rows, and why."""
    found = group_rows(read_failures(suite), lambda row: (row["detector"], row["reason"].partition(": ")[2]))
    if not found:
        return []
    lines = [(f"`{name}`", ", ".join(row["cell"] for row in own), why) for (name, why), own in sorted(found.items())]
    return [
        "A detector that fails in a cell has no rows there: *cells* counts the others, and the means are over them. "
        "For the ranking, a failed cell counts as 0 % exact.",
        table(("detector", "failed in", "reason"), lines),
    ]


def _compare_sizes(suite: FrozenSuite, rows: list[Row], names: list[str]) -> list[str]:
    """F1 and seconds of each cell, if the largest swarm of the suite is more than ten times the smallest."""
    sizes = [int(cell.arguments["uavs"]) for cell in suite.cells.values() if "uavs" in cell.arguments]
    if not sizes or max(sizes) <= 10 * min(sizes):
        return []
    cells = group_rows(rows, lambda row: (row["cell"], row["detector"]))

    def say(own: list[Row]) -> str:
        if not own:
            return "–"
        score, seconds = (median([float(row[name]) for row in own]) for name in ("f1_first", "seconds_per_round"))
        return f"{score:.2f}; {seconds:.2g} s"

    lines = [(f"`{name}`", *(say(cells.get((cell, name), [])) for cell in suite.cells)) for name in names]
    return [
        "The median F1 in round 1, and the median seconds of one answer, by cell:",
        table(("detector", *suite.cells), lines),
    ]


def _cells(suite: FrozenSuite, rows: list[Row]) -> str:
    """How often each detector is exact in each cell, with intervals."""
    cells = group_rows(rows, lambda row: (row["cell"], row["detector"]))
    order, leaks = list(_by_detector(suite, rows)), _read_leaks()
    body = [
        (
            cell,
            leaks.get((suite.name, cell, str(suite.version)), "–"),
            *(_exact(cells.get((cell, name), [])) for name in order),
        )
        for cell in suite.cells
    ]
    return table(("cell", "one track", *(f"`{name}`" for name in order)), body)


def _heat_map(suite: FrozenSuite, rows: list[Row]) -> Figure:
    """Cells from top to bottom, detectors from left to right; an entry is the share of exact episodes in percent."""
    found, cells = _by_detector(suite, rows), group_rows(rows, lambda row: (row["cell"], row["detector"]))
    order = list(found)
    share = np.full((len(suite.cells), len(order)), np.nan)
    for place, cell in enumerate(suite.cells):
        for column, name in enumerate(order):
            if own := cells.get((cell, name)):
                share[place, column] = 100 * (sum(int(row["exact"]) for row in own) / len(own))
    figure, grid = make_panels(4.2 + 0.42 * len(order), 3.4 + 0.24 * len(suite.cells))
    axes = grid[0, 0]
    axes.grid(False)
    axes.imshow(share, cmap="cividis", vmin=0, vmax=100, aspect="auto")
    for (place, column), value in np.ndenumerate(share):
        shown = "–" if np.isnan(value) else f"{value:.0f}"
        axes.text(column, place, shown, ha="center", va="center", fontsize=7.5, color="w" if value <= 55 else "k")
    played = {name: _episodes(own) for name, own in found.items()}
    labels = [f"{name}, n = {count}" if count < suite.episodes else name for name, count in played.items()]
    axes.set_xticks(range(len(order)), labels, rotation=50, ha="right", fontsize=8.5, color="k")
    axes.set_yticks(range(len(suite.cells)), list(suite.cells), fontsize=8.5, color="k")
    axes.tick_params(length=0)
    failed = " –: the detector failed there." if np.isnan(share).any() else ""
    fewer = ", fewer where a column says so" if labels != order else ""
    half = rate_interval([place % 2 for place in range(suite.episodes)])
    caption_figure(
        figure,
        f"{suite.label}: in how many percent of the episodes is round 1 exact?",
        f"A row is a cell, a column is a detector; the best detector is on the left. Exact: all heads are named, "
        f"and no other UAV. n = {suite.episodes} episodes in each entry{fewer}; the 95 % interval of a share of "
        f"one half is ±{50 * (half.high - half.low):.0f} points.{failed}",
    )
    return figure


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

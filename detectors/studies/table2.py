"""The paper's table of detection rates: 7 follow strategies x 10 sizes of one cluster, its values beside ours."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from detectors.studies.detection_rate import Cell, Row, measure, rate_of, read_rows, tasks_for
from usnet_env.config import ArgumentError, quote
from usnet_env.envs import SingleClusterEnv
from usnet_env.evaluation.statistics import Interval, rate_interval
from usnet_env.evaluation.suite import counter, flight_suffix, keep_report
from usnet_env.plugins import detector_label, make_detector

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "DETECTORS",
    "FOLLOW",
    "FOLLOWERS",
    "Entry",
    "draw",
    "entries",
    "markdown",
    "paper_rates",
    "reproduce",
    "verdict",
]

FOLLOW = ("f1", "f2", "f3", "f4", "f5", "f6", "f7")
FOLLOWERS = (2, 3, 5, 10, 15, 20, 25, 30, 40, 50)
PAPER_RUNS = 1000  # episodes behind each value of the paper

#: The paper's Algorithm 1, a variant of it, and a detector without training, on the same episodes.
DETECTORS = ("gassl", "neural-granger", "lagged-regression(clusters=1)")
#: Okabe and Ito's colours, apart for readers who see few colours.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
_FEW, _MANY = 30, 100  # episodes a cell: above 15 followers, and up to 15


def paper_rates() -> dict[tuple[str, int], Interval]:
    """The paper's values with the Wilson intervals of its 1,000 runs, by follow strategy and m."""
    source = files("detectors.studies") / "data" / "table2_detection_rate.csv"
    rates = {}
    with source.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            hits = round(float(row["detection_rate_percent"]) / 100 * PAPER_RUNS)
            rates[row["ifs"], int(row["followers"])] = rate_interval([1.0] * hits + [0.0] * (PAPER_RUNS - hits))
    return rates


def parse_cells(text: str | None) -> list[tuple[str, int]]:
    """``"f1:2,f4:15"`` as pairs; every cell of the table for ``None``.

    Raises:
        ArgumentError: a cell that is not in the table.
    """
    table = [(follow, followers) for follow in FOLLOW for followers in FOLLOWERS]
    if text is None:
        return table
    cells = []
    for word in text.split(","):
        follow, colon, size = word.strip().partition(":")
        chosen = [cell for cell in table if cell[0] == follow and (not colon or str(cell[1]) == size)]
        if not chosen:
            raise ArgumentError(
                f"--cells must list cells such as f1:2 or rows such as f1, of f1 to f7 and m in "
                f"{', '.join(map(str, FOLLOWERS))}, got {quote(word)}."
            )
        cells += chosen
    return list(dict.fromkeys(cells))


@dataclass(frozen=True)
class Entry:
    """One cell of the table: episodes, the rate of one of our detectors with its interval, and the paper's."""

    detector: str
    follow: str
    followers: int
    episodes: int
    ours: Interval
    paper: Interval


def verdict(entry: Entry) -> str:
    """``above``, ``overlaps`` or ``below``: our 95 % interval against the paper's."""
    if entry.ours.high < entry.paper.low:
        return "below"
    return "above" if entry.ours.low > entry.paper.high else "overlaps"


def entries(rows: Sequence[Row]) -> list[Entry]:
    """The cells that the rows fill."""
    paper = paper_rates()
    found = []
    for detector in dict.fromkeys(row.detector for row in rows):
        for (follow, followers), theirs in paper.items():
            rate = rate_of(
                row for row in rows if (row.detector, row.follow, row.followers) == (detector, follow, followers)
            )
            if rate is not None:
                found.append(Entry(detector, follow, followers, rate[0], rate[1], theirs))
    return found


def reproduce(
    folder: Path,
    *,
    episodes: int | None = None,
    cells: str | None = None,
    detectors: Sequence[str] = DETECTORS,
    decoys: int = 0,
    mobility: str = "iid",
    head_jitter: bool = False,
    seed: int = 2022,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[list[Row], Path]:
    """Measure the table's cells; an interrupted measurement continues where it stopped.

    Args:
        folder: gets ``episodes[-decoysK][-mobility][-jitter]-seedS.csv``, ``.md`` and ``.png``.
        episodes: in each cell; ``None``: 100 up to m = 15, 30 above.
        cells: as :func:`parse_cells` takes them.
        detectors: as :func:`usnet_env.make_detector` takes them.
        decoys: UAVs without followers that fly like heads.
        mobility: how the head flies.
        head_jitter: whether it has the followers' noise.
        seed: of the episodes; the reporting seed is one that nothing was tuned on.
        workers: processes.
        progress: called with the episodes done and to do.

    Returns:
        The rows of these detectors, and the path of the report.
    """
    for detector in detectors:
        make_detector(detector).reset(seed)  # a wrong name or argument is refused before anything is measured
    grid = [Cell(follow, followers, decoys, mobility, head_jitter) for follow, followers in parse_cells(cells)]
    for cell in grid:
        SingleClusterEnv(**asdict(cell))  # a wrong mobility or number of decoys, too

    def count(cell: Cell) -> int:
        return episodes or (_MANY if cell.followers <= 15 else _FEW)

    tasks = tasks_for([detector_label(detector) for detector in detectors], grid, count)
    suffix = (f"-decoys{decoys}" if decoys else "") + flight_suffix(mobility, head_jitter)
    path = folder / f"episodes{suffix}-seed{seed}.csv"
    rows = measure(tasks, seed, path, workers, counter(sum(task.count for task in tasks), progress))
    table = entries(read_rows(path))  # earlier measurements with the same seed stay in the table
    title = f"Detection rate, one cluster, {mobility} heads, {decoys} decoy{'s' if decoys != 1 else ''}"
    keep_report(path, markdown(table, title, with_paper=not suffix), draw(table, title, with_paper=not suffix))
    return rows, path.with_suffix(".md")


def _percent(value: float) -> str:
    return f"{100 * value:.1f}"


def markdown(table: Sequence[Entry], title: str, with_paper: bool) -> str:
    """The table in Markdown: one row for each follow strategy and detector; rates in percent."""
    sizes = [size for size in FOLLOWERS if any(entry.followers == size for entry in table)]
    lines = [
        f"# {title}",
        "",
        "Percent of episodes in which the head was the only candidate, with 95 % Wilson intervals and n, the number of "
        "episodes.",
        "",
    ]
    lines += ["| f | detector | " + " | ".join(f"m={size}" for size in sizes) + " |", "|---|---|" + "---|" * len(sizes)]
    detectors = list(dict.fromkeys(entry.detector for entry in table))
    for follow in dict.fromkeys(entry.follow for entry in table):
        cells = {(entry.detector, entry.followers): entry for entry in table if entry.follow == follow}
        if with_paper:
            theirs = {entry.followers: entry.paper for entry in cells.values()}
            shown_rates = [_percent(theirs[size].mean) if size in theirs else "" for size in sizes]
            lines.append(f"| {follow} | paper's table | " + " | ".join(shown_rates) + " |")
        for detector in detectors:
            texts = []
            for size in sizes:
                entry = cells.get((detector, size))
                if entry is None:
                    texts.append("")
                    continue
                mark = " **below**" if with_paper and verdict(entry) == "below" else ""
                low, high = _percent(entry.ours.low), _percent(entry.ours.high)
                texts.append(f"{_percent(entry.ours.mean)} ({low}–{high}; {entry.episodes}){mark}")
            lines.append(f"| {follow} | {detector} | " + " | ".join(texts) + " |")
    return "\n".join([*lines, ""])


def draw(table: Sequence[Entry], title: str, with_paper: bool) -> Figure:
    """One panel for each follow strategy: rates against m with 95 % intervals, the paper's as open circles."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    follows = list(dict.fromkeys(entry.follow for entry in table))
    detectors = list(dict.fromkeys(entry.detector for entry in table))
    colours = {detector: _COLOURS[place % len(_COLOURS)] for place, detector in enumerate(detectors)}
    figure = Figure(figsize=(13, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(2, 4, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, follow in zip(grid, follows, strict=False):
        for number, detector in enumerate(detectors):
            own = [entry for entry in table if (entry.follow, entry.detector) == (follow, detector)]
            places = [FOLLOWERS.index(entry.followers) + 0.18 * (number - len(detectors) / 2 + 0.5) for entry in own]
            means = [100 * entry.ours.mean for entry in own]
            ends = [
                [100 * (entry.ours.mean - entry.ours.low) for entry in own],
                [100 * (entry.ours.high - entry.ours.mean) for entry in own],
            ]
            axes.errorbar(places, means, ends, fmt="o", ms=4, lw=1.2, color=colours[detector], label=detector)
        if with_paper:
            theirs = {entry.followers: entry.paper for entry in table if entry.follow == follow}
            places = [FOLLOWERS.index(size) for size in theirs]
            axes.plot(
                places,
                [100 * rate.mean for rate in theirs.values()],
                "o",
                mfc="none",
                mec="black",
                ms=9,
                label="the paper's table (1,000 runs)",
            )
        axes.set_title(follow)
        axes.set_xticks(range(len(FOLLOWERS)), [str(size) for size in FOLLOWERS])
        axes.grid(alpha=0.3)
    for axes in grid[len(follows) :]:
        axes.set_visible(False)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower right", bbox_to_anchor=(0.98, 0.12), fontsize=9)
    figure.supxlabel("followers m")
    figure.supylabel("head is the only candidate, %")
    figure.suptitle(title)
    return figure

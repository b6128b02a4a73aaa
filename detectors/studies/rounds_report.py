"""Table and picture of the rounds of P2, the paper's figures in words beside ours."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from detectors.studies.rounds import STUDIES, Row
from usnet_env.evaluation import TRIVIAL
from usnet_env.evaluation.metrics import RATES
from usnet_env.evaluation.statistics import Interval, mean_interval, rate_interval
from usnet_env.evaluation.suite import episode_means

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["COLUMNS", "SHORT", "Words", "draw", "found_by_round", "interval_of", "markdown", "paper_words"]

Columns = tuple[tuple[str, str, int], ...]

#: Columns of the table: a field of the row, its heading, what it is multiplied by.
COLUMNS: Columns = (
    ("rounds", "R", 1),
    ("redundant", "redundant UAVs", 1),
    ("redundancy", "redundancy, %", 100),
    ("J", "J_m", 1),
    ("success", "finished, %", 100),
    ("exact", "exact in round 1, %", 100),
    ("precision_first", "precision 1", 1),
    ("recall_first", "recall 1", 1),
    ("f1_first", "F1 1", 1),
    ("ap_first", "AP 1", 1),
    ("purity_first", "purity 1", 1),
    ("head_in_cluster_first", "head in cluster 1", 1),
    ("seconds_per_round", "s / round", 1),
)
SHORT = tuple(column for column in COLUMNS if column[0] in ("rounds", "redundancy", "J", "success"))
_TITLES = {
    "follow": "Against the follow strategy (M=5, N=82)",
    "clusters": "Against the number of clusters (f1, N=82)",
    "uavs": "Against the number of UAVs (f3, M=5)",
    "example": "The example (f1, M=8, N=185), round by round",
}
_SAID = ("rounds", "redundant", "redundancy", "J")  # columns on which the paper says something
_ROUNDS_SHOWN = 5
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
_MARKS = dict(zip(TRIVIAL, "xv1d", strict=True))


@dataclass(frozen=True)
class Words:
    """What the paper says about a study: bounds of the mean rounds and of the redundant UAVs, and a summary.

    Args:
        rounds: lowest and highest.
        redundant: lowest and highest.
        at_most: whether the paper gives only the highest; the lowest are then the lowest possible values.
        words: a summary in our words.
    """

    rounds: tuple[float, float]
    redundant: tuple[float, float]
    at_most: bool
    words: str

    def bounds(self, field: str, uavs: int) -> tuple[float, float]:
        """Of ``rounds``, ``redundant``, ``redundancy`` or ``J`` with N UAVs."""
        low, high = (redundant / uavs for redundant in self.redundant)
        return {
            "rounds": self.rounds,
            "redundant": self.redundant,
            "redundancy": (low, high),
            "J": (self.rounds[0] + low, self.rounds[1] + high),
        }[field]


def paper_words() -> dict[str, Words]:
    """The paper's figures, by study."""
    source = files("detectors.studies") / "data" / "multi_cluster_in_words.csv"
    with source.open(encoding="utf-8") as file:
        return {
            row["study"]: Words(
                (float(row["rounds_low"] or 1), float(row["rounds_high"])),
                (float(row["redundant_low"] or 0), float(row["redundant_high"])),
                not row["rounds_low"],
                row["words"],
            )
            for row in csv.DictReader(file)
        }


def interval_of(rows: Sequence[Row], field: str) -> Interval | None:
    """Mean over all episodes with its interval, the rows of an episode taken together; ``None`` without a value.

    The cluster metrics are over those with clusters. Rates have Wilson's interval of all rows.
    """
    if field in RATES:
        return rate_interval([getattr(row, field) for row in rows]) if rows else None
    values = episode_means(rows, field)
    return mean_interval(values) if values else None


def found_by_round(rows: Sequence[Row], rounds: int) -> list[tuple[list[float], list[float]]]:
    """Candidates of each of the first rounds, and heads found until then; every episode counts in every round.

    Args:
        rows: at least one.
        rounds: how many.

    Returns:
        For each round two lists with a value for each episode: candidates in that round (0 after the end), heads found
        so far.
    """
    table = []
    for number in range(rounds):
        named = [float(sum(named for named, _ in row.each_round()[number : number + 1])) for row in rows]
        found = [float(sum(hits for _, hits in row.each_round()[: number + 1])) for row in rows]
        table.append((named, found))
    return table


def _text(interval: Interval | None, scale: float = 1) -> str:
    if interval is None:
        return "–"
    mean, low, high = (scale * value for value in interval)
    return f"{mean:.3g} ({low:.3g}–{high:.3g})" if mean < 100 else f"{mean:.0f} ({low:.0f}–{high:.0f})"


def _said(words: Words, field: str, uavs: int, scale: float) -> str:
    low, high = (f"{scale * bound:.3g}" for bound in words.bounds(field, uavs))
    return f"at most {high}" if words.at_most else low if low == high else f"{low}–{high}"


def _detectors(rows: Sequence[Row]) -> list[str]:
    """Detectors first, then the trivial policies."""
    return sorted(dict.fromkeys(row.detector for row in rows), key=lambda name: (name in TRIVIAL, name))


def _place(study: str, cell: tuple[str, int, int]) -> str:
    """What distinguishes a cell from the others of its study."""
    follow, clusters, uavs = cell
    return {"follow": follow, "clusters": f"M={clusters}", "uavs": f"N={uavs}", "example": "M=8, N=185"}[study]


def _of(rows: Sequence[Row], cell: tuple[str, int, int], detector: str | None = None) -> list[Row]:
    return [row for row in rows if (row.follow, row.clusters, row.uavs) == cell and detector in (None, row.detector)]


def markdown(rows: Sequence[Row], title: str, with_paper: bool, columns: Columns = COLUMNS) -> str:
    """The studies that the rows fill, in Markdown; ``columns`` are some of :data:`COLUMNS`."""
    lines = [
        f"# {title}",
        "",
        "Means over all episodes, unfinished ones included, with 95 % intervals (Wilson for rates, bootstrap else). "
        "A policy that destroys all UAVs has a good J_m; compare each detector with the trivial policies.",
    ]
    words = paper_words()
    for study, cells in STUDIES.items():
        filled = [cell for cell in cells if _of(rows, cell)]
        if not filled:
            continue
        lines += ["", f"## {_TITLES[study]}", ""]
        if with_paper:
            lines += [f"The paper, in words: {words[study].words}.", ""]
        lines += ["| | detector | n | " + " | ".join(heading for _, heading, _ in columns) + " |"]
        lines += ["|---|---|---|" + "---|" * len(columns)]
        for cell in filled:
            if with_paper:
                said = [
                    _said(words[study], field, cell[2], scale) if field in _SAID else "" for field, _, scale in columns
                ]
                lines.append(f"| {_place(study, cell)} | the paper, in words | | " + " | ".join(said) + " |")
            for detector in _detectors(rows):
                lines += _line(_place(study, cell), detector, _of(rows, cell, detector), columns)
        if len(filled) > 1:
            for detector in _detectors(rows):
                every = [row for cell in filled for row in _of(rows, cell, detector)]
                lines += _line("all", detector, every, columns)
        if study == "example":
            lines += _round_by_round(_of(rows, cells[0]), with_paper)
    return "\n".join([*lines, ""])


def _line(place: str, detector: str, rows: Sequence[Row], columns: Columns) -> list[str]:
    if not rows:
        return []
    values = [_text(interval_of(rows, field), scale) for field, _, scale in columns]
    return [f"| {place} | {detector} | {len(rows)} | " + " | ".join(values) + " |"]


def _round_by_round(rows: Sequence[Row], with_paper: bool) -> list[str]:
    heads = STUDIES["example"][0][1]
    shown = min(_ROUNDS_SHOWN, max(2, *(row.rounds for row in rows)))
    lines = ["", f"Candidates of a round / share of the {heads} heads found until then, %:", ""]
    lines += ["| detector | " + " | ".join(f"round {number + 1}" for number in range(shown)) + " |"]
    lines += ["|---|" + "---|" * shown]
    if with_paper:
        lines.append("| the paper | " + " | ".join(["8 / 75", "2 / 100"] + [""] * (shown - 2)) + " |")
    for detector in _detectors(rows):
        table = found_by_round([row for row in rows if row.detector == detector], shown)
        cells = [
            f"{_text(mean_interval(named))} / {_text(mean_interval(found), 100 / heads)}" for named, found in table
        ]
        lines.append(f"| {detector} | " + " | ".join(cells) + " |")
    return lines


def draw(rows: Sequence[Row], title: str, with_paper: bool) -> Figure:
    """One row of panels for each study: R, redundancy and J_m with 95 % intervals; the paper's bounds in grey."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    studies = [study for study, cells in STUDIES.items() if any(_of(rows, cell) for cell in cells)]
    figure = Figure(figsize=(15, 3.6 * len(studies) + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(studies), 3, squeeze=False)
    panels = (("rounds", "rounds R", 1), ("redundancy", "redundancy, %", 100), ("J", "J_m", 1))
    for axes_row, study in zip(grid, studies, strict=True):
        for axes, (field, label, scale) in zip(axes_row, panels, strict=True):
            _panel(axes, rows, study, field, scale, with_paper)
            axes.set_ylabel(label)
        if study == "example":
            _found_panel(axes_row[0], _of(rows, STUDIES[study][0]), with_paper)
        axes_row[0].set_title(_TITLES[study], loc="left", fontsize=10)
    handles, labels = grid[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9)
    figure.suptitle(title)
    return figure


def _look(detector: str, detectors: Sequence[str]) -> dict[str, Any]:
    if detector in TRIVIAL:
        return {"color": "#777777", "marker": _MARKS[detector], "label": detector}
    return {"color": _COLOURS[detectors.index(detector) % len(_COLOURS)], "marker": "o", "label": detector}


def _panel(axes: Axes, rows: Sequence[Row], study: str, field: str, scale: float, with_paper: bool) -> None:
    cells = [cell for cell in STUDIES[study] if _of(rows, cell)]
    detectors = _detectors(rows)
    if with_paper:
        bounds = scale * np.array([paper_words()[study].bounds(field, cell[2]) for cell in cells])
        edges = np.repeat(np.arange(len(cells)), 2) + np.tile([-0.5, 0.5], len(cells))
        ends = np.repeat(bounds, 2, axis=0)
        axes.fill_between(edges, ends[:, 0], ends[:, 1], color="#cccccc", edgecolor="#999999", label="the paper")
    for number, detector in enumerate(detectors):
        shift = 0.7 * ((number + 0.5) / len(detectors) - 0.5)
        filled = [(place, _of(rows, cell, detector)) for place, cell in enumerate(cells) if _of(rows, cell, detector)]
        known = [(place + shift, found) for place, own in filled if (found := interval_of(own, field)) is not None]
        means = [scale * found.mean for _, found in known]
        spread = [[scale * (f.mean - f.low) for _, f in known], [scale * (f.high - f.mean) for _, f in known]]
        axes.errorbar([x for x, _ in known], means, spread, ls="none", ms=5, lw=1.2, **_look(detector, detectors))
    axes.set_xticks(range(len(cells)), [_place(study, cell) for cell in cells])
    axes.grid(alpha=0.3)
    if field == "redundancy":
        axes.set_yscale("symlog", linthresh=1)
        axes.set_ylim(bottom=-0.2)
    else:
        axes.set_yscale("log")
        axes.set_yticks([1, 2, 3, 4, 5, 7, 10, 20], ["1", "2", "3", "4", "5", "7", "10", "20"])
        axes.minorticks_off()


def _found_panel(axes: Axes, rows: Sequence[Row], with_paper: bool) -> None:
    """The share of the heads that is found until each round."""
    axes.clear()
    heads, detectors = STUDIES["example"][0][1], _detectors(rows)
    x = list(range(1, _ROUNDS_SHOWN + 1))
    for detector in detectors:
        table = found_by_round([row for row in rows if row.detector == detector], _ROUNDS_SHOWN)
        found = [100 * float(np.mean(values)) / heads for _, values in table]
        axes.plot(x, found, lw=1.2, **_look(detector, detectors))
    if with_paper:
        axes.plot([1, 2], [75, 100], "o--", mfc="none", color="black", ms=9, label="the paper")
    axes.set_xticks(x)
    axes.set_xlabel("round")
    axes.set_ylabel("heads found, %")
    axes.grid(alpha=0.3)

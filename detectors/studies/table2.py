"""The paper's table of detection rates: 7 follow strategies x 10 sizes of one cluster, its values beside ours."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from detectors.studies import common
from usnet_env.config import ArgumentError, format_count, quote
from usnet_env.drawing import COLORS, MARKERS, caption_figure
from usnet_env.envs import SingleClusterEnv
from usnet_env.evaluation import report
from usnet_env.evaluation.statistics import Interval, rate_interval
from usnet_env.evaluation.suite import Game, Suite, read_rows
from usnet_env.plugins import detector_label, make_detector
from usnet_env.window import Window

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLLOWERS = (2, 3, 5, 10, 15, 20, 25, 30, 40, 50)
#: The paper's Algorithm 1, a variant of it, and a detector without training, on the same episodes.
DETECTORS = ("gassl", "neural-granger", "lagged-regression(clusters=1)")
PAPER_RUNS = 1000  # episodes behind each value of the paper
_FEW, _MANY = 30, 100  # episodes a cell: above 15 followers, and up to 15
#: Arguments of :func:`reproduce` for a quick look.
FAST: dict[str, Any] = {
    "episodes": 10,
    "cells": ",".join(f"{follow}:{size}" for follow in common.FOLLOW for size in FOLLOWERS if size <= 15),
}
_BATCH_UAVS = 64  # UAVs of the windows that a detector gets at once: small swarms train side by side


@dataclass(frozen=True)
class Cell:
    """One detector against one kind of swarm: follow strategy, m followers, decoys, mobility, jitter of the heads."""

    detector: str
    follow: str
    followers: int
    decoys: int = 0
    mobility: str = "iid"
    head_jitter: bool = False

    @property
    def uavs(self) -> int:
        """N."""
        return self.followers + 1 + self.decoys

    def make_env(self) -> SingleClusterEnv:
        """Make its environment."""
        return SingleClusterEnv(**common.swarm_arguments(self, Cell))


@dataclass(frozen=True, kw_only=True)
class Row(Cell):
    """One episode of a cell.

    Args:
        episode: number of the episode.
        named: whether there was a candidate.
        hit: whether the head was the only candidate: J_s = 0.
        explained: share of the squared velocity that the detector's fit explains, mean over UAVs; NaN without a fit.
        seconds: time of the batch divided by its number of episodes.
        batch: first episode and number of episodes that the detector answered together, such as ``42+21``. A detector
            that is not ``side_by_side`` answers each episode alone: ``43+1`` for episode 43.
    """

    episode: int
    named: int
    hit: int
    explained: float
    seconds: float
    batch: str


def make_tasks(cells: Sequence[Cell], episodes: Callable[[Cell], int]) -> list[list[Game[Cell]]]:
    """Tasks of all cells, the small swarms first.

    A detector that is ``side_by_side`` answers the episodes of a task as one batch, so its answers depend on the batch,
    and the last batch of a cell depends on the number of episodes. The rows therefore record the batch. The answers of
    other detectors depend on neither.
    """
    tasks: list[list[Game[Cell]]] = []
    for cell in sorted(cells, key=lambda cell: (cell.uavs, cell.follow)):
        count, size = episodes(cell), max(1, _BATCH_UAVS // cell.uavs)
        tasks += [
            [(cell, episode) for episode in range(first, min(first + size, count))] for first in range(0, count, size)
        ]
    return tasks


def _make_seed(seed: int, cell: Cell, episode: int, branch: int) -> int:
    """Seed of an episode's swarm (branch 0) or detector (branch 1); every detector gets the same swarms."""
    name = int.from_bytes(f"{cell.follow}/{cell.mobility}".encode(), "little")
    key = (name % 2**61, cell.followers, cell.decoys, int(cell.head_jitter), episode, branch)
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1)[0])


def play_games(games: Sequence[Game[Cell]], seed: int) -> list[Row]:
    """Play consecutive games of one cell."""
    cell, episodes = games[0][0], [episode for _, episode in games]
    env, detector = cell.make_env(), make_detector(cell.detector)
    windows, heads = [], []
    for episode in episodes:
        observation, _ = env.reset(seed=_make_seed(seed, cell, episode, 0))
        windows.append(Window.from_observation(observation))
        heads.append(env.swarm.head)
    answer_batch = getattr(detector, "detect_batch", None) if getattr(detector, "side_by_side", False) else None
    size = len(games) if answer_batch else 1
    rows: list[Row] = []
    for first in range(0, len(games), size):
        batch = windows[first : first + size]
        detector.reset(_make_seed(seed, cell, episodes[first], 1))
        begun = time.perf_counter()
        detections = answer_batch(batch) if answer_batch else [detector.detect(batch[0])]
        seconds = (time.perf_counter() - begun) / len(batch)
        rows += [
            Row(
                **vars(cell),
                episode=episodes[first] + number,
                named=int(detection.candidates.any()),
                hit=int(np.array_equal(detection.candidates, heads[first + number])),
                explained=float(np.mean(detection.extras.get("explained", np.nan))),
                seconds=seconds,
                batch=f"{episodes[first]}+{len(batch)}",
            )
            for number, detection in enumerate(detections)
        ]
    return rows


def make_suite(seed: int) -> Suite[Cell, Row]:
    """The suite of a seed. Its rows do not contain the seed, so the name of their file should."""
    order = ("mobility", "decoys", "follow", "followers", "detector", "episode")
    return Suite(Cell, Row, partial(play_games, seed=seed), order=order, digits=4)


def rate_of(rows: Iterable[Row], what: str = "hit") -> tuple[int, Interval] | None:
    """Number of episodes and the share with ``what`` (``"hit"`` or ``"named"``), Wilson; ``None`` without a row.

    Cells share the seeds of an episode, so its rows are one group.
    """
    values, episodes = [], []
    for row in rows:
        values.append(getattr(row, what))
        episodes.append(row.episode)
    return (len(values), rate_interval(values, episodes)) if values else None


def read_paper() -> dict[tuple[str, int], Interval]:
    """Read the paper's values, with the Wilson intervals of its 1,000 runs, by follow strategy and m."""
    rates = {}
    with (files("detectors.studies") / "data" / "table2_detection_rate.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            hits = round(float(row["detection_rate_percent"]) / 100 * PAPER_RUNS)
            rates[row["ifs"], int(row["followers"])] = rate_interval([1.0] * hits + [0.0] * (PAPER_RUNS - hits))
    return rates


def parse_cells(text: str | None) -> list[tuple[str, int]]:
    """``"f1:2,f4:15"`` as pairs; every cell of the table for ``None``.

    Raises:
        ArgumentError: a cell that is not in the table.
    """
    table = [(follow, followers) for follow in common.FOLLOW for followers in FOLLOWERS]
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

    @property
    def is_below(self) -> bool:
        """Whether our 95 % interval lies below the paper's."""
        return self.ours.high < self.paper.low


def fill_table(rows: Sequence[Row]) -> list[Entry]:
    """The cells that the rows fill."""
    groups = report.group_rows(rows, lambda row: (row.detector, row.follow, row.followers))
    found = []
    for detector in dict.fromkeys(row.detector for row in rows):
        for place, theirs in read_paper().items():
            if (rate := rate_of(groups.get((detector, *place), ()))) is not None:
                found.append(Entry(detector, *place, *rate, theirs))
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
    formats: Sequence[str] = ("png",),
    **running: Unpack[common.Running],
) -> common.Reproduction[Row]:
    """Measure the table's cells; an interrupted measurement continues where it stopped.

    The arguments are those of ``usnet reproduce table2``, and ``running``: see
    :class:`~detectors.studies.common.Running`. The folder gets ``episodes[-decoysK][-mobility][-jitter]-seedS.csv``,
    ``.md`` and the picture. Nothing was tuned on the default seed.

    Raises:
        ArgumentError: an argument was refused.
    """
    common.check_detectors(detectors, seed)
    grid = [
        Cell(detector_label(detector), follow, followers, decoys, mobility, head_jitter)
        for follow, followers in parse_cells(cells)
        for detector in detectors
    ]
    for cell in grid:
        cell.make_env()  # refuses a wrong mobility or number of decoys
    tasks = make_tasks(grid, lambda cell: episodes or (_MANY if cell.followers <= 15 else _FEW))
    suffix = (f"-decoys{decoys}" if decoys else "") + common.name_flight(grid[0])
    path = folder / f"episodes{suffix}-seed{seed}.csv"
    rows = make_suite(seed).run(tasks, path, **running)
    table = fill_table(read_rows(path, Row))  # earlier measurements with the same seed stay in the table
    title = f"Detection rate, one cluster, {mobility} heads, {format_count(decoys, 'decoy')}"
    text = report_rates(table, title, not suffix)
    report.keep_report(path, text, draw_rates(table, title, not suffix), formats)
    return common.Reproduction(rows, text)


def _percent(value: float) -> str:
    return f"{100 * value:.1f}"


def report_rates(table: Sequence[Entry], title: str, with_paper: bool) -> str:
    """The table in Markdown: one row for each follow strategy and detector; rates in percent."""
    sizes = [size for size in FOLLOWERS if any(entry.followers == size for entry in table)]
    lines = []
    for follow, entries in report.group_rows(table, lambda entry: entry.follow).items():
        if with_paper:
            theirs = {entry.followers: _percent(entry.paper.mean) for entry in entries}
            lines.append((follow, "paper's table", *(theirs.get(size, "") for size in sizes)))
        own = {(entry.detector, entry.followers): _format_entry(entry, with_paper) for entry in entries}
        for detector in dict.fromkeys(entry.detector for entry in table):
            lines.append((follow, detector, *(own.get((detector, size), "") for size in sizes)))
    header = ("f", "detector", *(f"m={size}" for size in sizes))
    what = (
        "Percent of episodes in which the head was the only candidate, with 95 % Wilson intervals and n, the number of "
        "episodes."
    )
    return "\n".join([f"# {title}", "", what, "", *report.format_markdown(header, lines), ""])


def _format_entry(entry: Entry, with_paper: bool) -> str:
    mean, low, high = map(_percent, entry.ours)
    mark = " **below**" if with_paper and entry.is_below else ""
    return f"{mean} ({low}–{high}; {entry.episodes}){mark}"


def draw_rates(table: Sequence[Entry], title: str, with_paper: bool) -> Figure:
    """Draw rates against m with 95 % intervals: a panel for each follow strategy, or one if there is one detector.

    The paper's rates are open circles.
    """
    detectors, follows = (list(dict.fromkeys(getattr(each, name) for each in table)) for name in ("detector", "follow"))
    together = len(detectors) == 1 and not with_paper
    panels = report.group_rows(table, lambda each: each.detector if together else each.follow)
    series = follows if together else detectors
    sizes = [size for size in FOLLOWERS if any(each.followers == size for each in table)]
    columns = min(4, len(panels))
    lines = -(-len(panels) // columns)
    figure, grid = report.make_panels(
        max(3.3 * columns, 8.0), 2.9 * lines + 1.1, lines, columns, sharex=True, sharey=True
    )
    shown = list(grid.ravel()[: len(panels)])
    for place, (axes, (name, entries)) in enumerate(zip(shown, panels.items(), strict=True)):
        for number, label in enumerate(series):
            shift = 0.7 * ((number + 0.5) / len(series) - 0.5)
            own = {
                sizes.index(each.followers) + shift: each.ours
                for each in entries
                if label == (each.follow if together else each.detector)
            }
            look = {"color": COLORS[number % len(COLORS)], "marker": MARKERS[number % len(MARKERS)], "label": label}
            report.draw_intervals(axes, own, 100, ls="none", ms=4, lw=1.2, **look)
        if with_paper:
            theirs = {sizes.index(each.followers): 100 * each.paper.mean for each in entries}
            axes.plot(list(theirs), list(theirs.values()), "o", mfc="none", mec="black", ms=9, label="the paper")
        axes.set_title(name, fontsize=10.5)
        axes.set_xticks(range(len(sizes)), [str(size) for size in sizes])
        if place + columns >= len(panels):
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("followers m")
        if place % columns == 0:
            axes.set_ylabel("rate, %")
    for axes in grid.ravel()[len(panels) :]:
        axes.set_visible(False)
    report.add_legend(figure, shown[:1], len(series) if together else max(columns, 2))
    count = report.format_counts((each.episodes for each in table), "episodes")
    caption = f"Percent of episodes in which the head is the only candidate; {count}. Bars are 95 % Wilson intervals."
    caption_figure(figure, title, caption + " Open circles: the paper's table, 1,000 runs each." * with_paper)
    return figure

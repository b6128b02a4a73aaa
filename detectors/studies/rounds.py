"""The paper's figures of P2: rounds and redundancy against follow strategy, M and N, and one swarm round by round."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from detectors.studies import common
from usnet_env.config import ArgumentError
from usnet_env.drawing import COLORS, MARKERS, caption_figure, style_axes
from usnet_env.envs import MultiClusterEnv
from usnet_env.evaluation import TRIVIAL, report
from usnet_env.evaluation.metrics import RATES, episode_metrics
from usnet_env.evaluation.statistics import Interval, mean_interval, rate_interval
from usnet_env.evaluation.suite import Game, Suite, play_detector, read_rows, split_games
from usnet_env.objectives import rounds_hits_and_redundant

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: The paper's Algorithm 2, a variant of it, and a detector without training; the trivial policies are added to them.
DETECTORS = ("mc-gassl", "lead-votes", "lagged-regression")
_EPISODES_A_TASK = 2  # few: an episode takes up to minutes, and an interruption loses those of a task


@dataclass(frozen=True)
class Cell:
    """One detector against one kind of swarm: follow strategy, M, N, mobility, jitter of the heads."""

    detector: str
    follow: str = "f1"
    clusters: int = 5
    uavs: int = 82
    mobility: str = "iid"
    head_jitter: bool = False

    def make_env(self) -> MultiClusterEnv:
        """Make its environment."""
        return MultiClusterEnv(**common.swarm_arguments(self, Cell))


#: The cells of each study (follow strategy, M, N), as the paper has them.
STUDIES: dict[str, tuple[tuple[str, int, int], ...]] = {
    "follow": tuple((follow, 5, 82) for follow in common.FOLLOW),
    "clusters": tuple(("f1", clusters, 82) for clusters in (2, 3, 5, 8, 10)),
    "uavs": tuple(("f3", 5, uavs) for uavs in (40, 60, 82, 120, 160, 200)),
    "example": (("f1", 8, 185),),
}


@dataclass(frozen=True, kw_only=True)
class Row(Cell):
    """One episode of a cell; metrics by the names of :data:`usnet_env.evaluation.METRICS`.

    Args:
        episode: number of the episode.
        redundant: redundant candidates of all rounds.
        named, hits: number of candidates in each round, and how many of them were heads, separated by spaces.
    """

    episode: int
    J: float
    rounds: int
    redundant: int
    redundancy: float
    success: int
    exact: int
    precision_first: float
    recall_first: float
    f1_first: float
    ap_first: float
    purity_first: float
    head_in_cluster_first: float
    seconds_per_round: float
    named: str
    hits: str

    def list_rounds(self) -> list[tuple[int, int]]:
        """Candidates and hits of every round."""
        return list(zip(map(int, self.named.split()), map(int, self.hits.split()), strict=True))


def list_cells(
    studies: Sequence[str], detectors: Sequence[str], mobility: str = "iid", head_jitter: bool = False
) -> list[Cell]:
    """The cells of some studies, each cell once.

    Raises:
        ArgumentError: no such study.
    """
    common.check_names("study", studies, STUDIES)
    swarms = dict.fromkeys(swarm for study in studies for swarm in STUDIES[study])
    return [Cell(detector, *swarm, mobility, head_jitter) for swarm in swarms for detector in dict.fromkeys(detectors)]


def play_games(games: Sequence[Game[Cell]], seed: int, isolate: bool = False) -> list[Row]:
    """Play the games that ``usnet evaluate`` plays with the same seed."""
    made = []
    for cell, episode in games:
        env = cell.make_env()
        rounds = play_detector(env, cell.detector, seed, episode, isolate)
        metrics: dict[str, Any] = episode_metrics(env.problem, rounds)
        candidates = np.array([each.answer.candidates for each in rounds])
        hits, redundant = rounds_hits_and_redundant(rounds[0].truth.head, candidates)
        values: dict[str, Any] = {name: np.nan if value is None else value for name, value in metrics.items()}
        named, hit = (" ".join(map(str, counts)) for counts in (hits + redundant, hits))
        values |= {"redundant": int(redundant.sum()), "named": named, "hits": hit}
        made.append(Row(**vars(cell), episode=episode, **values))
    return made


def reproduce(
    folder: Path,
    *,
    studies: Sequence[str] = tuple(STUDIES),
    detectors: Sequence[str] = DETECTORS,
    trivial: bool = True,
    episodes: int = 30,
    mobility: str = "iid",
    head_jitter: bool = False,
    seed: int = 2022,
    isolate: bool = False,
    formats: Sequence[str] = ("png",),
    **running: Unpack[common.Running],
) -> common.Reproduction[Row]:
    """Measure the studies' cells; an interrupted measurement continues where it stopped.

    The arguments are those of ``usnet reproduce rounds``, and ``running``: see
    :class:`~detectors.studies.common.Running`. The folder gets ``rounds[-mobility][-jitter]-seedS.csv``, ``.md`` and
    the picture; they are of all rows in the file, those of earlier measurements included. Nothing was tuned on the
    default seed.

    Raises:
        ArgumentError: an argument was refused.
        EvaluationError: a detector failed; rows that were finished are kept.
    """
    names = [*detectors, *(TRIVIAL if trivial else ())]
    cells = list_cells(studies, names, mobility, head_jitter)
    if not cells or episodes < 1:
        raise ArgumentError("studies, detectors and episodes must not be empty or 0.")
    common.check_detectors(names, seed)
    cells[0].make_env()
    suffix = common.name_flight(cells[0])
    path = folder / f"rounds{suffix}-seed{seed}.csv"
    order = ("follow", "clusters", "uavs", "detector", "episode")
    suite = Suite(Cell, Row, partial(play_games, seed=seed, isolate=isolate), order=order, digits=4)
    rows = suite.run(split_games(cells, episodes, _EPISODES_A_TASK), path, **running)
    title, kept = f"P2, {common.describe_flight(cells[0])}", read_rows(path, Row)
    report.keep_report(path, report_studies(kept, title, not suffix), draw_studies(kept, title, not suffix), formats)
    return common.Reproduction(rows, report_studies(rows, "P2 (all columns are in the file)", not suffix, SHORT))


#: Columns of the table: a field of the row, its heading, what it is multiplied by.
COLUMNS = (
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
_MARKS = dict(zip(TRIVIAL, "xv1d", strict=True))
_PAPER_FOUND = {1: (8, 75), 2: (2, 100)}  # the paper's example by round: candidates, percent of the heads found


@dataclass(frozen=True)
class Words:
    """What the paper says about a study: bounds of the mean rounds and of the redundant UAVs, and a summary."""

    rounds: tuple[float, float]  # lowest and highest
    redundant: tuple[float, float]
    at_most: bool  # whether the paper gives only the highest; the lowest are then the lowest possible values
    words: str  # a summary in our words

    def bounds(self, field: str, uavs: int) -> tuple[float, float]:
        """Of ``rounds``, ``redundant``, ``redundancy`` or ``J`` with N UAVs."""
        low, high = (redundant / uavs for redundant in self.redundant)
        return {
            "rounds": self.rounds,
            "redundant": self.redundant,
            "redundancy": (low, high),
            "J": (self.rounds[0] + low, self.rounds[1] + high),
        }[field]

    def format_bounds(self, field: str, uavs: int, scale: float) -> str:
        """The bounds in a table."""
        low, high = (f"{scale * bound:.3g}" for bound in self.bounds(field, uavs))
        return f"at most {high}" if self.at_most else low if low == high else f"{low}–{high}"


def read_paper() -> dict[str, Words]:
    """Read the paper's figures, by study."""
    with (files("detectors.studies") / "data" / "multi_cluster_in_words.csv").open(encoding="utf-8") as file:
        return {
            row["study"]: Words(
                (float(row["rounds_low"] or 1), float(row["rounds_high"])),
                (float(row["redundant_low"] or 0), float(row["redundant_high"])),
                not row["rounds_low"],
                row["words"],
            )
            for row in csv.DictReader(file)
        }


def measure_field(rows: Sequence[Row], field: str) -> Interval | None:
    """Mean over all episodes with its interval, the rows of an episode taken together; ``None`` without a value.

    The cluster metrics are over those with clusters. Rates have Wilson's interval.
    """
    if field in RATES:
        values = [getattr(row, field) for row in rows]
        return rate_interval(values, [row.episode for row in rows]) if rows else None
    means = report.episode_means(rows, field)
    return mean_interval(means) if means else None


def find_by_round(rows: Sequence[Row], rounds: int) -> list[tuple[list[float], list[float]]]:
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
        named = [float(sum(named for named, _ in row.list_rounds()[number : number + 1])) for row in rows]
        found = [float(sum(hits for _, hits in row.list_rounds()[: number + 1])) for row in rows]
        table.append((named, found))
    return table


def _format(interval: Interval | None, scale: float = 1) -> str:
    if interval is None:
        return "–"
    return report.format_interval(interval, ".3g" if scale * interval.mean < 100 else ".0f", scale)


def _list_detectors(rows: Sequence[Row]) -> list[str]:
    """Detectors first, then the trivial policies."""
    return sorted(dict.fromkeys(row.detector for row in rows), key=lambda name: (name in TRIVIAL, name))


def _name_place(study: str, swarm: tuple[str, int, int]) -> str:
    """What distinguishes a swarm from the others of its study."""
    follow, clusters, uavs = swarm
    return {"follow": follow, "clusters": f"M={clusters}", "uavs": f"N={uavs}", "example": "M=8, N=185"}[study]


def _of(rows: Sequence[Row], swarm: tuple[str, int, int], detector: str | None = None) -> list[Row]:
    return [row for row in rows if (row.follow, row.clusters, row.uavs) == swarm and detector in (None, row.detector)]


def report_studies(rows: Sequence[Row], title: str, with_paper: bool, columns: Sequence[Any] = COLUMNS) -> str:
    """The studies that the rows fill, in Markdown; ``columns`` are some of :data:`COLUMNS`."""
    parts = [
        f"# {title}",
        "",
        "Means over all episodes, unfinished ones included, with 95 % intervals (Wilson for rates, bootstrap else). "
        "A policy that destroys all UAVs has a good J_m; compare each detector with the trivial policies.",
    ]
    detectors = _list_detectors(rows)
    for study, swarms in STUDIES.items():
        filled = [swarm for swarm in swarms if _of(rows, swarm)]
        if not filled:
            continue
        words = read_paper()[study]
        parts += ["", f"## {_TITLES[study]}", ""]
        parts += [f"The paper, in words: {words.words}.", ""] if with_paper else []
        lines: list[tuple[str | None, ...]] = []
        for swarm in filled:
            if with_paper:
                said = [
                    words.format_bounds(name, swarm[2], scale) if name in _SAID else "" for name, _, scale in columns
                ]
                lines.append((_name_place(study, swarm), "the paper, in words", None, *said))
            for name in detectors:
                lines += _make_line(_name_place(study, swarm), name, _of(rows, swarm, name), columns)
        if len(filled) > 1:
            for name in detectors:
                lines += _make_line("all", name, [row for swarm in filled for row in _of(rows, swarm, name)], columns)
        parts += report.format_markdown((None, "detector", "n", *(heading for _, heading, _ in columns)), lines)
        if study == "example":
            parts += _report_rounds(_of(rows, swarms[0]), with_paper)
    return "\n".join([*parts, ""])


def _make_line(place: str, detector: str, rows: Sequence[Row], columns: Sequence[Any]) -> list[tuple[str, ...]]:
    values = (_format(measure_field(rows, field), scale) for field, _, scale in columns)
    return [(place, detector, str(len(rows)), *values)] if rows else []


def _report_rounds(rows: Sequence[Row], with_paper: bool) -> list[str]:
    heads = STUDIES["example"][0][1]
    shown = range(min(_ROUNDS_SHOWN, max(2, *(row.rounds for row in rows))))
    lines = []
    if with_paper:
        lines.append(("the paper", *(" / ".join(map(str, _PAPER_FOUND.get(number + 1, ()))) for number in shown)))
    for detector in _list_detectors(rows):
        table = find_by_round([row for row in rows if row.detector == detector], len(shown))
        cells = (
            f"{_format(mean_interval(named))} / {_format(mean_interval(found), 100 / heads)}" for named, found in table
        )
        lines.append((detector, *cells))
    header = ("detector", *(f"round {number + 1}" for number in shown))
    return [
        "",
        f"Candidates of a round / share of the {heads} heads found until then, %:",
        "",
        *report.format_markdown(header, lines),
    ]


def draw_studies(rows: Sequence[Row], title: str, with_paper: bool) -> Figure:
    """One row of panels for each study: R, redundancy and J_m with 95 % intervals; the paper's bounds in grey.

    A study of several swarms of which the rows hold one is left out, unless there is no other.
    """
    filled = {study: sum(bool(_of(rows, swarm)) for swarm in swarms) for study, swarms in STUDIES.items()}
    studies = [study for study, count in filled.items() if count > 1 or (count and len(STUDIES[study]) == 1)]
    studies = studies or [study for study, count in filled.items() if count]
    figure, grid = report.make_panels(15, 3.6 * len(studies) + 0.8, len(studies), 3)
    panels = (("rounds", "rounds R", 1), ("redundancy", "redundancy, %", 100), ("J", "J_m", 1))
    for axes_row, study in zip(grid, studies, strict=True):
        for axes, (field, label, scale) in zip(axes_row, panels, strict=True):
            _draw_panel(axes, rows, study, field, scale, with_paper)
            axes.set_ylabel(label)
        if study == "example":
            _draw_found(axes_row[0], _of(rows, STUDIES[study][0]), with_paper)
        axes_row[0].set_title(_TITLES[study], loc="left", fontsize=10)
    report.add_legend(figure, [grid[0, 1]])
    counts = report.group_rows(rows, lambda row: (row.detector, row.follow, row.clusters, row.uavs)).values()
    caption = f"Means; {report.format_counts(map(len, counts), 'episodes')}. Bars are 95 % bootstrap intervals."
    more = " Grey areas and lines: what the paper says in words, without n." if with_paper else ""
    caption_figure(figure, title, f"{caption}{more} Grey marks: trivial policies.")
    return figure


def _choose_look(detector: str, detectors: Sequence[str]) -> dict[str, Any]:
    if detector in TRIVIAL:
        return {"color": "#777777", "marker": _MARKS[detector], "label": detector}
    number = detectors.index(detector)
    return {"color": COLORS[number % len(COLORS)], "marker": MARKERS[number % len(MARKERS)], "label": detector}


def _draw_panel(axes: Axes, rows: Sequence[Row], study: str, field: str, scale: float, with_paper: bool) -> None:
    swarms = [swarm for swarm in STUDIES[study] if _of(rows, swarm)]
    detectors = _list_detectors(rows)
    if with_paper:
        bounds = scale * np.array([read_paper()[study].bounds(field, swarm[2]) for swarm in swarms])
        edges = np.repeat(np.arange(len(swarms)), 2) + np.tile([-0.5, 0.5], len(swarms))
        ends = np.repeat(bounds, 2, axis=0)
        axes.fill_between(edges, ends[:, 0], ends[:, 1], color="#cccccc", edgecolor="#999999", label="the paper")
    for number, detector in enumerate(detectors):
        shift = 0.7 * ((number + 0.5) / len(detectors) - 0.5)
        means = [measure_field(_of(rows, swarm, detector), field) for swarm in swarms]
        known = {place + shift: mean for place, mean in enumerate(means) if mean is not None}
        look = _choose_look(detector, detectors)
        report.draw_intervals(axes, known, scale, ls="none", ms=5, lw=1.2, **look)
    axes.set_xticks(range(len(swarms)), [_name_place(study, swarm) for swarm in swarms])
    if field == "redundancy":
        axes.set_yscale("symlog", linthresh=1)
        axes.set_ylim(-0.2, 150)
        axes.set_yticks([0, 1, 10, 100], ["0", "1", "10", "100"])
    else:
        axes.set_yscale("log")
        axes.set_yticks([1, 2, 3, 4, 5, 7, 10, 20], ["1", "2", "3", "4", "5", "7", "10", "20"])
        axes.minorticks_off()


def _draw_found(axes: Axes, rows: Sequence[Row], with_paper: bool) -> None:
    """Draw the share of the heads that is found until each round."""
    axes.clear()
    style_axes(axes)
    heads, detectors = STUDIES["example"][0][1], _list_detectors(rows)
    x = list(range(1, _ROUNDS_SHOWN + 1))
    for detector in detectors:
        table = find_by_round([row for row in rows if row.detector == detector], _ROUNDS_SHOWN)
        found = [100 * float(np.mean(values)) / heads for _, values in table]
        axes.plot(x, found, lw=1.2, **_choose_look(detector, detectors))
    if with_paper:
        shares = [share for _, share in _PAPER_FOUND.values()]
        axes.plot(list(_PAPER_FOUND), shares, "o--", mfc="none", color="black", ms=9, label="the paper")
    axes.set_xticks(x)
    axes.set_xlabel("round")
    axes.set_ylabel("heads found, %")

"""The paper's figures of P2: rounds and redundancy against follow strategy, M and N, and one swarm round by round."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from usnet_env.config import ArgumentError, unknown_name
from usnet_env.envs import MultiClusterEnv
from usnet_env.evaluation import TRIVIAL
from usnet_env.evaluation.agents import Agent, as_agent
from usnet_env.evaluation.episode import episode_seeds, play_agent, warm_up
from usnet_env.evaluation.metrics import episode_metrics
from usnet_env.evaluation.suite import Measurement, counter, flight_suffix, keep_report, measure, read_rows
from usnet_env.objectives import rounds_hits_and_redundant
from usnet_env.plugins import make_detector

__all__ = ["DETECTORS", "STUDIES", "Cell", "Row", "Task", "cells_of", "play", "reproduce", "tasks_for"]

#: The paper's Algorithm 2, a variant of it, and a detector without training; the trivial policies are added to them.
DETECTORS = ("mc-gassl", "lead-votes", "lagged-regression")
_EPISODES_A_TASK = 2  # few: an episode takes up to minutes, and an interruption loses those of a task


@dataclass(frozen=True)
class Cell:
    """One kind of swarm: follow strategy, M, N, mobility, jitter of the heads."""

    follow: str = "f1"
    clusters: int = 5
    uavs: int = 82
    mobility: str = "iid"
    head_jitter: bool = False


#: The cells of each study (follow strategy, M, N), as the paper has them.
STUDIES: dict[str, tuple[tuple[str, int, int], ...]] = {
    "follow": tuple((f"f{number}", 5, 82) for number in range(1, 8)),
    "clusters": tuple(("f1", clusters, 82) for clusters in (2, 3, 5, 8, 10)),
    "uavs": tuple(("f3", 5, uavs) for uavs in (40, 60, 82, 120, 160, 200)),
    "example": (("f1", 8, 185),),
}


@dataclass(frozen=True)
class Row:
    """One episode of one detector in one cell; metrics by the names of :data:`usnet_env.evaluation.METRICS`.

    Args:
        detector: its name, with its arguments.
        follow, clusters, uavs, mobility, head_jitter: the cell.
        episode: number of the episode.
        redundant: redundant candidates of all rounds.
        named, hits: number of candidates in each round, and how many of them were heads, separated by spaces.
    """

    detector: str
    follow: str
    clusters: int
    uavs: int
    mobility: str
    head_jitter: bool
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

    @property
    def cell(self) -> Cell:
        """Its cell."""
        return Cell(self.follow, self.clusters, self.uavs, self.mobility, self.head_jitter)

    def each_round(self) -> list[tuple[int, int]]:
        """Candidates and hits of every round."""
        return list(zip(map(int, self.named.split()), map(int, self.hits.split()), strict=True))


@dataclass(frozen=True)
class Task:
    """Some consecutive episodes of one detector in one cell."""

    detector: str
    cell: Cell
    first: int
    count: int


def cells_of(studies: Sequence[str], mobility: str = "iid", head_jitter: bool = False) -> list[Cell]:
    """The cells of some studies, each cell once.

    Raises:
        ArgumentError: no such study.
    """
    for study in studies:
        if study not in STUDIES:
            raise unknown_name("study", study, STUDIES)
    found = [cell for study in studies for cell in STUDIES[study]]
    return [Cell(*cell, mobility, head_jitter) for cell in dict.fromkeys(found)]


def tasks_for(detectors: Sequence[str], cells: Sequence[Cell], episodes: int) -> list[Task]:
    """Tasks of all cells, the first episodes of all cells first: an interruption leaves them equally full."""
    return [
        Task(detector, cell, first, min(_EPISODES_A_TASK, episodes - first))
        for first in range(0, episodes, _EPISODES_A_TASK)
        for cell in cells
        for detector in detectors
    ]


@cache
def _make_agent(detector: str) -> Agent:
    """This process's agent of that name, warmed up so that the seconds of an episode exclude compiling and loading."""
    agent = as_agent(make_detector(detector))
    warm_up(MultiClusterEnv(), agent, detector, episode_seeds(0, 0)[0])
    return agent


def play(task: Task, seed: int) -> list[Row]:
    """Play the episodes of one task, the ones that ``usnet evaluate`` plays with the same seed."""
    env, agent = MultiClusterEnv(**asdict(task.cell)), _make_agent(task.detector)
    made = []
    for episode in range(task.first, task.first + task.count):
        rounds = play_agent(env, agent, task.detector, episode, episode_seeds(seed, episode))
        metrics = episode_metrics(env.problem, rounds)
        candidates = np.array([each.answer.candidates for each in rounds])
        hits, redundant = rounds_hits_and_redundant(rounds[0].truth.head, candidates)
        values: dict[str, Any] = {
            name: np.nan if metrics[name] is None else metrics[name] for name in Row.__annotations__ if name in metrics
        }
        values |= asdict(task.cell) | {
            "detector": task.detector,
            "episode": episode,
            "redundant": int(redundant.sum()),
            "named": " ".join(map(str, hits + redundant)),
            "hits": " ".join(map(str, hits)),
        }
        made.append(Row(**values))
    return made


def _keys(task: Task) -> list[tuple[str, Cell, int]]:
    return [(task.detector, task.cell, episode) for episode in range(task.first, task.first + task.count)]


def _order(row: Row) -> tuple[str, int, int, str, int]:
    return row.follow, row.clusters, row.uavs, row.detector, row.episode


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
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Row]:
    """Measure the studies' cells; an interrupted measurement continues where it stopped.

    Args:
        folder: gets ``rounds[-mobility][-jitter]-seedS.csv``, ``.md`` and ``.png``; table and picture are of all rows
            in the file, those of earlier measurements included.
        studies: names of :data:`STUDIES`.
        detectors: names of detectors.
        trivial: also play the trivial policies.
        episodes: of each detector in each cell.
        mobility: how the heads fly.
        head_jitter: whether they have the followers' noise.
        seed: of the episodes; the reporting seed is one that nothing was tuned on.
        workers: processes.
        progress: called with the episodes done and to do.

    Returns:
        The rows of these studies and detectors.

    Raises:
        ArgumentError: an argument was refused.
        EvaluationError: a detector failed; rows that were finished are kept.
    """
    from detectors.studies import rounds_report

    cells = cells_of(studies, mobility, head_jitter)
    names = list(dict.fromkeys([*detectors, *(TRIVIAL if trivial else ())]))
    if not cells or not names or episodes < 1:
        raise ArgumentError("studies, detectors and episodes must not be empty or 0.")
    for name in names:
        make_detector(name).reset(seed)  # a wrong name or argument is refused before anything is measured
    MultiClusterEnv(**asdict(cells[0]))
    tasks = tasks_for(names, cells, episodes)
    suffix = flight_suffix(mobility, head_jitter)
    path = folder / f"rounds{suffix}-seed{seed}.csv"
    what = Measurement(Row, partial(play, seed=seed), _keys, lambda row: (row.detector, row.cell, row.episode), _order)
    rows = measure(what, tasks, path, workers, counter(sum(task.count for task in tasks), progress))
    title = f"P2, {mobility} heads{' with jitter' if head_jitter else ''}"
    kept = read_rows(path, Row)
    keep_report(
        path,
        rounds_report.markdown(kept, title, with_paper=not suffix),
        rounds_report.draw(kept, title, with_paper=not suffix),
    )
    return rows

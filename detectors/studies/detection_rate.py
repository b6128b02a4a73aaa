"""Detection rates in single clusters: many short episodes over a grid of cells, on every core, resumable."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from usnet_env.envs import SingleClusterEnv
from usnet_env.evaluation import suite
from usnet_env.evaluation.statistics import Interval, rate_interval
from usnet_env.plugins import make_detector
from usnet_env.window import Window

__all__ = ["Cell", "Row", "Task", "measure", "rate_of", "read_rows", "tasks_for", "write_rows"]

_BATCH_UAVS = 64  # UAVs of the windows that a detector gets at once: small swarms train side by side


@dataclass(frozen=True)
class Cell:
    """One kind of swarm: follow strategy, followers m, decoys, mobility, jitter of the heads."""

    follow: str
    followers: int
    decoys: int = 0
    mobility: str = "iid"
    head_jitter: bool = False

    @property
    def uavs(self) -> int:
        """N."""
        return self.followers + 1 + self.decoys


@dataclass(frozen=True)
class Row:
    """One episode of one detector in one cell.

    Args:
        detector: its name, with its arguments.
        follow, followers, decoys, mobility, head_jitter: the cell.
        episode: number of the episode.
        named: whether there was a candidate.
        hit: whether the head was the only candidate: J_s = 0.
        explained: share of the squared velocity that the detector's fit explains, mean over UAVs; NaN without a fit.
        seconds: time of the batch divided by its number of episodes.
        batch: first episode and number of episodes that the detector answered together, such as ``42+21``. A detector
            that is not ``side_by_side`` answers each episode alone: ``43+1`` for episode 43.
    """

    detector: str
    follow: str
    followers: int
    decoys: int
    mobility: str
    head_jitter: bool
    episode: int
    named: int
    hit: int
    explained: float
    seconds: float
    batch: str

    @property
    def cell(self) -> Cell:
        """Its cell."""
        return Cell(self.follow, self.followers, self.decoys, self.mobility, self.head_jitter)


@dataclass(frozen=True)
class Task:
    """Some consecutive episodes of one detector in one cell."""

    detector: str
    cell: Cell
    first: int
    count: int


def tasks_for(detectors: Sequence[str], cells: Sequence[Cell], episodes: Callable[[Cell], int]) -> list[Task]:
    """Tasks of all cells, the small swarms first.

    A detector that is ``side_by_side`` answers the episodes of a task as one batch, so its answers depend on the batch,
    and the last batch of a cell depends on the number of episodes. The rows therefore record the batch. The answers of
    other detectors depend on neither.
    """
    tasks = []
    for cell in sorted(cells, key=lambda cell: (cell.uavs, cell.follow)):
        size = max(1, _BATCH_UAVS // cell.uavs)
        for detector in detectors:
            tasks += [
                Task(detector, cell, first, min(size, episodes(cell) - first))
                for first in range(0, episodes(cell), size)
            ]
    return tasks


def _seeds(seed: int, cell: Cell, episode: int, branch: int) -> int:
    """Seed of an episode's swarm (branch 0) or detector (branch 1); every detector gets the same swarms."""
    name = int.from_bytes(f"{cell.follow}/{cell.mobility}".encode(), "little")
    key = (name % 2**61, cell.followers, cell.decoys, int(cell.head_jitter), episode, branch)
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1)[0])


def play(task: Task, seed: int) -> list[Row]:
    """Play the episodes of one task."""
    env = SingleClusterEnv(**asdict(task.cell))
    detector = make_detector(task.detector)
    episodes = range(task.first, task.first + task.count)
    windows, heads = [], []
    for episode in episodes:
        observation, _ = env.reset(seed=_seeds(seed, task.cell, episode, 0))
        windows.append(Window.from_observation(observation))
        heads.append(env.swarm.head)
    answer_batch = getattr(detector, "detect_batch", None) if getattr(detector, "side_by_side", False) else None
    size = task.count if answer_batch else 1
    rows: list[Row] = []
    for first in range(0, task.count, size):
        batch = windows[first : first + size]
        detector.reset(_seeds(seed, task.cell, episodes[first], 1))
        begun = time.perf_counter()
        detections = answer_batch(batch) if answer_batch else [detector.detect(batch[0])]
        seconds = (time.perf_counter() - begun) / len(batch)
        rows += [
            Row(
                detector=task.detector,
                **asdict(task.cell),
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


def measure(
    tasks: Sequence[Task],
    seed: int,
    path: Path,
    workers: int,
    advance: Callable[[int], None] = lambda episodes: None,
) -> list[Row]:
    """Play all tasks that ``path`` does not hold yet; rows are written as they come.

    Args:
        tasks: from :func:`tasks_for`.
        seed: of the whole measurement. The rows do not contain it, so the name of the file should.
        path: the CSV of rows, appearing whole each time it is written.
        workers: processes.
        advance: called with the number of episodes that are newly done.

    Returns:
        The rows of the tasks, in their order.
    """
    return suite.measure(_measurement(seed), tasks, path, workers, advance)


def _measurement(seed: int) -> suite.Measurement[Task, Row]:
    return suite.Measurement(
        Row, partial(play, seed=seed), _keys, lambda row: (row.detector, row.cell, row.episode), _order
    )


def _keys(task: Task) -> list[tuple[str, Cell, int]]:
    return [(task.detector, task.cell, episode) for episode in range(task.first, task.first + task.count)]


def _order(row: Row) -> tuple[str, int, str, int, str, int]:
    return row.mobility, row.decoys, row.follow, row.followers, row.detector, row.episode


def read_rows(path: Path) -> list[Row]:
    """The rows of a file; none if there is no file.

    Raises:
        ArgumentError: the file holds something else.
    """
    return suite.read_rows(path, Row)


def write_rows(path: Path, made: Iterable[Row]) -> None:
    """Write the rows, sorted, so that the file is there in full or as it was."""
    suite.write_rows(path, made, Row, _order)


def rate_of(made: Iterable[Row], what: str = "hit") -> tuple[int, Interval] | None:
    """Number of episodes and the share with ``what`` (``"hit"`` or ``"named"``), Wilson; ``None`` without a row."""
    values = [getattr(row, what) for row in made]
    return (len(values), rate_interval(values)) if values else None

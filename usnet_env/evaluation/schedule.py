"""What of a run has been played, with which seeds, and what is left to play."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError
from usnet_env.evaluation.episode import Row, episode_seeds
from usnet_env.evaluation.store import RunStore
from usnet_env.evaluation.table import Columns, RowTable
from usnet_env.evaluation.workers import Task, as_failure
from usnet_env.processes import Outcome


@dataclass
class Seeds:
    """The seeds of the episodes.

    An isolated run draws a new secret each time it is resumed, as the earlier ones are known by then. An episode that
    some detectors have played before keeps its swarm for the others.

    Args:
        seed: the seed of the evaluation.
        secret: the secret of an isolated run.
        given: whether the secret is that of an earlier run, so that all rows must have its seeds.
    """

    seed: int
    secret: str | None = None
    given: bool = False
    _swarms: dict[int, int] = field(default_factory=dict)

    def of(self, episode: int) -> tuple[int, int]:
        """The seeds of the swarm and of the detector."""
        swarm, detector = episode_seeds(self.seed, episode, self.secret)
        return self._swarms.get(episode, swarm), detector

    def take_over(self, rows: RowTable) -> None:
        """Take over the swarms of episodes that have been played.

        Raises:
            ArgumentError: the rows have other seeds than those of this run.
        """
        columns = (rows.column(name).tolist() for name in ("episode", "swarm_seed", "detector_seed"))
        for episode, swarm, detector in set(zip(*columns, strict=True)):
            if self.secret is None or self.given:
                same = (swarm, detector) == episode_seeds(self.seed, episode, self.secret)
            else:
                same = self._swarms.setdefault(episode, swarm) == swarm
            if not same:
                raise ArgumentError("out must hold only rows of this run, got rows of another seed.")


class Schedule:
    """What of a run has been played, and what is left: iterates over the tasks that are to be played.

    At first every contestant is prepared, so that one that refuses its arguments is found before anything is written.
    One that has failed plays no more.

    Args:
        store: the folder of the run; without one, the rows are kept in memory.
        seeds: take over the swarms of the rows in the folder.
        labels: of the contestants, in their order.
        detectors: labels of all detectors of the run: of the contestants, and of others that have played.
        episodes: number of episodes.
        columns: of the rows.

    Attributes:
        done: ``(episodes,)`` bool for each contestant, which episodes have been played.
        total: number of episodes of all contestants.
        count: number of episodes that were missing at first.
        finished: number of episodes that are done.
        uses_secret: whether the seeds' secret is that of some rows.
        failures: the errors of contestants that have failed.

    Raises:
        ArgumentError: the folder holds rows of another run.
    """

    def __init__(
        self,
        store: RunStore | None,
        seeds: Seeds,
        labels: Sequence[str],
        detectors: Sequence[str],
        episodes: int,
        columns: Columns,
    ) -> None:
        self._store = store
        self._played = RowTable(columns)
        self._unsaved: list[Row] = []
        self._withhold = seeds.secret is not None
        self.failures: dict[str, BaseException] = {}
        there, numbers = self.table.column("detector"), self.table.column("episode")
        if not set(there) <= set(detectors) or ((numbers < 0) | (numbers >= episodes)).any():
            raise ArgumentError("out must hold only rows of this run, got rows of other detectors or episodes.")
        self.done = {label: np.isin(np.arange(episodes), numbers[there == label]) for label in labels}
        seeds.take_over(self.table)
        missing = {label: ~own for label, own in self.done.items() if not own.all()}
        self.total = len(labels) * episodes
        self.count = sum(int(own.sum()) for own in missing.values())
        self.finished = self.total - self.count
        self.uses_secret = bool(self.count or seeds.given)
        self._unprepared = set(missing)
        self._left = self._list(missing, seeds)

    @staticmethod
    def _list(missing: Mapping[str, NDArray[np.bool_]], seeds: Seeds) -> Iterator[Task]:
        for label in missing:
            yield Task(label, None, seeds.of(0))
        for episode in np.flatnonzero(np.any(list(missing.values()), axis=0)).tolist():
            pair = seeds.of(episode)
            for label, own in missing.items():
                if own[episode]:
                    yield Task(label, episode, pair)

    @property
    def table(self) -> RowTable:
        """All rows that are saved, in the order in which they were played."""
        return self._played if self._store is None else self._store.table

    def __iter__(self) -> Iterator[Task]:
        return filter(self.is_wanted, self._left)

    def is_wanted(self, task: Task) -> bool:
        """Whether the contestant of the task has not failed."""
        return task.label not in self.failures

    def note(self, outcome: Outcome[Task, Row | None]) -> None:
        """Take notice of an outcome, and save the rows that may be saved; errors of arguments are raised."""
        task, row = outcome.task, outcome.result
        self._unprepared.discard(task.label)
        if outcome.error is not None:
            failure = as_failure(task, outcome.error)
            if task.label not in self.failures:
                self.failures[task.label] = failure
                if self._store is not None:
                    self._store.note_failures({task.label: str(failure)})
        if row is not None:
            self.done[task.label][task.episode] = True
            self.finished += 1
            self._unsaved.append(row)
        if not self._unprepared:
            self._save(secret=self._withhold)

    def save_rest(self) -> None:
        """Save also the rows of episodes that not all have played: no contestant runs any more."""
        if not self._unprepared:
            self._save(secret=False)

    def _save(self, secret: bool) -> None:
        """Save rows; if their seeds are secret, not those of an episode that others have still to play."""
        rows, self._unsaved = self._unsaved, []
        if secret:
            playing = [own for label, own in self.done.items() if label not in self.failures]
            self._unsaved = [row for row in rows if not all(own[row["episode"]] for own in playing)]
            rows = [row for row in rows if all(own[row["episode"]] for own in playing)]
        if self._store is None:
            self._played.extend(rows)
        elif rows:
            self._store.append(rows)

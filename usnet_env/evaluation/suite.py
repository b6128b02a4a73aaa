"""Suites: games of many cells, played on several processes and kept in a file of rows; none is played twice."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import gymnasium as gym

from usnet_env.envs.play import PlayedRound
from usnet_env.evaluation.agents import Answer
from usnet_env.evaluation.engine import Place
from usnet_env.evaluation.episode import episode_seeds, play_agent
from usnet_env.evaluation.mapping import run_or_raise
from usnet_env.evaluation.store import RowFile
from usnet_env.evaluation.table import RowTable, columns_of, read_table
from usnet_env.evaluation.workers import Worker
from usnet_env.processes import Limits

__all__ = ["Game", "Place", "Suite", "list_games", "play_detector", "read_rows", "split_games"]

CellT = TypeVar("CellT")
RowT = TypeVar("RowT")

#: A cell and the number of a game in it. The number gives the seeds, so games of one number meet the same swarm.
Game = tuple[CellT, int]


@dataclass(frozen=True)
class Suite(Generic[CellT, RowT]):
    """What is played, and what is kept of it.

    Args:
        cell: the class of the cells, a frozen dataclass: a detector and the arguments of an environment, for example.
        row: the class of the rows, a frozen dataclass of ``int``, ``float``, ``str`` and ``bool``: the fields of the
            cell, the number of the game, and what was measured. It may derive from the class of the cells.
        play: plays games, and returns the row of each. Other processes get it by value.
        number: the field of a row that has the number of its game.
        order: fields by which the rows of a complete file are sorted; none: they stay as they were played.
        digits: decimals of ``float``; ``None``: as many as are needed to read the same value again.
    """

    cell: type[CellT]
    row: type[RowT]
    play: Callable[[Sequence[Game[CellT]]], Iterable[RowT]]
    number: str = "episode"
    order: tuple[str, ...] = ()
    digits: int | None = None

    def run(
        self,
        tasks: Sequence[Sequence[Game[CellT]]],
        path: Path,
        *,
        workers: int | Place = 1,
        progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> list[RowT]:
        """Play all tasks of which ``path`` lacks a row; rows are written as they come.

        Args:
            tasks: games that one process plays in one go, as :func:`split_games` returns them.
            path: CSV file of the rows. Its name should hold whatever its rows do not say, such as the seed.
            workers: number of processes, or a :class:`Place` that also names a backend. The rows do not depend on it,
                except for measured seconds.
            progress: called with the number of games that are done, and of all games.

        Returns:
            The rows of the tasks, in their order.

        Raises:
            ArgumentError: another process writes the same file, its folder was removed, or it holds other rows.
            EvaluationError: a task ended its process; the message names it. Rows that were finished are kept.
        """
        wanted = [self._key_of_game(game) for task in tasks for game in task]
        with RowFile(path, columns_of(self.row), digits=self.digits) as file:
            rows = {self._key(row): row for row in (self.row(**each) for each in file.table)}
            todo = [task for task in tasks if any(self._key_of_game(game) not in rows for game in task)]
            done = len(set(wanted) & rows.keys())
            progress(done, len(wanted))
            with closing(run_or_raise(self.play, todo, workers, _name_task)) as played:
                for _, made in played:
                    fresh = {self._key(row): row for row in made if self._key(row) not in rows}
                    rows.update(fresh)
                    file.append(map(vars, fresh.values()))
                    done += len(fresh)
                    progress(done, len(wanted))
            if self.order:
                file.sort(self._sorted)
        return [rows[key] for key in wanted]

    def _key(self, row: RowT) -> Hashable:
        """What tells a row from all others: its cell and number."""
        return (*(getattr(row, field.name) for field in fields(cast(Any, self.cell))), getattr(row, self.number))

    @staticmethod
    def _key_of_game(game: Game[CellT]) -> Hashable:
        return (*vars(game[0]).values(), game[1])

    def _sorted(self, table: RowTable) -> list[int]:
        keys = list(zip(*(table.column(name).tolist() for name in self.order), strict=True))
        return sorted(range(len(keys)), key=keys.__getitem__)


def list_games(cells: Sequence[CellT], games: int | Callable[[CellT], int], first: int = 0) -> list[list[Game[CellT]]]:
    """List the games of all cells, cell by cell, each as a task of its own.

    Args:
        cells: the cells.
        games: number of games of each cell, or a function that returns it.
        first: number of the first game.
    """
    return [
        [(cell, number)]
        for cell in cells
        for number in range(first, first + (games(cell) if callable(games) else games))
    ]


def split_games(cells: Sequence[CellT], games: int, size: int) -> list[list[Game[CellT]]]:
    """Split the games of all cells into tasks, the first games of all cells first.

    An interruption then leaves all cells equally full.

    Args:
        cells: the cells.
        games: number of games of each cell.
        size: number of games of one task. An interruption loses at most those of the tasks that are being played.
    """
    return [
        [(cell, number) for number in range(first, min(first + size, games))]
        for first in range(0, games, size)
        for cell in cells
    ]


def read_rows(path: Path, kind: type[RowT]) -> list[RowT]:
    """Read the rows of a file; none if there is no file.

    Raises:
        ArgumentError: the file holds something else.
    """
    return [kind(**row) for row in read_table(path, columns_of(kind))]


def _name_task(task: Sequence[Game[Any]]) -> str:
    """Name a task by its first game."""
    cell, number = task[0]
    return f"Game {number} of {' '.join(repr(cell).split())}"


_workers: dict[tuple[str, bool], Worker] = {}  # of this process


def play_detector(
    env: gym.Env[Any, Any], detector: str, seed: int, episode: int, isolate: bool = True
) -> list[PlayedRound[Answer]]:
    """Play the episode that :func:`usnet_env.evaluate` plays with the same seed and without a secret.

    Args:
        env: a USNET environment.
        detector: a name as :func:`usnet_env.make_detector` takes it. Each process makes one detector of a name, which
            answers a window before anything is timed.
        seed: seed of all episodes.
        episode: number of the episode.
        isolate: play the detector in a process of its own, which never holds an environment.

    Raises:
        EvaluationError: the detector failed.
    """
    if (detector, isolate) not in _workers:
        _workers[detector, isolate] = Worker("", {}, {detector: detector}, Limits() if isolate else None)
    agent = _workers[detector, isolate].find_agent(env, detector, episode_seeds(seed, 0)[0])
    return play_agent(env, agent, detector, episode, episode_seeds(seed, episode))

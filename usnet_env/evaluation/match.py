"""Who plays where: one process's environment and its players, and the same spread over several processes."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from multiprocessing.context import SpawnContext
from typing import Any

import gymnasium as gym

from usnet_env.config import ArgumentError
from usnet_env.evaluation.environments import environment_spec, make_environment
from usnet_env.evaluation.episode import Row, play_episode, warm_up
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.players import Player, as_player
from usnet_env.plugins import make_detector

__all__ = ["Entrant", "Match", "play_in_processes"]

_TASKS_AHEAD = 2  # tasks that wait for each worker: enough to keep it busy, few enough to be dropped at once

Task = tuple[int, int]  # episode, number of the entrant


@dataclass(frozen=True)
class Entrant:
    """A detector under its label: a name to make it from, or the object itself."""

    label: str
    detector: Any

    def player(self) -> Player:
        """A fresh player for a name; the object's own player otherwise."""
        return as_player(make_detector(self.detector) if isinstance(self.detector, str) else self.detector)


@dataclass
class Match:
    """Plays episodes in this process. A player is made, and warmed up, when it plays for the first time."""

    env: gym.Env[Any, Any]
    entrants: list[Entrant]
    seed: int
    _players: dict[int, Player] = field(default_factory=dict)

    def play(self, task: Task) -> Row:
        """One episode of one entrant."""
        episode, number = task
        entrant = self.entrants[number]
        if number not in self._players:
            player = entrant.player()
            warm_up(self.env, player, entrant.label, self.seed)
            self._players[number] = player
        return play_episode(self.env, self._players[number], entrant.label, self.seed, episode)


_here: Match | None = None  # of a worker process
_arguments: tuple[str, dict[str, Any], list[Entrant], int]


def _prepare(env_id: str, env_kwargs: dict[str, Any], entrants: list[Entrant], seed: int) -> None:
    # Processes share the cores already; read by numeric libraries that a detector brings in after this.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    global _arguments
    _arguments = (env_id, env_kwargs, entrants, seed)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this worker process when its parent does, killed ones included; nobody waits for its row then."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _play(task: Task) -> Row:
    # The match is made in the first task, not by the initializer, whose errors would not reach the caller.
    global _here
    if _here is None:
        env_id, env_kwargs, entrants, seed = _arguments
        _here = Match(make_environment(environment_spec(env_id), env_kwargs), entrants, seed)
    return _here.play(task)


class _OwnProcesses(SpawnContext):
    """Remembers the processes that it starts: an executor has no public way to stop a running task."""

    def __init__(self) -> None:
        super().__init__()
        self.started: list[Any] = []

    def Process(self, *args: Any, **kwargs: Any) -> Any:  # type: ignore[override]  # a class in the base
        """A process, remembered."""
        process = multiprocessing.context.SpawnProcess(*args, **kwargs)
        self.started.append(process)
        return process


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Processes started inside never see Ctrl-C, which a terminal sends to all: only their parent answers it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def play_in_processes(
    env_id: str,
    env_kwargs: Mapping[str, Any],
    entrants: list[Entrant],
    seed: int,
    tasks: Iterable[Task],
    workers: int,
    collect: Callable[[Row], None],
) -> None:
    """Play all tasks in processes of their own; ``collect`` gets each row as it is finished, in any order.

    Args:
        env_id: the environment, made once in each process; a module in front of it is imported there.
        env_kwargs: its arguments.
        entrants: who plays.
        seed: of the evaluation.
        tasks: episodes and numbers of entrants.
        workers: how many processes.
        collect: called in this process.

    Raises:
        ArgumentError: something cannot be sent to another process.
        EvaluationError: a detector failed, or a process died.
    """
    arguments = (env_id, dict(env_kwargs), entrants, seed)
    try:
        pickle.dumps(arguments)
    except Exception as error:
        raise ArgumentError(
            f"workers must be 1 for a detector or argument that cannot be sent to another process, got {workers}: "
            f"{error}."
        ) from None
    context = _OwnProcesses()
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_prepare, initargs=arguments)
    queue, waiting = iter(tasks), set[Future[Row]]()
    try:
        with _interrupts_ignored():
            waiting.update(pool.submit(_play, task) for task in islice(queue, workers * _TASKS_AHEAD))
        while waiting:
            done, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                collect(future.result())
                waiting.discard(future)
            waiting.update(pool.submit(_play, task) for task in islice(queue, len(done)))
    except BrokenProcessPool:
        raise EvaluationError(
            "a worker process ended before its time (memory ran out, or what it was sent cannot be imported there); "
            "workers=1 shows the cause."
        ) from None
    except BaseException:
        for future in waiting:  # finished, but not collected yet
            if future.done() and not future.cancelled() and future.exception() is None:
                collect(future.result())
        for process in context.started:
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)

"""Run the episodes of an evaluation, in this process or spread over several worker processes."""

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
from usnet_env.evaluation.agents import Agent, as_agent
from usnet_env.evaluation.environments import find_environment, make_environment
from usnet_env.evaluation.episode import Row, play_episode, warm_up
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.plugins import make_detector

__all__ = ["Contestant", "Worker", "run_in_processes"]

_TASKS_AHEAD = 2  # queued tasks for each worker: enough to keep it busy, few enough to cancel quickly

Task = tuple[int, int]  # episode, index of the contestant


@dataclass(frozen=True)
class Contestant:
    """A detector or policy that takes part in an evaluation.

    Args:
        label: its name in rows and tables.
        detector: a name as :func:`usnet_env.make_detector` takes it, or the object itself.
    """

    label: str
    detector: Any

    def make_agent(self) -> Agent:
        """Create the agent: a new detector if a name is given, else the given object."""
        return as_agent(make_detector(self.detector) if isinstance(self.detector, str) else self.detector)


@dataclass
class Worker:
    """Runs episodes in one process. Each agent is created and warmed up before its first episode.

    Args:
        env: the environment of this process.
        contestants: all contestants of the evaluation.
        seed: the seed of the evaluation.
    """

    env: gym.Env[Any, Any]
    contestants: list[Contestant]
    seed: int
    _agents: dict[int, Agent] = field(default_factory=dict)

    def run_task(self, task: Task) -> Row:
        """Play one episode with one contestant."""
        episode, number = task
        contestant = self.contestants[number]
        if number not in self._agents:
            agent = contestant.make_agent()
            warm_up(self.env, agent, contestant.label, self.seed)
            self._agents[number] = agent
        return play_episode(self.env, self._agents[number], contestant.label, self.seed, episode)


_worker: Worker | None = None  # of this worker process
_worker_arguments: tuple[str, dict[str, Any], list[Contestant], int]


def _prepare_process(env_id: str, env_kwargs: dict[str, Any], contestants: list[Contestant], seed: int) -> None:
    # The processes already share the cores. Numeric libraries that a detector imports later read this variable.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    global _worker_arguments
    _worker_arguments = (env_id, env_kwargs, contestants, seed)
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    """Exit this worker process as soon as its parent has ended, even if the parent was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run_task(task: Task) -> Row:
    # The first task creates the worker, not the initializer: an error there would not reach the caller.
    global _worker
    if _worker is None:
        env_id, env_kwargs, contestants, seed = _worker_arguments
        _worker = Worker(make_environment(find_environment(env_id), env_kwargs), contestants, seed)
    return _worker.run_task(task)


class _TrackedProcesses(SpawnContext):
    """Keeps a list of the processes that it starts, because an executor has no public way to stop a running task."""

    def __init__(self) -> None:
        super().__init__()
        self.started: list[Any] = []

    def Process(self, *args: Any, **kwargs: Any) -> Any:  # type: ignore[override]  # a class in the base
        """Create a process and add it to the list."""
        process = multiprocessing.context.SpawnProcess(*args, **kwargs)
        self.started.append(process)
        return process


@contextmanager
def _ignore_interrupts() -> Iterator[None]:
    """Let processes started inside ignore Ctrl-C, which a terminal sends to all: only the parent handles it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def run_in_processes(
    env_id: str,
    env_kwargs: Mapping[str, Any],
    contestants: list[Contestant],
    seed: int,
    tasks: Iterable[Task],
    workers: int,
    collect: Callable[[Row], None],
) -> None:
    """Run all tasks in separate processes; ``collect`` receives each row when it is finished, in any order.

    Args:
        env_id: id of the environment, created once in each process; a module before the id is imported there.
        env_kwargs: arguments of the environment.
        contestants: all contestants of the evaluation.
        seed: the seed of the evaluation.
        tasks: pairs of an episode and the index of a contestant.
        workers: number of processes.
        collect: called with each row, in this process.

    Raises:
        ArgumentError: an argument cannot be sent to another process.
        EvaluationError: a detector failed, or a process ended early.
    """
    arguments = (env_id, dict(env_kwargs), contestants, seed)
    try:
        pickle.dumps(arguments)
    except Exception as error:
        raise ArgumentError(
            f"workers must be 1 for a detector or argument that cannot be sent to another process, got {workers}: "
            f"{error}."
        ) from None
    context = _TrackedProcesses()
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_prepare_process, initargs=arguments)
    queue, waiting = iter(tasks), set[Future[Row]]()
    try:
        with _ignore_interrupts():
            waiting.update(pool.submit(_run_task, task) for task in islice(queue, workers * _TASKS_AHEAD))
        while waiting:
            done, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                collect(future.result())
                waiting.discard(future)
            waiting.update(pool.submit(_run_task, task) for task in islice(queue, len(done)))
    except BrokenProcessPool:
        raise EvaluationError(
            "a worker process ended unexpectedly (it ran out of memory, or could not import what it received); "
            "workers=1 shows the cause."
        ) from None
    except BaseException:
        for future in waiting:  # keep the rows that are finished but not collected yet
            if future.done() and not future.cancelled() and future.exception() is None:
                collect(future.result())
        for process in context.started:
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)

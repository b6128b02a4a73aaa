"""The evaluator: one function that plays all detectors against the same swarms and scores them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from os import PathLike
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from usnet_env.config import ArgumentError, Config, quote
from usnet_env.evaluation.agents import PolicyAgent, as_agent
from usnet_env.evaluation.environments import find_environment, is_usnet, make_environment
from usnet_env.evaluation.episode import Row, episode_seeds
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.identity import describe, describe_detector
from usnet_env.evaluation.result import EvaluationResult, summarise
from usnet_env.evaluation.store import COLUMNS, RunStore
from usnet_env.evaluation.table import RowTable
from usnet_env.evaluation.workers import PREPARE, Contestant, Plan, Task, run_here, run_in_processes
from usnet_env.files import as_path
from usnet_env.plugins import detector_label, make_detector
from usnet_env.processes import Limits, Outcome

__all__ = ["MOST_EPISODES", "MOST_WORKERS", "TRIVIAL", "evaluate"]

#: The trivial policies that every published table also shows: decision (l) of ``docs/game.md``.
TRIVIAL = ("destroy-all", "none", "random", "one-per-round")

MOST_EPISODES = 1_000_000
MOST_WORKERS = 256


class _Run(Config):
    """The plain arguments of :func:`evaluate`."""

    episodes: Annotated[int, Field(ge=1, le=MOST_EPISODES)]
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    workers: Annotated[int, Field(ge=1, le=MOST_WORKERS)]
    trivial: bool
    progress: bool


def evaluate(
    env: str | gym.Env[Any, Any],
    detector: Any,
    *,
    episodes: int = 100,
    seed: int = 0,
    env_kwargs: Mapping[str, Any] | None = None,
    workers: int = 1,
    trivial: bool = False,
    out: str | PathLike[str] | None = None,
    progress: bool = False,
    time_limit: float | None = None,
    memory_limit: float | None = None,
) -> EvaluationResult:
    """Play the same episodes with every detector, and score them.

    The seeds of the swarm and of the detector in episode i come from two separate branches of (``seed``, i). So every
    detector plays against the same swarms, for any number of workers. Each episode starts with the detector's
    ``reset``; the detector receives windows and nothing else. Before its first episode each detector answers one window
    that is neither timed nor scored (warm-up).

    Args:
        env: a registered id, or an environment object (which allows one worker only, and is not closed).
        detector: a name as :func:`usnet_env.make_detector` takes it, a detector, an object with the ``predict`` method
            of Stable-Baselines3 (called with the observation and ``deterministic=True``), or a list of these.
        episodes: number of episodes for each detector.
        seed: seed of the whole evaluation.
        env_kwargs: arguments of the environment.
        workers: number of processes; the rows do not depend on it, except for the seconds. A script that uses worker
            processes must call ``evaluate`` in a block that begins with ``if __name__ == "__main__":``, because each
            worker process imports the script.
        trivial: also evaluate the policies of :data:`TRIVIAL`.
        out: folder for ``run.json`` (arguments, versions, machine), ``episodes.csv`` and ``summary.json``. An
            interrupted run keeps its finished episodes there, and the same call plays the remaining ones.
        progress: show a progress bar on standard error.
        time_limit: largest wall time of one answer, or of one ``reset``, in seconds; ``None``: no limit. A detector
            that exceeds it has failed.
        memory_limit: largest memory in megabytes (10^6 bytes) that one answer, or one ``reset``, may allocate;
            ``None``: no limit. Linux only. With one of the two limits, episodes are played in worker processes, also
            if ``workers`` is 1.

    Returns:
        Rows, summary and table.

    Raises:
        ArgumentError: an argument was refused.
        EvaluationError: a detector raised an exception, ended its process, exceeded a limit, or its answer has a wrong
            type or shape; the message names the detector, the episode and the cause. The other detectors play to the
            end: the error's ``result`` holds theirs. Finished rows are kept in ``out``.
    """
    folder = None if out is None else as_path("out", out)
    run = _Run(episodes=episodes, seed=seed, workers=workers, trivial=trivial, progress=progress)
    limits = _make_limits(time_limit, memory_limit)
    arguments = _check_env_kwargs(env_kwargs)
    contestants = _make_contestants(detector, run.trivial)
    with ExitStack() as stack:
        if isinstance(env, str):
            environment = make_environment(find_environment(env), arguments)
            stack.callback(environment.close)
        else:
            environment = _check_environment(env, arguments, run.workers, limits)
        config = _make_config(environment, arguments, contestants, run)
        store = None if folder is None else stack.enter_context(RunStore(folder, config))
        rows = _Rows(store, contestants, run)
        tasks = _Tasks(rows, contestants, run)
        threads: list[tuple[str, Task]] = []
        if isinstance(env, str) and tasks.count and (limits.any or (run.workers > 1 and tasks.count > 1)):
            processes = min(run.workers, tasks.count)
            plan = Plan(env, arguments, contestants)
            outcomes = run_in_processes(plan, tasks, tasks.is_wanted, processes, limits, threads)
        else:
            outcomes = run_here(environment, contestants, tasks, threads)
        try:
            with closing(outcomes), _progress_bar(run.progress, rows.done.size, int(rows.done.sum())) as advance:
                for outcome in outcomes:
                    tasks.note(outcome)
                    if outcome.result is not None:
                        rows.add(outcome.task, outcome.result)
                        advance()
                    if tasks.prepared:
                        rows.save()
        finally:
            if tasks.prepared:
                rows.save()
        _warn_of_threads(threads, contestants)
        failed = {contestants[number].label for number in tasks.failures}
        table = rows.table.take(rows.order(rows.table))
        table = table.take(np.flatnonzero([label not in failed for label in table.column("detector")]))
        result = EvaluationResult(table, summarise(table), config)
        if tasks.failures:
            error = EvaluationError(" ".join(map(str, tasks.failures.values())))
            error.result = result if table else None
            raise error
        if store is not None:
            store.finish(rows.order, result.summary)
    return result


class _Rows:
    """The rows of a run, which are kept in a folder if there is one.

    Raises:
        ArgumentError: the folder holds rows of another run.
    """

    def __init__(self, store: RunStore | None, contestants: Sequence[Contestant], run: _Run) -> None:
        self._store = store
        self._played = RowTable(COLUMNS)
        self._unsaved: list[Row] = []
        self._numbers = {contestant.label: number for number, contestant in enumerate(contestants)}
        #: ``(contestants, episodes)`` bool: which episodes have been played.
        self.done = np.zeros((len(contestants), run.episodes), bool)
        kept = self.table
        labels, episodes = kept.column("detector"), kept.column("episode")
        if not set(labels) <= self._numbers.keys() or ((episodes < 0) | (episodes >= run.episodes)).any():
            raise ArgumentError("out must hold only rows of this run, got rows of other detectors or episodes.")
        self.done[[self._numbers[label] for label in labels], episodes] = True
        columns = (episodes, kept.column("swarm_seed"), kept.column("detector_seed"))
        played = set(zip(*(column.tolist() for column in columns), strict=True))
        if any((swarm, detector) != episode_seeds(run.seed, episode) for episode, swarm, detector in played):
            raise ArgumentError("out must hold only rows of this run, got rows of another seed.")

    @property
    def table(self) -> RowTable:
        """All rows, in the order in which they were played."""
        return self._played if self._store is None else self._store.table

    def add(self, task: Task, row: Row) -> None:
        """Add the row of a finished task; :meth:`save` keeps it."""
        self.done[task.contestant, task.episode] = True
        self._unsaved.append(row)

    def save(self) -> None:
        """Append the new rows to the table and the file."""
        rows, self._unsaved = self._unsaved, []
        if self._store is not None and rows:
            self._store.append(rows)
        elif self._store is None:
            for row in rows:
                self._played.append(row)

    def order(self, table: RowTable) -> NDArray[np.int64]:
        """The places of the rows by detector, in the order of the contestants, then by episode."""
        numbers = np.array([self._numbers[label] for label in table.column("detector")], np.int64)
        return np.lexsort((table.column("episode"), numbers))


class _Tasks:
    """Iterates over the tasks that are to be played; a detector that has failed gets no more of them.

    At first every detector is prepared, so that one that refuses its arguments is found before anything is written.
    """

    def __init__(self, rows: _Rows, contestants: Sequence[Contestant], run: _Run) -> None:
        self.failures: dict[int, BaseException] = {}
        missing = ~rows.done
        self.count = int(missing.sum())  # episodes to play
        self._unprepared = set(np.flatnonzero(missing.any(axis=1)).tolist())
        self._left = self._list(sorted(self._unprepared), missing, run.seed)

    @staticmethod
    def _list(unprepared: Sequence[int], missing: NDArray[np.bool_], seed: int) -> Iterator[Task]:
        for number in unprepared:
            yield Task(PREPARE, number, episode_seeds(seed, 0))
        for episode in np.flatnonzero(missing.any(axis=0)).tolist():
            seeds = episode_seeds(seed, episode)
            for number in np.flatnonzero(missing[:, episode]).tolist():
                yield Task(episode, number, seeds)

    @property
    def prepared(self) -> bool:
        """Whether every detector has been prepared, or has failed."""
        return not self._unprepared

    def __iter__(self) -> Iterator[Task]:
        return self

    def __next__(self) -> Task:
        return next(filter(self.is_wanted, self._left))

    def is_wanted(self, task: Task) -> bool:
        """Whether the detector of the task has not failed."""
        return task.contestant not in self.failures

    def note(self, outcome: Outcome[Task, Row | None]) -> None:
        """Take notice of an outcome."""
        self._unprepared.discard(outcome.task.contestant)
        if outcome.error is not None:
            self.failures.setdefault(outcome.task.contestant, outcome.error)


def _warn_of_threads(threads: Sequence[tuple[str, Task]], contestants: Sequence[Contestant]) -> None:
    """Warn of threads that detectors have started and that keep a program from ending."""
    for label in dict.fromkeys(contestants[task.contestant].label for _, task in threads):
        names = [name for name, task in threads if contestants[task.contestant].label == label]
        count = "1 thread running that is no daemon" if len(names) == 1 else f"{len(names)} threads running, no daemons"
        warnings.warn(
            f"detector {label!r} left {count}: {', '.join(dict.fromkeys(names))}.", RuntimeWarning, stacklevel=3
        )


def _make_limits(time_limit: float | None, memory_limit: float | None) -> Limits:
    try:
        return Limits(seconds=time_limit, megabytes=memory_limit)
    except ArgumentError as error:
        text = str(error)
        raise ArgumentError(
            text.replace("seconds", "time_limit", 1)
            if text.startswith("seconds")
            else text.replace("megabytes", "memory_limit", 1)
        ) from None


def _check_env_kwargs(env_kwargs: Mapping[str, Any] | None) -> dict[str, Any]:
    if env_kwargs is None:
        return {}
    if not isinstance(env_kwargs, Mapping) or not all(isinstance(name, str) for name in env_kwargs):
        raise ArgumentError(f"env_kwargs must be a mapping of names to values, got {quote(env_kwargs)}.")
    return dict(env_kwargs)


def _check_environment(env: Any, arguments: Mapping[str, Any], workers: int, limits: Limits) -> gym.Env[Any, Any]:
    """Check an environment object given by the caller, and return it."""
    if not isinstance(env, gym.Env) or not is_usnet(env):
        raise ArgumentError(f"env must be a registered id or a USNET environment, got {quote(env)}.")
    if arguments:
        raise ArgumentError("env_kwargs must be empty if env is an environment object, got arguments for it.")
    if workers != 1:
        raise ArgumentError(f"workers must be 1 if env is an environment object, got {workers}.")
    if limits.any:
        raise ArgumentError("time_limit and memory_limit must be None if env is an environment object, got a limit.")
    return env


def _make_contestants(detector: Any, trivial: bool) -> list[Contestant]:
    """Give each detector its own label."""
    detectors = list(detector) if isinstance(detector, list | tuple) else [detector]
    if not detectors:
        raise ArgumentError("detector must name at least one detector, got an empty list.")
    contestants: dict[str, Contestant] = {}
    for each in detectors:
        label = _make_label(each)
        if label in contestants and isinstance(each, str):
            raise ArgumentError(f"detector must name each detector once, got {label!r} twice.")
        number = 2
        while label in contestants:
            label = f"{_make_label(each)} #{number}"
            number += 1
        contestants[label] = Contestant(label, each)
    for name in TRIVIAL if trivial else ():
        contestants.setdefault(name, Contestant(name, name))
    return list(contestants.values())


def _make_label(detector: Any) -> str:
    """Return the label of a detector; whatever is not a detector is refused."""
    agent = as_agent(make_detector(detector) if isinstance(detector, str) else detector)
    return type(detector).__name__ if isinstance(agent, PolicyAgent) else detector_label(detector)


def _make_config(
    environment: gym.Env[Any, Any], arguments: Mapping[str, Any], contestants: Sequence[Contestant], run: _Run
) -> dict[str, Any]:
    """Return the arguments of the run as plain values: runs with the same config have the same rows."""
    inner: Any = environment.unwrapped
    return {
        "env": type(inner).__name__ if environment.spec is None else environment.spec.id,
        "env_kwargs": describe(arguments),
        "environment": {name: describe(getattr(inner, name)) for name in ("config", "rules") if hasattr(inner, name)},
        "detectors": [contestant.label for contestant in contestants],
        "identities": [
            each.label if isinstance(each.detector, str) else describe_detector(each.detector) for each in contestants
        ],
        "episodes": run.episodes,
        "seed": run.seed,
    }


@contextmanager
def _progress_bar(visible: bool, total: int, done: int) -> Iterator[Callable[[], None]]:
    """Show a progress bar on standard error if ``visible``; yields the function that advances it by one episode."""
    if not visible:
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("episodes"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("episodes", total=total, completed=done)
        yield lambda: bar.advance(task)

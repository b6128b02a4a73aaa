"""Play the missing episodes of a run on a backend, keep their rows, and summarise them: the one loop of all runs."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from usnet_env.config import ArgumentError, Config
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.result import EvaluationResult, summarise
from usnet_env.evaluation.schedule import Rows, Seeds, Tasks
from usnet_env.evaluation.store import COLUMNS, RunStore
from usnet_env.evaluation.table import Columns
from usnet_env.evaluation.workers import Plan, Player, Task, as_failure, send_plan
from usnet_env.processes import Backend, InProcess, Limits, SendError, check_backend, make_backend

MOST_EPISODES = 1_000_000
MOST_WORKERS = 4_096

_GUARD = (
    "A worker process imports the script that started it, so a script must call evaluate in a block that begins with "
    '`if __name__ == "__main__":`.'
)


class RunNumbers(Config):
    """The plain arguments of a run."""

    episodes: Annotated[int, Field(ge=1, le=MOST_EPISODES)]
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    workers: Annotated[int, Field(ge=1, le=MOST_WORKERS)]
    progress: bool


@dataclass(frozen=True)
class Place:
    """Where episodes are played.

    Args:
        backend: a name of :data:`usnet_env.processes.BACKENDS`; ``None``: this process, unless others are needed.
        workers: number of processes.
        limits: of each answer of a detector that has no process of its own.
        address: of a Ray cluster.
    """

    backend: str | None
    workers: int
    limits: Limits = Limits()  # noqa: RUF009  # frozen
    address: str | None = None


def choose_place(backend: Any, workers: int, limits: Limits, address: Any, isolate: bool = False) -> Place:
    """Check where to play.

    Raises:
        ArgumentError: there is no such backend, or it does not go with the other arguments.
    """
    check_backend(backend, address)
    apart = limits.any and not isolate  # only another process can be stopped
    if backend == "serial" and workers > 1:
        raise ArgumentError(f"workers must be 1 if backend is 'serial', got {workers}.")
    if backend == "serial" and apart:
        raise ArgumentError("time_limit and memory_limit must be None if backend is 'serial', got a limit.")
    return Place(backend, workers, limits if apart else Limits(), address)


def play_run(
    plan: Plan,
    here: Callable[[], Player],
    config: Mapping[str, Any],
    seeds: Seeds,
    place: Place,
    folder: Path | None,
    progress: bool,
    columns: Columns = COLUMNS,
) -> EvaluationResult:
    """Play the episodes of a run that its folder does not hold yet.

    Args:
        plan: what other processes need to play them.
        here: makes the player of this process, for the backend ``serial``.
        config: the arguments of the run as plain values, with ``detectors``, ``identities`` and ``episodes``.
        seeds: of the episodes.
        place: where they are played.
        folder: where rows are kept.
        progress: show a progress bar on standard error.
        columns: of the rows.

    Raises:
        ArgumentError: the folder is that of another run, or an argument cannot be sent to another process.
        EvaluationError: a contestant failed; the others have played to the end.
    """
    with ExitStack() as stack:
        store = None if folder is None else stack.enter_context(RunStore(folder, config, columns))
        config = config if store is None else store.config
        rows = Rows(store, seeds, plan.labels, config["detectors"], config["episodes"], columns)
        tasks = Tasks(rows, seeds)
        pool = _make_pool(plan, here, place, tasks.count, stack)
        try:
            bar = _progress_bar(progress, rows.done.size, int(rows.done.sum()))
            # Closed before the last rows and the secret are written: no detector runs any more.
            with closing(pool.run(tasks, tasks.is_wanted)) as outcomes, bar as advance:
                for outcome in outcomes:
                    tasks.note(as_failure(outcome, plan.labels[outcome.task.contestant]))
                    if outcome.result is not None:
                        rows.add(outcome.task, outcome.result)
                        advance()
                    if tasks.prepared:
                        rows.save(tasks.failures)
        except SendError as error:
            raise (
                _cannot_be_sent(place, error) if error.started else EvaluationError(_add_guard(place, error))
            ) from None
        finally:
            if tasks.prepared:
                rows.save()
            if store is not None and seeds.secret is not None and (tasks.count or seeds.given):
                store.add_secret(seeds.secret)
        _warn_of_threads(pool.left_threads, plan.labels)
        failed = {plan.labels[number] for number in tasks.failures}
        table = rows.table.take(rows.order(rows.table))
        table = table.take(np.flatnonzero([label not in failed for label in table.column("detector")]))
        secret = seeds.describe() if store is None or tasks.count or seeds.given else store.describe_secret()
        result = EvaluationResult(table, summarise(table), dict(config) | secret)
        if tasks.failures:
            failure = EvaluationError(" ".join(map(str, tasks.failures.values())))
            failure.result = result if table else None
            failure.failures = {plan.labels[number]: str(error) for number, error in tasks.failures.items()}
            raise failure from next(iter(tasks.failures.values())).__cause__
        if store is not None:
            store.finish(rows.order, result.summary)
    return result


def _make_pool(
    plan: Plan, here: Callable[[], Player], place: Place, count: int, stack: ExitStack
) -> Backend[Task, Any]:
    """Make the backend for this number of episodes; the stack closes it."""
    workers = min(place.workers, count)
    backend = place.backend or ("processes" if place.limits.any or workers > 1 else "serial")
    if not count or backend == "serial":
        player = here()
        return InProcess(player.run_task, player.close)
    try:
        pool = make_backend(backend, send_plan(plan), workers, place.limits, place.address)
    except SendError as error:
        raise _cannot_be_sent(place, error) from None
    stack.callback(pool.close)
    return pool


def _add_guard(place: Place, error: SendError) -> str:
    return f"{error}." if place.backend == "ray" else f"{error}. {_GUARD}"


def _cannot_be_sent(place: Place, error: SendError) -> ArgumentError:
    if place.backend == "ray":
        text = "backend must be 'serial' for a detector or argument that cannot be sent to another process, got 'ray'"
    else:
        what = (
            f"got {place.workers}" if place.workers > 1 else "and time_limit and memory_limit must be None, got a limit"
        )
        text = f"workers must be 1 for a detector or argument that cannot be sent to another process, {what}"
    return ArgumentError(f"{text}: {error}.")


def _warn_of_threads(threads: Sequence[tuple[str, Task]], labels: Sequence[str]) -> None:
    """Warn of threads that detectors have started and that keep a program from ending."""
    for label in dict.fromkeys(labels[task.contestant] for _, task in threads):
        names = [name for name, task in threads if labels[task.contestant] == label]
        count = "1 thread running that is no daemon" if len(names) == 1 else f"{len(names)} threads running, no daemons"
        warnings.warn(
            f"detector {label!r} left {count}: {', '.join(dict.fromkeys(names))}.", RuntimeWarning, stacklevel=4
        )


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

"""Run tasks where it is asked for, and play the missing episodes of a run: the one loop of all runs."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import Field

from usnet_env.config import ArgumentError, Config
from usnet_env.evaluation.errors import EvaluationError, not_started
from usnet_env.evaluation.parts import send
from usnet_env.evaluation.result import EvaluationResult, make_result
from usnet_env.evaluation.schedule import Schedule, Seeds
from usnet_env.evaluation.store import RunStore
from usnet_env.evaluation.table import Columns
from usnet_env.evaluation.workers import Player
from usnet_env.processes import Limits, Outcome, SendError, check_backend, make_backend
from usnet_env.processes.outcome import every_task
from usnet_env.progress import progress_bar

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

MOST_EPISODES = 1_000_000
MOST_WORKERS = 4_096


class RunArguments(Config):
    """The plain arguments of a run."""

    episodes: Annotated[int, Field(ge=1, le=MOST_EPISODES)]
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    workers: Annotated[int, Field(ge=1, le=MOST_WORKERS)]
    progress: bool
    trivial: bool = False
    isolate: bool = False


@dataclass(frozen=True)
class Place:
    """Where tasks run, such as the episodes of a run.

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


def choose_place(backend: Any, workers: int, limits: Limits, address: Any) -> Place:
    """Check where to play.

    Raises:
        ArgumentError: there is no such backend, or it does not go with the other arguments.
    """
    check_backend(backend, address)
    if backend == "serial" and workers > 1:
        raise ArgumentError(f"workers must be 1 if backend is 'serial', got {workers}.")
    if backend == "serial" and limits.any:  # only another process can be stopped
        raise ArgumentError("time_limit and memory_limit must be None if backend is 'serial', got a limit.")
    return Place(backend, workers, limits, address)


def run_tasks(
    function: Callable[[TaskT], ResultT],
    tasks: Iterable[TaskT],
    count: int,
    place: Place,
    name: Callable[[TaskT], str],
    is_wanted: Callable[[TaskT], bool] = every_task,
) -> Generator[Outcome[TaskT, ResultT], None, None]:
    """Run a function on tasks: the one runner of evaluations, games, suites and trainings.

    Args:
        function: what to call with each task. Other processes get it by value, with the parts that this program has
            registered. Its results should hold arrays, not tensors: PyTorch sends tensors in shared memory, which ends
            with the process that made them.
        tasks: read one after the other, a few ahead of the outcomes.
        count: how many there are at most; of 0 and 1, no other process is started unless the place asks for it.
        place: where they run.
        name: names who runs a task, in a warning of threads that stay after the last one: ``"detector 'random'"``.
        is_wanted: whether a task should still be run whose process has ended before it was begun.

    Yields:
        What came of each task, in the order in which they are finished.

    Raises:
        ArgumentError: the function cannot be sent to another process.
        EvaluationError: no process could start.
    """
    workers = min(place.workers, count)
    backend = place.backend or ("processes" if place.limits.any or workers > 1 else "serial")
    if not count:
        backend = "serial"
    try:
        sent = function if backend == "serial" else send(function)
        with closing(make_backend(backend, sent, workers, place.limits, place.address)) as pool:
            yield from pool.run(tasks, is_wanted)
    except SendError as error:
        raise _refuse(place, error) from None
    names: dict[str, list[str]] = {}
    for thread, task in pool.left_threads:
        names.setdefault(name(task), []).append(thread)
    for who, own in names.items():  # they keep a program from ending
        threads = "1 thread running that is no daemon" if len(own) == 1 else f"{len(own)} threads running, no daemons"
        text = f"{who} left {threads}: {', '.join(dict.fromkeys(own))}."
        warnings.warn(text, RuntimeWarning, stacklevel=4)  # of evaluate's caller


def _refuse(place: Place, error: SendError) -> Exception:
    """The error of a function that cannot be sent, or of a process that did not start, in one sentence or two."""
    if not error.started:
        return not_started(error, hint=place.backend != "ray")
    if place.backend == "ray":
        text = "backend must be 'serial' for a detector or argument that cannot be sent to another process, got 'ray'"
    else:
        what = (
            f"got {place.workers}" if place.workers > 1 else "and time_limit and memory_limit must be None, got a limit"
        )
        text = f"workers must be 1 for a detector or argument that cannot be sent to another process, {what}"
    return ArgumentError(f"{text}: {error}.")


def play_run(
    player: Player,
    config: Mapping[str, Any],
    seeds: Seeds,
    place: Place,
    folder: Path | None,
    progress: bool,
    columns: Columns,
) -> EvaluationResult:
    """Play the episodes of a run that its folder does not hold yet, keep their rows, and summarise them.

    The config has the arguments of the run as plain values, with ``detectors``, ``identities`` and ``episodes``. The
    player plays in the place: here, and in other processes.

    Raises:
        ArgumentError: the folder is that of another run, or an argument cannot be sent to another process.
        EvaluationError: a contestant failed; the others have played to the end.
    """
    labels = config["detectors"]
    with ExitStack() as stack:
        store = None if folder is None else stack.enter_context(RunStore(folder, config, columns))
        config = config if store is None else store.config
        schedule = Schedule(store, seeds, labels, config["detectors"], config["episodes"], columns)
        played = run_tasks(
            player.run_task,
            schedule,
            schedule.count,
            place,
            lambda task: f"detector {task.label!r}",
            schedule.is_wanted,
        )
        show = stack.enter_context(progress_bar("episodes", progress))
        show(schedule.finished, schedule.total)
        try:
            # Closed before the last rows and the secret are written: no detector runs any more.
            with closing(player), closing(played):
                for outcome in played:
                    schedule.note(outcome)
                    show(schedule.finished, schedule.total)
        finally:
            schedule.save_rest()
            if store is not None:
                if seeds.secret is not None and schedule.uses_secret:
                    store.add_secret(seeds.secret)
                store.note_failures({}, [label for label, own in schedule.done.items() if own.all()])
        errors = schedule.failures
        failures = {label: str(error) for label, error in errors.items()}
        secret = seeds.secret if store is None or schedule.uses_secret else store.secret
        result = make_result(schedule.table, config, secret, failures if store is None else store.failures)
        if store is not None and result.rows:
            store.finish(result.summary)
        if errors:
            failure = EvaluationError(" ".join(failures.values()))
            failure.result = result if result.rows else None
            failure.failures = failures
            raise failure from next(iter(errors.values())).__cause__
    return result

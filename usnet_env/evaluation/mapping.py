"""Run a function on numbers in this process, in others, or on a cluster: the results come in order."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from typing import TypeVar

from usnet_env.evaluation.engine import Place, run_tasks
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.processes import ProcessDied

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")


def run_or_raise(
    function: Callable[[TaskT], ResultT],
    tasks: Sequence[TaskT],
    workers: int | Place,
    name: Callable[[TaskT], str],
) -> Generator[tuple[TaskT, ResultT], None, None]:
    """Run a function on tasks; the first one that fails ends the run.

    Args:
        function: as of :func:`usnet_env.evaluation.engine.run_tasks`.
        tasks: the tasks.
        workers: number of processes, or a place.
        name: names a task in errors.

    Yields:
        Each task with its result, as they come.

    Raises:
        EvaluationError: a task ended its process.
        Exception: what the function raised.
    """
    place = workers if isinstance(workers, Place) else Place(None, workers)
    with closing(run_tasks(function, tasks, len(tasks), place, name)) as outcomes:
        for outcome in outcomes:
            error = outcome.error
            if isinstance(error, Exception) and not isinstance(error, ProcessDied):
                raise error
            if error is not None:
                reason = error.reason if isinstance(error, ProcessDied) else f"{type(error).__name__}: {error}"
                raise EvaluationError(f"{name(outcome.task)} failed: {reason}.") from error
            yield outcome.task, outcome.result  # type: ignore[misc]


def run_in_order(
    function: Callable[[int], ResultT], numbers: Sequence[int], workers: int | Place, name: str
) -> Generator[ResultT, None, None]:
    """Run a function on numbers; the results come in the order of the numbers.

    At most a few results for each worker wait for the caller.

    Args:
        function: what to call with each number, see :func:`usnet_env.evaluation.engine.run_tasks`.
        numbers: the numbers.
        workers: number of processes, or a place.
        name: names a number in errors, ``"Step"`` for example.

    Raises:
        EvaluationError, Exception: as :func:`run_or_raise`.
    """
    waiting: dict[int, ResultT] = {}
    with closing(run_or_raise(function, numbers, workers, lambda number: f"{name} {number}")) as outcomes:
        for number in numbers:
            while number not in waiting:
                done, result = next(outcomes)
                waiting[done] = result
            yield waiting.pop(number)

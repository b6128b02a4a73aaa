"""Run a function on tasks in this process, in others, or on a cluster: the results as they come, or in order."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from typing import TypeVar

from usnet_env.evaluation.engine import Place
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.processes import Backend, ProcessDied, SendError, make_backend

__all__ = ["run_in_order", "run_tasks"]

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")


def run_tasks(
    function: Callable[[TaskT], ResultT],
    tasks: Sequence[TaskT],
    workers: int | Place,
    describe: Callable[[TaskT], str],
) -> Generator[tuple[TaskT, ResultT], None, None]:
    """Run a function on tasks, in this process if there is one worker or task and no other backend is asked for.

    Args:
        function: what to call with each task. Other processes must be able to import it.
        tasks: the tasks.
        workers: number of processes, or a place.
        describe: names a task in errors.

    Yields:
        Each task with its result, as they come.

    Raises:
        EvaluationError: a task ended its process, or the function cannot be sent to another one.
        Exception: what the function raised.
    """
    place = workers if isinstance(workers, Place) else Place(None, workers)
    if not tasks:
        return
    begun: list[TaskT] = []
    noted = (begun.append(task) or task for task in tasks)  # type: ignore[func-returns-value]
    pool: Backend[TaskT, ResultT]
    with closing(
        make_backend(
            _choose_backend(place, len(tasks)), function, min(place.workers, len(tasks)), place.limits, place.address
        )
    ) as pool:
        try:
            for outcome in pool.run(noted):
                if isinstance(outcome.error, Exception) and not isinstance(outcome.error, ProcessDied):
                    raise outcome.error
                if outcome.error is not None:
                    raise _failure(describe(outcome.task), outcome.error)
                yield outcome.task, outcome.result  # type: ignore[misc]
        except SystemExit as error:  # in this process, during the last task that was begun
            raise _failure(describe(begun[-1]), error) from error
        except SendError as error:
            raise EvaluationError(
                f"{error}. A worker process imports the script that started it, so a script must start a suite or a "
                'training in a block that begins with `if __name__ == "__main__":`.'
            ) from None


def run_in_order(
    function: Callable[[int], ResultT], numbers: Sequence[int], workers: int | Place, name: str
) -> Generator[ResultT, None, None]:
    """Run a function on numbers; the results come in the order of the numbers.

    At most a few results for each worker wait for the caller.

    Args:
        function: what to call with each number. Other processes must be able to import it. Its results should hold
            arrays, not tensors: PyTorch sends tensors in shared memory, which ends with the process that made them.
        numbers: the numbers.
        workers: number of processes, or a place.
        name: names a number in errors, ``"Step"`` for example.

    Raises:
        EvaluationError, Exception: as :func:`run_tasks`.
    """
    waiting: dict[int, ResultT] = {}
    with closing(run_tasks(function, numbers, workers, lambda number: f"{name} {number}")) as outcomes:
        for number in numbers:
            while number not in waiting:
                done, result = next(outcomes)
                waiting[done] = result
            yield waiting.pop(number)


def _choose_backend(place: Place, tasks: int) -> str:
    return place.backend or ("serial" if place.workers == 1 or tasks < 2 else "processes")


def _failure(what: str, error: BaseException) -> EvaluationError:
    """The error for a task that ended its process; one sentence."""
    reason = error.reason if isinstance(error, ProcessDied) else f"{type(error).__name__}: {error}"
    return EvaluationError(f"{what} failed: {reason}.")

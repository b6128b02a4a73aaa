"""What every backend yields for a task, and the methods that every backend has."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")


@dataclass(frozen=True)
class Outcome(Generic[TaskT, ResultT]):
    """What came of a task: a result, or an error.

    Args:
        task: the task.
        result: what the function returned; ``None`` after an error.
        error: what the function raised, or :class:`ProcessDied`; ``None`` after success.
    """

    task: TaskT
    result: ResultT | None = None
    error: BaseException | None = None


def every_task(task: Any) -> bool:
    """Every task is wanted: the default of :meth:`Backend.run`."""
    return True


class Backend(Protocol[TaskT, ResultT]):
    """Runs a function on tasks.

    Attributes:
        left_threads: after the last outcome: names of threads that a task started, that are no daemons, and that stayed
            after it, each with its task.
    """

    left_threads: list[tuple[str, TaskT]]

    def run(
        self, tasks: Iterable[TaskT], is_wanted: Callable[[TaskT], bool] = every_task
    ) -> Generator[Outcome[TaskT, ResultT], None, None]:
        """Run all tasks; the outcomes come in the order in which they are finished.

        Args:
            tasks: read one after the other, a few ahead of the outcomes.
            is_wanted: whether a task should still be run whose process has ended before it was begun.
        """

    def close(self) -> None:
        """End all processes; nothing is lost but unfinished tasks."""

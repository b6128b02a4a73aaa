"""Rows of a long measurement: made on every core, kept in a CSV file as they come, and never made twice."""

from __future__ import annotations

from collections.abc import Callable, Generator, Hashable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from usnet_env.config import ArgumentError
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.store import RowFile
from usnet_env.evaluation.table import RowTable, columns_of, read_table
from usnet_env.files import atomic_write
from usnet_env.processes import ProcessDied, ProcessPool, SendError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "Measurement",
    "counter",
    "episode_means",
    "flight_suffix",
    "keep_report",
    "measure",
    "read_rows",
    "write_rows",
]

RowT = TypeVar("RowT")
TaskT = TypeVar("TaskT")


@dataclass(frozen=True)
class Measurement(Generic[TaskT, RowT]):
    """What is measured.

    Args:
        row: the class of its rows, a frozen dataclass of ``int``, ``float``, ``str`` and ``bool``.
        play: gives the rows of a task. Other processes must be able to import it: a function of a module, or a
            ``partial`` of one.
        keys: what tells the rows of a task from all others, in their order.
        key: the same of a row.
        order: what the rows of a file are sorted by.
    """

    row: type[RowT]
    play: Callable[[TaskT], list[RowT]]
    keys: Callable[[TaskT], Sequence[Hashable]]
    key: Callable[[RowT], Hashable]
    order: Callable[[RowT], Any]


def measure(
    what: Measurement[TaskT, RowT],
    tasks: Sequence[TaskT],
    path: Path,
    workers: int,
    advance: Callable[[int], None] = lambda rows: None,
) -> list[RowT]:
    """Play all tasks that ``path`` does not hold yet; rows are written as they come.

    Args:
        what: the measurement.
        tasks: what there is to play.
        path: the CSV of rows. It grows as they come and is sorted at the end. Its name should hold whatever its rows do
            not say, such as the seed.
        workers: processes; the rows are the same for any number of them, seconds apart.
        advance: called with the number of rows that are newly done.

    Returns:
        The rows of the tasks, in their order.

    Raises:
        ArgumentError: another process measures into the same file, or its folder was removed.
        EvaluationError: a task ended its process; the message names it. Rows that were finished are kept.
    """
    wanted = [key for task in tasks for key in what.keys(task)]
    with _open_rows(path, what.row) as file:
        rows = {what.key(row): row for row in _records(file.table, what.row)}
        todo = [task for task in tasks if any(key not in rows for key in what.keys(task))]
        advance(len(set(wanted) & rows.keys()))
        with closing(_played(what.play, todo, workers)) as played:
            for done in played:
                fresh = {what.key(row): row for row in done if what.key(row) not in rows}
                rows.update(fresh)
                file.append(map(vars, fresh.values()))
                advance(len(fresh))

        def order(table: RowTable) -> list[int]:
            keys = [what.order(row) for row in _records(table, what.row)]
            return sorted(range(len(keys)), key=keys.__getitem__)

        file.sort(order)
    return [rows[key] for key in wanted]


def _played(
    play: Callable[[TaskT], list[RowT]], tasks: Sequence[TaskT], workers: int
) -> Generator[list[RowT], None, None]:
    """Play the tasks in this process if there is one worker or task, else in others."""
    if workers == 1 or len(tasks) < 2:
        for task in tasks:
            try:
                yield play(task)
            except SystemExit as error:
                raise _failure(task, error) from error
        return
    with ProcessPool[TaskT, list[RowT]](play, min(workers, len(tasks))) as pool:
        try:
            for outcome in pool.run(tasks):
                if isinstance(outcome.error, Exception) and not isinstance(outcome.error, ProcessDied):
                    raise outcome.error
                if outcome.error is not None:
                    raise _failure(outcome.task, outcome.error)
                yield cast("list[RowT]", outcome.result)
        except SendError as error:
            raise EvaluationError(
                f"{error}. A worker process imports the script that started it, so a script must start a measurement "
                'in a block that begins with `if __name__ == "__main__":`.'
            ) from None


def _failure(task: object, error: BaseException) -> EvaluationError:
    """The error for a task that ended its process; one sentence with the task."""
    reason = error.reason if isinstance(error, ProcessDied) else f"{type(error).__name__}: {error}"
    return EvaluationError(f"{' '.join(repr(task).split())} failed: {reason}.")


def counter(total: int, progress: Callable[[int, int], None]) -> Callable[[int], None]:
    """An ``advance`` for :func:`measure` that calls ``progress`` with the rows done and to do."""
    done = 0

    def advance(more: int) -> None:
        nonlocal done
        done += more
        progress(done, total)

    return advance


def _records(table: RowTable, kind: type[RowT]) -> list[RowT]:
    return [kind(**row) for row in table]


def _open_rows(path: Path, kind: type[RowT]) -> RowFile:
    """Open a file of rows to append to; floats have four decimals."""
    try:
        return RowFile(path, columns_of(kind), digits=4)
    except ArgumentError:
        raise
    except ValueError:
        raise _other_rows(path) from None


def _other_rows(path: Path) -> ArgumentError:
    return ArgumentError(f"out must hold rows of this measurement, got something else in {path.name!r}.")


def read_rows(path: Path, kind: type[RowT]) -> list[RowT]:
    """The rows of a file; none if there is no file.

    Raises:
        ArgumentError: the file holds something else.
    """
    try:
        return _records(read_table(path, columns_of(kind)), kind)
    except ValueError:
        raise _other_rows(path) from None


def write_rows(path: Path, rows: Iterable[RowT], kind: type[RowT], order: Callable[[RowT], Any]) -> None:
    """Write the rows, sorted, so that the file is there in full or as it was; floats have four decimals."""
    table = RowTable(columns_of(kind), map(vars, sorted(rows, key=order)))
    with atomic_write(path) as aside:
        aside.write_text(",".join(table.columns) + "\n" + table.format_csv(digits=4), encoding="utf-8", newline="")


def flight_suffix(mobility: str, head_jitter: bool) -> str:
    """What the name of a file says of how heads fly; nothing for the paper's heads."""
    return (f"-{mobility}" if mobility != "iid" else "") + ("-jitter" if head_jitter else "")


def keep_report(path: Path, markdown: str, picture: Figure) -> None:
    """Keep table and picture of a measurement beside its rows, as ``.md`` and ``.png``, each whole or as it was."""
    with atomic_write(path.with_suffix(".md")) as aside:
        aside.write_text(markdown, encoding="utf-8")
    with atomic_write(path.with_suffix(".png")) as aside:
        picture.savefig(aside, format="png", dpi=100)


def episode_means(rows: Iterable[Any], field: str) -> list[float]:
    """Mean of a field over the rows of each episode, NaN left out.

    Cells share the seed of an episode and so its chances: their rows are no independent sample, these means are.
    """
    values: dict[int, list[float]] = {}
    for row in rows:
        value = float(getattr(row, field))
        if isfinite(value):
            values.setdefault(row.episode, []).append(value)
    return [sum(own) / len(own) for own in values.values()]

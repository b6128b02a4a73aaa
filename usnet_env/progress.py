"""One progress bar for all that takes long."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress_bar(unit: str, visible: bool | None = None) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on standard error; yields the function to call with the numbers done and in total.

    Args:
        unit: what is counted, such as ``"episodes"``.
        visible: whether it is shown; ``None``: if standard error is a terminal.
    """
    if visible is False:
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn(unit), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    hidden = visible is None and not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task(unit, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)

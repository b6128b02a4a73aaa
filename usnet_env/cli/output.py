"""Print tables, messages and progress bars for all commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import click

PIPE_WIDTH = 400  # columns if standard output is not a terminal: wide enough that nothing is cut or wrapped


def show(*renderables: Any) -> None:
    """Print Rich renderables to standard output."""
    from rich.console import Console

    console = Console()
    if console.is_terminal:
        for renderable in renderables:
            console.print(renderable)
        return
    wide = Console(width=PIPE_WIDTH)
    with wide.capture() as captured:
        for renderable in renderables:
            wide.print(renderable)
    # Not click.echo, which writes UTF-8 where the stream is ASCII.
    print("".join(f"{line.rstrip()}\n" for line in captured.get().splitlines()), end="")


def show_markdown(text: str) -> None:
    """Print Markdown to standard output, wide enough that no table is wrapped."""
    from rich.console import Console
    from rich.markdown import Markdown

    if Console().is_terminal:
        Console(width=PIPE_WIDTH).print(Markdown(text))
    else:
        show(Markdown(text))


def print_message(sentence: str) -> None:
    """Print a message of the program to standard error."""
    click.echo(f"usnet: {sentence}", err=True)


@contextmanager
def progress_bar(unit: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on standard error; yields the function to call with the numbers done and in total.

    Args:
        unit: what is counted, such as ``"episodes"``.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn(unit), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(unit, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)

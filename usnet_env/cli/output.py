"""Print tables and messages for all commands."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

from usnet_env.config import printable

_PIPE_WIDTH = 400  # columns if standard output is not a terminal: wide enough that nothing is cut or wrapped


def show(*renderables: Any) -> None:
    """Print Rich renderables to standard output."""
    from rich.console import Console

    console = Console()
    if not console.is_terminal:
        console = Console(width=_PIPE_WIDTH)
    with console.capture() as captured:
        console.print(*renderables, sep="\n")
    # Not click.echo, which writes UTF-8 where the stream is ASCII.
    print("".join(f"{line.rstrip()}\n" for line in captured.get().splitlines()), end="")


def print_message(sentence: str) -> None:
    """Print a message of the program to standard error; what would control a terminal is left out."""
    click.echo(f"usnet: {printable(sentence)}", err=True)


@contextmanager
def print_warnings() -> Iterator[None]:
    """Print the warnings of a step as messages, each once, after it."""
    with warnings.catch_warnings(record=True, action="always") as caught:
        yield
    for text in dict.fromkeys(str(warning.message) for warning in caught):
        print_message(f"warning: {text}")

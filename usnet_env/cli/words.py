"""Words of the command line: numbers, ``key=value`` pairs, progress and what is printed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import click

from usnet_env.config import ArgumentError, quote

__all__ = ["PIPE_WIDTH", "PairsCommand", "WholeNumber", "pairs", "progress_bar", "say", "show", "show_markdown"]

PIPE_WIDTH = 400  # columns where standard output is no terminal: nothing need be cut or folded
_EXPONENT = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+")  # 1e-3 is a number to everybody but YAML 1.1


class WholeNumber(click.ParamType):  # type: ignore[type-arg]  # generic in the newest click only
    """A whole number in a range, refused in one sentence."""

    name = "number"

    def __init__(self, least: int, most: int) -> None:
        self.least, self.most = least, most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """The number."""
        if isinstance(value, int):
            return value
        text = str(value).strip()
        if re.fullmatch(r"[-+]?[0-9]{1,30}", text) and self.least <= int(text) <= self.most:
            return int(text)
        option = param.opts[0] if param is not None else "value"
        raise ArgumentError(f"{option} must be a whole number from {self.least} to {self.most}, got {quote(value)}.")


class PairsCommand(click.Command):
    """Lets one ``--set`` take every word up to the next option."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Give each pair a ``--set`` of its own, which is what click understands."""
        spread: list[str] = []
        words, taking = iter(args), False
        for word in words:
            if word.startswith("-") or not taking:
                taking = word == "--set" or word.startswith("--set=")
                spread.append(word)
                if word == "--set":
                    following = next(words, None)
                    if following is None or following.startswith("--"):
                        raise ArgumentError("--set must be followed by key=value pairs, got none.")
                    spread.append(following)
            else:
                spread += ["--set", word]
        return super().parse_args(ctx, spread)


def _yaml_value(key: str, text: str) -> Any:
    """A YAML scalar, or a list of them."""
    import yaml

    try:
        value = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        raise ArgumentError(f"{key} must be a YAML value, got {quote(text)}.") from None
    if isinstance(value, str) and _EXPONENT.fullmatch(value):
        return float(value)
    for item in value if isinstance(value, list) else [value]:
        if item is not None and not isinstance(item, str | int | float):
            raise ArgumentError(f"{key} must be a number, a name or a list of these, got {quote(text)}.")
    return value


def pairs(words: Sequence[str]) -> dict[str, Any]:
    """``key=value`` words as a mapping."""
    values: dict[str, Any] = {}
    for word in words:
        key, equals, text = word.partition("=")
        key = key.strip()
        if not equals or not key:
            raise ArgumentError(f"--set must be followed by key=value pairs, got {quote(word)}.")
        if key in values:
            raise ArgumentError(f"--set must name each key once, got {key} twice.")
        values[key] = _yaml_value(key, text)
    return values


def show(*things: Any) -> None:
    """Print to standard output by way of Rich."""
    from rich.console import Console

    console = Console()
    if not console.is_terminal:
        console = Console(width=PIPE_WIDTH)
    for thing in things:
        console.print(thing)


def show_markdown(text: str) -> None:
    """Print Markdown wide enough that no table is folded."""
    from rich.console import Console
    from rich.markdown import Markdown

    Console(width=PIPE_WIDTH).print(Markdown(text))


def say(sentence: str) -> None:
    """A sentence of the program's own, on standard error."""
    click.echo(f"usnet: {sentence}", err=True)


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on standard error, as a function of what is done and of all there is to do."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)

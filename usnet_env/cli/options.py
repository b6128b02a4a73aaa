"""Options that several commands share: numbers and ``key=value`` pairs."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Sequence
from typing import Any

import click

from usnet_env.config import ArgumentError, quote


class WholeNumber(click.ParamType):  # type: ignore[type-arg]  # generic in the newest click only
    """A whole number between two limits."""

    name = "number"

    def __init__(self, least: int, most: int) -> None:
        self.least, self.most = least, most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Convert an option's text to a number."""
        try:
            number = int(value)
        except ValueError:
            number = self.least - 1
        if not self.least <= number <= self.most:
            self.fail(f"{quote(value)} is not a whole number from {self.least} to {self.most}", param, ctx)
        return number


class PositiveNumber(click.ParamType):  # type: ignore[type-arg]  # generic in the newest click only
    """A positive, finite number."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Convert an option's text to a number."""
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not 0 < number < math.inf:
            self.fail(f"{quote(value)} is not a positive number", param, ctx)
        return number


def add_place(command: Any, default: str = "processes, if there are several workers") -> Any:
    """Add the options ``--backend`` and ``--address``, where tasks run, to a command; the help names the default."""
    backend = click.option(
        "--backend",
        type=click.Choice(["serial", "processes", "ray"]),
        help=f"Run in this process, in child processes, or on the nodes of a Ray cluster.  [default: {default}]",
    )
    return backend(
        click.option(
            "--address", metavar="ADDRESS", help="Address of the Ray cluster; by default one starts on this machine."
        )(command)
    )


class PairsCommand(click.Command):
    """A command whose ``--set`` takes all words up to the next option."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put ``--set`` before each pair, which is the form that click reads."""
        expanded: list[str] = []
        words, taking = iter(args), False
        for word in words:
            if word.startswith("-") or not taking:
                taking = word == "--set" or word.startswith("--set=")
                expanded.append(word)
                if word == "--set":
                    following = next(words, None)
                    if following is None or following.startswith("--"):
                        raise ArgumentError("--set must be followed by key=value pairs, got none.")
                    expanded.append(following)
            else:
                expanded += ["--set", word]
        return super().parse_args(ctx, expanded)


def describe_keys() -> str:
    """The keys of ``--set``: the arguments of the environments, in lines for a help page."""
    from usnet_env.envs.usnet import MultiClusterArguments, SingleClusterArguments

    several, one = (
        [name for name in kind.model_fields if name != "render_mode"]
        for kind in (MultiClusterArguments, SingleClusterArguments)
    )
    added = [name for name in one if name not in several]
    missing = [name for name in several if name not in one]
    lines = textwrap.wrap(", ".join(several), 68)
    lines += textwrap.wrap(f"SingleCluster takes {', '.join(added)} instead of {', '.join(missing)}", 68)
    return "\n".join(f"  {line}" for line in lines)


def parse_pairs(words: Sequence[str]) -> dict[str, Any]:
    """Parse ``key=value`` words into a mapping; a value is JSON or else YAML, so that a name needs no quotes."""
    values: dict[str, Any] = {}
    for word in words:
        key, equals, text = word.partition("=")
        key = key.strip()
        if not equals or not key or key in values:
            wanted = "key=value pairs" if not equals or not key else "each key once"
            raise ArgumentError(f"--set must be followed by {wanted}, got {quote(word)}.")
        values[key] = _parse_value(key, text)
    return values


def _parse_value(key: str, text: str) -> Any:
    try:
        return json.loads(text)  # it reads 1e-3, which is a name in YAML
    except (ValueError, RecursionError):
        import yaml
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        raise ArgumentError(f"{key} must be a YAML value, got {quote(text)}.") from None

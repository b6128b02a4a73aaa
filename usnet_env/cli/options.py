"""Options that several commands share: whole numbers and ``key=value`` pairs."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Sequence
from functools import cache
from typing import Any

import click

from usnet_env.config import ArgumentError, quote

_WHOLE = re.compile(r"[-+]?[0-9]+\Z")
_REAL = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?\Z")


class WholeNumber(click.ParamType):  # type: ignore[type-arg]  # generic in the newest click only
    """A whole number between two limits; anything else is refused in one sentence."""

    name = "number"

    def __init__(self, least: int, most: int) -> None:
        self.least, self.most = least, most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Convert an option's text to a number."""
        if isinstance(value, int):
            return value
        text = str(value).strip()
        if re.fullmatch(r"[-+]?[0-9]{1,30}", text) and self.least <= int(text) <= self.most:
            return int(text)
        option = param.opts[0] if param is not None else "value"
        raise ArgumentError(f"{option} must be a whole number from {self.least} to {self.most}, got {quote(value)}.")


class PositiveNumber(click.ParamType):  # type: ignore[type-arg]  # generic in the newest click only
    """A positive, finite number; anything else is refused in one sentence."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Convert an option's text to a number."""
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not 0 < number < math.inf:
            option = param.opts[0] if param is not None else "value"
            raise ArgumentError(f"{option} must be a positive number, got {quote(value)}.")
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


@cache
def _make_loader() -> Any:
    """A safe YAML loader that reads numbers as YAML 1.2 does; imported when the first option is read.

    In YAML 1.1, ``0100`` is 64, ``1:30`` is 90 and ``1e-3`` is a text; here they are 100, a text and 0.001.
    """
    import yaml

    class Loader(yaml.SafeLoader):
        pass

    numbers = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
    Loader.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in resolvers if tag not in numbers]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    for tag, pattern in zip(numbers, (_WHOLE, _REAL), strict=True):
        Loader.add_implicit_resolver(tag, pattern, list("-+0123456789."))
    Loader.add_constructor(numbers[0], lambda loader, node: int(node.value))
    Loader.add_constructor(numbers[1], lambda loader, node: float(node.value))
    return Loader


def _parse_yaml(key: str, text: str) -> Any:
    """Parse a YAML scalar or a list of scalars."""
    import yaml

    try:
        value = yaml.load(text, _make_loader())  # a subclass of the safe loader
    except (yaml.YAMLError, ValueError, RecursionError):
        raise ArgumentError(f"{key} must be a YAML value, got {quote(text)}.") from None
    for item in value if isinstance(value, list) else [value]:
        if item is not None and not isinstance(item, str | int | float):
            raise ArgumentError(f"{key} must be a number, a name or a list of these, got {quote(text)}.")
    return value


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
    """Parse ``key=value`` words into a mapping; values are YAML."""
    values: dict[str, Any] = {}
    for word in words:
        key, equals, text = word.partition("=")
        key = key.strip()
        if not equals or not key:
            raise ArgumentError(f"--set must be followed by key=value pairs, got {quote(word)}.")
        if key in values:
            raise ArgumentError(f"--set must contain each key once, got {key} twice.")
        values[key] = _parse_yaml(key, text)
    return values

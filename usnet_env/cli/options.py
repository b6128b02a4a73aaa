"""Options that several commands share: whole numbers and ``key=value`` pairs."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import click

from usnet_env.config import ArgumentError, quote

__all__ = ["PairsCommand", "PositiveNumber", "WholeNumber", "parse_pairs"]

_EXPONENT = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+")  # YAML 1.1 reads 1e-3 as text, not as a number


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


def _parse_yaml(key: str, text: str) -> Any:
    """Parse a YAML scalar or a list of scalars."""
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

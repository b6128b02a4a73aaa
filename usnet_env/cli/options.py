"""Options that several commands share: numbers and ``key=value`` pairs."""

from __future__ import annotations

import json
import math
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

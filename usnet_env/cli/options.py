"""Options that several commands share: numbers and ``key=value`` pairs."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import click
import yaml
from click.shell_completion import CompletionItem

from usnet_env.config import ArgumentError, quote

WholeNumber = click.IntRange
PositiveNumber = partial(click.FloatRange, min=0, min_open=True, max=1e12)


def complete_names(context: click.Context, option: click.Parameter, prefix: str) -> list[CompletionItem]:
    """The names that an option of this name takes and that begin so, for a shell's completion."""
    from usnet_env.envs import ENVIRONMENTS
    from usnet_env.evaluation.suites import list_suites
    from usnet_env.plugins import DETECTORS
    from usnet_env.swarm import FOLLOW_STRATEGIES

    names_of: dict[str, Iterable[str]] = {"env_id": ENVIRONMENTS, "suite": list_suites(), "follow": FOLLOW_STRATEGIES}
    names = names_of.get(str(option.name), sorted(DETECTORS))
    return [CompletionItem(name) for name in names if name.startswith(prefix)]


def parse_pairs(words: Sequence[str]) -> dict[str, Any]:
    """Parse ``key=value`` words into a mapping; a value is JSON or else YAML, so that a name needs no quotes."""
    values: dict[str, Any] = {}
    for word in words:
        key, equals, text = word.partition("=")
        key = key.strip()
        if not equals or not key or key in values:
            raise ArgumentError(f"--set must be followed by key=value pairs, each key once, got {quote(word)}.")
        try:
            values[key] = _parse_value(text)
        except (yaml.YAMLError, ValueError, RecursionError):
            raise ArgumentError(f"{key} must be a YAML value, got {quote(text)}.") from None
    return values


def _parse_value(text: str) -> Any:
    try:
        return json.loads(text)  # it reads 1e-3, which is a name in YAML
    except (ValueError, RecursionError):
        return yaml.safe_load(text)

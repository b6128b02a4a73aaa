"""``usnet list``: list the available parts."""

from __future__ import annotations

import shutil
import sys
import textwrap
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from usnet_env.plugins import DetectorEntry

__all__ = ["list_"]

_NARROWEST = 30  # columns of a description


@click.command(name="list", short_help="List envs, detectors, follow strategies, mobilities.")
@click.argument("part", type=click.Choice(["envs", "detectors", "follow", "mobility"]))
def list_(part: str) -> None:
    """List the available environments, detectors, follow strategies or mobilities, with one line about each.

    The list of detectors also names the packages that a detector needs beyond those that USNET always installs.
    """
    rows = _describe_parts(part)
    width = max(len(name) for name, _ in rows) + 2
    for name, description in rows:
        click.echo(_wrap(f"{name:{width}}", description))


def _wrap(start: str, description: str) -> str:
    """Put the description after ``start``, in lines that fit the terminal; into a pipe it is one line."""
    if not sys.stdout.isatty():
        return f"{start}{description}".rstrip()
    columns = max(shutil.get_terminal_size().columns, len(start) + _NARROWEST)
    indent = " " * len(start)
    lines = textwrap.fill(description, columns, initial_indent=start, subsequent_indent=indent, break_on_hyphens=False)
    return lines or start.rstrip()


def _describe_parts(part: str) -> list[tuple[str, str]]:
    """Return the names of all parts of this type, each with a description of one line."""
    if part == "detectors":
        from usnet_env.plugins import list_detectors

        return [(entry.name, entry.description + _format_needs(entry)) for entry in list_detectors()]
    if part == "follow":
        from usnet_env.swarm import follow_strategies

        control = ("none", "no UAV follows: followers fly like heads (a control)")
        return [*((name, strategy.equation) for name, strategy in follow_strategies().items()), control]
    if part == "mobility":
        from usnet_env.swarm import mobilities

        return [(name, law.description) for name, law in mobilities().items()]
    from usnet_env.evaluation.environments import describe_environments

    return list(describe_environments().items())


def _format_needs(entry: DetectorEntry) -> str:
    needs = ", ".join(f"{name}: not installed" if name in entry.missing else name for name in entry.needs)
    return f" (needs {needs})" if needs else ""

"""``usnet list``: list the available parts."""

from __future__ import annotations

import inspect
import shutil
import sys
import textwrap
from typing import TYPE_CHECKING, Any

import click

from usnet_env.cli.commands import find_entry_points
from usnet_env.config import ArgumentError

if TYPE_CHECKING:
    from usnet_env.plugins import DetectorEntry
    from usnet_env.registry import Registry

_NARROWEST = 30  # columns of a description
_PARTS = (
    "envs",
    "detectors",
    "follow",
    "mobility",
    "kinematics",
    "formation",
    "placement",
    "fusion",
    "clusterer",
    "suites",
)


@click.command(name="list", short_help="List envs, detectors, follow strategies and other parts.")
@click.argument("part", type=click.Choice(_PARTS), required=False)
def list_(part: str | None) -> None:
    """List the available environments, detectors or other parts, with one line about each.

    The list of detectors also shows what a detector needs and uses: packages beyond those that USNET always installs,
    the most UAVs and the least steps of a window, whether it uses positions, and whether it takes the number of
    clusters M. Without a word, it lists what can be listed.
    """
    if part is None:
        click.echo("".join(f"usnet list {name}\n" for name in _PARTS), nl=False)
        return
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

        return [(entry.name, f"{entry.description} {_format_tags(entry)}".rstrip()) for entry in list_detectors()]
    if part == "suites":
        from usnet_env.evaluation import list_suites

        suites = list_suites().values()
        return [(each.name, f"{each.purpose} ({len(each.cells)} cells, version {each.version})") for each in suites]
    if part == "envs":
        from usnet_env.evaluation.environments import describe_environments

        return list(describe_environments().items())
    registry = _find_registry(part)
    rows = [(name, _describe_part(registry, name)) for name in registry]
    control = ("none", "no UAV follows: followers fly like heads (a control)")
    return [*rows, control] if part == "follow" else rows


def _find_registry(part: str) -> Registry[Any]:
    """Return the registry of the parts that an argument of this name selects."""
    from usnet_env import swarm  # noqa: F401  # these modules create the registries
    from usnet_env.multiagent import sensors  # noqa: F401
    from usnet_env.registry import REGISTRIES

    if part in (modules := find_entry_points("usnet.registries")):
        modules[part].load()
    (found,) = [registry for registry in REGISTRIES.values() if registry.argument == part]
    return found


def _describe_part(registry: Registry[Any], name: str) -> str:
    """Return the equation, the description or the first line of the docstring of a part."""
    try:
        part = registry[name]
    except ArgumentError as error:
        return f"not available: {error}"
    text = getattr(part, "equation", "") or getattr(part, "description", "") or inspect.getdoc(part) or ""
    return str(text).partition("\n")[0]


def _format_tags(entry: DetectorEntry) -> str:
    """The tags that differ from those of a detector that takes every window, in brackets."""
    tags = entry.tags
    needs = ", ".join(f"{name}: not installed" if name in entry.missing else name for name in tags.needs)
    texts = {
        f"needs {needs}": bool(needs),
        f"at most {tags.most_uavs} UAVs": tags.most_uavs is not None,
        f"at least {tags.least_steps} steps": tags.least_steps > 1,
        "made for 1 m per step": tags.needs_unit_speed,
        "velocities only": not tags.uses_positions,
        "takes M": tags.takes_clusters,
    }
    shown = "; ".join(text for text, holds in texts.items() if holds)
    return f"({shown})" if shown else ""

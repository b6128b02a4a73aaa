"""``usnet list`` and ``usnet check-detector``: list the available parts, and test a detector."""

from __future__ import annotations

import inspect
import os
import shutil
import sys
import textwrap
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from usnet_env.cli.output import progress_bar, show
from usnet_env.config import ArgumentError, quote

if TYPE_CHECKING:
    from usnet_env.plugins import DetectorEntry
    from usnet_env.registry import Registry

__all__ = ["check_detector", "list_"]

_NARROWEST = 30  # columns of a description


@click.command(name="check-detector", short_help="Test that a detector keeps the contract.")
@click.argument("name", metavar="NAME")
@click.option(
    "--expect",
    "expected",
    multiple=True,
    metavar="CHECK=REASON",
    help="A check that this detector is expected to fail, and the reason. May be repeated.",
)
@click.option(
    "--seconds",
    type=float,
    default=10.0,
    show_default=True,
    metavar="S",
    help="Time budget for an answer with 82 UAVs.",
)
@click.option(
    "--time-limit",
    type=float,
    default=300.0,
    show_default=True,
    metavar="S",
    help="Seconds after which a call of the detector is stopped.",
)
@click.option("--memory-limit", type=float, metavar="MB", help="Memory that a call of the detector may allocate.")
@click.pass_context
def check_detector(
    ctx: click.Context,
    name: str,
    expected: tuple[str, ...],
    seconds: float,
    time_limit: float,
    memory_limit: float | None,
) -> None:
    """Test that a detector keeps the contract of usnet_env detectors.

    NAME is a detector's name, with or without arguments, or module:Class. The exit status is 1 if a check fails.

    The detector is imported and tested in a process of its own, which it may end or stop without harm.
    """
    reasons: dict[str, str] = {}
    for text in expected:
        check, equals, reason = text.partition("=")
        if not equals:
            raise ArgumentError(f"--expect must be written check=reason, got {quote(text)}.")
        reasons[check.strip()] = reason.strip()
    from detectors import checks
    from usnet_env.plugins import detector_names, make_detector

    plain = name.partition("(")[0].strip()
    if ":" not in plain and plain not in detector_names():
        make_detector(name)  # refuses the name; a known one is imported in the child process only
    done: list[checks.CheckResult] = []
    with progress_bar("checks") as progress:

        def count(result: checks.CheckResult) -> None:
            done.append(result)
            progress(len(done), len(checks.CHECKS))

        results = checks.check_factory(
            partial(make_detector, name),
            name,
            expected_failed_checks=reasons,
            seconds=seconds,
            callback=count,
            time_limit=time_limit,
            memory_limit=memory_limit,
        )
    show(checks.results_table(results))
    if os.environ.get("USNET_TRACEBACK"):
        click.echo(next((result.traceback for result in results if result.traceback), ""), err=True)
    ctx.exit(checks.exit_status(results))


_PARTS = ("envs", "detectors", "follow", "mobility", "formation", "placement", "fusion", "clusterer")


@click.command(name="list", short_help="List envs, detectors, follow strategies and other parts.")
@click.argument("part", type=click.Choice(_PARTS))
def list_(part: str) -> None:
    """List the available environments, detectors or other parts, with one line about each.

    The list of detectors also shows what a detector needs and uses: packages beyond those that USNET always installs,
    the most UAVs and the least steps of a window, whether it uses positions, and whether it takes the number of
    clusters M.
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

        return [(entry.name, f"{entry.description} {_format_tags(entry)}".rstrip()) for entry in list_detectors()]
    if part != "envs":
        rows = [(name, _describe_part(registry, name)) for registry in [_find_registry(part)] for name in registry]
        control = ("none", "no UAV follows: followers fly like heads (a control)")
        return [*rows, control] if part == "follow" else rows
    from usnet_env.evaluation.environments import describe_environments

    return list(describe_environments().items())


def _find_registry(part: str) -> Registry[Any]:
    """Return the registry of the parts that an argument of this name selects."""
    from usnet_env import swarm  # noqa: F401  # these modules create the registries
    from usnet_env.multiagent import fusion, sensors  # noqa: F401
    from usnet_env.registry import REGISTRIES

    if part == "clusterer":
        import detectors.clustering  # noqa: F401
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
    texts = {
        "needs " + ", ".join(f"{name}: not installed" if name in entry.missing else name for name in tags.needs): (
            bool(tags.needs)
        ),
        f"at most {tags.most_uavs} UAVs": tags.most_uavs is not None,
        f"at least {tags.least_steps} steps": tags.least_steps > 1,
        "velocities only": not tags.uses_positions,
        "takes M": tags.takes_clusters,
    }
    shown = "; ".join(text for text, holds in texts.items() if holds)
    return f"({shown})" if shown else ""

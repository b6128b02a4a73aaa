"""``usnet list`` and ``usnet check-detector``: what there is, and whether a detector keeps the contract."""

from __future__ import annotations

import click

from usnet_env.cli.words import progress_bar, show
from usnet_env.config import ArgumentError, quote

__all__ = ["check_detector", "list_"]


@click.command(name="check-detector")
@click.argument("name", metavar="NAME")
@click.option(
    "--expect",
    "expected",
    multiple=True,
    metavar="CHECK=REASON",
    help="A check that this detector can't pass, and why. May repeat.",
)
@click.option(
    "--seconds", type=float, default=10.0, show_default=True, metavar="S", help="Time budget of an answer for 82 UAVs."
)
@click.pass_context
def check_detector(ctx: click.Context, name: str, expected: tuple[str, ...], seconds: float) -> None:
    """Check that a detector (a name or module:Class) keeps the contract; status 1 if it does not."""
    reasons: dict[str, str] = {}
    for word in expected:
        check, equals, reason = word.partition("=")
        if not equals:
            raise ArgumentError(f"--expect must be written check=reason, got {quote(word)}.")
        reasons[check.strip()] = reason.strip()
    from detectors import checks
    from usnet_env.plugins import make_detector

    done: list[checks.CheckResult] = []
    with progress_bar("checks") as progress:

        def count(result: checks.CheckResult) -> None:
            done.append(result)
            progress(len(done), len(checks.CHECKS))

        checks.check_detector(
            make_detector(name), expected_failed_checks=reasons, seconds=seconds, on_fail=None, callback=count
        )
    show(checks.results_table(done))
    ctx.exit(checks.exit_status(done))


@click.command(name="list")
@click.argument("what", type=click.Choice(["envs", "detectors", "follow", "mobility"]))
def list_(what: str) -> None:
    """List what can be named: envs, detectors, follow strategies or mobilities."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, show_header=False, pad_edge=False)
    for name, about in _listing(what):
        table.add_row(Text(name), Text(about))
    show(table)


def _listing(what: str) -> list[tuple[str, str]]:
    """Names, each with one line about it."""
    if what == "detectors":
        from usnet_env.plugins import describe_detectors

        return sorted(describe_detectors().items())
    if what == "follow":
        from usnet_env.swarm import follow_strategies

        control = ("none", "nobody follows: followers fly like heads (a control)")
        return [*((name, strategy.equation) for name, strategy in follow_strategies().items()), control]
    if what == "mobility":
        from usnet_env.swarm import mobilities

        return [(name, law.description) for name, law in mobilities().items()]
    from usnet_env.evaluation.environments import describe_environment, usnet_ids

    return [(name, describe_environment(name)) for name in usnet_ids()]

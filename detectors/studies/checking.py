"""``usnet check-detector``: test a detector."""

from __future__ import annotations

import os
from functools import partial

import click

from usnet_env.cli.output import show
from usnet_env.config import ArgumentError, quote
from usnet_env.progress import progress_bar


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

    The detector is imported and tested in a separate process, which it may end or stop without harm.
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

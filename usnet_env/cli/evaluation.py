"""``usnet evaluate``: play episodes and score detectors."""

from __future__ import annotations

import json
import sys
import warnings
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usnet_env.cli.options import PairsCommand, PositiveNumber, WholeNumber, add_place, describe_keys, parse_pairs
from usnet_env.cli.output import print_message, show

if TYPE_CHECKING:
    from usnet_env.evaluation import EvaluationResult, SuiteResult

_TIME_LIMIT = 3600.0  # seconds

_EXAMPLES = f"""
\b
Examples:
  usnet evaluate --detector lagged-regression --trivial --episodes 20
  usnet evaluate --detector granger --detector factions --all \\
      --set follow=f3 clusters=3 uavs=40 mobility=gauss_markov
  usnet evaluate --env USNET/SingleCluster-v0 --detector gassl \\
      --episodes 5 --set followers=10 decoys=1
  usnet evaluate --suite controls --detector factions --out runs/controls

\b
Arguments for --set:
{describe_keys()}
"""  # click reads the control characters: they keep the lines


@click.command(cls=PairsCommand, short_help="Play detectors against the same swarms and score them.", epilog=_EXAMPLES)
@click.option(
    "--env",
    "env_id",
    metavar="ID",
    help="Environment; see `usnet list envs`.  [default: USNET/MultiCluster-v0]",
)
@click.option("--suite", metavar="NAME|FILE.yaml", help="Play all cells of a suite, isolated; see `usnet list suites`.")
@click.option("--cell", "cells", multiple=True, metavar="NAME", help="Cell of the suite. May be repeated.")
@click.option(
    "--detector",
    "detectors",
    multiple=True,
    required=True,
    metavar="NAME",
    help="Detector, e.g. random, 'lagged-regression(clusters=5)' or module:Class. May be repeated.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE …",
    help="Arguments of the environment, see below. May be repeated.",
)
@click.option(
    "--episodes",
    type=WholeNumber(1, 1_000_000),
    help="Episodes for each detector.  [default: 100, or those of the suite]",
)
@click.option(
    "--seed",
    type=WholeNumber(0, 2**63 - 1),
    help="Seed of the evaluation.  [default: 0, or that of the suite]",
)
@click.option("--workers", type=WholeNumber(1, 4_096), default=1, show_default=True, help="Number of processes.")
@partial(add_place, default="processes, also for one worker; with --isolate or --suite, serial for one worker")
@click.option(
    "--time-limit",
    type=PositiveNumber(),
    help="Seconds that one answer of a detector may take.  [default: 3600, none with --backend serial]",
)
@click.option("--memory-limit", type=PositiveNumber(), help="Megabytes that one answer of a detector may allocate.")
@click.option(
    "--isolate",
    is_flag=True,
    help="Play each detector in a process without an environment, with seeds from a secret of the run.",
)
@click.option("--secret", metavar="HEX", help="Secret of an earlier isolated run, to play its episodes again.")
@click.option(
    "--out", metavar="DIR", help="Folder for rows, summary and config; the same command resumes an interrupted run."
)
@click.option("--record", metavar="every=N|worst", help="Also write episode files to DIR/episodes, for `usnet replay`.")
@click.option(
    "--trivial", is_flag=True, help="Also evaluate the trivial policies destroy-all, none, random and one-per-round."
)
@click.option("--all", "show_all", is_flag=True, help="Print all metrics, each with its interval.")
@click.option("--json", "as_json", is_flag=True, help="Print only the summary, as JSON.")
@click.pass_context
def evaluate(
    ctx: click.Context,
    /,
    *,
    env_id: str | None,
    suite: str | None,
    cells: tuple[str, ...],
    detectors: tuple[str, ...],
    settings: tuple[str, ...],
    isolate: bool,
    record: str | None,
    show_all: bool,
    as_json: bool,
    **how: Any,
) -> None:
    """Play every detector against the same swarms, and print a table of them, best first.

    The workers are child processes, also a single one; with --isolate or --suite, each detector has its own process,
    and a single worker is the command itself. A detector that hangs or ends its process has failed; the other detectors
    play to the end. With --backend serial and without isolation, such a detector ends the command.
    """
    env_kwargs, out = parse_pairs(settings), how["out"]
    if suite is not None and (env_id is not None or env_kwargs):
        raise click.UsageError("--suite gives the environments: it goes without --env and --set.")
    if cells and suite is None:
        raise click.UsageError("--cell names a cell of a suite: it needs --suite.")
    if how["secret"] is not None and not isolate and suite is None:
        raise click.UsageError("--secret gives the seeds of an isolated run: it needs --isolate or --suite.")
    if record is not None and suite is not None:
        raise click.UsageError("--record keeps episodes of one environment: it goes without --suite.")
    if how["time_limit"] is None and (how["backend"] != "serial" or isolate or suite is not None):
        how["time_limit"] = _TIME_LIMIT
    if out is not None:
        ctx.find_root().obj = partial(_tell_what_is_kept, out)
    from usnet_env import evaluation

    how["progress"] = sys.stderr is not None and sys.stderr.isatty()
    failure: Exception | None = None
    result: EvaluationResult | SuiteResult
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RuntimeWarning)
        try:
            if suite is not None:
                result = evaluation.evaluate_suite(suite, list(detectors), cells=cells or None, **how)
            else:
                given = {name: value for name, value in how.items() if value is not None}
                env = "USNET/MultiCluster-v0" if env_id is None else env_id
                result = evaluation.evaluate(env, list(detectors), env_kwargs=env_kwargs, isolate=isolate, **given)
        except evaluation.EvaluationError as error:
            if error.result is None:
                raise
            result, failure = error.result, error  # the other detectors have played to the end
    for warning in caught:
        print_message(str(warning.message))
    if as_json:
        click.echo(json.dumps(result.summary, indent=2, allow_nan=False))
    if isinstance(result, evaluation.SuiteResult):
        if not as_json:
            show(result.ranking())
            click.echo(result.to_markdown() if show_all else "", nl=False)
        for cell, own in result.failures.items():
            print_message(f"{cell}: {' '.join(own.values())}")
        if not result.detectors:
            failure = evaluation.EvaluationError("no detector has a result in any cell.")
    else:
        if not as_json and result.summary:
            show(result.table() if show_all else result.ranking())
            click.echo(result.conclusion())
        if isolate:
            secret = result.config.get("secret", "not known: an earlier part of it was killed before its end")
            print_message(f"The secret of this run is {secret}.")
    if failure is not None:
        raise failure
    if out is not None and not as_json:
        click.echo(f"Rows, summary and config are in {out}.", err=True)


def _tell_what_is_kept(out: str) -> str:
    """What an interrupted run, or suite, has left."""
    for path in (Path(out, "episodes.csv"), *Path(out).glob("*/episodes.csv")):
        if path.is_file():
            with path.open("rb") as file:
                if file.readline() and file.readline():  # more than the header
                    return f"Finished episodes are kept in {out}; the same command resumes from there."
    return "No episode was finished."

"""``usnet evaluate`` and ``usnet report``: play episodes, score detectors, and print the tables of a run."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from contextlib import closing, nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usnet_env.cli.options import PositiveNumber, WholeNumber, complete_names, parse_pairs
from usnet_env.cli.output import print_message, print_warnings, show
from usnet_env.config import format_count

if TYPE_CHECKING:
    from usnet_env.evaluation import EvaluationResult

_MAX_RECORDED = 20  # of the worst episodes of a detector
_DEFAULT_DETECTORS = ("reader", "lagged-network", "lagged-regression")  # each good at something, and fast
_EVERY = re.compile(r"every=([1-9][0-9]{0,8})\Z")

_EXAMPLES = """
\b
Examples:
  usnet evaluate --episodes 10
  usnet evaluate --detector reader --trivial --episodes 20 --set follow=f3 clusters=3
  usnet evaluate --suite controls-v2 --detector reader --out runs/controls
"""  # click reads the control characters: they keep the lines


@click.command(short_help="Play detectors against the same swarms and score them.", epilog=_EXAMPLES)
@click.argument("pairs", nargs=-1, metavar="")
@click.option(
    "--env", "env_id", shell_complete=complete_names, metavar="ID", help="Environment; see `usnet list envs`."
)
@click.option("--suite", shell_complete=complete_names, metavar="NAME|FILE.yaml", help="Play the cells of a suite.")
@click.option("--cell", "cells", multiple=True, metavar="NAME", help="Cell of the suite. May be repeated.")
@click.option(
    "--detector", "detectors", multiple=True, default=_DEFAULT_DETECTORS, shell_complete=complete_names, metavar="NAME",
    help=f"A name or module:Class; repeatable.  [default: {', '.join(_DEFAULT_DETECTORS)}]",
)  # fmt: skip
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE …", help="Arguments of the environment.")
@click.option("--episodes", type=WholeNumber(1, 1_000_000), help="For each detector; 100, or the suite's.")
@click.option("--seed", type=WholeNumber(0, 2**192 - 1), help="Seed of all episodes; 0, or the suite's.")
@click.option("--workers", type=WholeNumber(1, 4_096), default=1, help="Number of processes; 1.")
@click.option("--backend", type=click.Choice(["serial", "processes", "ray"]), help="Where the workers run.")
@click.option("--time-limit", type=PositiveNumber(), metavar="SECONDS", help="For one answer of a detector.")
@click.option("--memory-limit", type=PositiveNumber(), metavar="MEGABYTES", help="For one answer of a detector.")
@click.option("--isolate", is_flag=True, help="Play each detector in a child process.")
@click.option("--out", metavar="DIR", help="Folder; the same command resumes a run.")
@click.option("--record", metavar="every=N|worst", help="Also write episode files, for a replay.")
@click.option("--trivial", is_flag=True, help="Also play the trivial policies.")
@click.option("--all", "show_all", is_flag=True, help="Print all metrics, each with its interval.")
@click.option("--json", "as_json", is_flag=True, help="Print only the summary, as JSON.")
@click.pass_context
def evaluate(
    ctx: click.Context,
    /,
    *,
    pairs: tuple[str, ...],
    env_id: str | None,
    suite: str | None,
    cells: tuple[str, ...],
    detectors: tuple[str, ...],
    settings: tuple[str, ...],
    record: str | None,
    show_all: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Play every detector against the same swarms, and print a table of them, best first.

    The status is 2 if a detector failed in every episode; a failed episode is a row with its reason.
    """
    env_kwargs, out = parse_pairs((*settings, *pairs)), options["out"]
    if suite is not None and (env_id is not None or env_kwargs or record is not None):
        raise click.UsageError("--suite gives the environments: it goes without --env, --set and --record.")
    if cells and suite is None:
        raise click.UsageError("--cell names a cell of a suite: it needs --suite.")
    if record is not None and (out is None or (record != "worst" and not _EVERY.match(record))):
        raise click.UsageError("--record must be every=NUMBER or worst, and needs --out.")
    if out is not None:
        ctx.find_root().obj = f"Finished episodes are kept in {out}; the same command resumes."
    from usnet_env import evaluation

    run_options = {name: value for name, value in options.items() if value is not None}
    run_options["progress"] = sys.stderr is not None and sys.stderr.isatty()
    with redirect_stdout(sys.stderr) if as_json else nullcontext():  # what a detector prints is no JSON
        if suite is not None:
            result = evaluation.evaluate_suite(suite, list(detectors), cells=cells or None, **run_options)
        else:
            env_id = env_id or "USNET/MultiCluster-v0"
            result = evaluation.evaluate(env_id, list(detectors), env_kwargs=env_kwargs, **run_options)
    if as_json:
        click.echo(json.dumps(result.summary, indent=2, allow_nan=False))
    else:
        _show_result(result, "all" if show_all else "")
    for sentence in result.failures.values():
        print_message(sentence)
    if record is not None and env_id is not None:
        files = format_count(record_episodes(result, record, detectors, env_id, env_kwargs, out), "episode file")
        click.echo(f"Wrote {files} to {out}/episodes; `usnet replay {out}` lists them.", err=True)
    if out is not None and not as_json:
        click.echo(f"Rows and arguments are in {out}.", err=True)
    if not (result.rows["error"] == "").groupby(result.rows["detector"]).any().all():
        ctx.exit(2)


def _show_result(result: EvaluationResult, form: str) -> None:
    """Print the tables of a result: short, ``"all"``, or as ``"markdown"``."""
    if form == "markdown":
        exact = [result.to_markdown("exact")] * (len(result.cells) > 1)
        click.echo("\n".join([result.to_markdown(), *exact]), nl=False)
        return
    show(result.table() if form == "all" else result.ranking())
    if form == "all" and len(result.cells) > 1:
        show(result.table("exact"))


@click.command(short_help="Print the tables of a run, and compare detectors.")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--format", "form", type=click.Choice(["all", "markdown"]), help="All metrics; or for a page.")
@click.option(
    "--compare", "labels", multiple=True, metavar="LABEL", help="Compare with the next --compare, or with all."
)
@click.option("--metric", default="J", show_default=True, metavar="NAME", help="What is compared.")
def report(folder: Path, form: str | None, labels: tuple[str, ...], metric: str) -> None:
    """Print the tables of FOLDER, which `usnet evaluate --out FOLDER` has written."""
    from usnet_env.evaluation import EvaluationResult

    result = EvaluationResult.load(folder)
    _show_result(result, form or "")
    if labels:
        with print_warnings():
            comparisons = result.compare(labels[0], list(labels[1:]) or None, metric)
        click.echo("".join(f"{comparison}.\n" for comparison in comparisons), nl=False)
    for sentence in result.failures.values():
        print_message(sentence)


def record_episodes(
    result: EvaluationResult, choice: str, detectors: Sequence[str], env_id: str, env_kwargs: dict[str, Any], out: str
) -> int:
    """Play chosen episodes of a run again, from the seeds in their rows, and write their episode files.

    ``choice`` is ``"every=10"`` or ``"worst"``: the 20 worst episodes of each detector whose round 1 was not exact.
    Returns the number of files.
    """
    import gymnasium as gym

    from usnet_env.evaluation import TRIVIAL
    from usnet_env.evaluation.tables import first_metric
    from usnet_env.plugins import detector_label, make_detector
    from usnet_env.replay import record_episode

    names = {detector_label(name): name for name in (*TRIVIAL, *detectors)}
    rows = result.rows[(result.rows["error"] == "") & result.rows["detector"].isin(names)]  # no others of the folder
    if every := _EVERY.match(choice):
        rows = rows[rows["episode"] % int(every[1]) == 0]
    else:
        metric, _, sign = first_metric(result.summary)
        rows = rows[rows["exact"] == 0].sort_values(metric, ascending=sign == -1, kind="stable")
        rows = rows.groupby("detector", sort=False).head(_MAX_RECORDED)
    for row in rows.to_dict("records"):
        label, seeds = row["detector"], (row["swarm_seed"], row["detector_seed"])
        with closing(gym.make(env_id, **env_kwargs)) as env:
            record = record_episode(env, make_detector(names[label]), *seeds, label=label)
        name = re.sub(r"[^\w.=-]+", "_", label).strip("_")
        record.save(Path(out, "episodes", f"{name}-{row['episode']}.npz"))
    return len(rows)

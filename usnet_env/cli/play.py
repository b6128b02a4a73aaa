"""``usnet evaluate`` and ``usnet demo``: detectors meet swarms."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

import click

from usnet_env.cli.words import PIPE_WIDTH, PairsCommand, WholeNumber, pairs, show

if TYPE_CHECKING:
    from usnet_env.evaluation import EvaluationResult

__all__ = ["demo", "evaluate"]


@click.command(cls=PairsCommand)
@click.option("--env", "env_id", default="USNET/MultiCluster-v0", show_default=True, metavar="ID", help="Environment.")
@click.option(
    "--detector",
    "detectors",
    multiple=True,
    required=True,
    metavar="NAME",
    help="Detector, e.g. random, 'lagged-regression(clusters=5)' or module:Class. May repeat.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE …",
    help="Arguments of the environment, every pair up to the next option. May repeat.",
)
@click.option("--episodes", type=WholeNumber(1, 1_000_000), default=100, show_default=True, help="For each detector.")
@click.option("--seed", type=WholeNumber(0, 2**63 - 1), default=0, show_default=True, help="Of the whole evaluation.")
@click.option("--workers", type=WholeNumber(1, 256), default=1, show_default=True, help="Processes.")
@click.option("--out", metavar="DIR", help="Keep rows, summary and config here; the same command continues a run.")
@click.option("--trivial", is_flag=True, help="Also evaluate destroy-all, none, random and one-per-round.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON and nothing else.")
@click.pass_context
def evaluate(
    ctx: click.Context,
    env_id: str,
    detectors: tuple[str, ...],
    settings: tuple[str, ...],
    episodes: int,
    seed: int,
    workers: int,
    out: str | None,
    trivial: bool,
    as_json: bool,
) -> None:
    """Let detectors meet the same swarms, and score them with 95 % intervals."""
    env_kwargs = pairs(settings)
    if out is not None:
        ctx.find_root().obj = f"Finished episodes are kept in {out}: the same command goes on from there."
    from usnet_env import evaluation

    result = evaluation.evaluate(
        env_id,
        list(detectors),
        episodes=episodes,
        seed=seed,
        env_kwargs=env_kwargs,
        workers=workers,
        trivial=trivial,
        out=out,
        progress=sys.stderr.isatty(),
    )
    if as_json:
        click.echo(json.dumps(result.summary, indent=2, allow_nan=False))
        return
    _print_result(result)
    if out is not None:
        click.echo(f"Rows, summary and config are in {out}.", err=True)


def _print_result(result: EvaluationResult) -> None:
    """One table where it fits, else several with some of the columns each."""
    from rich.console import Console

    from usnet_env.evaluation import METRICS

    console = Console()
    width = console.width if console.is_terminal else PIPE_WIDTH
    wide = console.options.update(max_width=10_000)
    columns: list[str] = []
    for name in METRICS:
        if columns and console.measure(result.table([*columns, name]), options=wide).maximum > width:
            show(result.table(columns))
            columns = []
        columns.append(name)
    show(result.table(columns))


@click.command()
@click.option("--out", default="runs/demo", show_default=True, metavar="DIR", help="Where the files go.")
@click.option("--seed", type=WholeNumber(0, 2**63 - 1), default=0, show_default=True, help="Of the episode.")
@click.option("--detector", metavar="NAME", help="Detector; by default the best one at hand.")
def demo(out: str, seed: int, detector: str | None) -> None:
    """Play one episode with 8 clusters and 185 UAVs, and keep a replay and a picture of it."""
    from usnet_env.replay.demo import run_demo

    if detector is None:
        run_demo(out, seed=seed)
    else:
        run_demo(out, seed=seed, detector=detector)

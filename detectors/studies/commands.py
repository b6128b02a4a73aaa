"""``usnet reproduce …``: the tables and figures of the paper, with its values beside ours."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

import click

from usnet_env.cli.options import WholeNumber
from usnet_env.cli.output import progress_bar, show_markdown

__all__ = ["reproduce"]


@click.group(short_help="Reproduce a table or figure of the paper.")
def reproduce() -> None:
    """Reproduce the tables and figures of the paper."""


def _add_out_and_seed(folder: str, seed_of: str = "episodes") -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Add the options ``--out`` and ``--seed``: the folder of the results and the seed."""

    def with_options(command: Callable[..., None]) -> Callable[..., None]:
        @click.option("--out", default=folder, show_default=True, metavar="DIR", help="Folder of the results.")
        @click.option(
            "--seed", type=WholeNumber(0, 2**31), default=2022, show_default=True, help=f"Seed of the {seed_of}."
        )
        @wraps(command)
        def called(*, out: str, **values: Any) -> None:
            command(out=Path(out), **values)

        return called

    return with_options


def _add_workers(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option ``--workers``."""

    @click.option("--workers", type=WholeNumber(1, 256), help="Number of processes; by default the number of cores.")
    @wraps(command)
    def called(*, workers: int | None, **values: Any) -> None:
        command(workers=workers or os.cpu_count() or 1, **values)

    return called


def _add_head_motion(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options ``--mobility`` and ``--head-jitter``."""
    command = click.option("--head-jitter", is_flag=True, help="Give heads the noise of the followers.")(command)
    return click.option("--mobility", default="iid", show_default=True, metavar="NAME", help="Motion of the heads.")(
        command
    )


@contextmanager
def _resumable(out: Path, what: str) -> Iterator[Callable[[int, int], None]]:
    """Show the progress of a measurement; an interruption prints how to continue it.

    Raises:
        MissingExtraError: matplotlib, which draws the picture of the results, is not installed.
    """
    from usnet_env.drawing import new_figure

    new_figure(1, 1)  # before anything is measured
    click.get_current_context().find_root().obj = (
        f"Finished {what} are kept in {out}: the same command continues from there."
    )
    with progress_bar(what) as progress:
        yield progress


def _print_report(text: str, out: Path) -> None:
    """Print a report, and the folder of the rows, tables and picture."""
    show_markdown(text)
    click.echo(f"Rows, tables and picture are in {out}.", err=True)


@reproduce.command(short_help="Table of detection rates (P1).")
@_add_out_and_seed("runs/table2")
@click.option(
    "--detector",
    "detectors",
    multiple=True,
    metavar="NAME",
    help="Detector; may repeat; by default gassl, neural-granger and lagged-regression(clusters=1).",
)
@click.option(
    "--episodes", type=WholeNumber(1, 1_000_000), help="Episodes in each cell; by default 100 up to m=15, else 30."
)
@click.option("--cells", metavar="LIST", help="Cells such as f1:2,f4:15 or rows such as f1; by default all 70.")
@click.option(
    "--decoys",
    type=WholeNumber(0, 1000),
    default=0,
    show_default=True,
    help="Number of decoys: UAVs without followers that fly like heads.",
)
@_add_head_motion
@click.option("--fast", is_flag=True, help="Only 10 episodes in each cell, and only cells up to m=15.")
@_add_workers
def table2(
    *,
    out: Path,
    detectors: tuple[str, ...],
    episodes: int | None,
    cells: str | None,
    decoys: int,
    mobility: str,
    head_jitter: bool,
    fast: bool,
    seed: int,
    workers: int,
) -> None:
    """Measure detection rates in one cluster: 7 follow strategies and 10 sizes."""
    from detectors.studies import table2 as table

    if fast and cells is None:
        cells = ",".join(f"{follow}:{size}" for follow in table.FOLLOW for size in table.FOLLOWERS if size <= 15)
    chosen: dict[str, Any] = {"detectors": detectors} if detectors else {}
    with _resumable(out, "episodes") as progress:
        _, report = table.reproduce(
            out,
            episodes=10 if fast and episodes is None else episodes,
            cells=cells,
            decoys=decoys,
            mobility=mobility,
            head_jitter=head_jitter,
            seed=seed,
            workers=workers,
            progress=progress,
            **chosen,
        )
    _print_report(report.read_text(encoding="utf-8"), out)


@reproduce.command(short_help="All figures, as PNG and PDF.")
@_add_out_and_seed("runs/figures", "scenes, of the example and of the rows")
@click.option("--only", multiple=True, metavar="NAME", help="Name of a figure; may repeat; by default all figures.")
@click.option(
    "--results",
    default="benchmarks/results",
    show_default=True,
    metavar="DIR",
    help="Folder of the measured rows from which tables and curves are drawn.",
)
def figures(*, out: Path, only: tuple[str, ...], results: str, seed: int) -> None:
    """Make the figures of the paper as PNG and PDF.

    \b
    Drawn from measured rows:
      detection-rates         detection rates of P1, beside the paper's table
      meta-loss               off-line loss, and on-line loss by start
      purity                  purity of four algorithms, f1 to f7
      rounds                  P2 against follow strategy, M and N
    Computed:
      attention-heads-f1-m15  heat maps of α and of α_l of each attention head
      hierarchy-f1-m15        attention graph and hierarchy graph
      attention-sizes-f7      heat maps of α for six sizes
      feature-space           GRU features before and after metric learning
      example-m8-n185         rounds of one game with attention (minutes)
    """  # noqa: D301  # click reads the control character: it keeps the lines of the list
    from detectors.studies import figures as paper

    with progress_bar("figures") as progress:
        files = paper.make_figures(
            out, only=only, settings=paper.Settings(results=Path(results), seed=seed), progress=progress
        )
    for file in files:
        click.echo(str(file))


@reproduce.command(short_help="Purity of every clusterer.")
@_add_out_and_seed("runs/purity")
@click.option(
    "--episodes", type=WholeNumber(1, 1_000_000), default=30, show_default=True, help="Episodes of each method."
)
@click.option("--follow", multiple=True, metavar="NAME", help="Follow strategy; may repeat; by default f1 to f7.")
@click.option("--clusterer", "clusterers", multiple=True, metavar="NAME", help="Clusterer; may repeat; by default all.")
@click.option(
    "--features",
    multiple=True,
    metavar="NAME",
    help="Features: raw, scaled, velocities, gru-single, gru-mean or gru-series; may repeat; by default all.",
)
@click.option(
    "--count", "counts", multiple=True, metavar="NAME", help="How M is known: given or estimated; by default both."
)
@click.option("--clusters", type=WholeNumber(1, 1000), default=5, show_default=True, help="M.")
@click.option("--uavs", type=WholeNumber(3, 10_000), default=82, show_default=True, help="N.")
@_add_head_motion
@_add_workers
def purity(
    *,
    out: Path,
    episodes: int,
    follow: tuple[str, ...],
    clusterers: tuple[str, ...],
    features: tuple[str, ...],
    counts: tuple[str, ...],
    clusters: int,
    uavs: int,
    mobility: str,
    head_jitter: bool,
    seed: int,
    workers: int,
) -> None:
    """Measure purity and head-in-cluster of every clusterer, M given and estimated."""
    from detectors.studies import purity as figure
    from detectors.studies import purity_report

    methods = figure.list_methods(clusterers or tuple(figure.CLUSTERERS), features or None, counts or figure.COUNTS)
    with _resumable(out, "windows") as progress:
        rows = figure.reproduce(
            out,
            follow=follow or figure.FOLLOW,
            methods=methods,
            clusters=clusters,
            uavs=uavs,
            episodes=episodes,
            mobility=mobility,
            head_jitter=head_jitter,
            seed=seed,
            workers=workers,
            progress=progress,
        )
    _print_report(purity_report.format_markdown(rows, "Purity and head-in-cluster"), out)


@reproduce.command(short_help="P2 against follow strategy, M and N.")
@_add_out_and_seed("runs/rounds")
@click.option(
    "--study",
    "studies",
    multiple=True,
    metavar="NAME",
    help="Study: follow, clusters, uavs or example; may repeat; by default all four.",
)
@click.option(
    "--detector",
    "detectors",
    multiple=True,
    metavar="NAME",
    help="Detector; may repeat; by default the detectors of the committed rows.",
)
@click.option("--no-trivial", is_flag=True, help="Omit destroy-all, none, random and one-per-round.")
@click.option(
    "--episodes",
    type=WholeNumber(1, 1_000_000),
    default=30,
    show_default=True,
    help="Episodes of each detector and swarm.",
)
@_add_head_motion
@_add_workers
def rounds(
    *,
    out: Path,
    studies: tuple[str, ...],
    detectors: tuple[str, ...],
    no_trivial: bool,
    episodes: int,
    mobility: str,
    head_jitter: bool,
    seed: int,
    workers: int,
) -> None:
    """Measure rounds, redundancy and J_m of P2 against follow strategy, M and N, and in the paper's example."""
    from detectors.studies import rounds as figure
    from detectors.studies import rounds_report

    with _resumable(out, "episodes") as progress:
        rows = figure.reproduce(
            out,
            studies=studies or tuple(figure.STUDIES),
            detectors=detectors or figure.DETECTORS,
            trivial=not no_trivial,
            episodes=episodes,
            mobility=mobility,
            head_jitter=head_jitter,
            seed=seed,
            workers=workers,
            progress=progress,
        )
    with_paper = mobility == "iid" and not head_jitter
    _print_report(
        rounds_report.markdown(rows, "P2 (all columns are in the file)", with_paper, rounds_report.SHORT), out
    )


@reproduce.command(name="meta", short_help="Losses of metric learning.")
@_add_out_and_seed("runs/meta-losses", "measurement")
@click.option(
    "--trainings", type=WholeNumber(2, 1000), default=5, show_default=True, help="Number of trainings of each start."
)
@click.option(
    "--strategies",
    type=WholeNumber(1, 10**6),
    default=30,
    show_default=True,
    help="F, follow strategies of each training.",
)
@click.option(
    "--episodes", type=WholeNumber(1, 10**6), default=1000, show_default=True, help="E, episodes of each training."
)
@_add_workers
def meta_losses(*, out: Path, trainings: int, strategies: int, episodes: int, seed: int, workers: int) -> None:
    """Measure the off-line loss, and the on-line loss from meta-learned, jointly trained and random starts."""
    from detectors.studies import metric_learning

    with _resumable(out, "losses") as progress:
        rows = metric_learning.measure_losses(
            out,
            trainings=trainings,
            strategies=strategies,
            episodes=episodes,
            seed=seed,
            workers=workers,
            progress=progress,
        )
    _print_report(metric_learning.format_markdown(rows), out)

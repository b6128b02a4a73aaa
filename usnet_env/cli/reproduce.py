"""``usnet reproduce …``: tables and figures of the paper, its values beside ours."""

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
    """Reproduce a table or figure of the paper, its values beside ours."""


def _to(folder: str, seed_of: str = "episodes") -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Where a reproduction is kept, and its seed: ``out``, a path, and ``seed``."""

    def with_options(command: Callable[..., None]) -> Callable[..., None]:
        @click.option("--out", default=folder, show_default=True, metavar="DIR", help="What is made goes here.")
        @click.option("--seed", type=WholeNumber(0, 2**31), default=2022, show_default=True, help=f"Of the {seed_of}.")
        @wraps(command)
        def called(*, out: str, **values: Any) -> None:
            command(out=Path(out), **values)

        return called

    return with_options


def _on_cores(command: Callable[..., None]) -> Callable[..., None]:
    """Gives ``workers``, processes."""

    @click.option("--workers", type=WholeNumber(1, 256), help="Processes; by default one a core.")
    @wraps(command)
    def called(*, workers: int | None, **values: Any) -> None:
        command(workers=workers or os.cpu_count() or 1, **values)

    return called


def _flight(command: Callable[..., None]) -> Callable[..., None]:
    """How heads fly: ``mobility`` and ``head_jitter``."""
    command = click.option("--head-jitter", is_flag=True, help="The heads have the followers' noise.")(command)
    return click.option("--mobility", default="iid", show_default=True, metavar="NAME", help="How the heads fly.")(
        command
    )


@contextmanager
def _resumable(out: Path, what: str) -> Iterator[Callable[[int, int], None]]:
    """Progress of a measurement that keeps what it has finished, which is said where it is interrupted."""
    click.get_current_context().find_root().obj = (
        f"Finished {what} are kept in {out}: the same command goes on from there."
    )
    with progress_bar(what) as progress:
        yield progress


def _made(text: str, out: Path) -> None:
    """The table, and where the rest of what was made is."""
    show_markdown(text)
    click.echo(f"Rows, tables and picture are in {out}.", err=True)


@reproduce.command()
@_to("runs/table2")
@click.option("--episodes", type=WholeNumber(1, 1_000_000), help="A cell; by default 100 up to m=15 and 30 above.")
@click.option("--cells", metavar="LIST", help="Cells such as f1:2,f4:15 or rows such as f1; by default all 70.")
@click.option(
    "--preset",
    "presets",
    multiple=True,
    metavar="NAME",
    help="default, paper or lagged-regression; may repeat; by default all three.",
)
@click.option("--decoys", type=WholeNumber(0, 1000), default=0, show_default=True, help="UAVs that lead nobody.")
@_flight
@click.option("--fast", is_flag=True, help="10 episodes a cell, m up to 15: a look in minutes.")
@_on_cores
@click.option(
    "--device", default="cpu", show_default=True, metavar="NAME", help="Where GASSL trains: cpu, cuda or auto."
)
def table2(
    *,
    out: Path,
    episodes: int | None,
    cells: str | None,
    presets: tuple[str, ...],
    decoys: int,
    mobility: str,
    head_jitter: bool,
    fast: bool,
    seed: int,
    workers: int,
    device: str,
) -> None:
    """Detection rates of GASSL: 7 follow strategies and 10 sizes of one cluster."""
    from usnet_env.reproduce import table2 as table

    if fast and cells is None:
        cells = ",".join(f"{follow}:{size}" for follow in table.FOLLOW for size in table.FOLLOWERS if size <= 15)
    with _resumable(out, "episodes") as progress:
        table.reproduce(
            out,
            episodes=10 if fast and episodes is None else episodes,
            cells=cells,
            presets=presets or tuple(table.DETECTORS),
            decoys=decoys,
            mobility=mobility,
            head_jitter=head_jitter,
            seed=seed,
            workers=workers,
            device=device,
            progress=progress,
        )
    newest = max(out.glob("*.md"), key=lambda path: path.stat().st_mtime)
    _made(newest.read_text(encoding="utf-8"), out)


@reproduce.command()
@_to("runs/attention")
def attention(*, out: Path, seed: int) -> None:
    """Heat maps of attention (f1 with m=15, f7 at six sizes) and the hierarchy graph."""
    from usnet_env.reproduce import attention as figures

    with progress_bar("fits") as progress:
        made = figures.reproduce(out, seed, progress)
    for path in made:
        click.echo(str(path))


@reproduce.command()
@_to("runs/purity")
@click.option("--episodes", type=WholeNumber(1, 1_000_000), default=30, show_default=True, help="For each method.")
@click.option("--follow", multiple=True, metavar="NAME", help="Follow strategy; may repeat; by default f1 to f7.")
@click.option("--clusterer", "clusterers", multiple=True, metavar="NAME", help="May repeat; by default all.")
@click.option(
    "--features",
    multiple=True,
    metavar="NAME",
    help="raw, scaled, velocities, gru-single, gru-mean or gru-series; may repeat; by default all.",
)
@click.option("--count", "counts", multiple=True, metavar="NAME", help="M given or estimated; by default both.")
@click.option("--clusters", type=WholeNumber(1, 1000), default=5, show_default=True, help="M.")
@click.option("--uavs", type=WholeNumber(3, 10_000), default=82, show_default=True, help="N.")
@_flight
@_on_cores
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
    """Purity and head-in-cluster of every clusterer, M given and estimated."""
    from usnet_env.reproduce import purity as figure
    from usnet_env.reproduce import purity_report

    methods = figure.methods_of(clusterers or tuple(figure.CLUSTERERS), features or None, counts or figure.COUNTS)
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
    _made(purity_report.markdown(rows, "Purity and head-in-cluster"), out)


@reproduce.command()
@_to("runs/rounds")
@click.option(
    "--study",
    "studies",
    multiple=True,
    metavar="NAME",
    help="follow, clusters, uavs or example; may repeat; by default all four.",
)
@click.option(
    "--detector",
    "detectors",
    multiple=True,
    metavar="NAME",
    help="May repeat; by default both presets of mc-gassl and lagged-regression.",
)
@click.option("--no-trivial", is_flag=True, help="Leave out destroy-all, none, random and one-per-round.")
@click.option("--episodes", type=WholeNumber(1, 1_000_000), default=30, show_default=True, help="A swarm and detector.")
@_flight
@_on_cores
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
    """Rounds, redundancy and J_m of P2 against follow strategy, M and N, and one swarm round by round."""
    from usnet_env.reproduce import rounds as figure
    from usnet_env.reproduce import rounds_report

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
    _made(rounds_report.markdown(rows, "P2 (all columns are in the file)", with_paper, rounds_report.SHORT), out)


@reproduce.command(name="meta")
@_to("runs/meta-losses", "measurement")
@click.option("--trainings", type=WholeNumber(2, 1000), default=5, show_default=True, help="Seeds, for the bands.")
@click.option("--strategies", type=WholeNumber(1, 10**6), default=30, show_default=True, help="F of each training.")
@click.option("--episodes", type=WholeNumber(1, 10**6), default=1000, show_default=True, help="E of each training.")
@_on_cores
def meta_losses(*, out: Path, trainings: int, strategies: int, episodes: int, seed: int, workers: int) -> None:
    """Off-line loss, and on-line loss from meta-learned, jointly trained and random starts."""
    from usnet_env.reproduce import metric_learning

    with _resumable(out, "losses") as progress:
        rows = metric_learning.losses(
            out,
            trainings=trainings,
            strategies=strategies,
            episodes=episodes,
            seed=seed,
            workers=workers,
            progress=progress,
        )
    _made(metric_learning.markdown(rows), out)


@reproduce.command()
@_to("runs/features", "swarm")
@click.option("--follow", multiple=True, metavar="NAME", help="May repeat; by default f1 and f4.")
def features(*, out: Path, follow: tuple[str, ...], seed: int) -> None:
    """The feature space of the GRU network before and after training."""
    from usnet_env.reproduce import metric_learning

    for name in follow or ("f1", "f4"):
        click.echo(str(metric_learning.features(out, seed, name)))

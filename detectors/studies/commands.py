"""``usnet reproduce …``: the tables and figures of the paper; ``usnet train …``: the models of the package."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usnet_env.cli.options import WholeNumber, add_place
from usnet_env.cli.output import show_markdown
from usnet_env.progress import progress_bar

if TYPE_CHECKING:
    from detectors.studies.common import Reproduction
    from usnet_env.evaluation.engine import Place

Option = Callable[[Callable[..., Any]], Callable[..., Any]]
Progress = Callable[[int, int], None]


@click.group(short_help="Reproduce a table or figure of the paper.")
def reproduce() -> None:
    """Reproduce the tables and figures of the paper."""


def _name(option: str, field: str, of: str, by_default: str) -> Option:
    """An option with a name, which may repeat."""
    text = f"{of}; may repeat; by default {by_default}."
    return click.option(option, field, multiple=True, metavar="NAME", help=text)


def _number(option: str, least: int, most: int, default: int | None, text: str) -> Option:
    """An option with a whole number."""
    kind = WholeNumber(least, most)
    return click.option(option, type=kind, default=default, show_default=default is not None, help=text)


def _add_options(command: Callable[..., Any], *options: Option) -> Callable[..., Any]:
    for option in options:
        command = option(command)
    return command


def _out(folder: str, of: str = "of the results") -> Option:
    """The option ``--out``."""
    return click.option("--out", default=folder, show_default=True, metavar="DIR", help=f"Folder {of}.")


def _seed(of: str, most: int = 2**31, default: int = 2022) -> Option:
    """The option ``--seed``."""
    return _number("--seed", 0, most, default, f"Seed of the {of}.")


def _format(by_default: str) -> Option:
    """The option ``--format``: of pictures."""
    text = f"Format of the pictures: png (200 dpi) or pdf; may repeat; by default {by_default}."
    return click.option("--format", "formats", multiple=True, type=click.Choice(["png", "pdf"]), help=text)


def _head_motion(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options ``--mobility`` and ``--head-jitter``."""
    jitter = click.option("--head-jitter", is_flag=True, help="Give heads the noise of the followers.")
    text = "Motion of the heads."
    mobility = click.option("--mobility", default="iid", show_default=True, metavar="NAME", help=text)
    return _add_options(command, jitter, mobility)


def _choose_place(backend: str | None, workers: int, address: str | None) -> Place:
    """Check where to run; the engine is imported only when a command runs."""
    from usnet_env.evaluation.engine import choose_place
    from usnet_env.processes import Limits

    return choose_place(backend, workers, Limits(), address)


def _measurement(folder: str, unit: str, seed_of: str = "episodes") -> Option:
    """The options that all measurements share; they show their progress, and print their report.

    An interruption prints how to continue. Options that were not given keep the defaults of the study.

    Raises:
        MissingExtraError: matplotlib, which draws the picture of the results, is not installed.
    """

    def with_options(command: Callable[..., Reproduction[Any]]) -> Callable[..., Any]:
        @wraps(command)
        def called(*, out: str, workers: int | None, backend: str | None, address: str | None, **values: Any) -> None:
            from usnet_env.drawing import new_figure

            new_figure(1, 1)  # before anything is measured
            resume = f"Finished {unit} are kept in {out}: the same command continues from there."
            click.get_current_context().find_root().obj = resume
            cores = 1 if backend == "serial" else os.cpu_count() or 1
            place = _choose_place(backend, workers or cores, address)
            values["formats"] = tuple(dict.fromkeys(values["formats"]))
            given = {name: value for name, value in values.items() if value not in ((), None)}
            with progress_bar(unit) as progress:
                made = command(Path(out), workers=place, progress=progress, **given)
            show_markdown(made.text)
            click.echo(f"Rows, tables and picture are in {out}.", err=True)

        workers = _number("--workers", 1, 256, None, "Number of processes; by default the number of cores.")
        return _add_options(called, workers, add_place, _format("PNG"), _seed(seed_of), _out(folder))

    return with_options


@reproduce.command(short_help="Table of detection rates (P1).")
@_measurement("runs/table2", "episodes")
@_name("--detector", "detectors", "Detector", "gassl, neural-granger and lagged-regression(clusters=1)")
@_number("--episodes", 1, 1_000_000, None, "Episodes in each cell; by default 100 up to m=15, else 30.")
@click.option("--cells", metavar="LIST", help="Cells such as f1:2,f4:15 or rows such as f1; by default all 70.")
@_number("--decoys", 0, 1000, 0, "Number of decoys: UAVs without followers that fly like heads.")
@_head_motion
@click.option("--fast", is_flag=True, help="Only 10 episodes in each cell, and only cells up to m=15.")
def table2(out: Path, *, fast: bool, **options: Any) -> Reproduction[Any]:
    """Measure detection rates in one cluster: 7 follow strategies and 10 sizes."""
    from detectors.studies import table2 as study

    return study.reproduce(out, **(study.FAST if fast else {}) | options)


@reproduce.command(short_help="All figures, as PNG and PDF.")
@_out("runs/figures")
@_seed("scenes, of the example and of the rows")
@_name("--only", "only", "Name of a figure", "all figures")
@_format("both")
@click.option(
    "--results",
    default="benchmarks/results",
    show_default=True,
    metavar="DIR",
    help="Folder of the measured rows from which tables and curves are drawn.",
)
def figures(*, out: str, only: tuple[str, ...], formats: tuple[str, ...], results: str, seed: int) -> None:
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
    from usnet_env.drawing import FORMATS

    settings = paper.Settings(results=Path(results), seed=seed)
    with progress_bar("figures") as progress:
        files = paper.make_figures(
            Path(out), only=only, formats=formats or FORMATS, settings=settings, progress=progress
        )
    for file in files:
        click.echo(str(file))


@reproduce.command(short_help="Purity of every clusterer.")
@_measurement("runs/purity", "windows")
@_number("--episodes", 1, 1_000_000, 30, "Episodes of each method.")
@_name("--follow", "follow", "Follow strategy", "f1 to f7")
@_name("--clusterer", "clusterers", "Clusterer", "all")
@_name("--features", "features", "Features: raw, scaled, velocities, gru-single, gru-mean or gru-series", "all")
@click.option(
    "--count", "counts", multiple=True, metavar="NAME", help="How M is known: given or estimated; by default both."
)
@_number("--clusters", 1, 1000, 5, "M.")
@_number("--uavs", 3, 10_000, 82, "N.")
@_head_motion
def purity(out: Path, **options: Any) -> Reproduction[Any]:
    """Measure purity and head-in-cluster of every clusterer, M given and estimated."""
    from detectors.studies import purity as study

    methods = {name: options.pop(name) for name in ("clusterers", "features", "counts") if name in options}
    return study.reproduce(out, methods=study.list_methods(**methods), **options)


@reproduce.command(short_help="P2 against follow strategy, M and N.")
@_measurement("runs/rounds", "episodes")
@_name("--study", "studies", "Study: follow, clusters, uavs or example", "all four")
@_name("--detector", "detectors", "Detector", "the detectors of the committed rows")
@click.option("--no-trivial", is_flag=True, help="Omit destroy-all, none, random and one-per-round.")
@_number("--episodes", 1, 1_000_000, 30, "Episodes of each detector and swarm.")
@_head_motion
@click.option("--isolate", is_flag=True, help="Play each detector in a process that never holds an environment.")
def rounds(out: Path, *, no_trivial: bool, **options: Any) -> Reproduction[Any]:
    """Measure rounds, redundancy and J_m of P2 against follow strategy, M and N, and in the paper's example."""
    from detectors.studies import rounds as study

    return study.reproduce(out, trivial=not no_trivial, **options)


@reproduce.command(name="meta", short_help="Losses of metric learning.")
@_measurement("runs/meta-losses", "losses", "measurement")
@_number("--trainings", 2, 1000, 5, "Number of trainings of each start.")
@_number("--strategies", 1, 10**6, 30, "F, follow strategies of each training.")
@_number("--episodes", 1, 10**6, 1000, "E, episodes of each training.")
def meta_losses(out: Path, **options: Any) -> Reproduction[Any]:
    """Measure the off-line loss, and the on-line loss from meta-learned, jointly trained and random starts."""
    from detectors.studies import metric_learning

    return metric_learning.reproduce(out, **options)


@click.group(short_help="Retrain the models that are part of the package.")
def train() -> None:
    """Retrain the models that are part of the package: weights and calibration."""


def _training(folder: str, what: str, unit: str, seed_of: str, most: int, resume_from: str) -> Option:
    """The options that all trainings share; they show their progress, and print the path of what they made."""

    def with_options(command: Callable[..., Path]) -> Callable[..., Any]:
        @wraps(command)
        def called(*, workers: int, backend: str | None, address: str | None, **values: Any) -> None:
            place = _choose_place(backend, workers, address)
            with progress_bar(unit) as progress:
                click.echo(str(command(progress=progress, workers=place, **values)))

        text = f"Resume from {resume_from} in --out."
        resume = click.option("--resume/--no-resume", default=True, show_default=True, help=text)
        text = "Number of processes that draw swarms; the result does not depend on it."
        count = _number("--workers", 1, 10**4, 1, text)
        return _add_options(called, resume, add_place, count, _seed(seed_of, most, 0), _out(folder, f"for {what}"))

    return with_options


@train.command(short_help="The GRU network of mc-gassl.")
@_training("runs/meta", "weights and losses", "strategies and episodes", "training", 2**31, "a checkpoint")
@click.option(
    "--method", type=click.Choice(["meta", "joint"]), default="meta", show_default=True, help="Training method."
)
@_number("--strategies", 1, 10**7, 100, "F, number of random follow strategies.")
@_number("--episodes", 1, 10**7, 10_000, "Number of episodes.")
def meta(*, out: str, resume: bool, progress: Progress, workers: Place, **settings: Any) -> Path:
    """Train the GRU network of mc-gassl off-line, on random follow strategies that exclude f1 to f7."""
    from detectors.mc_gassl.train import MetaTraining, train_meta

    return train_meta(out, MetaTraining.model_validate(settings), progress, resume, workers=workers)


@train.command(short_help="The network of the learned detector.")
@_training("runs/learned", "weights and losses", "steps", "training", 2**63 - 1, "a checkpoint")
@_number("--steps", 1, 10**7, 4000, "Number of optimiser steps.")
@_number("--swarms", 1, 10**5, 8, "Swarms in each step.")
def learned(*, out: str, resume: bool, progress: Progress, workers: Place, **settings: Any) -> Path:
    """Train the network of the learned detector, on random follow strategies that exclude f1 to f7."""
    from detectors.learned.train import HeadTraining, train_heads

    return train_heads(out, HeadTraining.model_validate(settings), progress, resume, workers=workers)


@train.command("follow-mixture", short_help="The calibration of follow-mixture.")
@_training("runs/follow-mixture", "calibration and rows", "swarms", "swarms", 2**63 - 1, "the rows")
@_number("--swarms", 1, 10**6, 600, "Number of simulated swarms.")
def follow_mixture(*, out: str, resume: bool, progress: Progress, workers: Place, **settings: Any) -> Path:
    """Calibrate the probabilities of follow-mixture, on swarms with random follow strategies."""
    from detectors.follow_mixture.train import CalibrationTraining, train_calibration

    return train_calibration(out, CalibrationTraining.model_validate(settings), progress, resume, workers)

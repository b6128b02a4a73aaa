"""``usnet train …``: the models of the package; ``usnet check-detector``: the contract of detectors."""

from __future__ import annotations

import os
import traceback
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import click

from usnet_env.files import reserve_folder
from usnet_env.progress import progress_bar

Option = Callable[[Callable[..., Any]], Callable[..., Any]]
Progress = Callable[[int, int], None]


def _number(option: str, least: int, most: int, default: int, text: str) -> Option:
    return click.option(option, type=click.IntRange(least, most), default=default, show_default=True, help=text)


@click.group(short_help="Retrain the models that are part of the package.")
def train() -> None:
    """Retrain the models that are part of the package: weights and calibration."""


def _training(folder: str, what: str, unit: str, most_seed: int, resume_from: str) -> Option:
    """The options that all trainings share; they show their progress, and print the path of what they made."""

    def with_options(command: Callable[..., Path]) -> Callable[..., Any]:
        @wraps(command)
        def called(**values: Any) -> None:
            reserve_folder(Path(values["out"]))  # before libraries that take seconds are imported
            with progress_bar(unit) as progress:
                click.echo(str(command(progress=progress, **values)))

        options = (
            click.option("--resume/--no-resume", default=True, help=f"Resume from {resume_from} in --out."),
            click.option(
                "--backend",
                type=click.Choice(["serial", "processes", "ray"]),
                help="Draw swarms in this process, in child processes, or on a Ray cluster.",
            ),
            _number("--workers", 1, 10**4, 1, "Processes that draw swarms; the result does not depend on it."),
            _number("--seed", 0, most_seed, 0, "Seed of the training."),
            click.option("--out", default=folder, show_default=True, metavar="DIR", help=f"Folder for {what}."),
        )
        made: Callable[..., Any] = called
        for option in options:
            made = option(made)
        return made

    return with_options


@train.command(short_help="The GRU network of mc-gassl.")
@_training("runs/meta", "weights and losses", "strategies and episodes", 2**31, "a checkpoint")
@click.option(
    "--method", type=click.Choice(["meta", "joint"]), default="meta", show_default=True, help="Training method."
)
@_number("--strategies", 1, 10**7, 100, "F, number of random follow strategies.")
@_number("--episodes", 1, 10**7, 10_000, "Number of episodes.")
def meta(*, out: str, progress: Progress, resume: bool, workers: int, backend: str | None, **settings: Any) -> Path:
    """Train the GRU network of mc-gassl off-line, on random follow strategies that exclude f1 to f7."""
    from detectors.mc_gassl.train import MetaTraining, train_meta

    return train_meta(out, MetaTraining(**settings), progress, resume, workers=workers, backend=backend)


@train.command(short_help="The network of the learned detector.")
@_training("runs/learned", "weights and losses", "steps", 2**63 - 1, "a checkpoint")
@_number("--steps", 1, 10**7, 4000, "Number of optimiser steps.")
@_number("--swarms", 1, 10**5, 8, "Swarms in each step.")
def learned(*, out: str, progress: Progress, resume: bool, workers: int, backend: str | None, **settings: Any) -> Path:
    """Train the network of the learned detector, on random follow strategies that exclude f1 to f7."""
    from detectors.learned.train import HeadTraining, train_heads

    return train_heads(out, HeadTraining(**settings), progress, resume, workers=workers, backend=backend)


@train.command("follow-mixture", short_help="The calibration of follow-mixture.")
@_training("runs/follow-mixture", "calibration and rows", "swarms", 2**63 - 1, "the rows")
@_number("--swarms", 1, 10**6, 600, "Number of simulated swarms.")
def follow_mixture(
    *, out: str, progress: Progress, resume: bool, workers: int, backend: str | None, **settings: Any
) -> Path:
    """Calibrate the probabilities of follow-mixture, on swarms with random follow strategies."""
    from detectors.follow_mixture.train import CalibrationTraining, train_calibration

    return train_calibration(out, CalibrationTraining(**settings), progress, resume, workers=workers, backend=backend)


@click.command(name="check-detector", short_help="Test that a detector keeps the contract.")
@click.argument("name", metavar="NAME")
@click.option(
    "--expect",
    "expected",
    multiple=True,
    metavar="CHECK=REASON",
    help="A check that this detector is expected to fail, and the reason. May be repeated.",
)
@click.pass_context
def check_detector(ctx: click.Context, name: str, expected: tuple[str, ...]) -> None:
    """Test that a detector keeps the contract of usnet_env detectors.

    NAME is a detector's name, with or without arguments, or module:Class. The exit status is 1 if a check fails.
    """
    from detectors import checks

    reasons = {check.strip(): reason.strip() for check, _, reason in (text.partition("=") for text in expected)}
    done: list[checks.CheckResult] = []
    with progress_bar("checks") as progress:

        def count(result: checks.CheckResult) -> None:
            done.append(result)
            progress(len(done), len(checks.CHECKS))

        checks.check_detector(name, expected_failed_checks=reasons, on_fail=None, callback=count)
    click.echo(checks.results_table(done))
    if os.environ.get("USNET_TRACEBACK"):
        for error in filter(None, (result.error for result in done)):
            click.echo("".join(traceback.format_exception(error)), err=True)
    ctx.exit(checks.exit_status(done))

"""``usnet train …``: retrain the models that are part of the package."""

from __future__ import annotations

import click

from usnet_env.cli.options import WholeNumber
from usnet_env.cli.output import progress_bar

__all__ = ["train"]


@click.group(short_help="Retrain the models that are part of the package.")
def train() -> None:
    """Retrain the models that are part of the package: weights and calibration."""


@train.command(short_help="The GRU network of mc-gassl.")
@click.option("--out", default="runs/meta", show_default=True, metavar="DIR", help="Folder for weights and losses.")
@click.option(
    "--method", type=click.Choice(["meta", "joint"]), default="meta", show_default=True, help="Training method."
)
@click.option(
    "--strategies",
    type=WholeNumber(1, 10**7),
    default=100,
    show_default=True,
    help="F, number of random follow strategies.",
)
@click.option("--episodes", type=WholeNumber(1, 10**7), default=10_000, show_default=True, help="Number of episodes.")
@click.option("--seed", type=WholeNumber(0, 2**31), default=0, show_default=True, help="Seed of the training.")
@click.option("--resume/--no-resume", default=True, show_default=True, help="Resume from a checkpoint in --out.")
def meta(out: str, method: str, strategies: int, episodes: int, seed: int, resume: bool) -> None:
    """Train the GRU network of mc-gassl off-line, on random follow strategies that exclude f1 to f7."""
    from detectors.mc_gassl.train import MetaTraining, train_meta

    training = MetaTraining.model_validate(
        {"method": method, "strategies": strategies, "episodes": episodes, "seed": seed}
    )
    with progress_bar("strategies and episodes") as progress:
        click.echo(str(train_meta(out, training, progress, resume)))


@train.command(short_help="The network of the learned detector.")
@click.option("--out", default="runs/learned", show_default=True, metavar="DIR", help="Folder for weights and losses.")
@click.option("--steps", type=WholeNumber(1, 10**7), default=4000, show_default=True, help="Number of optimiser steps.")
@click.option("--swarms", type=WholeNumber(1, 10**5), default=8, show_default=True, help="Swarms in each step.")
@click.option("--seed", type=WholeNumber(0, 2**63 - 1), default=0, show_default=True, help="Seed of the training.")
@click.option("--resume/--no-resume", default=True, show_default=True, help="Resume from a checkpoint in --out.")
def learned(out: str, steps: int, swarms: int, seed: int, resume: bool) -> None:
    """Train the network of the learned detector, on random follow strategies that exclude f1 to f7."""
    from detectors.learned.train import HeadTraining, train_heads

    training = HeadTraining.model_validate({"steps": steps, "swarms": swarms, "seed": seed})
    with progress_bar("steps") as progress:
        click.echo(str(train_heads(out, training, progress, resume)))


@train.command("follow-mixture", short_help="The calibration of follow-mixture.")
@click.option(
    "--out", default="runs/follow-mixture", show_default=True, metavar="DIR", help="Folder for calibration and rows."
)
@click.option(
    "--swarms", type=WholeNumber(1, 10**6), default=600, show_default=True, help="Number of simulated swarms."
)
@click.option("--seed", type=WholeNumber(0, 2**63 - 1), default=0, show_default=True, help="Seed of the swarms.")
@click.option("--resume/--no-resume", default=True, show_default=True, help="Resume from the rows in --out.")
def follow_mixture(out: str, swarms: int, seed: int, resume: bool) -> None:
    """Calibrate the probabilities of follow-mixture, on swarms with random follow strategies."""
    from detectors.follow_mixture.train import CalibrationTraining, train_calibration

    training = CalibrationTraining.model_validate({"swarms": swarms, "seed": seed})
    with progress_bar("swarms") as progress:
        click.echo(str(train_calibration(out, training, progress, resume)))

"""``usnet train …``: make again what ships trained."""

from __future__ import annotations

import click

from usnet_env.cli.words import WholeNumber, progress_bar

__all__ = ["train"]


@click.group()
def train() -> None:
    """Make again what ships trained."""


@train.command()
@click.option("--out", default="runs/meta", show_default=True, metavar="DIR", help="Weights and losses go here.")
@click.option("--method", type=click.Choice(["meta", "joint"]), default="meta", show_default=True, help="The training.")
@click.option("--strategies", type=WholeNumber(1, 10**7), default=100, show_default=True, help="F, drawn at random.")
@click.option("--episodes", type=WholeNumber(1, 10**7), default=10_000, show_default=True, help="Of the training.")
@click.option("--seed", type=WholeNumber(0, 2**31), default=0, show_default=True, help="Of the training.")
@click.option("--resume/--no-resume", default=True, show_default=True, help="Go on from a checkpoint in --out.")
def meta(out: str, method: str, strategies: int, episodes: int, seed: int, resume: bool) -> None:
    """The GRU network of MC-GASSL, off line, on random follow strategies (none of f1 to f7)."""
    from detectors.mc_gassl.train import MetaTraining, train_meta

    training = MetaTraining.model_validate(
        {"method": method, "strategies": strategies, "episodes": episodes, "seed": seed}
    )
    with progress_bar("strategies and episodes") as progress:
        click.echo(str(train_meta(out, training, progress, resume)))


@train.command()
@click.option("--out", default="runs/learned", show_default=True, metavar="DIR", help="Weights and losses go here.")
@click.option("--steps", type=WholeNumber(1, 10**7), default=4000, show_default=True, help="Of the optimiser.")
@click.option("--swarms", type=WholeNumber(1, 10**5), default=8, show_default=True, help="In each step.")
@click.option("--seed", type=WholeNumber(0, 2**63 - 1), default=0, show_default=True, help="Of the training.")
@click.option("--resume/--no-resume", default=True, show_default=True, help="Go on from a checkpoint in --out.")
def learned(out: str, steps: int, swarms: int, seed: int, resume: bool) -> None:
    """The network of the learned detector, on random follow strategies (none of f1 to f7)."""
    from detectors.learned.train import HeadTraining, train_heads

    training = HeadTraining.model_validate({"steps": steps, "swarms": swarms, "seed": seed})
    with progress_bar("steps") as progress:
        click.echo(str(train_heads(out, training, progress, resume)))


@train.command("follow-mixture")
@click.option(
    "--out", default="runs/follow-mixture", show_default=True, metavar="DIR", help="Calibration and rows go here."
)
@click.option("--swarms", type=WholeNumber(1, 10**6), default=1500, show_default=True, help="To explain.")
@click.option("--seed", type=WholeNumber(0, 2**63 - 1), default=0, show_default=True, help="Of all draws.")
@click.option("--resume/--no-resume", default=True, show_default=True, help="Go on from the rows in --out.")
def follow_mixture(out: str, swarms: int, seed: int, resume: bool) -> None:
    """Probabilities of follow-mixture: its calibration, on random follow strategies (none of f1 to f7)."""
    from detectors.follow_mixture.train import CalibrationTraining, train_calibration

    training = CalibrationTraining.model_validate({"swarms": swarms, "seed": seed})
    with progress_bar("swarms") as progress:
        click.echo(str(train_calibration(out, training, progress, resume)))

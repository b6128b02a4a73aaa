"""``usnet train …``: the models of the package; ``usnet check-detector``: the contract of detectors."""

from __future__ import annotations

import os
import traceback
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from usnet_env.cli.options import complete_names
from usnet_env.config import ArgumentError, quote
from usnet_env.files import reserve_folder
from usnet_env.progress import progress_bar


@click.group(short_help="Retrain the models that are part of the package.")
def train() -> None:
    """Retrain the models that are part of the package."""


def _make_number(option: str, least: int, most: int, default: int, text: str) -> click.Option:
    return click.Option([option], type=click.IntRange(least, most), default=default, show_default=True, help=text)


def _make_choice(option: str, choices: list[str], text: str) -> click.Option:
    return click.Option([option], type=click.Choice(choices), default=choices[0], show_default=True, help=text)


def _add_training(name: str, made: str, module: str, *options: click.Option) -> None:
    """Add a command that calls ``train_name(out, NameTraining(**options), ...)`` of a module, and prints the path."""

    def call(out: str, resume: bool, workers: int, backend: str | None, **values: Any) -> None:
        reserve_folder(Path(out))  # before libraries that take seconds are imported
        training = import_module(module)
        with progress_bar("steps") as progress:
            settings, run = getattr(training, f"{name.title()}Training"), getattr(training, f"train_{name}")
            path = run(out, settings(**values), progress, resume, workers=workers, backend=backend)
        click.echo(str(path))

    shared = [
        click.Option(["--out"], default=f"runs/{name}", show_default=True, metavar="DIR", help="Folder for its files."),
        _make_number("--seed", 0, 2**63 - 1, 0, "Seed of the training."),
        _make_number("--workers", 1, 10**4, 1, "Processes that draw swarms; the result does not depend on it."),
        click.Option(
            ["--backend"],
            type=click.Choice(["serial", "processes", "ray"]),
            help="Draw swarms in this process, in child processes, or on a Ray cluster.",
        ),
        click.Option(["--resume/--no-resume"], default=True, help="Resume from what is in --out."),
    ]
    text = f"Train {made} on simulated swarms, none of which follows by one of f1 to f7 alone."
    command = click.Command(name, callback=call, params=[*options, *shared], help=text, short_help=f"T{made[1:]}.")
    train.add_command(command)


_add_training(
    "meta",
    "the GRU network of mc-gassl",
    "detectors.mc_gassl.train",
    _make_choice("--method", ["meta", "joint"], "Training method."),
    _make_number("--strategies", 1, 10**7, 100, "F, number of random follow strategies."),
    _make_number("--episodes", 1, 10**7, 10_000, "Number of episodes."),
)
_add_training(
    "reader",
    "the network of the reader",
    "detectors.reader.train",
    _make_choice("--preset", ["minutes", "hours"], "How long."),
    click.Option(["--start"], metavar="WEIGHTS", help="Weights to begin with, instead of random ones."),
    click.Option(["--without"], multiple=True, metavar="FAMILY", help="A family of the prior that is left out."),
    _make_choice("--device", ["cpu", "cuda"], "Where it learns."),
)


@click.command(name="check-detector", short_help="Test that a detector keeps the contract.")
@click.argument("name", metavar="NAME", shell_complete=complete_names)
@click.option("--expect", "expected", multiple=True, metavar="CHECK=REASON", help="A check that fails, and the reason.")
@click.pass_context
def check_detector(ctx: click.Context, name: str, expected: tuple[str, ...]) -> None:
    """Test that a detector keeps the contract of usnet_env detectors.

    NAME is a detector's name, with or without arguments, or module:Class. The exit status is 1 if a check fails.
    """
    from joblib.externals.loky import get_reusable_executor
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    from usnet_env.evaluation.tasks import become_worker

    reasons = {check.strip(): reason.strip() for check, _, reason in (text.partition("=") for text in expected)}
    environment = {"PYTHONFAULTHANDLER": os.environ.get("USNET_TRACEBACK", "")}  # the line of a crash
    executor = get_reusable_executor(max_workers=1, initializer=become_worker, env=environment)
    try:
        table, failures, failed = executor.submit(_run_checks, name, reasons).result()
    except TerminatedWorkerError as error:
        status = str(error).rpartition("{")[2].rpartition("}")[0]
        raise ArgumentError(f"detector {quote(name)} ended the process of its checks: {status}.") from None
    finally:
        executor.shutdown(kill_workers=True)
    click.echo(table)
    if os.environ.get("USNET_TRACEBACK"):
        click.echo(failures, err=True)
    ctx.exit(int(failed))


def _run_checks(name: str, reasons: dict[str, str]) -> tuple[str, str, bool]:
    """The results of a detector's checks as a table, the tracebacks of what failed, and whether any did."""
    from detectors import checks

    try:
        results, failed = checks.check_detector(name, expected_failed_checks=reasons), False
    except checks.DetectorChecksError as error:
        results, failed = error.results, True
    failures = [line for result in results if result.error for line in traceback.format_exception(result.error)]
    return checks.results_table(results), "".join(failures), failed

"""The command line: ``usnet evaluate``, ``usnet demo`` and ``usnet list``.

No traceback reaches the user: whatever is refused or fails is one sentence on standard error. Everything heavy is
imported by the command that needs it, so that ``usnet --help`` answers at once.
"""

from __future__ import annotations

import json
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from usnet_env.config import InvalidArgument, shown

if TYPE_CHECKING:
    from usnet_env.evaluation import EvaluationResult

__all__ = ["main"]

_REFUSED, _FAILED, _INTERRUPTED = 2, 1, 130
_PIPE_WIDTH = 400  # columns where standard output is no terminal: nothing need be cut or folded
_EXPONENT = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+")  # 1e-3 is a number to everybody but YAML 1.1


class _WholeNumber(click.ParamType):  # type: ignore[type-arg]  # generic in the newest click only
    """A whole number in a range, refused in one sentence."""

    name = "number"

    def __init__(self, least: int, most: int) -> None:
        self.least, self.most = least, most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """The number."""
        if isinstance(value, int):
            return value
        text = str(value).strip()
        if re.fullmatch(r"[-+]?[0-9]{1,30}", text) and self.least <= int(text) <= self.most:
            return int(text)
        option = param.opts[0] if param is not None else "value"
        raise InvalidArgument(f"{option} must be a whole number from {self.least} to {self.most}, got {shown(value)}.")


class _PairsCommand(click.Command):
    """Lets one ``--set`` take every word up to the next option."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Give each pair a ``--set`` of its own, which is what click understands."""
        spread: list[str] = []
        words, taking = iter(args), False
        for word in words:
            if word.startswith("-") or not taking:
                taking = word == "--set" or word.startswith("--set=")
                spread.append(word)
                if word == "--set":
                    following = next(words, None)
                    if following is None or following.startswith("--"):
                        raise InvalidArgument("--set must be followed by key=value pairs, got none.")
                    spread.append(following)
            else:
                spread += ["--set", word]
        return super().parse_args(ctx, spread)


def _yaml_value(key: str, text: str) -> Any:
    """A YAML scalar, or a list of them."""
    import yaml

    try:
        value = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        raise InvalidArgument(f"{key} must be a YAML value, got {shown(text)}.") from None
    if isinstance(value, str) and _EXPONENT.fullmatch(value):
        return float(value)
    for item in value if isinstance(value, list) else [value]:
        if item is not None and not isinstance(item, str | int | float):
            raise InvalidArgument(f"{key} must be a number, a name or a list of these, got {shown(text)}.")
    return value


def _pairs(words: Sequence[str]) -> dict[str, Any]:
    """``key=value`` words as a mapping."""
    values: dict[str, Any] = {}
    for word in words:
        key, equals, text = word.partition("=")
        key = key.strip()
        if not equals or not key:
            raise InvalidArgument(f"--set must be followed by key=value pairs, got {shown(word)}.")
        if key in values:
            raise InvalidArgument(f"--set must name each key once, got {key} twice.")
        values[key] = _yaml_value(key, text)
    return values


def _print(*things: Any) -> None:
    """Print to standard output by way of Rich."""
    from rich.console import Console

    console = Console()
    if not console.is_terminal:
        console = Console(width=_PIPE_WIDTH)
    for thing in things:
        console.print(thing)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="usnet", prog_name="usnet", message="%(prog)s %(version)s")
def _usnet() -> None:
    """Who leads this swarm? Environments, a referee and detectors for finding the cluster heads of a UAV swarm."""


@_usnet.command(cls=_PairsCommand)
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
@click.option("--episodes", type=_WholeNumber(1, 1_000_000), default=100, show_default=True, help="For each detector.")
@click.option("--seed", type=_WholeNumber(0, 2**63 - 1), default=0, show_default=True, help="Of the whole evaluation.")
@click.option("--workers", type=_WholeNumber(1, 256), default=1, show_default=True, help="Processes.")
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
    env_kwargs = _pairs(settings)
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
    width = console.width if console.is_terminal else _PIPE_WIDTH
    wide = console.options.update(max_width=10_000)
    columns: list[str] = []
    for name in METRICS:
        if columns and console.measure(result.table([*columns, name]), options=wide).maximum > width:
            _print(result.table(columns))
            columns = []
        columns.append(name)
    _print(result.table(columns))


@_usnet.command()
@click.option("--out", default="runs/demo", show_default=True, metavar="DIR", help="Where the files go.")
@click.option("--seed", type=_WholeNumber(0, 2**63 - 1), default=0, show_default=True, help="Of the episode.")
@click.option("--detector", metavar="NAME", help="Detector; by default the best one at hand.")
def demo(out: str, seed: int, detector: str | None) -> None:
    """Play one episode with 8 clusters and 185 UAVs, and keep a replay and a picture of it."""
    from usnet_env.replay.demo import run_demo

    if detector is None:
        run_demo(out, seed=seed)
    else:
        run_demo(out, seed=seed, detector=detector)


@_usnet.group()
def reproduce() -> None:
    """Reproduce a table or figure of the paper, its values beside ours."""


@reproduce.command()
@click.option("--out", default="runs/table2", show_default=True, metavar="DIR", help="Rows, table and picture go here.")
@click.option("--episodes", type=_WholeNumber(1, 1_000_000), help="A cell; by default 100 up to m=15 and 30 above.")
@click.option("--cells", metavar="LIST", help="Cells such as f1:2,f4:15 or rows such as f1; by default all 70.")
@click.option(
    "--preset",
    "presets",
    multiple=True,
    metavar="NAME",
    help="default, paper or lagged-regression; may repeat; by default all three.",
)
@click.option("--decoys", type=_WholeNumber(0, 1000), default=0, show_default=True, help="UAVs that lead nobody.")
@click.option("--mobility", default="iid", show_default=True, metavar="NAME", help="How the head flies.")
@click.option("--head-jitter", is_flag=True, help="The head has the followers' noise.")
@click.option("--fast", is_flag=True, help="10 episodes a cell, m up to 15: a look in minutes.")
@click.option("--seed", type=_WholeNumber(0, 2**31), default=2022, show_default=True, help="Of the episodes.")
@click.option("--workers", type=_WholeNumber(1, 256), help="Processes; by default one a core.")
@click.option(
    "--device", default="cpu", show_default=True, metavar="NAME", help="Where GASSL trains: cpu, cuda or auto."
)
@click.pass_context
def table2(
    ctx: click.Context,
    out: str,
    episodes: int | None,
    cells: str | None,
    presets: tuple[str, ...],
    decoys: int,
    mobility: str,
    head_jitter: bool,
    fast: bool,
    seed: int,
    workers: int | None,
    device: str,
) -> None:
    """Detection rates of GASSL: 7 follow strategies and 10 sizes of one cluster."""
    from pathlib import Path

    from rich.console import Console
    from rich.markdown import Markdown

    from usnet_env.reproduce import table2 as table

    ctx.find_root().obj = f"Finished episodes are kept in {out}: the same command goes on from there."
    if fast and cells is None:
        cells = ",".join(f"{follow}:{size}" for follow in table.FOLLOW for size in table.FOLLOWERS if size <= 15)
    with _bar("episodes") as progress:
        table.reproduce(
            Path(out),
            episodes=10 if fast and episodes is None else episodes,
            cells=cells,
            presets=presets or tuple(table.DETECTORS),
            decoys=decoys,
            mobility=mobility,
            head_jitter=head_jitter,
            seed=seed,
            workers=workers or os.cpu_count() or 1,
            device=device,
            progress=progress,
        )
    newest = max(Path(out).glob("*.md"), key=lambda path: path.stat().st_mtime)
    Console(width=_PIPE_WIDTH).print(Markdown(newest.read_text(encoding="utf-8")))
    click.echo(f"Rows, table and picture are in {out}.", err=True)


@reproduce.command()
@click.option("--out", default="runs/attention", show_default=True, metavar="DIR", help="The pictures go here.")
@click.option("--seed", type=_WholeNumber(0, 2**31), default=2022, show_default=True, help="Of the episodes.")
def attention(out: str, seed: int) -> None:
    """Heat maps of attention (f1 with m=15, f7 at six sizes) and the hierarchy graph."""
    from pathlib import Path

    from usnet_env.reproduce import attention as figures

    with _bar("fits") as progress:
        made = figures.reproduce(Path(out), seed, progress)
    for path in made:
        click.echo(str(path))


@reproduce.command()
@click.option(
    "--out", default="runs/purity", show_default=True, metavar="DIR", help="Rows, tables and picture go here."
)
@click.option("--episodes", type=_WholeNumber(1, 1_000_000), default=30, show_default=True, help="For each method.")
@click.option("--follow", multiple=True, metavar="NAME", help="Follow strategy; may repeat; by default f1 to f7.")
@click.option("--clusterer", "clusterers", multiple=True, metavar="NAME", help="May repeat; by default all.")
@click.option(
    "--features",
    multiple=True,
    metavar="NAME",
    help="raw, scaled, velocities, gru-single, gru-mean or gru-series; may repeat; by default all.",
)
@click.option("--count", "counts", multiple=True, metavar="NAME", help="M given or estimated; by default both.")
@click.option("--clusters", type=_WholeNumber(1, 1000), default=5, show_default=True, help="M.")
@click.option("--uavs", type=_WholeNumber(3, 10_000), default=82, show_default=True, help="N.")
@click.option("--mobility", default="iid", show_default=True, metavar="NAME", help="How the heads fly.")
@click.option("--head-jitter", is_flag=True, help="The heads have the followers' noise.")
@click.option("--seed", type=_WholeNumber(0, 2**31), default=2022, show_default=True, help="Of the episodes.")
@click.option("--workers", type=_WholeNumber(1, 256), help="Processes; by default one a core.")
@click.pass_context
def purity(
    ctx: click.Context,
    out: str,
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
    workers: int | None,
) -> None:
    """Purity and head-in-cluster of every clusterer, M given and estimated."""
    from pathlib import Path

    from rich.console import Console
    from rich.markdown import Markdown

    from usnet_env.reproduce import purity as figure
    from usnet_env.reproduce import purity_report

    ctx.find_root().obj = f"Finished windows are kept in {out}: the same command goes on from there."
    methods = figure.methods_of(clusterers or tuple(figure.CLUSTERERS), features or None, counts or figure.COUNTS)
    with _bar("windows") as progress:
        rows = figure.reproduce(
            Path(out),
            follow=follow or figure.FOLLOW,
            methods=methods,
            clusters=clusters,
            uavs=uavs,
            episodes=episodes,
            mobility=mobility,
            head_jitter=head_jitter,
            seed=seed,
            workers=workers or os.cpu_count() or 1,
            progress=progress,
        )
    Console(width=_PIPE_WIDTH).print(Markdown(purity_report.markdown(rows, "Purity and head-in-cluster")))
    click.echo(f"Rows, tables and picture are in {out}.", err=True)


@reproduce.command()
@click.option(
    "--out", default="runs/rounds", show_default=True, metavar="DIR", help="Rows, tables and picture go here."
)
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
@click.option(
    "--episodes", type=_WholeNumber(1, 1_000_000), default=30, show_default=True, help="A swarm and detector."
)
@click.option("--mobility", default="iid", show_default=True, metavar="NAME", help="How the heads fly.")
@click.option("--head-jitter", is_flag=True, help="The heads have the followers' noise.")
@click.option("--seed", type=_WholeNumber(0, 2**31), default=2022, show_default=True, help="Of the episodes.")
@click.option("--workers", type=_WholeNumber(1, 256), help="Processes; by default one a core.")
@click.pass_context
def rounds(
    ctx: click.Context,
    out: str,
    studies: tuple[str, ...],
    detectors: tuple[str, ...],
    no_trivial: bool,
    episodes: int,
    mobility: str,
    head_jitter: bool,
    seed: int,
    workers: int | None,
) -> None:
    """Rounds, redundancy and J_m of P2 against follow strategy, M and N, and one swarm round by round."""
    from pathlib import Path

    from rich.console import Console
    from rich.markdown import Markdown

    from usnet_env.reproduce import rounds as figure
    from usnet_env.reproduce import rounds_report

    ctx.find_root().obj = f"Finished episodes are kept in {out}: the same command goes on from there."
    with _bar("episodes") as progress:
        rows = figure.reproduce(
            Path(out),
            studies=studies or tuple(figure.STUDIES),
            detectors=detectors or figure.DETECTORS,
            trivial=not no_trivial,
            episodes=episodes,
            mobility=mobility,
            head_jitter=head_jitter,
            seed=seed,
            workers=workers or os.cpu_count() or 1,
            progress=progress,
        )
    with_paper = mobility == "iid" and not head_jitter
    text = rounds_report.markdown(rows, "P2 (all columns are in the file)", with_paper, rounds_report.SHORT)
    Console(width=_PIPE_WIDTH).print(Markdown(text))
    click.echo(f"Rows, tables and picture are in {out}.", err=True)


@reproduce.command(name="meta")
@click.option("--out", default="runs/meta-losses", show_default=True, metavar="DIR", help="What is made goes here.")
@click.option("--trainings", type=_WholeNumber(2, 1000), default=5, show_default=True, help="Seeds, for the bands.")
@click.option("--strategies", type=_WholeNumber(1, 10**6), default=30, show_default=True, help="F of each training.")
@click.option("--episodes", type=_WholeNumber(1, 10**6), default=1000, show_default=True, help="E of each training.")
@click.option("--seed", type=_WholeNumber(0, 2**31), default=2022, show_default=True, help="Of the measurement.")
@click.option("--workers", type=_WholeNumber(1, 256), help="Processes; by default one a core.")
@click.pass_context
def meta_losses(
    ctx: click.Context, out: str, trainings: int, strategies: int, episodes: int, seed: int, workers: int | None
) -> None:
    """Off-line loss, and on-line loss from meta-learned, jointly trained and random starts."""
    from pathlib import Path

    from rich.console import Console
    from rich.markdown import Markdown

    from usnet_env.reproduce import metric_learning

    ctx.find_root().obj = f"Finished trainings are kept in {out}: the same command goes on from there."
    with _bar("losses") as progress:
        rows = metric_learning.losses(
            Path(out),
            trainings=trainings,
            strategies=strategies,
            episodes=episodes,
            seed=seed,
            workers=workers or os.cpu_count() or 1,
            progress=progress,
        )
    Console(width=_PIPE_WIDTH).print(Markdown(metric_learning.markdown(rows)))
    click.echo(f"Rows, table and picture are in {out}.", err=True)


@reproduce.command()
@click.option("--out", default="runs/features", show_default=True, metavar="DIR", help="The pictures go here.")
@click.option("--follow", multiple=True, metavar="NAME", help="May repeat; by default f1 and f4.")
@click.option("--seed", type=_WholeNumber(0, 2**31), default=2022, show_default=True, help="Of the swarm.")
def features(out: str, follow: tuple[str, ...], seed: int) -> None:
    """The feature space of the GRU network before and after training."""
    from pathlib import Path

    from usnet_env.reproduce import metric_learning

    for name in follow or ("f1", "f4"):
        click.echo(str(metric_learning.features(Path(out), seed, name)))


@_usnet.group()
def train() -> None:
    """Make again what ships trained."""


@train.command()
@click.option("--out", default="runs/meta", show_default=True, metavar="DIR", help="Weights and losses go here.")
@click.option("--method", type=click.Choice(["meta", "joint"]), default="meta", show_default=True, help="The training.")
@click.option("--strategies", type=_WholeNumber(1, 10**7), default=100, show_default=True, help="F, drawn at random.")
@click.option("--episodes", type=_WholeNumber(1, 10**7), default=10_000, show_default=True, help="Of the training.")
@click.option("--seed", type=_WholeNumber(0, 2**31), default=0, show_default=True, help="Of the training.")
@click.option("--resume/--no-resume", default=True, show_default=True, help="Go on from a checkpoint in --out.")
def meta(out: str, method: str, strategies: int, episodes: int, seed: int, resume: bool) -> None:
    """The GRU network of MC-GASSL, off line, on random follow strategies (none of f1 to f7)."""
    from detectors.mc_gassl.train import MetaTraining, train_meta

    training = MetaTraining.model_validate(
        {"method": method, "strategies": strategies, "episodes": episodes, "seed": seed}
    )
    with _bar("strategies and episodes") as progress:
        click.echo(str(train_meta(out, training, progress, resume)))


@train.command()
@click.option("--out", default="runs/learned", show_default=True, metavar="DIR", help="Weights and losses go here.")
@click.option("--steps", type=_WholeNumber(1, 10**7), default=4000, show_default=True, help="Of the optimiser.")
@click.option("--swarms", type=_WholeNumber(1, 10**5), default=8, show_default=True, help="In each step.")
@click.option("--seed", type=_WholeNumber(0, 2**63 - 1), default=0, show_default=True, help="Of the training.")
@click.option("--resume/--no-resume", default=True, show_default=True, help="Go on from a checkpoint in --out.")
def learned(out: str, steps: int, swarms: int, seed: int, resume: bool) -> None:
    """The network of the learned detector, on random follow strategies (none of f1 to f7)."""
    from detectors.learned.train import HeadTraining, train_heads

    training = HeadTraining.model_validate({"steps": steps, "swarms": swarms, "seed": seed})
    with _bar("steps") as progress:
        click.echo(str(train_heads(out, training, progress, resume)))


@contextmanager
def _bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on standard error, as a function of what is done and of all there is to do."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@_usnet.command(name="check-detector")
@click.argument("name", metavar="NAME")
@click.option(
    "--expect",
    "expected",
    multiple=True,
    metavar="CHECK=REASON",
    help="A check that this detector can't pass, and why. May repeat.",
)
@click.option(
    "--seconds", type=float, default=10.0, show_default=True, metavar="S", help="Time budget of an answer for 82 UAVs."
)
@click.pass_context
def check_detector(ctx: click.Context, name: str, expected: tuple[str, ...], seconds: float) -> None:
    """Check that a detector (a name or module:Class) keeps the contract; status 1 if it does not."""
    reasons: dict[str, str] = {}
    for word in expected:
        check, equals, reason = word.partition("=")
        if not equals:
            raise InvalidArgument(f"--expect must be written check=reason, got {shown(word)}.")
        reasons[check.strip()] = reason.strip()
    from detectors import checks
    from usnet_env.plugins import make_detector

    done: list[checks.CheckResult] = []
    with _bar("checks") as progress:

        def count(result: checks.CheckResult) -> None:
            done.append(result)
            progress(len(done), len(checks.CHECKS))

        checks.check_detector(
            make_detector(name), expected_failed_checks=reasons, seconds=seconds, on_fail=None, callback=count
        )
    _print(checks.results_table(done))
    ctx.exit(checks.exit_status(done))


@_usnet.command(name="list")
@click.argument("what", type=click.Choice(["envs", "detectors", "follow", "mobility"]))
def list_(what: str) -> None:
    """List what can be named: envs, detectors, follow strategies or mobilities."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, show_header=False, pad_edge=False)
    for name, about in _listing(what):
        table.add_row(Text(name), Text(about))
    _print(table)


def _listing(what: str) -> list[tuple[str, str]]:
    """Names, each with one line about it."""
    if what == "detectors":
        from usnet_env.plugins import describe_detectors

        return sorted(describe_detectors().items())
    if what == "follow":
        from usnet_env.swarm import follow_strategies

        control = ("none", "nobody follows: followers fly like heads (a control)")
        return [*((name, strategy.equation) for name, strategy in follow_strategies().items()), control]
    if what == "mobility":
        from usnet_env.swarm import mobilities

        return [(name, law.description) for name, law in mobilities().items()]
    from usnet_env.evaluation.environments import environment_about, usnet_ids

    return [(name, environment_about(name)) for name in usnet_ids()]


def _say(sentence: str) -> None:
    click.echo(f"usnet: {sentence}", err=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: the words after ``usnet``; by default those of this process.

    Returns:
        The exit status: 0, 1 if something failed, 2 if an argument was refused or a detector failed, 130 if it was
        interrupted.
    """
    if "" not in sys.path and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())  # a console script does not look there, but module:Class often lies there
    try:
        with _usnet.make_context("usnet", list(sys.argv[1:] if argv is None else argv)) as context:
            try:
                _usnet.invoke(context)
                sys.stdout.flush()
            except (KeyboardInterrupt, EOFError):
                _say(f"interrupted. {context.obj or ''}".rstrip())
                return _INTERRUPTED
        return 0
    except click.exceptions.Exit as end:
        return int(end.exit_code)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        return _REFUSED
    except click.ClickException as error:
        _say(" ".join(error.format_message().split()).rstrip(".") + ".")
        return _REFUSED
    except KeyboardInterrupt:
        _say("interrupted.")
        return _INTERRUPTED
    except BrokenPipeError:  # the reader of our output has gone, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _FAILED
    except InvalidArgument as error:
        _say(str(error))
        return _REFUSED
    except Exception as error:
        return _failed(error)


def _failed(error: Exception) -> int:
    """What is left: a detector that failed, files that cannot be written, and what should not happen at all."""
    if os.environ.get("USNET_TRACEBACK"):
        traceback.print_exception(error)
    if type(error).__name__ == "EvaluationError":  # by name: its module is heavy, and may not have been imported
        _say(str(error))
        return _REFUSED
    if isinstance(error, OSError) and error.strerror:
        _say(f"cannot use {error.filename or 'a file'}: {error.strerror}.")
        return _FAILED
    if isinstance(error, MemoryError):
        _say("there is not enough memory for this; try fewer UAVs, observation steps or workers.")
        return _FAILED
    text = " ".join(str(error).split())
    _say(f"failed with {type(error).__name__}: {text.rstrip('.')}. USNET_TRACEBACK=1 shows where.")
    return _FAILED


if __name__ == "__main__":
    sys.exit(main())

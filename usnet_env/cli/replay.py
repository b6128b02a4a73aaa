"""``usnet demo``, ``replay``, ``compare`` and ``report``: play, keep and show episodes."""

from __future__ import annotations

import html
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click

from usnet_env.cli.options import WholeNumber
from usnet_env.cli.output import print_message, show
from usnet_env.config import ArgumentError, quote

if TYPE_CHECKING:
    from usnet_env.evaluation import EvaluationResult
    from usnet_env.evaluation.result import Results
    from usnet_env.processes import Limits
    from usnet_env.replay import EpisodeRecord

EPISODES = "episodes"  # the folder of the episode files of a run
_MOST_FAILURES, _MOST_ON_PAGE = 20, 6
_SAME = 1e-9  # of two values of a metric
_EVERY = re.compile(r"every=([1-9][0-9]{0,8})\Z")

_DEMO_EXAMPLES = """
\b
Examples:
  usnet demo --open
  usnet demo --detector learned --clusters 8 --uavs 185 --follow f1
  usnet demo --paper-example --out runs/paper
"""  # click reads the control characters: they keep the lines
_REPORT_EXAMPLES = """
\b
Examples:
  usnet report runs/mine
  usnet report runs/mine --compare learned --compare factions
  usnet report runs/mine --compare learned --metric exact
"""
_REPLAY_EXAMPLES = """
\b
Examples:
  usnet replay runs/demo/episode.npz --open
  usnet replay runs/mine                      (lists the episodes of a run)
  usnet replay runs/mine --episode 7 --animation game.gif
  usnet replay runs/demo --screenshot answer.png --round 1
"""


@click.command(short_help="Play one episode; save a replay, a page and pictures.", epilog=_DEMO_EXAMPLES)
@click.option("--out", default="runs/demo", show_default=True, metavar="DIR", help="Folder for the files.")
@click.option("--seed", type=WholeNumber(0, 2**63 - 1), help="Seed of the episode.  [default: 3]")
@click.option("--detector", metavar="NAME", help="Detector.  [default: lagged-correlation]")
@click.option("--follow", metavar="NAME", help="Strategy; see `usnet list follow`.  [default: f3]")
@click.option("--clusters", type=WholeNumber(1, 9_000), help="Number of clusters.  [default: 5]")
@click.option("--uavs", type=WholeNumber(3, 90_000), help="Number of UAVs.  [default: 60]")
@click.option("--paper-example", is_flag=True, help="Play the paper's example, 185 UAVs and mc-gassl; takes minutes.")
@click.option("--open", "open_viewer", is_flag=True, help="Open the replay in the Rerun viewer.")
def demo(out: str, seed: int | None, detector: str | None, paper_example: bool, open_viewer: bool, **game: Any) -> None:
    """Play one episode of USNET/MultiCluster-v0 with UAVs that fly smoothly, and keep it.

    The detector errs in round 1 and recovers. The folder gets an episode file, a replay, a page and a picture.
    """
    from usnet_env.replay.demo import run_demo
    from usnet_env.replay.rerun import open_replay

    given = {name: value for name, value in game.items() if value is not None}
    files = run_demo(out, seed=seed, detector=detector, paper_example=paper_example, **given)
    if open_viewer and "replay" in files:
        open_replay(files["replay"])


def _find_episodes(place: Path) -> list[Path]:
    """The episode files of a folder: its own, or those of a run."""
    for folder in (place, place / EPISODES):
        if found := sorted(folder.glob("*.npz"), key=lambda path: [int(n) for n in re.findall(r"\d+", path.stem)][-1:]):
            return found
    hint = "; `usnet evaluate --out DIR --record every=10` writes them."
    if _is_suite(place):
        hint = ", the folder of a suite, which has none; `usnet report` writes a page of its tables."
    raise ArgumentError(f"path must be an episode file or a folder with some, got {quote(str(place))}{hint}")


def _is_suite(place: Path) -> bool:
    """Whether a folder holds the runs of a suite."""
    return not (place / "run.json").exists() and any(place.glob("*/run.json"))


def _choose_episode(place: Path, episode: int | None) -> Path | None:
    """The episode file that was asked for; ``None`` if there are several."""
    if not place.is_dir():
        return place
    found = _find_episodes(place)
    if episode is not None:
        found = [path for path in found if re.search(rf"(?:\D|\A)0*{episode}\Z", path.stem)]
        if not found:
            raise ArgumentError(f"--episode must be the number of a recorded episode, got {episode}.")
    return found[0] if len(found) == 1 else None


def _screenshot_options(command: Callable[..., None]) -> Callable[..., None]:
    """Options of the commands that take a picture of a replay."""
    options = (
        click.option("--screenshot", metavar="PNG", help="Picture of the viewer to take; needs no screen."),
        click.option("--round", "number", type=WholeNumber(1, 10**6), help="Round of the screenshot.  [default: 1]"),
        click.option(
            "--step", type=WholeNumber(0, 10**9), help="Step of its window.  [default: when the answer is given]"
        ),
    )
    for option in reversed(options):
        command = option(command)
    return command


def _check_screenshot_options(screenshot: str | None, number: int | None, step: int | None) -> None:
    """Refuse a round or a step without a screenshot, and a screenshot that is no PNG."""
    if screenshot is None and (number, step) != (None, None):
        raise ArgumentError("--round and --step must be given together with --screenshot, got no --screenshot.")
    from usnet_env.replay.rerun import check_screenshot

    if screenshot is not None:
        check_screenshot(screenshot)


def _show_replay(written: Path, shown: tuple[str, float] | None, open_viewer: bool) -> None:
    """Say where a replay is; take its picture, and open it, if that was asked for."""
    from usnet_env.replay.rerun import find_viewer, open_replay, take_screenshot

    click.echo(f"replay     {written}" + ("" if open_viewer else f"  (open: {find_viewer()} {written})"))
    if shown is not None:
        click.echo(f"screenshot {take_screenshot([written], *shown)}")
    if open_viewer:
        open_replay(written)


@click.command(short_help="Show a recorded episode: replay, screenshot, animation.", epilog=_REPLAY_EXAMPLES)
@click.argument("path", type=click.Path(path_type=Path))
@click.option("--episode", type=WholeNumber(0, 10**9), help="Number of the episode in a folder of several.")
@click.option(
    "--rrd",
    type=click.Path(path_type=Path),
    help="Replay to write.  [default: beside the file; none if only --screenshot or --animation is given]",
)
@click.option("--open", "open_viewer", is_flag=True, help="Open the replay in the Rerun viewer.")
@_screenshot_options
@click.option("--animation", metavar="GIF|MP4", help="Animation to write, .gif or .mp4.")
def replay(
    path: Path,
    episode: int | None,
    rrd: Path | None,
    open_viewer: bool,
    screenshot: str | None,
    number: int | None,
    step: int | None,
    animation: str | None,
) -> None:
    """Show a recorded episode.

    PATH is an episode file (.npz), or the folder of a run or a demo. A folder with several episodes is listed, unless
    --episode chooses one.
    """
    _check_screenshot_options(screenshot, number, step)
    from usnet_env.replay import EpisodeRecord, animate, write_recording
    from usnet_env.replay.story import describe_outcome, describe_round, name_game
    from usnet_env.replay.rerun import find_time, take_screenshot

    file = _choose_episode(path, episode)
    if file is None:
        _list_episodes(_find_episodes(path))
        return
    record = EpisodeRecord.load(file)
    shown = None if screenshot is None else (screenshot, find_time(record, number or 1, step))
    click.echo(name_game(record))
    for each in range(1, record.rounds + 1):
        click.echo(f"  {each}: {describe_round(record, each)}")
    click.echo(describe_outcome(record))
    if animation is not None:
        click.echo(f"animation  {animate(record, animation)}")
    if rrd is not None or open_viewer or (animation is None and shown is None):
        _show_replay(write_recording(record, rrd or file.with_suffix(".rrd")), shown, open_viewer)
    elif shown is not None:  # the viewer needs a replay for its picture
        with TemporaryDirectory() as folder:
            written = write_recording(record, Path(folder, "episode.rrd"))
            click.echo(f"screenshot {take_screenshot([written], *shown)}")


def _list_episodes(files: Sequence[Path]) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from usnet_env.replay import EpisodeRecord
    from usnet_env.replay.story import name_score

    records = [EpisodeRecord.load(file) for file in files]
    scores = [name_score(record) for record in records]
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    names = " or ".join(dict.fromkeys(name for name, _ in scores))
    for name in ("file", "detector", "seed", "rounds", names, "heads left"):
        table.add_column(name, overflow="fold")
    for record, file, (_, value) in zip(records, files, scores, strict=True):
        score = ["–" if value is None else f"{value:.3f}", record.heads_left[-1] if record.labelled else "–"]
        numbers = ("–" if record.seed is None else record.seed, record.rounds, *score)
        table.add_row(str(file), record.detector, *map(str, numbers))
    show(table)


@click.command(short_help="Show two detectors on the same swarm, side by side.")
@click.argument("first", metavar="A.npz")
@click.argument("second", metavar="B.npz")
@click.option("--rrd", default="comparison.rrd", show_default=True, metavar="FILE", help="Replay to write.")
@click.option("--open", "open_viewer", is_flag=True, help="Open the replay in the Rerun viewer.")
@_screenshot_options
def compare(
    first: str,
    second: str,
    rrd: str,
    open_viewer: bool,
    screenshot: str | None,
    number: int | None,
    step: int | None,
) -> None:
    """Write one replay of two episode files that began with the same swarm."""
    _check_screenshot_options(screenshot, number, step)
    from usnet_env.replay import EpisodeRecord, write_comparison
    from usnet_env.replay.story import describe_outcome
    from usnet_env.replay.rerun import find_time

    one, other = EpisodeRecord.load(first), EpisodeRecord.load(second)
    longer = max(one, other, key=lambda record: record.rounds)
    shown = None if screenshot is None else (screenshot, find_time(longer, number or 1, step))
    written = write_comparison(one, other, rrd)
    for record in (one, other):
        click.echo(f"{record.detector}: {describe_outcome(record)}")
    _show_replay(written, shown, open_viewer)


@click.command(short_help="Write a page of a run or an episode for any browser.", epilog=_REPORT_EXAMPLES)
@click.argument("path", type=click.Path(path_type=Path))
@click.option("--html", "page", type=click.Path(path_type=Path), help="Page to write.  [default: PATH/report.html]")
@click.option(
    "--compare",
    "labels",
    multiple=True,
    metavar="LABEL",
    help="Compare this detector with the further ones, or with all, swarm by swarm. May be repeated.",
)
@click.option("--metric", metavar="NAME", help="What is compared.  [default: J]")
def report(path: Path, page: Path | None, labels: tuple[str, ...], metric: str | None) -> None:
    """Write one self-contained page: scores, and for each recorded episode an animation and its rounds.

    PATH is the folder of `usnet evaluate --out`, or of a demo, or an episode file. The page opens without a network.
    That of a suite has its tables. Comparisons are printed, too.
    """
    if metric is not None and not labels:
        raise ArgumentError("--metric must be given together with --compare, got no --compare.")
    from usnet_env.evaluation import EvaluationResult, SuiteResult
    from usnet_env.replay import EpisodeRecord
    from usnet_env.replay.page import write_page

    if path.is_dir() and _is_suite(path):
        suite = SuiteResult.load(path)
        tables = [suite._repr_html_(), *_compare_detectors(suite, labels, metric)]
        written = write_page(f"Detectors on {suite.label}", {}, page or path / "report.html", tables=tables)
        click.echo(f"page  {written}")
        return
    folder = path if path.is_dir() else path.parent
    result = EvaluationResult.load(path) if (path / "run.json").exists() else None
    if result is None and labels:
        raise ArgumentError(f"--compare must be given with the folder of a run or a suite, got {quote(str(path))}.")
    files = [path]
    if path.is_dir():
        files = _find_episodes(path) if result is None or (path / EPISODES).is_dir() else []
    page = page or folder / "report.html"
    records = {file.stem: EpisodeRecord.load(file) for file in files[:_MOST_ON_PAGE]}
    links = {file.stem: Path(os.path.relpath(file, page.parent)).as_posix() for file in files}
    tables = [] if result is None else [result._repr_html_(), *_compare_detectors(result, labels, metric)]
    title = "Who leads this swarm?" if result is None else f"Detectors on {result.config['env']}"
    click.echo(f"page  {write_page(title, records, page, links=links, tables=tables)}")
    if len(files) > _MOST_ON_PAGE:
        print_message(f"the page shows {_MOST_ON_PAGE} of {len(files)} recorded episodes.")


def _compare_detectors(result: Results, labels: Sequence[str], metric: str | None) -> list[str]:
    """Print the comparisons that were asked for, and return them as HTML."""
    if not labels:
        return []
    if len(set(labels)) < len(labels):
        raise ArgumentError(f"--compare must name each detector once, got {', '.join(labels)}.")
    found = result.compare(labels[0], list(labels[1:]) or None, metric or "J")
    if not found:
        raise ArgumentError(f"--compare must find another detector there, got {quote(labels[0])} alone.")
    for each in found:
        click.echo(f"{each}.")
    return [f"<p>{html.escape(str(each))}.</p>" for each in found]


def check_record_option(wanted: str, out: str | None) -> None:
    """Refuse a value of ``--record`` that is neither ``every=NUMBER`` nor ``worst``, or one without ``--out``."""
    if wanted != "worst" and not _EVERY.match(wanted):
        raise ArgumentError(f"--record must be every=NUMBER or worst, got {quote(wanted)}.")
    if out is None:
        raise ArgumentError("--record must be given together with --out, got no --out.")


def _choose_rows(result: EvaluationResult, wanted: str) -> list[dict[str, Any]]:
    """The rows whose episodes are recorded."""
    every = _EVERY.match(wanted)
    if every:
        return [row for row in result.rows if row["episode"] % int(every[1]) == 0]
    from usnet_env.evaluation.tables import first_metric

    chosen, metric = [], first_metric(result.summary)
    for entry in result.summary:
        rows = [row for row in result.rows if row["detector"] == entry["detector"] and not row["exact"]]
        chosen += sorted(rows, key=lambda row: (-metric.sign * row[metric.column], row["episode"]))[:_MOST_FAILURES]
    return chosen


def record_episodes(
    result: EvaluationResult,
    wanted: str,
    detectors: Sequence[str],
    env_kwargs: dict[str, Any],
    out: str,
    isolation: Limits | None = None,
) -> list[Path]:
    """Play chosen episodes of a run again, from the seeds in their rows, and write their episode files.

    An episode that differs from its row is not written: a message names its detector. What is wanted is ``"every=10"``
    or ``"worst"``: the 20 worst episodes of each detector whose round 1 was not exact. Detectors of an earlier command
    are not recorded. Those of an isolated run play in processes of their own here too, with the limits of isolation.
    """
    from usnet_env.evaluation.report import group_rows
    from usnet_env.plugins import detector_label

    players = {detector_label(each): each for each in (*detectors, *result.config["detectors"])}
    written = []
    for label, rows in group_rows(_choose_rows(result, wanted), lambda row: row["detector"]).items():
        name = re.sub(r"[^\w.=-]+", "_", label).strip("_")
        others: list[int] = []
        failed: dict[int, str] = {}
        for row, record in _play_again(result.config["env"], env_kwargs, players[label], label, rows, isolation):
            if isinstance(record, str):
                failed[row["episode"]] = record
            elif _differs(record, row):
                others.append(row["episode"])
            else:
                written.append(record.save(Path(out) / EPISODES / f"{name}-{row['episode']}.npz"))
        none = "No file of such an episode was written."
        if others:
            print_message(
                f"{label} answered {_name_episodes(others)} differently when played again: it is not deterministic, or "
                f"it reads something besides the window and its seed. {none}"
            )
        if failed:
            which, reason = _name_episodes(list(failed)), next(iter(failed.values()))
            print_message(f"{label} failed in {which} when played again, but not in the run: {reason}. {none}")
    return written


def _name_episodes(episodes: Sequence[int]) -> str:
    return f"episode {episodes[0]}" if len(episodes) == 1 else f"{len(episodes)} episodes, such as {episodes[0]},"


def _play_again(
    env_id: str,
    env_kwargs: dict[str, Any],
    player: str,
    label: str,
    rows: Sequence[dict[str, Any]],
    isolation: Limits | None,
) -> Iterator[tuple[dict[str, Any], EpisodeRecord | str]]:
    """Each row with the record of its episode; with the reason if an isolated detector failed in it this time."""
    import gymnasium as gym

    from usnet_env.evaluation.isolation import IsolatedAgent
    from usnet_env.plugins import make_detector
    from usnet_env.processes import PlainError, ProcessDied
    from usnet_env.replay import record_episode

    with ExitStack() as stack:
        alone = None if isolation is None else stack.enter_context(closing(IsolatedAgent(player, isolation)))
        for row in rows:
            detector: Any = make_detector(player) if alone is None else alone
            with closing(gym.make(env_id, **env_kwargs)) as env:
                try:
                    yield row, record_episode(env, detector, row["swarm_seed"], row["detector_seed"], label=label)
                except (ArgumentError, PlainError, ProcessDied) as error:
                    if alone is None:
                        raise
                    yield row, " ".join(str(error).split()).rstrip(".")


def _differs(record: EpisodeRecord, row: dict[str, Any]) -> bool:
    """Whether the record has another score than the row in any metric, except the seconds."""
    from usnet_env.evaluation.metrics import CLUSTER_METRICS, METRICS, record_metrics

    found = record_metrics(record)
    compared = [name for name in METRICS if name not in CLUSTER_METRICS and name != "seconds_per_round"]
    return any(abs(float(found[name] or 0) - float(row[name])) > _SAME for name in compared)

"""``usnet demo``, ``replay``, ``compare`` and ``report``: play, keep and show episodes."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click

from usnet_env.cli.options import WholeNumber
from usnet_env.cli.output import show
from usnet_env.config import ArgumentError, quote

if TYPE_CHECKING:
    pass

EPISODES = "episodes"  # the folder of the episode files of a run

_DEMO_EXAMPLES = """
\b
Examples:
  usnet demo --open
  usnet demo --detector learned --clusters 8 --uavs 185 --follow f1
  usnet demo --paper-example --out runs/paper
"""  # click reads the control characters: they keep the lines
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
    from usnet_env.replay.viewer import open_replay

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
    from usnet_env.replay.viewer import check_screenshot

    if screenshot is not None:
        check_screenshot(screenshot)


def _show_replay(written: Path, shown: tuple[str, float] | None, open_viewer: bool) -> None:
    """Say where a replay is; take its picture, and open it, if that was asked for."""
    from usnet_env.replay.viewer import find_viewer, open_replay, take_screenshot

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
    from usnet_env.replay.viewer import find_time, take_screenshot

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
    from usnet_env.replay.viewer import find_time

    one, other = EpisodeRecord.load(first), EpisodeRecord.load(second)
    longer = max(one, other, key=lambda record: record.rounds)
    shown = None if screenshot is None else (screenshot, find_time(longer, number or 1, step))
    written = write_comparison(one, other, rrd)
    for record in (one, other):
        click.echo(f"{record.detector}: {describe_outcome(record)}")
    _show_replay(written, shown, open_viewer)

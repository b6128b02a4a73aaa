"""``usnet demo`` and ``usnet replay``: play and show episodes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usnet_env.cli.options import complete_names
from usnet_env.cli.output import show
from usnet_env.config import ArgumentError, printable, quote

if TYPE_CHECKING:
    from usnet_env.replay import EpisodeRecord

EPISODES = "episodes"  # the folder of the episode files of a run

_DEMO_EXAMPLES = """
\b
Examples:
  usnet demo --open
  usnet demo --detector reader --clusters 8 --uavs 185 --follow f1
"""  # click reads the control characters: they keep the lines
_REPLAY_EXAMPLES = """
\b
Examples:
  usnet replay runs/demo/episode.npz --open
  usnet replay runs/mine                      (lists the episodes of a run)
  usnet replay runs/mine --episode 7 --animation game.gif --page game.html
"""


@click.command(short_help="Play one episode; save a replay, a page and pictures.", epilog=_DEMO_EXAMPLES)
@click.option("--out", default="runs/demo", show_default=True, metavar="DIR", help="Folder for the files.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), metavar="N", help="Seed of the episode.  [default: 3]")
@click.option(
    "--detector", shell_complete=complete_names, metavar="NAME", help="Detector.  [default: lagged-correlation]"
)
@click.option(
    "--follow", shell_complete=complete_names, metavar="NAME", help="Strategy; see `usnet list follow`.  [default: f3]"
)
@click.option("--clusters", type=int, metavar="N", help="Number of clusters.  [default: 5]")
@click.option("--uavs", type=int, metavar="N", help="Number of UAVs.  [default: 60]")
@click.option("--open", "open_viewer", is_flag=True, help="Open the replay in the Rerun viewer.")
def demo(out: str, open_viewer: bool, **options: Any) -> None:
    """Play one episode of USNET/MultiCluster-v0 with UAVs that fly smoothly, and keep it.

    The detector errs in round 1 and recovers. The folder gets an episode file, a replay, a page and a picture.
    """
    from usnet_env.replay.demo import run_demo
    from usnet_env.replay.rerun import open_replay

    files = run_demo(out, **{name: value for name, value in options.items() if value is not None})
    if open_viewer and "replay" in files:
        open_replay(files["replay"])


@click.command(short_help="Show recorded episodes: replay, animation, page.", epilog=_REPLAY_EXAMPLES)
@click.argument("path", type=click.Path(path_type=Path))
@click.option("--episode", type=click.IntRange(0), metavar="N", help="Number of the episode in a folder of several.")
@click.option("--rrd", type=click.Path(path_type=Path), metavar="FILE", help="Replay.  [default: next to the file]")
@click.option("--open", "open_viewer", is_flag=True, help="Open the replay in the Rerun viewer.")
@click.option("--animation", metavar="GIF|MP4", help="Animation to write, .gif or .mp4.")
@click.option("--page", metavar="HTML", help="Page to write for any browser; it needs no network.")
@click.option("--figure", metavar="PNG|PDF", help="Picture to write, a map for each round.")
def replay(path: Path, episode: int | None, rrd: Path | None, open_viewer: bool, **files: str | None) -> None:
    """Show a recorded episode.

    PATH is an episode file (.npz), or the folder of a run or a demo. A folder with several episodes is listed, unless
    --episode chooses one.
    """
    from usnet_env.replay import EpisodeRecord, write_recording
    from usnet_env.replay.rerun import find_viewer, open_replay
    from usnet_env.replay.story import describe_outcome, describe_round, name_game

    episodes = _choose_episodes(path, episode)
    if len(episodes) > 1:
        _list_episodes(episodes)
        return
    record = EpisodeRecord.load(episodes[0])
    rounds = [f"  {number}: {describe_round(record, number)}" for number in range(1, record.rounds + 1)]
    lines = [name_game(record), *rounds, describe_outcome(record)]
    click.echo("\n".join(map(printable, lines)))  # a terminal would obey control characters of a file
    if _write_files(record, **files) and rrd is None and not open_viewer:
        return
    replay_path = write_recording(record, rrd or episodes[0].with_suffix(".rrd"))
    click.echo(f"replay     {replay_path}" + ("" if open_viewer else f"  (open: {find_viewer()} {replay_path})"))
    if open_viewer:
        open_replay(replay_path)


def _choose_episodes(path: Path, episode: int | None) -> list[Path]:
    """The episode files of a path: itself, or those of a folder or of a run; only that of a number if one is given."""
    if not path.is_dir():
        return [path]
    files = [*path.glob("*.npz")] or [*(path / EPISODES).glob("*.npz")]
    files.sort(key=lambda file: [int(n) for n in re.findall(r"\d+", file.stem)][-1:])
    if episode is not None:
        files = [file for file in files if re.search(rf"(?:\D|\A)0*{episode}\Z", file.stem)]
    if not files:
        number = "" if episode is None else f" of number {episode}"
        hint = "`usnet evaluate --out DIR --record every=10` writes such files"
        raise ArgumentError(f"path must be an episode file{number} or their folder, got {quote(str(path))}; {hint}.")
    return files


def _list_episodes(files: Sequence[Path]) -> None:
    from usnet_env.evaluation.tables import make_table
    from usnet_env.replay import EpisodeRecord
    from usnet_env.replay.story import name_score

    records = [EpisodeRecord.load(file) for file in files]
    rows = []
    for record, file in zip(records, files, strict=True):
        cells = ("{} {:.3f}".format(*name_score(record)), record.heads_left[-1]) if record.labelled else ("–", "–")
        rows.append((file, record.detector, "–" if record.seed is None else record.seed, record.rounds, *cells))
    header = ("file", "detector", "seed", "rounds", "score", "heads left")
    show(make_table(f"{len(files)} episodes", header, rows, words=True))


def _write_files(record: EpisodeRecord, animation: str | None, page: str | None, figure: str | None) -> bool:
    """Write what was asked for besides a replay, and say where it is; whether anything was."""
    from usnet_env.replay import animate, write_picture
    from usnet_env.replay.page import write_page

    writers = {"animation": (animate, animation), "page": (write_page, page), "figure": (write_picture, figure)}
    for name, (write, path) in writers.items():
        if path is not None:
            click.echo(f"{name:<9}  {write(record, path)}")
    return (animation, page, figure) != (None, None, None)

"""``usnet detect``: find the leaders in recorded tracks."""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from usnet_env.cli.options import PositiveNumber, WholeNumber, complete_names
from usnet_env.cli.output import print_message, show
from usnet_env.config import ArgumentError, MissingExtraError, printable, quote
from usnet_env.files import as_path, replace_files, reserve_folder, write_text
from usnet_env.progress import progress_bar

if TYPE_CHECKING:
    from rich.table import Table

    from usnet_env.detection import Detection
    from usnet_env.replay import EpisodeRecord
    from usnet_env.tracks import DetectedWindow, FoundLeaders, Leader, Tracks, TrackWindow

    Kept = tuple[TrackWindow, Detection, DetectedWindow]

_DETECTOR = "reader(policy='map')"
_MOST_ROWS, _MOST_NAMES = 40, 6  # of a table that is printed; ids in a row
_OPTIONAL = ("episode.npz", "replay.rrd", "network.png", "delays.png", "timeline.png", "picture.png")  # files
_COLUMN = "Name of a column; without NAME, the role is left out. May be repeated."
_HEADER = "Names of the columns, with commas, of a file without them in row 1."
_LENGTH = "Unit of x, y and z; beside degrees of z.  [default: m]"
_DUPLICATES = "Of several places of an id at one time, keep one.  [default: error]"
_SIZE = "MiB to which a file of gzip, zip or NumPy may unpack."
_EXAMPLES = """
\b
Examples:
  usnet detect flock.csv
  usnet detect flock.csv --out runs/flock --record
  usnet detect ants.csv --column id=animal --time-unit 0.0333 --step 0.5 --json

\b
Roles for --column:
  id  t  frame  x  y  z  lon  lat  leader  confidence
"""  # click reads the control characters: they keep the lines


def _parse_columns(context: click.Context, option: click.Parameter, words: Sequence[str]) -> dict[str, str]:
    mapping = dict(word.split("=", 1) for word in words if "=" in word)
    if len(mapping) < len(words):
        raise click.BadParameter("must be written ROLE=NAME, with each role once.", context, option)
    return mapping


def _parse_names(context: click.Context, option: click.Parameter, words: str | None) -> list[str] | None:
    return None if words is None else [name.strip() for name in words.split(",")]


def _parse_place(context: click.Context, option: click.Parameter, words: str | None) -> tuple[float, ...] | None:
    try:
        place = None if words is None else tuple(map(float, words.split(",")))
    except ValueError:
        place = ()
    if place is not None and len(place) != 2:
        raise click.BadParameter("must be two numbers, such as 0,0.", context, option)
    return place


@click.command(short_help="Find the leaders in recorded tracks.", epilog=_EXAMPLES)
@click.argument("tracks", nargs=-1, required=True, metavar="TRACKS…")
@click.option(
    "--detector", default=_DETECTOR, show_default=True, shell_complete=complete_names, metavar="NAME",
    help="See `usnet list detectors`.",
)  # fmt: skip
@click.option("--window", type=WholeNumber(1, 10**6), help="Steps of a window.  [default: as many as fit, about 100]")
@click.option("--stride", type=WholeNumber(1, 10**9), help="Steps from window to window.  [default: --window]")
@click.option("--step", type=PositiveNumber(), help="Seconds of a step.  [default: chosen from the tracks]")
@click.option("--max-gap", type=PositiveNumber(), help="Longest gap in seconds that is interpolated.")
@click.option("--keep-spikes", is_flag=True, help="Keep single samples off the track, to which it jumps and back.")
@click.option("--format", metavar="NAME", help="See `usnet list format`.  [default: by suffix]")
@click.option("--column", "columns", multiple=True, callback=_parse_columns, metavar="ROLE=NAME", help=_COLUMN)
@click.option("--time-unit", type=PositiveNumber(), help="Seconds in one unit of the time column.  [default: guessed]")
@click.option("--columns", "header", callback=_parse_names, metavar="NAMES", help=_HEADER)
@click.option("--time-format", metavar="FORMAT", help="Of timestamps, such as '%d/%m/%Y %H:%M:%S'.")
@click.option("--length-unit", type=click.Choice(["m", "cm", "mm", "km", "ft", "px"]), help=_LENGTH)
@click.option("--duplicates", type=click.Choice(["error", "first", "mean"]), default="error", help=_DUPLICATES)
@click.option("--skip-missing", "missing", flag_value="skip", default="refuse", help="Skip rows that can't be read.")
@click.option("--missing", "missing_place", callback=_parse_place, metavar="X,Y", help="A place that means none.")
@click.option("--min-confidence", type=float, help="Skip rows with a smaller confidence, likelihood or score.")
@click.option("--split-gap", type=PositiveNumber(), help="Seconds; after a longer gap, an id is another one.")
@click.option("--pool", is_flag=True, help="Files are recordings of the same ids, each with its own time.")
@click.option("--max-size", type=PositiveNumber(), default=256, show_default=True, help=_SIZE)
@click.option("--encoding", default="utf-8", show_default=True, metavar="NAME", help="Encoding of a CSV file.")
@click.option("--decimal", type=click.Choice([".", ","]), default=".", help="Decimal sign of a CSV file.  [default: .]")
@click.option("--seed", type=WholeNumber(0, 2**63 - 1), default=0, show_default=True, help="Seed of the detector.")
@click.option("--unconfirmed", is_flag=True, help="Also name leaders whose followers don't move like them later.")
@click.option("--out", metavar="DIR", help="Folder for a page, tables, JSON and pictures.")
@click.option("--record", is_flag=True, help="Also write an episode file and a replay; needs --out.")
@click.option("--windows", "by_windows", is_flag=True, help="Also print the leaders of each window.")
@click.option("--json", "as_json", is_flag=True, help="Print only the leaders, as JSON.")
def detect(
    tracks: tuple[str, ...],
    detector: str,
    window: int | None,
    stride: int | None,
    step: float | None,
    max_gap: float | None,
    keep_spikes: bool,
    seed: int,
    unconfirmed: bool,
    out: str | None,
    record: bool,
    by_windows: bool,
    as_json: bool,
    **reading: Any,
) -> None:
    """Find the leaders in recorded tracks: their followers, times, probabilities and reasons.

    TRACKS is a CSV file with the columns id, t (or frame), x, y and optionally z, or lon and lat in degrees; or a file
    of another format, such as Parquet, GPX, SLEAP, DeepLabCut, ULog or ROS bags. Several files are read as one.
    """
    from usnet_env.detection import read_tags
    from usnet_env.plugins import make_detector
    from usnet_env.tracks import find_leaders, read_tracks
    from usnet_env.tracks.confirm import LEAST_STEPS
    from usnet_env.tracks.page import write_page

    if record and out is None:
        raise click.UsageError("--record needs --out.")
    folder = None if out is None else as_path("out", out)
    read = read_tracks(list(tracks), **reading)
    report = read.report()
    player = make_detector(detector)
    if read_tags(player).false_leaders and not unconfirmed:
        what = f"got {quote(detector)}, which names some in more than 5 % of the windows of tracks without one"
        raise ArgumentError(f"detector must confirm few false leaders, {what} (--unconfirmed takes it).")
    for sentence in report.warnings:
        print_message(f"warning: {sentence}")
    even = read.resample(step, max_gap=max_gap, keep_spikes=keep_spikes, length=window or 0)
    facts = [*report.facts, *even.notes[len(read.notes) :]]
    window = even.choose_length() if window is None else window
    if window < LEAST_STEPS and not unconfirmed:
        facts.append(f"Windows of fewer than {LEAST_STEPS} steps are too short for the test that confirms leaders.")
    if folder is not None:
        reserve_folder(folder)
    kept: list[Kept] = []
    with progress_bar("windows") as progress:

        def keep(*answered: Any) -> None:
            kept.append(answered)
            progress(len(kept), even.count_windows(window, stride or window))

        options: Any = {"length": window, "stride": stride, "seed": seed, "confirm": not unconfirmed}
        found = find_leaders(even, player, on_window=keep, **options)
    if not unconfirmed and all(answer.leader is None and answer.clusters is None for _, answer, _ in kept):
        print_message("the detector names no followers, so no leader is confirmed; --unconfirmed lists its candidates.")
    content = json.dumps(found.as_dict(), indent=2, allow_nan=False)
    if as_json:
        click.echo(content)
    else:
        over_file, by_window = _tables(found)
        show(over_file)
        events = [printable(str(event)) for event in (*found.confounds, *found.events)]
        if len(events) > _MOST_ROWS:
            events[_MOST_ROWS:] = [f"{len(events) - _MOST_ROWS} more changes; --out DIR writes all windows."]
        click.echo("\n".join(["", *events]))
        if by_windows:
            show(by_window)
        click.echo("\n".join(map(printable, ["", *facts])))
    if folder is not None:
        title = ", ".join(Path(name).name for name in tracks)
        episode = _make_record(even, kept, title, found.detector, seed) if record else None
        with replace_files(folder, _OPTIONAL) as aside:
            write_text(aside / "leaders.json", content + "\n")
            _write_files(aside, found, episode, ([cut for cut, _, _ in kept], title, even))
            write_page(found, aside / "page.html", title, facts)
            names = ", ".join(sorted(path.name for path in aside.iterdir()))
        click.echo(f"{names} are in {folder}.", err=True)


def _tables(found: FoundLeaders) -> list[Table]:
    from usnet_env.tracks.leaders import CONFOUNDS

    rows: list[list[str]] = []
    for window in found.windows:
        alike = f"{_names(window.alike)} {CONFOUNDS[window.confound]}." if window.confound else ""
        cells = [_cells(leader) for leader in window.leaders] or [["none found", "", "", alike]]
        if window.not_confirmed:
            cells.append(["", "", "", f"Not confirmed: {_names(window.not_confirmed)}."])
        rows += [[str(window.start), str(window.end), *row] for row in cells]
    over_file = [[*_cells(leader), f"{leader.share or 0.0:.0%}"] for leader in found.leaders]
    headings = ["leader", "p", "followers", "why"]
    return [
        _make_table(f"Over the file, by {found.detector}", [*headings, "windows"], over_file or [["none found"]]),
        _make_table("Windows", ["from", "to", *headings], rows),
    ]


def _names(ids: Sequence[str | int]) -> str:
    more = f" and {len(ids) - _MOST_NAMES} more" if len(ids) > _MOST_NAMES else ""
    return ", ".join(map(str, ids[:_MOST_NAMES])) + more


def _cells(leader: Leader) -> list[str]:
    probability = "" if leader.probability is None else f"{leader.probability:.2f}"
    return [str(leader.id), probability, _names(leader.followers), leader.reason]


def _make_table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    from usnet_env.evaluation.tables import make_table

    table = make_table(title, headings, rows[:_MOST_ROWS], words=True)
    if len(rows) > _MOST_ROWS:
        table.caption = f"{len(rows) - _MOST_ROWS} more rows; --out DIR writes all of them."
    return table


def _write_files(folder: Path, found: FoundLeaders, episode: EpisodeRecord | None, drawn: tuple[Any, str, Any]) -> None:
    """Write tables, the episode and, where their extras are installed, a replay and a picture of ``drawn``."""
    from usnet_env.drawing import write_figure
    from usnet_env.replay import write_recording
    from usnet_env.tracks.picture import draw_leaders

    pictures = {"network.png": found.plot, "delays.png": found.plot_delays, "timeline.png": found.plot_timeline}
    pictures["picture.png"] = lambda: draw_leaders(found, *drawn)
    for name, table in found.tables().items():
        write_text(folder / f"{name}.csv", table.to_csv(index=False))
    writers: dict[str, Any] = {
        name: partial(lambda name, draw: write_figure(draw(), folder / name), name, draw)
        for name, draw in pictures.items()
    }
    if episode is not None:
        episode.save(folder / "episode.npz")
        writers["replay.rrd"] = lambda: write_recording(episode, folder / "replay.rrd")
    with warnings.catch_warnings(record=True, action="always") as caught:
        for name, write in writers.items():
            try:
                write()
            except MissingExtraError as error:
                print_message(f"{name} is left out. {error}")
    for message in dict.fromkeys(str(warning.message) for warning in caught):
        print_message(f"warning: {message}")


def _make_record(even: Tracks, kept: Sequence[Kept], title: str, detector: str, seed: int) -> EpisodeRecord:
    """The episode of all windows: a round for each, without truth, and without destroyed UAVs."""
    from usnet_env.provenance import versions
    from usnet_env.replay import EpisodeRecord

    rounds, ids, steps = len(kept), len(even.ids), kept[0][0].window.observation_steps
    arrays: dict[str, Any] = {
        "position": np.zeros((rounds, steps + 1, ids, 3)),
        "velocity": np.zeros((rounds, steps, ids, 3)),
        "seen": np.zeros((rounds, steps + 1, ids), bool),
        "scores": np.zeros((rounds, ids)),
        "root": np.full((rounds, ids), -1),
        "decoy": np.zeros(ids, bool),
        "alive": np.ones((rounds, ids), bool),
        "over_budget": np.ones(rounds, bool),
        **dict.fromkeys(("objective", "seconds"), np.zeros(rounds)),
    }
    if all("probability" in answer.extras for _, answer, _ in kept):
        arrays["probability"] = np.zeros((rounds, ids))
    reasons = []
    for r, (cut, answer, detected) in enumerate(kept):
        rows, window, behind = cut.rows, cut.window, detected.roots(cut.ids)
        place = np.where(window.seen[..., None], window.position + cut.origin, 0.0)
        for name, values in (("position", place), ("velocity", window.velocity), ("seen", window.seen)):
            arrays[name][r][:, rows] = values
        arrays["scores"][r, rows] = answer.scores
        if "probability" in arrays:
            arrays["probability"][r, rows] = answer.extras["probability"]
        arrays["root"][r, rows] = np.where(behind >= 0, rows[behind], -1)
        reasons.append({str(rows[cut.ids.index(leader.id)]): leader.reason for leader in detected.leaders})
    candidates = arrays["root"] == np.arange(ids)  # confirmed ones only
    arrays |= {"candidates": candidates, "head": candidates.any(axis=0), "leader_estimate": arrays["root"]}
    config = {"ids": [*even.ids], "step": even.step, "frame": even.frame, "origin": even.origin.tolist()}
    config |= {end: [getattr(found, end) for _, _, found in kept] for end in ("start", "end")}
    about: Any = {"env_id": title, "detector": detector, "detector_seed": seed, "config": config, "reasons": reasons}
    return EpisodeRecord(**arrays, **about, versions=versions(), labelled=False)

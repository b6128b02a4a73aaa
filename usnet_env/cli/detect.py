"""``usnet detect``: find the leaders in recorded tracks."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usnet_env.cli.options import PositiveNumber, WholeNumber, complete_names
from usnet_env.cli.output import print_message, print_warnings, show
from usnet_env.config import ArgumentError, list_names, printable
from usnet_env.files import as_path, reserve_folder
from usnet_env.progress import progress_bar

if TYPE_CHECKING:
    from usnet_env.detection import Detection
    from usnet_env.tracks import DetectedWindow, FoundLeaders, Leader, TrackWindow

_DETECTOR = "reader(policy='map')"
_MAX_ROWS, _MAX_NAMES = 40, 6  # of a table that is printed; ids in a row
_COLUMN = "Name of a column; without NAME, the role is left out. May be repeated."
_HEADER = "Names of the columns, with commas, of a file without them in row 1."
_LENGTH = "Unit of x, y and z; of z only if positions are degrees.  [default: m]"
_DUPLICATES = "Which one to keep of several positions of an id at one time.  [default: error]"
_FOLLOW = "Read lines of a CSV from standard input, TRACKS -, as they come, and print what changes; needs --step."
_SIZE = "MiB to which a file of gzip, zip or NumPy may unpack."
_EXAMPLES = """
\b
Examples:
  usnet detect flock.csv
  usnet detect flock.csv --out runs/flock --record
  tracker | usnet detect - --follow --step 1
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


def _parse_position(context: click.Context, option: click.Parameter, words: str | None) -> tuple[float, ...] | None:
    try:
        position = None if words is None else tuple(map(float, words.split(",")))
    except ValueError:
        position = ()
    if position is not None and len(position) != 2:
        raise click.BadParameter("must be two numbers, such as 0,0.", context, option)
    return position


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
@click.option("--missing", "missing_place", callback=_parse_position, metavar="X,Y", help="Position that means no fix.")
@click.option("--min-confidence", type=float, help="Skip rows with a smaller confidence, likelihood or score.")
@click.option("--split-gap", type=PositiveNumber(), help="Seconds; after a longer gap, the id counts as a new one.")
@click.option("--pool", is_flag=True, help="Files are recordings of the same ids, each with its own time.")
@click.option("--pool-by", metavar="NAME", help="Column, such as period, of the recordings in one file.")
@click.option("--max-size", type=PositiveNumber(), default=256, show_default=True, help=_SIZE)
@click.option("--encoding", default="utf-8", show_default=True, metavar="NAME", help="Encoding of a CSV file.")
@click.option("--decimal", type=click.Choice([".", ","]), default=".", help="Decimal sign of a CSV file.  [default: .]")
@click.option("--seed", type=WholeNumber(0, 2**63 - 1), default=0, show_default=True, help="Seed of the detector.")
@click.option("--unconfirmed", is_flag=True, help="Also name leaders whose followers don't move like them later.")
@click.option("--out", metavar="DIR", help="Folder for a page, tables, JSON and pictures.")
@click.option("--open", "open_page", is_flag=True, help="Show the page in the browser; needs --out.")
@click.option("--record", is_flag=True, help="Also write an episode file and a replay; needs --out.")
@click.option("--follow", is_flag=True, help=_FOLLOW)
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
    open_page: bool,
    record: bool,
    follow: bool,
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

    if follow:
        options = {name: value for name, value in {"window": window, "stride": stride}.items() if value is not None}
        _follow_stream(tracks, reading, step=step, detector=detector, seed=seed, **options)
        return
    if (record or open_page) and out is None:
        raise click.UsageError(f"--{'record' if record else 'open'} needs --out.")
    folder = None if out is None else as_path("out", out)
    file_tracks = read_tracks(list(tracks), **reading)
    warnings_of_file = file_tracks.report().warnings
    player = make_detector(detector)
    if read_tags(player).false_leaders and not unconfirmed:
        fault = "names too many false leaders in tracks (in more than 5 % of the windows without a leader)"
        raise ArgumentError(f"{printable(detector)} {fault}; --unconfirmed uses it anyway.")
    for sentence in warnings_of_file:
        print_message(f"warning: {sentence}")
    resampled = file_tracks.resample(step, max_gap=max_gap, keep_spikes=keep_spikes, length=window or 0)
    for sentence in resampled.doubts[len(file_tracks.doubts) :]:
        print_message(f"warning: {sentence}")
    window = resampled.choose_length() if window is None else window
    if folder is not None:
        reserve_folder(folder)
    has_followers: list[bool] = []
    with progress_bar("windows") as progress:

        def count_window(_: TrackWindow, answer: Detection, __: DetectedWindow) -> None:
            has_followers.append(answer.leader is not None or answer.clusters is not None)
            progress(len(has_followers), resampled.count_windows(window, stride or window))

        settings: Any = {"length": window, "stride": stride, "seed": seed, "confirm": not unconfirmed}
        found = find_leaders(resampled, player, on_window=count_window, **settings)
    if not unconfirmed and not any(has_followers):
        print_message("the detector names no followers, so no leader is confirmed; --unconfirmed lists its candidates.")
    if as_json:
        click.echo(json.dumps(found.as_dict(), indent=2, allow_nan=False))
    else:
        _print_leaders(found, by_windows)
    if folder is not None:
        with print_warnings():
            files = found.write(folder, ", ".join(Path(name).name for name in tracks), record=record)
        click.echo(f"{', '.join(file.name for file in files)} are in {folder}.", err=True)
    if folder is not None and open_page:
        click.launch(str(folder / "page.html"))


def _follow_stream(tracks: tuple[str, ...], reading: dict[str, Any], **options: Any) -> None:
    """Print what changes in the tracks of standard input while they come."""
    from usnet_env.tracks import LeaderTracker
    from usnet_env.tracks.read import read_stream

    if tracks != ("-",) or options["step"] is None:
        raise click.UsageError("--follow needs --step, and - for TRACKS.")
    tracker = LeaderTracker(**options)
    for time, position, ids, clock in read_stream(sys.stdin.buffer, **reading):
        for change in tracker.update(time, position, ids).changes:
            click.echo(printable(replace(change, time=clock.file_time(time))))


def _print_leaders(found: FoundLeaders, by_windows: bool) -> None:
    headings = ["leader", "p", "followers", "why"]
    summary = [[*_list_cells(leader), f"{leader.share or 0.0:.0%}"] for leader in found.leaders]
    none_found = "none in a whole window" if found.colors else "none found"
    _show_table(f"Over the file, by {found.detector}", [*headings, "windows"], summary or [[none_found]])
    events = [printable(event) for event in (*found.confounds, *found.events)]
    if len(events) > _MAX_ROWS:
        events[_MAX_ROWS:] = [f"{len(events) - _MAX_ROWS} more changes; --out DIR writes all windows."]
    click.echo("\n".join(["", *events]))
    if by_windows:
        rows = [[str(window.start), str(window.end), *row] for window in found.windows for row in _list_rows(window)]
        _show_table("Windows", ["from", "to", *headings], rows)
    click.echo("\n".join(map(printable, ["", *found.facts])))


def _list_rows(window: DetectedWindow) -> list[list[str]]:
    from usnet_env.tracks.found import CONFOUNDS

    confound = f"{list_names(window.alike, _MAX_NAMES)} {CONFOUNDS[window.confound]}." if window.confound else ""
    rows = [_list_cells(leader) for leader in window.leaders] or [["none found", "", "", confound]]
    if window.not_confirmed:
        rows.append(["", "", "", f"Not confirmed: {list_names(window.not_confirmed, _MAX_NAMES)}."])
    return rows


def _list_cells(leader: Leader) -> list[str]:
    probability = "" if leader.probability is None else f"{leader.probability:.2f}"
    return [str(leader.id), probability, list_names(leader.followers, _MAX_NAMES), leader.reason]


def _show_table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from usnet_env.evaluation.tables import make_table

    table = make_table(title, headings, rows[:_MAX_ROWS], words=True)
    if len(rows) > _MAX_ROWS:
        table.caption = f"{len(rows) - _MAX_ROWS} more rows; --out DIR writes all of them."
    show(table)

"""``usnet detect``: find the leaders in recorded tracks."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from usnet_env.cli.options import PositiveNumber, WholeNumber
from usnet_env.cli.output import print_message, show
from usnet_env.config import ArgumentError, quote
from usnet_env.progress import progress_bar

if TYPE_CHECKING:
    from rich.table import Table

    from usnet_env.arrays import Floats
    from usnet_env.detection import Detection
    from usnet_env.replay import EpisodeRecord
    from usnet_env.tracks import DetectedWindow, FoundLeaders, Leader, Tracks, TrackWindow

    Kept = tuple[TrackWindow, Floats, DetectedWindow]  # with the scores of the answer
    Map = tuple[TrackWindow, Any, DetectedWindow]  # with the leader of each id

_DETECTOR = "follow-mixture(policy='map')"
_MOST_ROWS, _MOST_NAMES = 40, 6  # of a table that is printed; ids in a row
_LARGEST_RECORD = 2**30  # bytes of an episode file before compression

_OPTIONS = {  # patterns of arguments in errors, and the options that set them
    r"\(stride=(?=\d)": "(--stride ",
    r"\(length=(?=\d)": "(--window ",
    r"^(stride|step|encoding|out) must": r"--\1 must",
    r"^length must": "--window must",
    r"^columns must": "--column must",
    r"""columns={'(\w+)': ('[^']*'|"[^"]*")}""": r"--column \1=\2",
    r"^time_unit must be None": "--time-unit must be left out",
    r"^(time|max)_(unit|gap|bytes) must": r"--\1-\2 must",
    r"keep_spikes=True ": "--keep-spikes ",
    r"missing='skip'": "--skip-missing is given",
    r"encoding= ": "--encoding ",
    r"decimal=','": "--decimal ,",
    r"time_unit=( |(?=\d))": "--time-unit ",
}

_EXAMPLES = """
\b
Examples:
  usnet detect flock.csv
  usnet detect flock.csv --out runs/flock --record
  usnet detect ants.csv --column id=animal --time-unit 0.0333 --step 0.5 --json

\b
Roles for --column:
  id  t  frame  x  y  z  lon  lat  vx  vy  vz  leader
"""  # click reads the control characters: they keep the lines


def _name_options(command: Callable[..., None]) -> Callable[..., None]:
    """Write the names of the command's options in errors, in place of those of the functions' arguments."""

    @wraps(command)
    def called(**values: Any) -> None:
        try:
            command(**values)
        except ArgumentError as error:
            raise ArgumentError(_rename_arguments(str(error))) from None

    return called


def _rename_arguments(sentence: str) -> str:
    """Replace the names of the functions' arguments by those of the options."""
    for argument, option in _OPTIONS.items():
        sentence = re.sub(argument, option, sentence)
    return sentence


@click.command(short_help="Find the leaders in recorded tracks.", epilog=_EXAMPLES)
@click.argument("tracks", nargs=-1, required=True, metavar="TRACKS…")
@click.option(
    "--detector", default=_DETECTOR, show_default=True, metavar="NAME", help="Detector; see `usnet list detectors`."
)
@click.option("--window", type=WholeNumber(1, 10**6), default=100, show_default=True, help="Steps of a window.")
@click.option(
    "--stride",
    type=WholeNumber(1, 10**9),
    help="Steps from the start of a window to that of the next.  [default: --window]",
)
@click.option("--step", type=PositiveNumber(), help="Seconds of a step.  [default: chosen from the tracks]")
@click.option("--max-gap", type=PositiveNumber(), help="Longest gap in seconds that is interpolated.")
@click.option("--keep-spikes", is_flag=True, help="Keep single samples off the track, to which it jumps and back.")
@click.option(
    "--column",
    "columns",
    multiple=True,
    metavar="ROLE=NAME",
    help="Name of a column; without NAME, the role is left out. May be repeated.",
)
@click.option("--time-unit", type=PositiveNumber(), help="Seconds in one unit of the time column.  [default: 1]")
@click.option("--skip-missing", is_flag=True, help="Skip rows without a time, place or id.")
@click.option("--encoding", default="utf-8", show_default=True, metavar="NAME", help="Encoding of a CSV file.")
@click.option("--decimal", type=click.Choice([".", ","]), help="Decimal sign of a CSV file.  [default: as it says]")
@click.option("--max-bytes", type=WholeNumber(1, 2**60), help="Most bytes that a compressed file may expand to.")
@click.option("--seed", type=WholeNumber(0, 2**63 - 1), default=0, show_default=True, help="Seed of the detector.")
@click.option("--unconfirmed", is_flag=True, help="Also name leaders whose followers don't move like them later.")
@click.option("--out", metavar="DIR", help="Folder for tables, JSON and a picture.")
@click.option("--record", is_flag=True, help="Also write an episode file and a replay; needs --out.")
@click.option("--json", "as_json", is_flag=True, help="Print only the leaders, as JSON.")
@_name_options
def detect(
    tracks: tuple[str, ...],
    detector: str,
    window: int,
    stride: int | None,
    step: float | None,
    max_gap: float | None,
    keep_spikes: bool,
    columns: tuple[str, ...],
    skip_missing: bool,
    seed: int,
    unconfirmed: bool,
    out: str | None,
    record: bool,
    as_json: bool,
    **reading: Any,
) -> None:
    """Find the leaders in recorded tracks: their followers, times, probabilities and reasons.

    TRACKS is a CSV file with the columns id, t (or frame), x, y and optionally z, or lon and lat in degrees; or a
    Parquet, NPZ, Movebank, GPX or PX4 ULog file. Several files are read as one.
    """
    if record and out is None:
        raise ArgumentError("--record must be given together with --out, got no --out.")
    mapping = _parse_columns(columns)
    from usnet_env.files import as_path, reserve_folder
    from usnet_env.plugins import make_detector
    from usnet_env.tracks import find_leaders, read_tracks
    from usnet_env.tracks.confirming import LEAST_STEPS
    from usnet_env.tracks.windows import count_windows, describe_rest

    folder = None if out is None else as_path("out", out)
    if folder is not None:
        click.get_current_context().call_on_close(reserve_folder(folder, "leaders.json").release)
    player = make_detector(detector)
    with progress_bar("rows") as progress:
        read = read_tracks(
            list(tracks),
            columns=mapping,
            missing="skip" if skip_missing else "refuse",
            progress=lambda rows: progress(rows, rows),
            **reading,
        )
    report = read.report()
    for finding in report.warnings:
        print_message(f"warning: {_rename_arguments(finding.sentence)}")
    even = read.resample(step, max_gap=max_gap, keep_spikes=keep_spikes)
    chosen = list(even.notes[len(read.notes) :])
    del read
    stride = window if stride is None else stride
    count = count_windows(even, window, stride)
    chosen += describe_rest(even, window, stride)
    if window < LEAST_STEPS and not unconfirmed:
        chosen.append(f"Windows of fewer than {LEAST_STEPS} steps are too short for the test that confirms leaders.")
    if record:
        _check_record_size(even, count, window)
    kept: list[Kept] = []
    done, groups_given = 0, unconfirmed
    with progress_bar("windows") as progress:

        def keep(cut: TrackWindow, detection: Detection, found: DetectedWindow) -> None:
            nonlocal done, groups_given
            groups_given |= detection.leader is not None or detection.clusters is not None
            if record:
                kept.append((cut, detection.scores, found))
            done += 1
            progress(done, count)

        found = find_leaders(
            even, player, length=window, stride=stride, seed=seed, confirm=not unconfirmed, on_window=keep
        )
    if not groups_given:
        print_message("the detector names no followers, so no leader is confirmed; --unconfirmed lists its candidates.")
    if as_json:
        click.echo(json.dumps(found.as_dict(), indent=2, allow_nan=False))
    else:
        for sentence in (*report.facts, *chosen):
            click.echo(_rename_arguments(sentence))
        show(*_tables(found))
    if folder is not None:
        for name in ("picture.png", "episode.npz", "replay.rrd"):  # of an earlier run, which this one may not replace
            (folder / name).unlink(missing_ok=True)
        title = ", ".join(Path(each).name for each in tracks)
        _write_all(folder, found, _choose_maps(found, even.windows(window, stride)), even, title)
        if record:
            _write_record(folder, _make_record(even, kept, found, title, window, seed))


def _parse_columns(words: Sequence[str]) -> dict[str, str]:
    """Parse ``role=name`` words."""
    mapping: dict[str, str] = {}
    for word in words:
        role, equals, name = word.partition("=")
        if not equals or role in mapping:
            raise ArgumentError(f"--column must be written role=name, with each role once, got {quote(word)}.")
        mapping[role.strip()] = name
    return mapping


def _choose_maps(found: FoundLeaders, cuts: Iterable[TrackWindow]) -> list[Map]:
    """The windows of the picture: up to six, evenly spread, those with leaders first."""
    from usnet_env.tracks.picture import MOST_MAPS

    chosen: list[int] = []
    for led in (True, False):
        some = [place for place, window in enumerate(found.windows) if bool(window.leaders) == led]
        most = min(len(some), MOST_MAPS - len(chosen))
        chosen += [some[k] for k in np.unique(np.linspace(0, len(some) - 1, most).astype(int))]
    pairs = zip(cuts, found.windows, strict=True)
    return [(cut, _leaders_of(cut, window), window) for k, (cut, window) in enumerate(pairs) if k in chosen]


def _tables(found: FoundLeaders) -> list[Table]:
    """The tables of windows and of leaders over the file, with the first rows of long ones."""
    from usnet_env.tracks.leaders import find_date, format_time

    rows: list[list[Any]] = []
    date = find_date(found)
    for window in found.windows:
        when = [format_time(each, date) if date else each for each in (window.start, window.end)]
        for leader in window.leaders:
            rows.append([*when, *_cells(leader)])
            when = ["", ""]
        if window.not_confirmed or not window.leaders:
            named = ", ".join(map(str, window.not_confirmed[:_MOST_NAMES]))
            found_none = "" if window.leaders else "none found"
            rows.append([*when, found_none, "", "", f"Not confirmed: {named}." if named else ""])
    over_file = []
    for leader in found.leaders:
        name, *cells = _cells(leader)
        over_file.append([name, f"{leader.share or 0.0:.0%}", *cells])
    headings = ["leader", "p", "followers", "why"]
    return [
        _make_table(
            f"Windows{f' on {date} (UTC)' if date else ''}, by {found.detector}", ["from", "to", *headings], rows
        ),
        _make_table(
            "Over the file", ["leader", "windows", *headings[1:]], over_file or [["none found", "", "", "", ""]]
        ),
    ]


def _cells(leader: Leader) -> list[Any]:
    followers = ", ".join(map(str, leader.followers[:_MOST_NAMES]))
    if len(leader.followers) > _MOST_NAMES:
        followers += f" and {len(leader.followers) - _MOST_NAMES} more"
    sure = "" if leader.probability is None else f"{leader.probability:.2f}"
    return [leader.id, sure, followers, leader.reason]


def _make_table(title: str, headings: Sequence[str], rows: Sequence[Sequence[Any]]) -> Table:
    from rich.box import SIMPLE
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left", title_style="bold", box=SIMPLE, pad_edge=False)
    for heading in headings:
        table.add_column(heading, overflow="fold")
    for row in rows[:_MOST_ROWS]:
        table.add_row(*(Text(str(cell)) for cell in row))
    if len(rows) > _MOST_ROWS:
        table.caption = f"{len(rows) - _MOST_ROWS} more rows; --out DIR writes all of them."
    return table


def _write_all(folder: Path, found: FoundLeaders, maps: Sequence[Map], even: Tracks, title: str) -> None:
    """Write the tables, the JSON and the picture; a file whose extra is not installed is left out with a message."""
    from usnet_env.drawing import MissingExtraError, write_figure
    from usnet_env.files import atomic_write
    from usnet_env.tracks.leader_tables import write_tables
    from usnet_env.tracks.picture import draw_leaders

    write_tables(found, folder, even.ids)
    with atomic_write(folder / "leaders.json") as aside:
        aside.write_text(json.dumps(found.as_dict(), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    written = "Tables and JSON"
    try:
        figure = draw_leaders(found, maps, title, even)
    except MissingExtraError as missing:
        print_message(f"the picture is left out. {missing}")
    else:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            write_figure(figure, folder / "picture.png")
        for warning in caught:
            print_message(f"warning: {warning.message}")
        written = "Tables, JSON and picture"
    click.echo(f"{written} are in {folder}.", err=True)


def _leaders_of(cut: TrackWindow, window: DetectedWindow) -> Any:
    """``(N,)`` index of the leader of each id of a window; a leader has its own index, -1: none."""
    place = {each: i for i, each in enumerate(cut.ids)}
    leader = np.full(len(cut.ids), -1, np.int64)
    for each in window.leaders:
        leader[[place[follower] for follower in each.followers]] = place[each.id]
    for each in window.leaders:
        leader[place[each.id]] = place[each.id]
    return leader


def _check_record_size(even: Tracks, count: int, window: int) -> None:
    """Refuse an episode file whose arrays, one place for every id in every window, would fill the memory."""
    needed = count * (window + 1) * len(even.ids) * 25  # two float32 vectors and a flag
    if needed > _LARGEST_RECORD:
        raise ArgumentError(
            f"--record must need at most {_LARGEST_RECORD} bytes, got {needed} for {count} windows of {len(even.ids)} "
            "ids; a longer --stride makes fewer windows."
        )


def _write_record(folder: Path, record: EpisodeRecord) -> None:
    """Write an episode file and, if rerun-sdk is installed, a replay."""
    from usnet_env.drawing import MissingExtraError
    from usnet_env.replay import write_recording

    record.save(folder / "episode.npz")
    written = "Episode file is"
    try:
        write_recording(record, folder / "replay.rrd")
    except MissingExtraError as missing:
        print_message(f"the replay is left out. {missing}")
    else:
        written = "Episode file and replay are"
    click.echo(f"{written} in {folder}.", err=True)


def _make_record(
    even: Tracks, kept: Sequence[Kept], found: FoundLeaders, title: str, window: int, seed: int
) -> EpisodeRecord:
    """The episode of all windows: a round for each, without truth, and without destroyed UAVs."""
    from usnet_env.provenance import versions
    from usnet_env.replay import EpisodeRecord

    rounds, ids = len(kept), len(even.ids)
    position = np.zeros((rounds, window + 1, ids, 3), np.float32)
    velocity = np.zeros((rounds, window, ids, 3), np.float32)
    seen = np.zeros((rounds, window + 1, ids), bool)
    root, scores = np.full((rounds, ids), -1, np.int64), np.zeros((rounds, ids))
    candidates, reasons = np.zeros((rounds, ids), bool), []
    for r, (cut, answer, detected) in enumerate(kept):
        rows = cut.rows
        position[r][:, rows] = np.where(cut.window.seen[..., None], cut.window.position + cut.origin, 0.0)
        velocity[r][:, rows], seen[r][:, rows] = cut.window.velocity, cut.window.seen
        behind = _leaders_of(cut, detected)
        root[r, rows] = np.where(behind >= 0, rows[behind], -1)
        candidates[r, rows] = behind == np.arange(len(rows))  # confirmed ones only
        scores[r, rows] = answer
        place = {each: int(row) for each, row in zip(cut.ids, rows, strict=True)}
        reasons.append({str(place[each.id]): each.reason for each in detected.leaders})
    return EpisodeRecord(
        position=position,
        velocity=velocity,
        seen=seen,
        alive=np.ones((rounds, ids), bool),
        root=root,
        candidates=candidates,
        scores=scores,
        objective=np.zeros(rounds),
        head=np.asarray(candidates.any(axis=0)),
        decoy=np.zeros(ids, bool),
        over_budget=np.ones(rounds, bool),
        seconds=np.zeros(rounds),
        leader_estimate=root,
        reasons=reasons,
        env_id=title,
        detector=found.detector,
        detector_seed=seed,
        config={
            "ids": list(even.ids),
            "step": even.step,
            "frame": even.frame,
            "origin": even.origin.tolist(),
            "start": [each.start for each in found.windows],
            "end": [each.end for each in found.windows],
        },
        versions=versions(),
        labelled=False,
    )

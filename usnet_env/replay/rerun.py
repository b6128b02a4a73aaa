"""Rerun recordings with their layout: one of an episode, and one of two episodes that began with the same swarm."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np

from usnet_env.config import ArgumentError, MissingExtraError, how_to_install
from usnet_env.drawing import MOST_LINKED
from usnet_env.files import as_path, atomic_write
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.figure import find_least_side
from usnet_env.replay.recording import EpisodeWriter
from usnet_env.replay.story import explain_replay, name_round

if TYPE_CHECKING:
    import rerun.blueprint as rrb

_UNKNOWN, _BACKGROUND = [140, 148, 156], [16, 20, 24]


def _space(writer: EpisodeWriter, name: str, truth: bool) -> rrb.Spatial3DView:
    """A view of the swarm: the truth with the verdict, or what the detector sees, with its answer."""
    import rerun.blueprint as rrb

    rr, root = writer.rr, f"/{writer.root}"
    parts, overrides = ["swarm", "verdict", "observers"], {}
    if writer.record.uavs > MOST_LINKED:  # not shown at first; a person can turn them on
        links = ("world/swarm/links", "world/found/links")
        overrides = {f"{root}{path}": rrb.EntityBehavior(visible=False) for path in links}
    if not truth:
        parts = ["swarm/uavs", "swarm/tracks", "found", "observers"]
        alike = rr.Points3D.from_fields(colors=[_UNKNOWN], radii=[5.0 * writer.scale])
        tracks = rr.LineStrips3D.from_fields(colors=[[*_UNKNOWN, 110]])
        overrides |= {f"{root}world/swarm/uavs": alike, f"{root}world/swarm/tracks": tracks}
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=writer.span * np.array([0.0, -0.8, 0.9]),
        look_target=writer.span * np.array([0.0, -0.08, 0.0]),
        eye_up=[0.0, 0.0, 1.0],
    )
    return rrb.Spatial3DView(
        origin=root.rstrip("/") or "/",  # not the world itself, whose transform would have no effect
        contents=[f"{root}world/{part}/**" for part in parts],
        name=name,
        eye_controls=eye,
        background=_BACKGROUND,
        line_grid=False,
        overrides=overrides,  # type: ignore[arg-type]  # Dict is invariant
    )


def _arrange(writers: Sequence[EpisodeWriter], labels: Sequence[str]) -> rrb.Blueprint:
    """The layout: for each episode the swarm as it is seen and as it is, and beside them texts; below them charts."""
    import rerun.blueprint as rrb

    record, single = writers[0].record, len(writers) == 1
    columns: list[Any] = []
    charts: list[Any] = []
    start, end = writers[0].rr.TimeRangeBoundary.infinite(), writers[0].rr.TimeRangeBoundary.cursor_relative()
    past = writers[0].rr.VisibleTimeRange("time", start=start, end=end)  # curves don't show the future
    for writer, label in zip(writers, labels, strict=True):
        root, prefix = f"/{writer.root}", f"{label}: "
        spaces = [_space(writer, f"{prefix}the truth" if record.labelled else f"{prefix}tracks", truth=True)]
        if record.labelled:
            spaces.insert(0, _space(writer, f"{prefix}what it sees and answers", truth=False))
        told = rrb.TextDocumentView(origin=f"{root}this_round", name=f"{prefix}this {name_round(record).lower()}")
        columns += [*spaces, told] if single else [rrb.Vertical(*spaces, told)]
        charts.append(rrb.BarChartView(origin=f"{root}scores", name=f"{prefix}scores by index"))
        if single and record.attention is not None:
            charts.append(rrb.Spatial2DView(origin=f"{root}mind/attention", name="Attention of a UAV (row)"))
    for name in ("J", "heads_left") * (not record.recorded):
        paths = [f"/{writer.root}game/{name}" for writer in writers]
        view = rrb.TimeSeriesView(origin="/", contents=paths, name=name.replace("_", " "), time_ranges=[past])
        charts.append(view)
    about = rrb.TextDocumentView(origin="/about", name="What you see")
    above = rrb.Horizontal(*columns, about, column_shares=[4] * (len(columns) - single) + [2] * (1 + single))
    panel = rrb.TimePanel(state="collapsed", timeline="time", play_state="paused", loop_mode="off")
    return rrb.Blueprint(rrb.Vertical(above, rrb.Horizontal(*charts), row_shares=[3, 1.4]), panel, collapse_panels=True)


def _find_span(record: EpisodeRecord) -> float:
    """The side of the largest box around the UAVs of a round, metres."""
    known = [position[seen] for position, seen in zip(record.position, record.seen, strict=True) if seen.any()]
    return max([float(np.ptp(each, axis=0).max()) for each in known] + [find_least_side(record)])


def _write(records: Sequence[EpisodeRecord], path: str | os.PathLike[str]) -> Path:
    """Write one episode, or two side by side."""
    try:
        import rerun as rr
    except ImportError:
        raise MissingExtraError(f"Replays need rerun-sdk; {how_to_install('replay')}.") from None
    place, labels = as_path("path", path), [record.detector or "A detector" for record in records]
    if len(set(labels)) < len(labels):
        labels = [f"{letter} {label}" for letter, label in zip("AB", labels, strict=True)]
    name = str(uuid4())  # recordings with the same application id share one camera and one layout in the viewer
    stream = rr.RecordingStream(f"usnet {name}", recording_id=name)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    roots = [""] if len(records) == 1 else ["a/", "b/"]
    span = max(map(_find_span, records))  # one scale, so that all views show the swarm from the same place
    writers = [EpisodeWriter(record, stream, root, span) for record, root in zip(records, roots, strict=True)]
    with atomic_write(place) as aside:
        stream.save(aside, default_blueprint=_arrange(writers, labels))
        try:
            stream.send_recording_name(f"{' and '.join(labels)} on {records[0].env_id}, seed {records[0].seed}")
            about = rr.TextDocument(explain_replay(records, labels), media_type="text/markdown")
            stream.log("about", about, static=True)
            for writer in writers:
                writer.write()
        finally:
            stream.disconnect()  # writes the rest and closes the file
    return place


def write_recording(record: EpisodeRecord, path: str | os.PathLike[str]) -> Path:
    """Write an episode as a Rerun recording that contains its layout; the file appears whole. ``rerun PATH`` opens it.

    One view shows what the detector sees and answers, another one the truth and the verdict. The timelines are
    ``time``, seconds of the replay with a pause after each answer, destruction and re-merge; ``step``, see
    :func:`usnet_env.replay.recording.list_steps`; and ``round``.

    Raises:
        ArgumentError: the place can't be written to.
        MissingExtraError: rerun-sdk is not installed.
    """
    return _write([record], path)


def write_comparison(first: EpisodeRecord, second: EpisodeRecord, path: str | os.PathLike[str]) -> Path:
    """Write two episodes with the same first window side by side, with the errors of :func:`write_recording`."""
    if not np.array_equal(first.position[0], second.position[0]):
        raise ArgumentError("second must begin with the same swarm as first, got an episode with another first window.")
    return _write([first, second], path)


def find_viewer() -> str:
    """The command that opens a replay: ``rerun`` if the shell finds it, else the path of the one beside this Python."""
    beside = Path(sys.executable).with_name("rerun")
    return "rerun" if shutil.which("rerun") or not beside.exists() else os.path.relpath(beside)


def open_replay(path: Path) -> None:
    """Open a recording in the Rerun viewer, in a process that continues after this one and writes no output."""
    try:
        subprocess.Popen([find_viewer(), str(path)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    except FileNotFoundError:
        raise MissingExtraError(f"The viewer needs rerun-sdk; {how_to_install('replay')}.") from None

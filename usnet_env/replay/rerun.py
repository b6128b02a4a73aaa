"""The Rerun recording of an episode, with its layout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np

from usnet_env.config import MissingExtraError, how_to_install
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

    rr = writer.rr
    parts, overrides = ["swarm", "verdict", "observers"], {}
    if writer.record.uavs > MOST_LINKED:  # not shown at first; a person can turn them on
        overrides = {f"/world/{part}/links": rrb.EntityBehavior(visible=False) for part in ("swarm", "found")}
    if not truth:
        parts = ["swarm/uavs", "swarm/tracks", "found", "observers"]
        alike = rr.Points3D.from_fields(colors=[_UNKNOWN], radii=[5.0 * writer.scale])
        tracks = rr.LineStrips3D.from_fields(colors=[[*_UNKNOWN, 110]])
        overrides |= {"/world/swarm/uavs": alike, "/world/swarm/tracks": tracks}
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=writer.span * np.array([0.0, -0.8, 0.9]),
        look_target=writer.span * np.array([0.0, -0.08, 0.0]),
        eye_up=[0.0, 0.0, 1.0],
    )
    return rrb.Spatial3DView(
        origin="/",  # not the world itself, whose transform would have no effect
        contents=[f"/world/{part}/**" for part in parts],
        name=name,
        eye_controls=eye,
        background=_BACKGROUND,
        line_grid=False,
        overrides=overrides,  # type: ignore[arg-type]  # Dict is invariant
    )


def _arrange(writer: EpisodeWriter) -> rrb.Blueprint:
    """The layout: the swarm as it is seen and as it is, and beside them texts; below them charts."""
    import rerun.blueprint as rrb

    record, range_of = writer.record, writer.rr.TimeRangeBoundary
    past = writer.rr.VisibleTimeRange("time", start=range_of.infinite(), end=range_of.cursor_relative())
    views = [_space(writer, "the truth" if record.labelled else "tracks", truth=True)]
    if record.labelled:
        views.insert(0, _space(writer, "what it sees and answers", truth=False))
    told = rrb.TextDocumentView(origin="/this_round", name=f"this {name_round(record).lower()}")
    charts: list[Any] = [rrb.BarChartView(origin="/scores", name="scores by index")]
    if record.attention is not None:
        charts.append(rrb.Spatial2DView(origin="/mind/attention", name="Attention of a UAV (row)"))
    for name in ("J", "heads_left") * (not record.recorded):  # curves that don't show the future
        title, contents = name.replace("_", " "), [f"/game/{name}"]
        charts.append(rrb.TimeSeriesView(origin="/", contents=contents, name=title, time_ranges=[past]))
    about = rrb.TextDocumentView(origin="/about", name="What you see")
    above = rrb.Horizontal(*views, told, about, column_shares=[4] * len(views) + [2, 2])
    panel = rrb.TimePanel(state="collapsed", timeline="time", play_state="paused", loop_mode="off")
    return rrb.Blueprint(rrb.Vertical(above, rrb.Horizontal(*charts), row_shares=[3, 1.4]), panel, collapse_panels=True)


def _find_span(record: EpisodeRecord) -> float:
    """The side of the largest box around the UAVs of a round, metres."""
    known = [position[seen] for position, seen in zip(record.position, record.seen, strict=True) if seen.any()]
    return max([float(np.ptp(each, axis=0).max()) for each in known] + [find_least_side(record)])


def write_recording(record: EpisodeRecord, path: str | os.PathLike[str]) -> Path:
    """Write an episode as a Rerun recording that contains its layout; the file appears whole. ``rerun PATH`` opens it.

    One view shows what the detector sees and answers, another one the truth and the verdict. The timelines are
    ``time``, seconds of the replay with a pause after each answer, destruction and re-merge; ``step``, see
    :func:`usnet_env.replay.recording.list_steps`; and ``round``.

    Raises:
        ArgumentError: the place can't be written to.
        MissingExtraError: rerun-sdk is not installed.
    """
    try:
        import rerun as rr
    except ImportError:
        raise MissingExtraError(f"Replays need rerun-sdk; {how_to_install('replay')}.") from None
    place, label = as_path("path", path), record.detector or "A detector"
    name = str(uuid4())  # recordings with the same application id share one camera and one layout in the viewer
    stream = rr.RecordingStream(f"usnet {name}", recording_id=name)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    writer = EpisodeWriter(record, stream, _find_span(record))
    with atomic_write(place) as aside:
        stream.save(aside, default_blueprint=_arrange(writer))
        try:
            stream.send_recording_name(f"{label} on {record.env_id}, seed {record.seed}")
            stream.log("about", rr.TextDocument(explain_replay(record), media_type="text/markdown"), static=True)
            writer.write()
        finally:
            stream.disconnect()  # writes the rest and closes the file
    return place


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

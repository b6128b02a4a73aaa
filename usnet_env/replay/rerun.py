"""The Rerun recording of an episode: the swarm, the answers, what the detector thought, texts, curves and layout."""

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
from numpy.typing import NDArray

from usnet_env.arrays import Indices, Mask, Singles
from usnet_env.config import MissingExtraError, how_to_install, instance_of
from usnet_env.drawing import CLUSTER_COLORS, MOST_LINKED, NO_CLUSTER_COLOR, cluster_colors, last_seen_position
from usnet_env.files import as_path, atomic_write
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.figure import find_least_side
from usnet_env.replay.story import (
    HIT,
    LEADER,
    MISSED,
    OTHER,
    REDUNDANT,
    explain_replay,
    mark_words,
    name_round,
    name_uav,
    tell_round,
)

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

_UNKNOWN_COLOR, _BACKGROUND = [140, 148, 156], [16, 20, 24]
_WATCH_SECONDS, _PAUSE_SECONDS = 6.0, 2.0  # of the timeline "time": a window, and the pause after each beat
_STAGES, _MAX_POINTS = 12, 41  # how often the tracks of a window grow, and the most points of a track
_FOLLOWER_RADIUS, _HEAD_RADIUS, _MARK_RADIUS = 6.0, 14.0, 30.0  # metres: radii of a follower, of a head, and of a mark
_TYPICAL_SPAN = 800.0  # metres: a swarm may be smaller or larger, and all sizes with it
_MAX_LABELS = 16  # in a round with more marks, they have no labels
_MARKS = {HIT: 0x1ED9A0FF, LEADER: 0x1ED9A0FF, REDUNDANT: 0xFF7A1AFF, MISSED: 0xF5F5F5FF, OTHER: 0x6A6A6AFF}
_CANDIDATE, _DESTROYED, _OBSERVER, _DECOY = 0x35A7FFFF, 0x8A8A8AFF, 0x7CC7FFFF, "#FFE45C"
_INTRUDER = 0xFF7A1AFF
_SERIES = 0x56B4E9FF  # of the curves


def lighten(colors: Sequence[str] | NDArray[np.str_]) -> NDArray[np.uint8]:
    """Lighten colours ``"#RRGGBB"`` made for white paper for a dark view: ``(n, 4)`` uint8."""
    paper = np.array([[*bytes.fromhex(str(color)[1:])] for color in colors], np.float64).reshape(-1, 3)
    return np.insert(90 + 0.65 * paper, 3, 255, axis=1).astype(np.uint8)


def _fade(colors: NDArray[np.uint8], alpha: float) -> NDArray[np.uint8]:
    return (colors * np.array([1, 1, 1, alpha])).astype(np.uint8)


def find_groups(record: EpisodeRecord, r: int) -> Indices:
    """``(N,)``: the number of the group that was found for each UAV in round ``r`` (from 0); -1: none."""
    values = np.full(record.uavs, -1)
    if record.clusters is not None and (record.clusters[r][record.alive[r]] >= 0).any():
        values = record.clusters[r]
    elif record.leader_estimate is not None:
        values = np.where(record.candidates[r], np.arange(record.uavs), record.leader_estimate[r])
    values = np.where(record.alive[r], values, -1)
    labels, number = np.unique(values, return_inverse=True)
    return np.where(values < 0, -1, number - int(labels[0] < 0))


def attention_sheet(record: EpisodeRecord, r: int) -> NDArray[np.uint8]:
    """The weights of round ``r`` (from 0) as a grey image; the largest weight of a row is white.

    Rows and columns are the living UAVs, sorted by their found group, so that groups are blocks on the diagonal.
    """
    assert record.attention is not None
    groups = find_groups(record, r)
    order = np.lexsort((~record.candidates[r], np.where(groups < 0, record.uavs, groups)))
    order = order[record.alive[r][order]]
    weights = record.attention[r][np.ix_(order, order)]
    weights /= np.maximum(weights.max(axis=1, keepdims=True), 1e-12)
    return (255 * weights.clip(0, 1)).astype(np.uint8)


class EpisodeWriter:
    """Writes an episode into a stream; ``span`` is the side of the swarm in metres."""

    def __init__(self, record: EpisodeRecord, stream: rr.RecordingStream, span: float) -> None:
        import rerun

        self.rr, self.record, self.stream, self.span, self.log = rerun, record, stream, span, stream.log
        self.scale = span / _TYPICAL_SPAN
        self.samples = record.position.shape[1]
        self.answer, self.destroy, self.remerge = range(self.samples, self.samples + 3)
        self.last = np.stack([last_seen_position(*each) for each in zip(record.position, record.seen, strict=True)])
        self.names = [name_uav(record, i).removeprefix("UAV ") for i in range(record.uavs)]
        self.colors = np.stack([lighten(cluster_colors(record.head, root)) for root in record.root])

    def at(self, r: int, instant: int) -> None:
        """Set the time of what is logged next: the samples of round ``r`` (from 0) are followed by three beats."""
        self.stream.set_time("round", sequence=r + 1)
        window_seconds = _WATCH_SECONDS * min(instant / (self.samples - 1), 1.0)
        pauses = 0.25 + _PAUSE_SECONDS * (instant - self.answer) if instant >= self.answer else 0.0
        round_seconds = _WATCH_SECONDS + 3 * _PAUSE_SECONDS + 0.5
        self.stream.set_time("time", duration=round_seconds * r + window_seconds + pauses)

    def write(self) -> None:
        """Write all of it."""
        self.log("world", self.rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._write_observers()
        if not self.record.recorded:
            self.at(0, 0)
            for name in ("J", "heads_left"):
                style: dict[str, Any] = {"colors": _SERIES, "names": name}
                lines = self.rr.SeriesLines(interpolation_mode="StepAfter", **style)
                self.log(f"game/{name}", self.rr.SeriesPoints(marker_sizes=5, **style), lines, static=True)
            self._log_game(0.0, int(self.record.head.sum()))
        for r in range(self.record.rounds):
            self.at(r, 0)
            visible = self.record.position[r][self.record.seen[r]]
            if len(visible):  # a fixed camera shows all rounds
                self.log("world", self.rr.Transform3D(translation=-(visible.min(axis=0) + visible.max(axis=0)) / 2))
            for path in ("world/found", "world/verdict", "mind", "scores"):
                self.log(path, self.rr.Clear(recursive=True))
            texts = tell_round(self.record, r + 1, self.names)
            for instant, text in zip((0, self.answer), texts, strict=True):
                self.at(r, instant)
                self.log("this_round", self.rr.TextDocument(text, media_type="text/markdown"))
            self._write_window(r)
            self._write_answer(r)
            self._write_end(r)

    def _write_window(self, r: int) -> None:
        record, alive = self.record, self.record.alive[r]
        for instant in range(self.samples):
            self.at(r, instant)
            self._log_uavs(r, record.position[r, instant], alive & record.seen[r, instant], self.colors[r])
            if record.intruders is not None:
                flown = record.intruders[r, : instant + 1].swapaxes(0, 1)
                intruders = self.rr.Points3D(flown[:, -1], colors=_INTRUDER, radii=_HEAD_RADIUS * self.scale)
                self.log("world/observers/intruders", intruders)
                self.log("world/observers/flown", self.rr.LineStrips3D(flown, colors=_INTRUDER, radii=self.scale))
        for instant in np.linspace(0, self.samples - 1, min(_STAGES, self.samples)).astype(int).tolist():
            self.at(r, instant)
            instants = np.unique(np.linspace(0, instant, min(instant + 1, _MAX_POINTS)).astype(int))
            seen, position = record.seen[r, instants], record.position[r, instants]
            strips = [position[seen[:, i], i] for i in np.flatnonzero(alive)]
            colors = _fade(self.colors[r][alive], 0.6)
            self.log("world/swarm/tracks", self.rr.LineStrips3D(strips, colors=colors, radii=0.9 * self.scale))
            last = last_seen_position(record.position[r, : instant + 1], record.seen[r, : instant + 1])
            self._log_links(last, np.where(alive, record.root[r], -1), self.colors[r])

    def _log_uavs(self, r: int, position: Singles, is_shown: Mask, colors: NDArray[np.uint8]) -> None:
        decoys = self.record.decoys[r]
        colors = np.where(decoys[:, None], lighten([_DECOY]), colors)[is_shown]
        radii = np.where(self.record.head | decoys, _HEAD_RADIUS, _FOLLOWER_RADIUS)[is_shown] * self.scale
        style: dict[str, Any] = {"labels": [self.names[i] for i in np.flatnonzero(is_shown)], "show_labels": False}
        self.log("world/swarm/uavs", self.rr.Points3D(position[is_shown], colors=colors, radii=radii, **style))

    def _log_links(self, position: Singles, root: Indices, colors: NDArray[np.uint8]) -> None:
        is_located = np.isfinite(position[:, 0] + position[root, 0])
        followers = np.flatnonzero((root >= 0) & (root != np.arange(len(root))) & is_located)
        strips = position[np.stack([followers, root[followers]], axis=1)]
        links = self.rr.LineStrips3D(strips, colors=_fade(colors[followers], 0.3), radii=0.5 * self.scale)
        self.log("world/swarm/links", links)

    def _write_answer(self, r: int) -> None:
        record, rr, position = self.record, self.rr, self.last[r]
        self.at(r, self.answer)
        seen = np.isfinite(position[:, 0])
        groups, living = find_groups(record, r), np.flatnonzero(record.alive[r] & seen)
        palette = np.array([*CLUSTER_COLORS, NO_CLUSTER_COLOR])
        colors = lighten(palette[np.where(groups < 0, len(CLUSTER_COLORS), groups % len(CLUSTER_COLORS))])
        scores = np.maximum(record.scores[r], 0)
        share = scores / max(float(scores.max()), 1e-300) if record.probability is None else record.probability[r]
        radii = _FOLLOWER_RADIUS * self.scale * (0.9 + 1.8 * share)
        labels = [f"{name}: score {score:.3g}" for name, score in zip(self.names, record.scores[r], strict=True)]
        style: dict[str, Any] = {"radii": radii[living], "labels": [labels[i] for i in living], "show_labels": False}
        self.log("world/found/uavs", rr.Points3D(position[living], colors=colors[living], **style))
        pairs = record.hierarchy(r + 1)
        if pairs is not None:
            pairs = pairs[seen[pairs].all(axis=1)]
            links = rr.LineStrips3D(position[pairs], colors=_fade(colors[pairs[:, 0]], 0.35), radii=0.6 * self.scale)
            self.log("world/found/links", links)
        self._log_rings("world/found/candidates", r, record.candidates[r] & seen, _CANDIDATE, labels)
        marks = mark_words(record, r + 1)
        place = np.argsort(np.argsort(np.where(record.alive[r], -record.scores[r], np.inf), kind="stable"))
        for mark in [mark for mark in _MARKS if (marks == mark).any()]:
            if mark != OTHER:
                texts = [f"{mark} {name}" for name in self.names]
                self._log_rings(f"world/verdict/{mark}", r, (marks == mark) & seen, _MARKS[mark], texts)
            uavs = np.flatnonzero((marks == mark) & record.alive[r])
            self.log(f"scores/{mark}", rr.BarChart(record.scores[r, uavs], color=_MARKS[mark], abscissa=place[uavs]))
        if record.attention is not None:
            self.log("mind/attention", rr.Image(attention_sheet(record, r)))

    def _log_rings(self, path: str, r: int, is_marked: Mask, color: int, labels: Sequence[str]) -> None:
        rings = np.flatnonzero(is_marked).tolist()
        half = np.full((len(rings), 3), self.scale * _MARK_RADIUS, np.float32)
        kind, width = (self.rr.Boxes3D, "radii") if path.endswith(REDUNDANT) else (self.rr.Ellipsoids3D, "line_radii")
        half *= 0.8 if width == "radii" else 1.0
        frame = self.rr.components.FillMode.MajorWireframe
        style: dict[str, Any] = {"colors": color, width: 0.6 * self.scale, "fill_mode": frame}
        style |= {"labels": [labels[i] for i in rings], "show_labels": len(rings) <= _MAX_LABELS}
        self.log(path, kind(centers=self.last[r][is_marked], half_sizes=half, **style))

    def _write_end(self, r: int) -> None:
        record, rr = self.record, self.rr
        is_living, orphans = record.alive[r] & ~record.destroyed[r], record.orphans[r]
        grey = np.where(orphans[:, None], lighten([NO_CLUSTER_COLOR]), self.colors[r])
        next_round = min(r + 1, record.rounds - 1)
        for instant, root, colors in (
            (self.destroy, np.where(orphans, -1, record.root[r]), grey),
            (self.remerge, record.root[next_round], self.colors[next_round]),
        ):
            self.at(r, instant)
            self._log_uavs(r, self.last[r], is_living & np.isfinite(self.last[r, :, 0]), colors)
            self._log_links(self.last[r], np.where(is_living & (root >= 0) & is_living[root], root, -1), colors)
        self.at(r, self.destroy)
        position = record.last_position(r + 1)[~is_living]
        position = position[np.isfinite(position[:, 0])]
        points = rr.Points3D(position, colors=_DESTROYED, radii=_FOLLOWER_RADIUS * self.scale)
        self.log("world/swarm/destroyed", points)
        if not record.recorded:
            self._log_game(record.objective[r], record.heads_left[r])

    def _log_game(self, objective: float, heads_left: int) -> None:
        """Log J and the heads that are left from now on."""
        for name, value in (("J", objective), ("heads_left", heads_left)):
            self.log(f"game/{name}", self.rr.Scalars(value))

    def _write_observers(self) -> None:
        if self.record.observers is None:
            return
        position, ranges = self.record.observers[:, None, :3], self.record.observers[:, 3]
        angle = np.linspace(0, 2 * np.pi, 65)
        circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        names = [f"observer {k}, range {sensing_range:g} m" for k, sensing_range in enumerate(ranges)]
        style: dict[str, Any] = {"colors": _OBSERVER, "labels": names, "radii": 1.2 * self.scale}
        rings = self.rr.LineStrips3D((position + ranges[:, None, None] * circle).astype(np.float32), **style)
        self.log("world/observers", rings, static=True)


def _make_spatial_view(writer: EpisodeWriter, name: str, truth: bool) -> rrb.Spatial3DView:
    """A view of the swarm: the truth with the verdict, or what the detector sees, with its answer."""
    import rerun.blueprint as rrb

    rr = writer.rr
    parts, overrides = ["swarm", "verdict", "observers"], {}
    if writer.record.uavs > MOST_LINKED:  # not shown at first; a person can turn them on
        overrides = {f"/world/{part}/links": rrb.EntityBehavior(visible=False) for part in ("swarm", "found")}
    if not truth:
        parts = ["swarm/uavs", "swarm/tracks", "found", "observers"]
        dots = rr.Points3D.from_fields(colors=[_UNKNOWN_COLOR], radii=[5.0 * writer.scale])
        tracks = rr.LineStrips3D.from_fields(colors=[[*_UNKNOWN_COLOR, 110]])
        overrides |= {"/world/swarm/uavs": dots, "/world/swarm/tracks": tracks}
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


def _arrange_views(writer: EpisodeWriter) -> rrb.Blueprint:
    """The layout: the swarm as it is seen and as it is, next to them texts; below them charts."""
    import rerun.blueprint as rrb

    record, range_of = writer.record, writer.rr.TimeRangeBoundary
    past_range = writer.rr.VisibleTimeRange("time", start=range_of.infinite(), end=range_of.cursor_relative())
    views = [_make_spatial_view(writer, "the truth" if record.labelled else "tracks", truth=True)]
    if record.labelled:
        views.insert(0, _make_spatial_view(writer, "what it sees and answers", truth=False))
    texts = rrb.TextDocumentView(origin="/this_round", name=f"this {name_round(record).lower()}")
    charts: list[Any] = [rrb.BarChartView(origin="/scores", name="scores, the highest first")]
    if record.attention is not None:
        charts.append(rrb.Spatial2DView(origin="/mind/attention", name="Attention of a UAV (row)"))
    for name in ("J", "heads_left") * (not record.recorded):  # curves that don't show the future
        title, contents = name.replace("_", " "), [f"/game/{name}"]
        charts.append(rrb.TimeSeriesView(origin="/", contents=contents, name=title, time_ranges=[past_range]))
    explanation = rrb.TextDocumentView(origin="/about", name="What you see")
    upper = rrb.Horizontal(*views, texts, explanation, column_shares=[4] * len(views) + [2, 2])
    rows = rrb.Vertical(upper, rrb.Horizontal(*charts), row_shares=[3, 1.4])
    panel = rrb.TimePanel(state="collapsed", timeline="time", play_state="paused", loop_mode="off")
    return rrb.Blueprint(rows, panel, collapse_panels=True)


def _find_span(record: EpisodeRecord) -> float:
    """The side of the largest box around the UAVs of a round, metres."""
    visible = [position[seen] for position, seen in zip(record.position, record.seen, strict=True) if seen.any()]
    return max([float(np.ptp(points, axis=0).max()) for points in visible] + [find_least_side(record)])


def write_recording(record: EpisodeRecord, path: str | os.PathLike[str]) -> Path:
    """Write an episode as a Rerun recording that contains its layout; the file appears whole. ``rerun PATH`` opens it.

    One view shows what the detector sees and answers, another one the truth and the verdict. The timelines are
    ``time``, seconds of the replay with a pause after each answer, destruction and re-merge, and ``round``.

    Args:
        record: the episode.
        path: where to, such as ``replay.rrd``; an existing file is replaced.

    Raises:
        ArgumentError: the position can't be written to.
        MissingExtraError: rerun-sdk is not installed.
    """
    instance_of("record", record, EpisodeRecord)
    try:
        import rerun as rr
    except ImportError:
        raise MissingExtraError(f"Replays need rerun-sdk; {how_to_install('replay')}.") from None
    file, label = as_path("path", path), record.detector or "A detector"
    name = str(uuid4())  # recordings with the same application id share one camera and one layout in the viewer
    stream = rr.RecordingStream(f"usnet {name}", recording_id=name)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    writer = EpisodeWriter(record, stream, _find_span(record))
    memory = stream.memory_recording()  # on a full disk, Rerun's own files are truncated without an error, or it waits
    stream.send_blueprint(_arrange_views(writer), make_active=False)
    stream.send_recording_name(f"{label} on {record.env_id}, seed {record.seed}")
    stream.log("about", rr.TextDocument(explain_replay(record), media_type="text/markdown"), static=True)
    writer.write()
    with atomic_write(file) as temporary:
        temporary.write_bytes(memory.drain_as_bytes())
    return file


def find_viewer() -> str:
    """The command that opens a replay: ``rerun`` if the shell finds it, else the path of the one beside this Python."""
    installed = Path(sys.executable).with_name("rerun")
    return "rerun" if shutil.which("rerun") or not installed.exists() else os.path.relpath(installed)


def open_replay(path: Path) -> None:
    """Open a recording in the Rerun viewer, in a process that continues after this one and writes no output."""
    try:
        subprocess.Popen([find_viewer(), str(path)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    except FileNotFoundError:
        raise MissingExtraError(f"The viewer needs rerun-sdk; {how_to_install('replay')}.") from None

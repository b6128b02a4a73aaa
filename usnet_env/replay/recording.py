"""A Rerun recording of an episode: the swarm in 3-D, the candidates of each round, and the course of the game.

Rerun is an extra (``pip install 'usnet[replay]'``) and is imported only here, when a recording is written. Each
recording has a stream of its own; Rerun's global state does not change.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from usnet_env.drawing import MissingExtraError, cluster_colors
from usnet_env.files import as_path, atomic_write
from usnet_env.replay.episode import EpisodeRecord, check_record
from usnet_env.replay.story import describe_outcome, describe_round, format_count, rank_scores

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

__all__ = ["list_steps", "write_recording"]

_SWARM, _CANDIDATES, _SCORES, _GAME = "swarm", "candidates", "scores", "game"  # first parts of the entities' paths
_BACKGROUND, _DESTROYED, _MISSED, _HEAD_BAR, _OTHER_BAR = "#101418", "#8A8A8A", "#F5F5F5", "#56B4E9", "#9A9A9A"
_HIT, _REDUNDANT = "#1ED9A0", "#FF7A1A"  # green and orange of the picture, brighter for a dark view
_SMALL, _LARGE, _RING = 5.0, 12.0, 24.0  # metres: radii of a follower, of a head, and of the mark of a candidate
_MOST_LABELS = 12  # with more marks of one kind, the labels are hidden


def list_steps(record: EpisodeRecord) -> NDArray[np.int64]:
    """List the simulated step of every sample, ``(R, T_ob + 1)`` int64, counted from the start of the swarm.

    A round begins with ``memory`` unobserved steps after a re-merge; the window follows, with a sample every
    ``sample_every`` steps. Where ``config`` lacks these two, the steps count the samples.
    """
    every, memory = int(record.config.get("sample_every", 1)), int(record.config.get("memory", 0))
    samples = record.position.shape[1]
    flown = memory + (samples - 1) * every
    return flown * np.arange(record.rounds)[:, None] + memory + every * np.arange(samples)[None]


def _parse_color(color: str, alpha: int = 255) -> tuple[int, int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16), alpha


def _lighten(colors: Iterable[str], alpha: int = 255) -> NDArray[np.uint8]:
    """Lighten colours made for white paper for a dark view: ``(..., 4)`` uint8."""
    paper = np.array([_parse_color(color, alpha) for color in colors], np.float64).reshape(-1, 4)
    return np.where(np.arange(4) < 3, 90 + 0.65 * paper, paper).astype(np.uint8)


class _Writer:
    """Writes the entities of one recording, column by column: a row for each instant, with all UAVs in it."""

    def __init__(self, record: EpisodeRecord, stream: rr.RecordingStream) -> None:
        import rerun

        self.rr = rerun
        self.record = record
        self.stream = stream
        self.steps = list_steps(record)

    def _times(self, rounds: NDArray[np.int64], steps: NDArray[np.int64]) -> list[Any]:
        return [self.rr.TimeColumn("round", sequence=rounds), self.rr.TimeColumn("step", sequence=steps)]

    def _all_instants(self) -> list[Any]:
        rounds = np.repeat(np.arange(1, self.record.rounds + 1), self.steps.shape[1])
        return self._times(rounds, self.steps.reshape(-1))

    def _all_rounds(self, last: bool = False) -> list[Any]:
        return self._times(np.arange(1, self.record.rounds + 1), self.steps[:, -1 if last else 0])

    def _send(self, path: str, times: list[Any], columns: Any, lengths: Any, **look: Any) -> None:
        """Write rows of ``lengths`` instances each, and once the look that all rows share."""
        self.stream.send_columns(path, times, columns.partition(lengths))
        self.stream.log(path, look.pop("kind").from_fields(**look), static=True)

    def write_uavs(self, path: str, who: NDArray[np.bool_], radius: float) -> None:
        """Write some UAVs, ``who`` ``(N,)``, as points in the colour of their cluster, at every instant."""
        record = self.record
        visible = record.seen & (record.alive & who)[:, None]
        shade = np.stack([_lighten(cluster_colors(record.head, leader)[0]) for leader in record.leader])
        columns = self.rr.Points3D.columns(
            positions=record.position[visible],
            colors=np.broadcast_to(shade[:, None], (*visible.shape, 4))[visible],
            labels=[f"UAV {i}" for i in np.nonzero(visible)[2]],
        )
        look = {"kind": self.rr.Points3D, "radii": radius, "show_labels": False}
        self._send(path, self._all_instants(), columns, visible.sum(axis=2).reshape(-1), **look)

    def write_links(self, path: str) -> None:
        """Write the communication links, a strip from every follower to its head, at every instant."""
        record = self.record
        strips, colors, lengths = [], [], []
        for position, seen, alive, leader in zip(
            record.position, record.seen, record.alive, record.leader, strict=True
        ):
            linked = alive & (leader >= 0) & (leader != np.arange(record.uavs))
            shade = _lighten(cluster_colors(record.head, leader)[0], 60)
            for place, visible in zip(position, seen, strict=True):
                who = np.flatnonzero(linked & visible & visible[leader])
                strips.append(np.stack([place[who], place[leader[who]]], axis=1))
                colors.append(shade[who])
                lengths.append(len(who))
        columns = self.rr.LineStrips3D.columns(strips=np.concatenate(strips), colors=np.concatenate(colors))
        self._send(path, self._all_instants(), columns, lengths, kind=self.rr.LineStrips3D, radii=0.5)

    def write_tracks(self, path: str) -> None:
        """Write the path of each UAV through the window, a strip for each UAV and round."""
        record = self.record
        strips: list[NDArray[np.float32]] = []
        colors, lengths = [], []
        for position, seen, leader in zip(record.position, record.seen, record.leader, strict=True):
            who = np.flatnonzero(seen.sum(axis=0) > 1)
            strips += [position[seen[:, i], i] for i in who]
            colors.append(_lighten(cluster_colors(record.head, leader)[0], 140)[who])
            lengths.append(len(who))
        columns = self.rr.LineStrips3D.columns(strips=strips, colors=np.concatenate(colors))
        self._send(path, self._all_rounds(), columns, lengths, kind=self.rr.LineStrips3D, radii=0.8)

    def write_destroyed(self, path: str) -> None:
        """Write the destroyed UAVs as points where they were seen last."""
        record = self.record
        places = [record.last_position(r + 1)[~record.alive[r]] for r in range(record.rounds)]
        places = [place[np.isfinite(place[:, 0])] for place in places]
        columns = self.rr.Points3D.columns(positions=np.concatenate(places))
        look = {"kind": self.rr.Points3D, "radii": 1.4 * _SMALL, "colors": _parse_color(_DESTROYED)}
        self._send(path, self._all_rounds(), columns, [len(place) for place in places], **look)

    def write_marks(self, path: str, who: NDArray[np.bool_], color: str, word: str, square: bool = False) -> None:
        """Write a wire sphere (or box) around some UAVs, ``who`` ``(R, N)``, at every instant of the window."""
        record = self.record
        visible = record.seen & who[:, None]
        kind: Any = self.rr.Boxes3D if square else self.rr.Ellipsoids3D
        total = int(visible.sum())
        # Every row has sizes: with one static size, an empty row would show a mark at the origin.
        half = np.full((total, 3), _RING * (0.8 if square else 1.0))
        columns = kind.columns(centers=record.position[visible], half_sizes=half, labels=[word] * total)
        look: dict[str, Any] = {"kind": kind, "colors": _parse_color(color), "radii" if square else "line_radii": 1.2}
        look["show_labels"] = bool(who.sum(axis=1).max() <= _MOST_LABELS)
        self._send(path, self._all_instants(), columns, visible.sum(axis=2).reshape(-1), **look)

    def write_scores(self, heads: str, others: str) -> None:
        """Write the highest scores of each round, highest first, heads and other UAVs as two charts on one axis."""
        record = self.record
        for r in range(record.rounds):
            self.stream.set_time("round", sequence=r + 1)
            self.stream.set_time("step", sequence=int(self.steps[r, 0]))
            order = rank_scores(record, r + 1)
            for path, who, color in ((heads, record.head, _HEAD_BAR), (others, ~record.head, _OTHER_BAR)):
                bars = np.where(who[order], record.scores[r, order], 0.0)
                self.stream.log(path, self.rr.BarChart(bars, color=_parse_color(color)))
        self.stream.reset_time()

    def write_progress(self, path: str, name: str, values: NDArray[Any], color: str) -> None:
        """Write a number before the first round and after each round, ``(R + 1,)``."""
        rounds = np.arange(self.record.rounds + 1)
        steps = np.append(self.steps[0, 0], self.steps[:, -1])
        self.stream.send_columns(path, self._times(rounds, steps), self.rr.Scalars.columns(scalars=values))
        self.stream.log(
            path,
            self.rr.SeriesLines(colors=_parse_color(color), names=name, widths=2, interpolation_mode="StepAfter"),
            self.rr.SeriesPoints(colors=_parse_color(color), names=name, markers="circle", marker_sizes=5),
            static=True,
        )


def _explain(record: EpisodeRecord) -> str:
    """Explain the recording in Markdown; the links select the entities in the viewer."""
    heads, decoys = int(record.head.sum()), int(record.decoy.sum())
    rounds = "\n".join(f"- Round {r}: {describe_round(record, r)}" for r in range(1, record.rounds + 1))
    decoy = (
        f"- [decoys](recording://{_SWARM}/decoys): {decoys}, flying like heads but without followers\n"
        if decoys
        else ""
    )
    windows = format_count(record.rounds, "observed window")
    return f"""# Who leads this swarm?

**{record.detector or "A detector"}** on {record.env_id or "an episode"}, seed {record.seed}. {describe_outcome(record)}

{rounds}

## What you see
{record.uavs} UAVs in {format_count(heads, "cluster")}, in {windows}. **Press play.**

- [heads](recording://{_SWARM}/heads): the large points, one in each cluster; the detector has to find them
- [followers](recording://{_SWARM}/followers): the small points, in the colour of the head that they follow
- [links](recording://{_SWARM}/links) from each follower to its head, and [tracks](recording://{_SWARM}/tracks) of all
  UAVs in this window
{decoy}- [destroyed](recording://{_SWARM}/destroyed) in earlier rounds: grey, where they were seen last

The detector receives the flight paths of all UAVs, but not the roles, colours and links. It names its candidates at the
end of each window:

- [hit](recording://{_CANDIDATES}/hit), green spheres: candidates that are heads
- [redundant](recording://{_CANDIDATES}/redundant), orange boxes: candidates that are not heads
- [missed](recording://{_CANDIDATES}/missed), white spheres: heads that are no candidates in this round

The candidates are destroyed after the window. Followers without a head join the nearest head that is left. The marks
move with their UAVs through the whole window, so that you can compare the flight of candidates and other UAVs.

The bars are the highest scores of this round, highest first: [heads](recording://{_SCORES}/heads) in blue,
[other UAVs](recording://{_SCORES}/others) in grey.
"""


def _arrange_views(record: EpisodeRecord) -> rrb.Blueprint:
    import rerun.blueprint as rrb

    place = record.position[record.seen & record.alive[:, None]]
    low, high = (place.min(axis=0), place.max(axis=0)) if len(place) else (np.zeros(3), np.ones(3))
    middle, span = (low + high) / 2, max(float((high - low).max()), 1.0)
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=middle + span * np.array([0.0, -0.75, 0.9]),
        look_target=middle - span * np.array([0.0, 0.05, 0.0]),
        eye_up=[0.0, 0.0, 1.0],
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(
                origin="/",
                contents=[f"/{_SWARM}/**", f"/{_CANDIDATES}/**"],
                name="The swarm",
                eye_controls=eye,
                background=_parse_color(_BACKGROUND)[:3],
                line_grid=False,
            ),
            rrb.Vertical(
                rrb.TextDocumentView(origin="/about", name="What you see"),
                rrb.BarChartView(origin=f"/{_SCORES}", name="Highest scores in this round"),
                rrb.TimeSeriesView(origin=f"/{_GAME}", name="The game so far", plot_legend=rrb.Corner2D.RightTop),
                row_shares=[5, 2, 2],
            ),
            column_shares=[5, 3],
        ),
        rrb.TimePanel(state="collapsed", timeline="step", play_state="paused", loop_mode="off", fps=20),
        collapse_panels=True,
    )


def write_recording(record: EpisodeRecord, path: str | os.PathLike[str]) -> Path:
    """Write an episode as a Rerun recording that contains its blueprint; the file appears whole.

    The timelines are ``step`` (see :func:`list_steps`) and ``round``. ``rerun PATH`` opens the file.

    Args:
        record: the episode.
        path: the file to write, with the suffix ``.rrd`` by convention; an existing file is replaced.

    Returns:
        The path.

    Raises:
        ArgumentError: the place can't be written to.
        MissingExtraError: rerun-sdk is not installed.
    """
    try:
        import rerun as rr
    except ImportError:
        raise MissingExtraError("Replays need rerun-sdk: pip install 'usnet[replay]'.") from None
    check_record(record)
    place = as_path("path", path)
    stream = rr.RecordingStream("usnet", recording_id=str(uuid4()))
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    with atomic_write(place) as aside:
        stream.save(aside, default_blueprint=_arrange_views(record))
        try:
            _write(record, _Writer(record, stream))
        finally:
            stream.disconnect()  # writes the rest and closes the file
    return place


def _write(record: EpisodeRecord, writer: _Writer) -> None:
    rr, stream = writer.rr, writer.stream
    stream.send_recording_name(f"{record.env_id} seed {record.seed}: {record.detector}")
    stream.log("about", rr.TextDocument(_explain(record), media_type=rr.MediaType.MARKDOWN), static=True)
    stream.log(_SWARM, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    target = record.head & record.alive
    writer.write_uavs(f"{_SWARM}/followers", ~record.head & ~record.decoy, _SMALL)
    writer.write_uavs(f"{_SWARM}/heads", record.head, _LARGE)
    if record.decoy.any():
        writer.write_uavs(f"{_SWARM}/decoys", record.decoy, _LARGE)
    writer.write_links(f"{_SWARM}/links")
    writer.write_tracks(f"{_SWARM}/tracks")
    writer.write_destroyed(f"{_SWARM}/destroyed")
    writer.write_marks(f"{_CANDIDATES}/hit", record.candidates & target, _HIT, "hit")
    writer.write_marks(
        f"{_CANDIDATES}/redundant", record.candidates & record.alive & ~target, _REDUNDANT, "redundant", square=True
    )
    writer.write_marks(f"{_CANDIDATES}/missed", ~record.candidates & target, _MISSED, "missed")
    writer.write_scores(f"{_SCORES}/heads", f"{_SCORES}/others")
    start = np.array([record.head.sum()])
    writer.write_progress(f"{_GAME}/heads_left", "heads left", np.append(start, record.heads_left), _HEAD_BAR)
    wrong = np.append([0], np.cumsum(record.redundant))
    writer.write_progress(f"{_GAME}/redundant", "redundant so far", wrong, _REDUNDANT)
    writer.write_progress(f"{_GAME}/J", "J so far", np.append([0.0], record.objective), _HIT)

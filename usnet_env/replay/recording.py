"""A Rerun recording of an episode: the swarm in 3-D, what was named, and how the game went.

Rerun is an extra (``pip install 'usnet[replay]'``) and is imported only here, when a recording is written. The stream
is the function's own; Rerun's global state is left alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from usnet_env.drawing import NO_CLUSTER_COLOR, MissingExtraError, cluster_colors
from usnet_env.files import atomic_write
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.story import count, highest_scores, outcome, round_line

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

__all__ = ["instants", "write_recording"]

_SWARM, _NAMED, _SCORES, _GAME = "swarm", "named", "scores", "game"  # the entities' first words
_BACKGROUND, _DESTROYED, _MISSED, _HEAD_BAR = "#101418", "#8A8A8A", "#F5F5F5", "#56B4E9"
_HIT, _REDUNDANT = "#1ED9A0", "#FF7A1A"  # the picture's green and orange, brighter for a dark view
_SMALL, _LARGE, _RING = 5.0, 12.0, 24.0  # metres: radii of a follower, a head, and of what marks a candidate
_MOST_LABELS = 12  # marks of one kind that still get a word beside them


def instants(record: EpisodeRecord) -> NDArray[np.int64]:
    """``(R, T_ob + 1)`` the step at which each sample was taken, counted from the swarm's start.

    A round is the unobserved ``memory`` steps after a re-merge, then the window, one sample every ``sample_every``
    steps; a record that doesn't say counts samples.
    """
    every, memory = int(record.config.get("sample_every", 1)), int(record.config.get("memory", 0))
    samples = record.position.shape[1]
    flown = memory + (samples - 1) * every
    return flown * np.arange(record.rounds)[:, None] + memory + every * np.arange(samples)[None]


def _rgba(color: str, alpha: int = 255) -> tuple[int, int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16), alpha


def _lifted(colors: Iterable[str], alpha: int = 255) -> NDArray[np.uint8]:
    """``(..., 4)`` colours made for white paper, lightened for a dark view."""
    paper = np.array([_rgba(color, alpha) for color in colors], np.float64).reshape(-1, 4)
    return np.where(np.arange(4) < 3, 90 + 0.65 * paper, paper).astype(np.uint8)


class _Writer:
    """The entities of one recording, written column by column (one row an instant, all its UAVs in the row)."""

    def __init__(self, record: EpisodeRecord, stream: rr.RecordingStream) -> None:
        import rerun

        self.rr = rerun
        self.record = record
        self.stream = stream
        self.steps = instants(record)

    def _times(self, rounds: NDArray[np.int64], steps: NDArray[np.int64]) -> list[Any]:
        return [self.rr.TimeColumn("round", sequence=rounds), self.rr.TimeColumn("step", sequence=steps)]

    def _every_instant(self) -> list[Any]:
        rounds = np.repeat(np.arange(1, self.record.rounds + 1), self.steps.shape[1])
        return self._times(rounds, self.steps.reshape(-1))

    def _every_round(self, last: bool = False) -> list[Any]:
        return self._times(np.arange(1, self.record.rounds + 1), self.steps[:, -1 if last else 0])

    def _send(self, path: str, times: list[Any], columns: Any, lengths: Any, **look: Any) -> None:
        """Rows of ``lengths`` instances each, and what is the same in all of them."""
        self.stream.send_columns(path, times, columns.partition(lengths))
        self.stream.log(path, look.pop("kind").from_fields(**look), static=True)

    def uavs(self, path: str, who: NDArray[np.bool_], radius: float) -> None:
        """The UAVs of ``who`` ``(N,)`` as points in the colour of their cluster, at every instant."""
        record = self.record
        visible = record.seen & (record.alive & who)[:, None]
        shade = np.stack([_lifted(cluster_colors(record.head, leader)[0]) for leader in record.leader])
        columns = self.rr.Points3D.columns(
            positions=record.position[visible],
            colors=np.broadcast_to(shade[:, None], (*visible.shape, 4))[visible],
            labels=[f"UAV {i}" for i in np.nonzero(visible)[2]],
        )
        look = {"kind": self.rr.Points3D, "radii": radius, "show_labels": False}
        self._send(path, self._every_instant(), columns, visible.sum(axis=2).reshape(-1), **look)

    def links(self, path: str) -> None:
        """A strip from every follower to its head, at every instant."""
        record = self.record
        strips, colors, lengths = [], [], []
        for position, seen, alive, leader in zip(
            record.position, record.seen, record.alive, record.leader, strict=True
        ):
            linked = alive & (leader >= 0) & (leader != np.arange(record.uavs))
            shade = _lifted(cluster_colors(record.head, leader)[0], 60)
            for place, visible in zip(position, seen, strict=True):
                who = np.flatnonzero(linked & visible & visible[leader])
                strips.append(np.stack([place[who], place[leader[who]]], axis=1))
                colors.append(shade[who])
                lengths.append(len(who))
        columns = self.rr.LineStrips3D.columns(strips=np.concatenate(strips), colors=np.concatenate(colors))
        self._send(path, self._every_instant(), columns, lengths, kind=self.rr.LineStrips3D, radii=0.5)

    def tracks(self, path: str) -> None:
        """Each UAV's way through the window, one strip a UAV and round."""
        record = self.record
        strips: list[NDArray[np.float32]] = []
        colors, lengths = [], []
        for position, seen, leader in zip(record.position, record.seen, record.leader, strict=True):
            who = np.flatnonzero(seen.sum(axis=0) > 1)
            strips += [position[seen[:, i], i] for i in who]
            colors.append(_lifted(cluster_colors(record.head, leader)[0], 140)[who])
            lengths.append(len(who))
        columns = self.rr.LineStrips3D.columns(strips=strips, colors=np.concatenate(colors))
        self._send(path, self._every_round(), columns, lengths, kind=self.rr.LineStrips3D, radii=0.8)

    def destroyed(self, path: str) -> None:
        """Destroyed UAVs, where they were seen last."""
        record = self.record
        places = [record.last_position(r + 1)[~record.alive[r]] for r in range(record.rounds)]
        places = [place[np.isfinite(place[:, 0])] for place in places]
        columns = self.rr.Points3D.columns(positions=np.concatenate(places))
        look = {"kind": self.rr.Points3D, "radii": 1.4 * _SMALL, "colors": _rgba(_DESTROYED)}
        self._send(path, self._every_round(), columns, [len(place) for place in places], **look)

    def marks(self, path: str, who: NDArray[np.bool_], color: str, word: str, square: bool = False) -> None:
        """A wire sphere (or box) around every UAV of ``who`` ``(R, N)``; it flies with it through the window."""
        record = self.record
        visible = record.seen & who[:, None]
        kind: Any = self.rr.Boxes3D if square else self.rr.Ellipsoids3D
        total = int(visible.sum())
        # Sizes stand in every row: one static size would draw a ghost at the origin where a row is empty.
        half = np.full((total, 3), _RING * (0.8 if square else 1.0))
        columns = kind.columns(centers=record.position[visible], half_sizes=half, labels=[word] * total)
        look: dict[str, Any] = {"kind": kind, "colors": _rgba(color), "radii" if square else "line_radii": 1.2}
        look["show_labels"] = bool(who.sum(axis=1).max() <= _MOST_LABELS)
        self._send(path, self._every_instant(), columns, visible.sum(axis=2).reshape(-1), **look)

    def scores(self, heads: str, others: str) -> None:
        """The highest scores in each round, best first, heads and others as two charts on one axis."""
        record = self.record
        for r in range(record.rounds):
            self.stream.set_time("round", sequence=r + 1)
            self.stream.set_time("step", sequence=int(self.steps[r, 0]))
            order = highest_scores(record, r + 1)
            for path, who, color in ((heads, record.head, _HEAD_BAR), (others, ~record.head, NO_CLUSTER_COLOR)):
                bars = np.where(who[order], record.scores[r, order], 0.0)
                self.stream.log(path, self.rr.BarChart(bars, color=_rgba(color)))
        self.stream.reset_time()

    def progress(self, path: str, name: str, values: NDArray[Any], color: str) -> None:
        """A number before the first round and after each one, ``(R + 1,)``."""
        rounds = np.arange(self.record.rounds + 1)
        steps = np.append(self.steps[0, 0], self.steps[:, -1])
        self.stream.send_columns(path, self._times(rounds, steps), self.rr.Scalars.columns(scalars=values))
        self.stream.log(
            path,
            self.rr.SeriesLines(colors=_rgba(color), names=name, widths=2, interpolation_mode="StepAfter"),
            self.rr.SeriesPoints(colors=_rgba(color), names=name, markers="circle", marker_sizes=5),
            static=True,
        )


def _explanation(record: EpisodeRecord) -> str:
    """What one sees, in Markdown; the links select the entities in the viewer."""
    heads, decoys = int(record.head.sum()), int(record.decoy.sum())
    rounds = "\n".join(f"- Round {r}: {round_line(record, r)}" for r in range(1, record.rounds + 1))
    decoy = f"- [decoys](recording://{_SWARM}/decoys): {decoys} that fly like heads and lead nobody\n" if decoys else ""
    return f"""# Who leads this swarm?

**{record.detector or "A detector"}** on {record.env_id or "an episode"}, seed {record.seed}. {outcome(record)}

{rounds}

## What you see
{record.uavs} UAVs in {count(heads, "cluster")}, in {count(record.rounds, "observed window")}. **Press play.**

- [heads](recording://{_SWARM}/heads): the large points, one a cluster, to be found
- [followers](recording://{_SWARM}/followers): the small points, in the colour of the head they steer by
- [links](recording://{_SWARM}/links) to that head, and [tracks](recording://{_SWARM}/tracks) of this window
{decoy}- [destroyed](recording://{_SWARM}/destroyed) in earlier rounds: grey, where they were seen last

The detector saw where everyone flew, not the roles, colours and links. At the end of each window it answered:

- [hit](recording://{_NAMED}/hit), green spheres: heads that it named
- [redundant](recording://{_NAMED}/redundant), orange boxes: others that it named
- [not named](recording://{_NAMED}/not_named), white spheres: heads that got away in this round

Who is named is destroyed; orphans turn to the nearest head that is left. The marks fly along with their UAVs through
the whole window, so that you can see what gave them away.

The bars are the highest scores of this round, best first: [heads](recording://{_SCORES}/heads) in blue,
[others](recording://{_SCORES}/others) in grey.
"""


def _blueprint(record: EpisodeRecord) -> rrb.Blueprint:
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
                contents=[f"/{_SWARM}/**", f"/{_NAMED}/**"],
                name="The swarm",
                eye_controls=eye,
                background=_rgba(_BACKGROUND)[:3],
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
    """Write an episode as a Rerun recording with its blueprint inside; the file appears whole.

    Timelines: ``step`` (see :func:`instants`) and ``round``. Open it with ``rerun PATH``.

    Args:
        record: the episode.
        path: where to, by custom with the suffix ``.rrd``; an existing file is replaced.

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
    stream = rr.RecordingStream("usnet", recording_id=str(uuid4()))
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    with atomic_write(path) as aside:
        stream.save(aside, default_blueprint=_blueprint(record))
        try:
            _write(record, _Writer(record, stream))
        finally:
            stream.disconnect()  # flushes, and lets go of the file
    return Path(path)


def _write(record: EpisodeRecord, writer: _Writer) -> None:
    rr, stream = writer.rr, writer.stream
    stream.send_recording_name(f"{record.env_id} seed {record.seed}: {record.detector}")
    stream.log("about", rr.TextDocument(_explanation(record), media_type=rr.MediaType.MARKDOWN), static=True)
    stream.log(_SWARM, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    target = record.head & record.alive
    writer.uavs(f"{_SWARM}/followers", ~record.head & ~record.decoy, _SMALL)
    writer.uavs(f"{_SWARM}/heads", record.head, _LARGE)
    if record.decoy.any():
        writer.uavs(f"{_SWARM}/decoys", record.decoy, _LARGE)
    writer.links(f"{_SWARM}/links")
    writer.tracks(f"{_SWARM}/tracks")
    writer.destroyed(f"{_SWARM}/destroyed")
    writer.marks(f"{_NAMED}/hit", record.candidates & target, _HIT, "hit")
    writer.marks(
        f"{_NAMED}/redundant", record.candidates & record.alive & ~target, _REDUNDANT, "redundant", square=True
    )
    writer.marks(f"{_NAMED}/not_named", ~record.candidates & target, _MISSED, "not named")
    writer.scores(f"{_SCORES}/heads", f"{_SCORES}/others")
    start = np.array([record.head.sum()])
    writer.progress(f"{_GAME}/heads_left", "heads left", np.append(start, record.heads_left), _HEAD_BAR)
    wrong = np.append([0], np.cumsum(record.redundant))
    writer.progress(f"{_GAME}/redundant", "redundant so far", wrong, _REDUNDANT)
    writer.progress(f"{_GAME}/J", "J so far", np.append([0.0], record.objective), _HIT)

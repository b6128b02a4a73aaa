"""A Rerun recording of an episode: the swarm in 3-D, the candidates of each round, and the course of the game.

Rerun is an extra (``pip install 'usnet[replay]'``) and is imported only here, when a recording is written. Each
recording has a stream of its own; Rerun's global state does not change.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
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

_SWARM, _CANDIDATES, _SCORES, _GAME, _ROUND = (
    "swarm",
    "candidates",
    "scores",
    "game",
    "this_round",
)  # first parts of the entities' paths
_BACKGROUND, _DESTROYED, _DECOY, _MISSED = "#101418", "#8A8A8A", "#FFE45C", "#F5F5F5"
_LEADER = "leader"  # the word of a candidate if the truth is unknown
_HEADS_LEFT, _OTHER_BAR, _TEXT = "#56B4E9", "#6A6A6A", "#C8C8C8"
_HIT, _REDUNDANT = "#1ED9A0", "#FF7A1A"  # green and orange of the picture, brighter for a dark view
_SMALL, _LARGE, _RING = 5.0, 14.0, 30.0  # metres: radii of a follower, of a head, and of the mark of a candidate
_USUAL_SPAN = 800.0  # metres: recorded tracks may be smaller or larger, and all sizes with them
_MOST_LABELS = 16  # in a round with more candidates and missed heads, the labels are left out, and the text says so
_MOST_LISTED = 30  # rows of the table of a round's candidates
_CHART_WIDTH, _CHART_HEIGHT = 8.0, 1.0  # of the bars, in the units of their view
_ONE_ROW = 20  # with more bars, the numbers below them take turns in two rows
_DIAMOND = np.array(
    [[0, 0, 1], [1, 0, 0], [0, 0, -1], [-1, 0, 0], [0, 0, 1], [0, 1, 0], [0, 0, -1], [0, -1, 0], [0, 0, 1]]
)
_CROSS = np.array([[[-1, -1, 0], [1, 1, 0]], [[-1, 1, 0], [1, -1, 0]]])


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
        self.scale = 1.0 if record.labelled else _span(record) / _USUAL_SPAN

    def name(self, uav: int | np.integer[Any]) -> str:
        """The id of a UAV in its file if there is one, otherwise its number."""
        ids = self.record.config.get("ids")
        return f"UAV {uav}" if ids is None else str(ids[uav])

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
            labels=[self.name(i) for i in np.nonzero(visible)[2].tolist()],
        )
        look = {"kind": self.rr.Points3D, "radii": radius * self.scale, "show_labels": False}
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
        self._send(path, self._all_instants(), columns, lengths, kind=self.rr.LineStrips3D, radii=0.5 * self.scale)

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
        self._send(path, self._all_rounds(), columns, lengths, kind=self.rr.LineStrips3D, radii=0.8 * self.scale)

    def write_decoys(self, path: str) -> None:
        """Write the decoys as diamonds, at every instant."""
        record = self.record
        visible = record.seen & (record.alive & record.decoy)[:, None]
        strips = record.position[visible][:, None] + 1.4 * _LARGE * _DIAMOND.astype(np.float32)
        columns = self.rr.LineStrips3D.columns(strips=list(strips))
        look = {"kind": self.rr.LineStrips3D, "radii": 1.6, "colors": _parse_color(_DECOY)}
        self._send(path, self._all_instants(), columns, visible.sum(axis=2).reshape(-1), **look)

    def write_destroyed(self, path: str) -> None:
        """Write the destroyed UAVs as crosses where they were seen last."""
        record = self.record
        places = [record.last_position(r + 1)[~record.alive[r]] for r in range(record.rounds)]
        places = [place[np.isfinite(place[:, 0])] for place in places]
        strips = np.concatenate(places)[:, None, None] + 1.6 * _SMALL * _CROSS.astype(np.float32)
        columns = self.rr.LineStrips3D.columns(strips=list(strips.reshape(-1, 2, 3)))
        look = {"kind": self.rr.LineStrips3D, "radii": 1.2, "colors": _parse_color(_DESTROYED)}
        self._send(path, self._all_rounds(), columns, [2 * len(place) for place in places], **look)

    def write_centers(self, paths: Iterable[str]) -> None:
        """Move the middle of the swarm to the origin in each round, so that a fixed camera has all rounds in view."""
        middles = [(low + high) / 2 for low, high in map(_corners, _list_windows(self.record))]
        columns = self.rr.Transform3D.columns(translation=-np.array(middles, np.float32))
        for path in paths:
            self.stream.send_columns(path, self._all_rounds(), columns)

    def write_marks(self, path: str, who: NDArray[np.bool_], color: str, square: bool = False) -> None:
        """Write a wire sphere (or box) around some UAVs, ``who`` ``(R, N)``, at every instant of the window."""
        record = self.record
        visible = record.seen & who[:, None]
        kind: Any = self.rr.Boxes3D if square else self.rr.Ellipsoids3D
        total = int(visible.sum())
        # Every row has sizes: with one static size, an empty row would show a mark at the origin.
        half = np.full((total, 3), self.scale * _RING * (0.8 if square else 1.0))
        columns = kind.columns(centers=record.position[visible], half_sizes=half)
        line = {"radii" if square else "line_radii": 0.6 * self.scale}
        look: dict[str, Any] = {"kind": kind, "colors": _parse_color(color), **line}
        self._send(path, self._all_instants(), columns, visible.sum(axis=2).reshape(-1), **look)

    def write_labels(self, path: str, marks: Mapping[str, tuple[NDArray[np.bool_], str]]) -> None:
        """Write the words of the marks above them; rounds with too many marks have none."""
        record = self.record
        shown = np.sum([who for who, _ in marks.values()], axis=(0, 2)) <= _MOST_LABELS
        every = np.any([who for who, _ in marks.values()], axis=0) & shown[:, None]
        visible = record.seen & every[:, None]
        numbers, uavs = np.nonzero(visible)[0], np.nonzero(visible)[2]
        words, colors = np.empty(every.shape, object), np.zeros((*every.shape, 4), np.uint8)
        for word, (who, color) in marks.items():
            words[who], colors[who] = word, _parse_color(color)
        columns = self.rr.Points3D.columns(
            positions=record.position[visible] + np.array([0, 0, 3.2 * _RING * self.scale], np.float32),
            colors=colors[numbers, uavs],
            labels=[
                f"{words[r, i]} {self.name(int(i)).removeprefix('UAV ')}" for r, i in zip(numbers, uavs, strict=True)
            ],
        )
        look = {"kind": self.rr.Points3D, "radii": 0.1, "show_labels": True}
        self._send(path, self._all_instants(), columns, visible.sum(axis=2).reshape(-1), **look)

    def _mark(self, r: int, uav: int) -> tuple[str, str]:
        """The word and the colour of a UAV in round ``r`` (from 0)."""
        record = self.record
        if not record.labelled:
            return (_LEADER, _HIT) if record.candidates[r, uav] else ("other", _OTHER_BAR)
        if record.candidates[r, uav]:
            return ("hit", _HIT) if record.head[uav] and record.alive[r, uav] else ("redundant", _REDUNDANT)
        return ("missed", _MISSED) if record.head[uav] and record.alive[r, uav] else ("other", _OTHER_BAR)

    def write_scores(self, path: str) -> None:
        """Write the scores of each round as bars, highest first, with the numbers of candidates and heads below."""
        record, rr = self.record, self.rr
        for r in range(record.rounds):
            self.stream.set_time("round", sequence=r + 1)
            self.stream.set_time("step", sequence=int(self.steps[r, 0]))
            order = rank_scores(record, r + 1)
            scores, marks = record.scores[r, order], [self._mark(r, int(i)) for i in order]
            top = max(float(np.abs(scores).max(initial=0)), np.finfo(float).tiny)
            height, step = scores / top * _CHART_HEIGHT, _CHART_WIDTH / max(len(order), 1)
            colors = [_parse_color(color) for _, color in marks]
            left = step * np.arange(len(order))
            # y grows downwards; a thin base shows the UAVs whose score is 0, too.
            mins = np.stack([left, np.minimum(-height, 0)], axis=1)
            sizes = np.stack([np.full(len(order), 0.8 * step), np.abs(height) + 0.03], axis=1)
            words = [
                f"{self.name(i)}: score {score:.3g}, {word}"
                for i, score, (word, _) in zip(order, scores, marks, strict=True)
            ]
            bars = rr.Boxes2D(mins=mins, sizes=sizes, colors=colors, labels=words, show_labels=False)
            self.stream.log(f"{path}/bars", bars)
            named = [k for k, (word, _) in enumerate(marks) if word != "other"]
            named = named if len(named) <= _MOST_LABELS else []
            below = (
                max(float(-height.min(initial=0)), 0)
                + 0.18
                + 0.22 * (np.arange(len(named)) % 2) * (len(order) > _ONE_ROW)
            )
            places = [[left[k] + 0.4 * step, y] for k, y in zip(named, below, strict=True)]
            numbers = rr.Points2D(
                np.array(places).reshape(-1, 2),
                colors=[colors[k] for k in named],
                labels=[self.name(order[k]).removeprefix("UAV ") for k in named],
                radii=0.001,
                show_labels=True,
            )
            self.stream.log(f"{path}/numbers", numbers)
            scale = f"highest score {scores.max():.3g}" if scores.any() else "all scores are 0"
            title = rr.Points2D(
                [[0.8 * _CHART_WIDTH, -1.2]],
                labels=[scale],
                colors=_parse_color(_TEXT),
                radii=0.001,
                show_labels=True,
            )
            self.stream.log(f"{path}/scale", title)
        self.stream.reset_time()

    def write_rounds(self, path: str) -> None:
        """Write for each round its result, and a table of the candidates and missed heads, as Markdown."""
        texts = [
            _describe_marks(self.record, number, self._mark, self.name) for number in range(1, self.record.rounds + 1)
        ]
        columns = self.rr.TextDocument.columns(text=texts, media_type=["text/markdown"] * len(texts))
        self.stream.send_columns(path, self._all_rounds(), columns)

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


def _list_windows(record: EpisodeRecord) -> list[NDArray[np.float32]]:
    """The positions that were seen in each round, ``(n, 3)`` each; those of the round before if there is none."""
    windows: list[NDArray[np.float32]] = []
    for position, seen in zip(record.position, record.seen, strict=True):
        windows.append(position[seen] if seen.any() or not windows else windows[-1])
    return windows


def _corners(places: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The lowest and the highest coordinates of some positions; the origin if there are none."""
    return (places.min(axis=0), places.max(axis=0)) if len(places) else (np.zeros(3, np.float32),) * 2


def _span(record: EpisodeRecord) -> float:
    """The longest side of a box around the positions of a round, metres."""
    spans = [float((high - low).max()) for low, high in map(_corners, _list_windows(record))]
    return max(*spans, 1.0 if record.labelled else 1e-6)


def _describe_marks(
    record: EpisodeRecord, number: int, mark: Callable[[int, int], tuple[str, str]], name: Callable[[int], str]
) -> str:
    """Describe a round (from 1) in Markdown: its result, and its candidates and missed heads by their scores."""
    r = number - 1
    order = np.argsort(-record.scores[r], kind="stable").tolist()
    rows = [(i, mark(r, i)[0]) for i in order if mark(r, i)[0] != "other"]
    lines = [
        f"| {name(i).removeprefix('UAV ').replace('|', '/')} | {word} | {record.scores[r, i]:.3g} |"
        for i, word in rows[:_MOST_LISTED]
    ]
    table = "\n".join(["| UAV | mark | score |", "| --- | --- | --- |", *lines]) if lines else ""
    more = f"\n\n… and {len(rows) - _MOST_LISTED} more." if len(rows) > _MOST_LISTED else ""
    hidden = "\n\nThe marks have no labels here, because there are too many." if len(rows) > _MOST_LABELS else ""
    return f"**Round {number} of {record.rounds}:** {describe_round(record, number)}.{hidden}\n\n{table}{more}\n"


def _explain(record: EpisodeRecord) -> str:
    """Explain the recording in Markdown; the links select the entities in the viewer."""
    if not record.labelled:
        return _explain_tracks(record)
    heads, decoys = int(record.head.sum()), int(record.decoy.sum())
    decoy = (
        f"- [decoys](recording://{_SWARM}/decoys), yellow diamonds: {decoys}, flying like heads but without followers\n"
        if decoys
        else ""
    )
    windows = format_count(record.rounds, "observed window")
    return f"""# Who leads this swarm?

**{record.detector or "A detector"}** on {record.env_id or "an episode"}, seed {record.seed}. {describe_outcome(record)}

## What you see
{record.uavs} UAVs in {format_count(heads, "cluster")}, in {windows}. **Press play.**

- [heads](recording://{_SWARM}/heads): the large points, one in each cluster; the detector has to find them
- [followers](recording://{_SWARM}/followers): the small points, in the colour of the head that they follow
- [links](recording://{_SWARM}/links) from each follower to its head, and [tracks](recording://{_SWARM}/tracks) of all
  UAVs in this window
{decoy}- [destroyed](recording://{_SWARM}/destroyed) in earlier rounds: grey crosses, where they were seen last

The detector receives the flight paths of all UAVs, but not the roles, colours and links. It names its candidates at the
end of each window:

- [hit](recording://{_CANDIDATES}/hit), green spheres: candidates that are heads
- [redundant](recording://{_CANDIDATES}/redundant), orange boxes: candidates that are not heads
- [missed](recording://{_CANDIDATES}/missed), white spheres: heads that are no candidates in this round

The candidates are destroyed after the window. Followers without a head join the nearest head that is left. The marks
move with their UAVs through the whole window, so that you can compare the flight of candidates and other UAVs. In each
round the view is centred on the swarm.

The [bars](recording://{_SCORES}/bars) are scores of this round, highest first, in the colours of the marks; other UAVs
are grey. The numbers below them are those of the marked UAVs. The [table](recording://{_ROUND}) lists the marked UAVs.
"""


def _explain_tracks(record: EpisodeRecord) -> str:
    """Explain the recording of tracks without labels in Markdown."""
    return f"""# Leaders and followers

**{record.detector or "A detector"}** on {record.env_id or "recorded tracks"}. {describe_outcome(record)}

## What you see
{record.uavs} recorded tracks in {format_count(record.rounds, "window")}. **Press play.** Nothing here is the truth,
which is unknown: colours, links and marks show what the detector found.

- [leader](recording://{_CANDIDATES}/{_LEADER}), green spheres: leaders in this window
- [heads](recording://{_SWARM}/heads), large points: leaders in this or another window
- [followers](recording://{_SWARM}/followers): the others, in the colour of the leader that they follow, or grey
- [links](recording://{_SWARM}/links) from each follower to its leader
- [tracks](recording://{_SWARM}/tracks) in this window

In each window the view is centred on the tracks. The [bars](recording://{_SCORES}/bars) are scores of this window,
highest first. The [table](recording://{_ROUND}) lists the leaders.
"""


def _arrange_views(record: EpisodeRecord) -> rrb.Blueprint:
    import rerun.blueprint as rrb

    span = _span(record)
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=span * np.array([0.0, -0.74, 0.82]),
        look_target=span * np.array([0.0, -0.08, 0.0]),
        eye_up=[0.0, 0.0, 1.0],
    )
    lowest = 0.62 + _CHART_HEIGHT * bool((record.scores < 0).any())
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
                rrb.TextDocumentView(origin=f"/{_ROUND}", name="This round"),
                rrb.Spatial2DView(
                    origin=f"/{_SCORES}",
                    name="Scores in this round, highest first",
                    background=_parse_color(_BACKGROUND)[:3],
                    visual_bounds=rrb.VisualBounds2D(x_range=[-0.1, _CHART_WIDTH + 0.1], y_range=[-1.35, lowest]),
                ),
                rrb.TimeSeriesView(origin=f"/{_GAME}", name="The game so far", plot_legend=rrb.Corner2D.LeftTop),
                row_shares=[5, 2, 2, 2],
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
    # Recordings with the same application id share one camera and one layout in the viewer.
    recording_id = str(uuid4())
    stream = rr.RecordingStream(f"usnet {recording_id}", recording_id=recording_id)
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
        writer.write_decoys(f"{_SWARM}/decoys")
    writer.write_links(f"{_SWARM}/links")
    writer.write_tracks(f"{_SWARM}/tracks")
    writer.write_destroyed(f"{_SWARM}/destroyed")
    writer.write_centers((_SWARM, _CANDIDATES))
    marks = {
        "hit": (record.candidates & target, _HIT),
        "redundant": (record.candidates & record.alive & ~target, _REDUNDANT),
        "missed": (~record.candidates & target, _MISSED),
    }
    if not record.labelled:
        marks = {_LEADER: (record.candidates, _HIT)}
    for word, (who, color) in marks.items():
        writer.write_marks(f"{_CANDIDATES}/{word}", who, color, square=word == "redundant")
    writer.write_labels(f"{_CANDIDATES}/labels", marks)
    writer.write_scores(_SCORES)
    writer.write_rounds(_ROUND)
    if not record.labelled:
        named = np.append([0], record.candidates.sum(axis=1))
        writer.write_progress(f"{_GAME}/leaders", "leaders named", named, _HIT)
        return
    start = np.array([record.head.sum()])
    writer.write_progress(f"{_GAME}/heads_left", "heads left", np.append(start, record.heads_left), _HEADS_LEFT)
    wrong = np.append([0], np.cumsum(record.redundant))
    writer.write_progress(f"{_GAME}/redundant", "redundant so far", wrong, _REDUNDANT)
    writer.write_progress(f"{_GAME}/J", "J so far", np.append([0.0], record.objective), _HIT)

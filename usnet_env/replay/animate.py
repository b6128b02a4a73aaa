"""An animation of one game: what the detector sees next to the truth, round by round, as a GIF or MP4."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from usnet_env import drawing
from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError, format_count, instance_of, quote, whole_number
from usnet_env.files import atomic_write
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.figure import check_ending, describe_scene, find_least_side
from usnet_env.replay.story import describe_outcome, describe_round, name_round, name_times

_WIDTH, _HEIGHT = 9.6, 5.7  # inches
BESIDE = 0.5  # the right map is so far from the left one, in widths of the picture
_RATE = 2  # frames per second
WATCH, NAME, VERDICT, REMERGE = range(4)  # phases of a round
SECONDS = (0.5, 2.0, 2.5, 2.0)  # how long their frames stay


class Scene(NamedTuple):
    """What one frame shows: a phase of a round (from 1), with so many samples of its window, and one sentence."""

    round: int
    phase: int
    samples: int
    text: str


def list_scenes(record: EpisodeRecord, frames: int) -> Iterator[Scene]:
    """The frames of an episode in their order; ``frames`` are those in which the tracks of one window grow."""
    samples = record.position.shape[1]
    for number in range(1, record.rounds + 1):
        for shown_samples in np.unique(np.linspace(1, samples, frames).round().astype(int)).tolist():
            watched = f"{name_times(record, number)}the detector watches {samples - 1} steps"
            yield Scene(number, WATCH, shown_samples, watched)
        count = format_count(int(record.candidates[number - 1].sum()), "candidate" if record.labelled else "leader")
        yield Scene(number, NAME, samples, f"it names {count}")
        if record.labelled:
            yield Scene(number, VERDICT, samples, describe_round(record, number))
        if number < record.rounds and (orphans := int(record.orphans[number - 1].sum())):
            yield Scene(number, REMERGE, samples, f"followers without a head join another one: {orphans}")
    yield Scene(record.rounds, VERDICT if record.labelled else NAME, samples, describe_outcome(record))


def describe_frame(record: EpisodeRecord, scene: Scene) -> dict[str, Any]:
    """What a scene shows, as arguments of ``draw_round``, without candidates."""
    frame = describe_scene(record, scene.round)
    cut = ("position", "seen", *["intruders"] * (record.intruders is not None))
    frame |= {name: frame[name][: scene.samples] for name in cut}
    if scene.phase == REMERGE:
        frame |= {"alive": record.alive[scene.round], "root": record.root[scene.round]}
    return frame


class Painter:
    """Draws the scenes of one record into one figure with fixed axes."""

    def __init__(self, record: EpisodeRecord, dpi: float = 100) -> None:
        self.record = record
        self.figure = drawing.new_figure(_WIDTH, _HEIGHT, dpi)
        legend_axes = self.figure.add_axes((0, 0, 1, 0.1))
        legend_axes.axis("off")
        boxes = [(left, 0.11, 0.45, 0.45 * _WIDTH / _HEIGHT) for left in (0.04, 0.04 + BESIDE)]
        self.observed, self.truth = map(self.figure.add_axes, boxes)
        visible = record.position[record.seen & record.alive[:, None]]
        self.limits = drawing.limits_around(visible, 0.08, find_least_side(record))
        self.header = self.figure.text(0.02, 0.985, "", fontsize=13, va="top", wrap=True)
        marks = [drawing.HEAD_MARK, drawing.FOLLOWER_MARK, drawing.CANDIDATE_MARK, drawing.HIT_MARK]
        marks += [drawing.REDUNDANT_MARK, drawing.MISSED_MARK, *[drawing.DECOY_MARK] * bool(record.decoys.any())]
        marks += [drawing.DESTROYED_MARK] * (not record.recorded)
        marks += [drawing.INTRUDER_MARK] * (record.intruders is not None)
        names = {mark: mark for mark in marks} if record.labelled else drawing.TRACK_WORDS
        layout = {"loc": "center", "bbox_to_anchor": (0.5, 0.35), "ncols": 4, "labelspacing": 0.5, "markerscale": 0.6}
        drawing.draw_legend(legend_axes, names, **layout)
        self._draw_background(legend_axes)

    def _draw_background(self, legend_axes: Any) -> None:
        """Replace the ticks, grids and the legend by a picture of them: to draw them anew takes longest in a frame."""
        for axes in (self.observed, self.truth):
            drawing.set_up_axes(axes, self.limits, "")
            axes.set(xlabel="", ylabel="")
        pixels = drawing.pixels_of(self.figure)
        legend_axes.remove()
        for axes in (self.observed, self.truth):
            axes.axis("off")
        self.figure.figimage(pixels, zorder=-1)

    def locate(self, scene: Scene) -> Floats:
        """Where UAVs stand in the left map of a scene, ``(N, 2)``: parts of the picture, from below. One was drawn."""
        window = describe_frame(self.record, scene)
        position = drawing.last_seen_position(window["position"], window["seen"] & window["alive"])[:, :2]
        return self.figure.transFigure.inverted().transform(self.observed.transData.transform(position))

    def draw(self, scene: Scene) -> None:
        """Draw a scene in place of the one before."""
        record, r = self.record, scene.round - 1
        window = describe_frame(record, scene)
        candidates = record.candidates[r] if scene.phase in (NAME, VERDICT) else None
        truth = dict(window)
        if not record.labelled and scene.phase == WATCH:
            truth |= {"head": np.zeros_like(record.head), "root": np.full(record.uavs, -1)}
        truth["candidates"] = candidates if record.labelled and scene.phase == VERDICT else None
        style: dict[str, Any] = {"legend": False, "limits": self.limits}
        observed = window | {"candidates": candidates, "truth": False, "title": "What the detector sees"}
        truth["title"] = "The truth" if record.labelled else "What it found"
        for axes, picture in ((self.observed, observed), (self.truth, truth)):
            for artist in (*axes.collections, *axes.lines):
                artist.remove()
            drawing.draw_round(**picture, axes=axes, **style)
        header = f"{name_round(record)} {scene.round} of {record.rounds}: {scene.text}"
        self.header.set_text(drawing.escape_math(header))


def write_frames(
    record: EpisodeRecord, scenes: Iterable[Scene], writer: Any, path: Path, dpi: float, rate: int
) -> Painter:
    """Draw scenes with a writer of matplotlib, with ``rate`` frames for each second of a scene, and at least one."""
    painter = Painter(record, dpi)
    with writer.saving(painter.figure, str(path), dpi=dpi):
        for scene in scenes:
            painter.draw(scene)
            for _ in range(max(1, round(SECONDS[scene.phase] * rate))):
                writer.grab_frame()
    return painter


def animate(record: EpisodeRecord, path: str | os.PathLike[str], *, frames: int = 8) -> Path:
    """Write an animation of an episode: what the detector sees and names, next to the truth; the file appears whole.

    Args:
        record: the episode.
        path: where to; the suffix ``.gif`` or ``.mp4`` chooses the format. An existing file is replaced.
        frames: frames in which the tracks of one window grow.

    Raises:
        ArgumentError: ``path`` has another suffix or can't be written to, ``frames`` is below 2, or an MP4 is asked for
            and ffmpeg is not installed.
        MissingExtraError: matplotlib is not installed.
    """
    instance_of("record", record, EpisodeRecord)
    file = check_ending(path, ".gif", ".mp4")
    scenes = list_scenes(record, whole_number("frames", frames, 2))
    drawing.new_figure(1, 1)  # refuses without matplotlib
    from matplotlib import rc_context
    from matplotlib.animation import FFMpegWriter, PillowWriter

    writer_type, program = PillowWriter if file.suffix.lower() == ".gif" else FFMpegWriter, "ffmpeg"
    with suppress(ImportError, RuntimeError):
        from imageio_ffmpeg import get_ffmpeg_exe  # moviepy brings it

        program = get_ffmpeg_exe()
    with rc_context({"animation.ffmpeg_path": program}):
        if not writer_type.isAvailable():
            raise ArgumentError(f"path must end in .gif where ffmpeg is not installed, got {quote(str(file))}.")
        with atomic_write(file) as temporary:
            write_frames(record, scenes, writer_type(fps=_RATE), temporary, 100, _RATE)
    return file

"""An animation of one game: what the detector sees beside the truth, round by round, as a GIF or MP4.

It is made from the neutral episode file alone. Matplotlib is an extra (``pip install 'usnet[render]'``) and brings
Pillow, which writes the GIF, and moviepy, which brings the program ffmpeg for the MP4.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, quote, whole_number
from usnet_env.drawing import HIT, MISSED, REDUNDANT, cluster_colors, last_seen_position, limits_around, new_figure
from usnet_env.files import as_path, atomic_write
from usnet_env.replay.episode import EpisodeRecord, check_record
from usnet_env.replay.story import (
    describe_answer,
    describe_ending,
    describe_remerge,
    describe_verdict,
    name_round,
    name_score,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL.Image import Image

_WIDTH, _HEIGHT, _DPI = 9.6, 6.0, 100  # inches, pixels per inch
_PANEL, _LEFT, _BOTTOM = 4.55, 0.2, 0.52  # inches: side of a map, margins
_WATCH, _NAME, _DESTROY, _REMERGE, _END = range(5)
_PHASES = ("Watch", "Name", "Destroy", "Re-merge", "End")
_TRACK_PHASES, _KNOWN_PHASES = ("Watch", "Find"), ("Watch", "Find", "Compare")
_PHASE_PLACES = (1.4, 2.25, 3.05, 4.0, 5.1)  # inches
_STEP_SECONDS, _READ_SECONDS, _END_SECONDS = 0.09, 1.7, 3.5
_LINK_FRAMES = 5  # frames in which orphans turn to their new heads
_GIF_COLORS = 255  # the 256th is transparent
_MP4_RATE = 20  # frames per second
_UNKNOWN, _ORPHAN, _NAMED = "#6E6E6E", "#9A9A9A", "#0072B2"
_DASHES = (0, (2, 1.2))
_SCALE_BAR = 200.0  # metres


@dataclass(frozen=True)
class Scene:
    """What one frame shows.

    Args:
        round: from 1.
        phase: 0 watch, 1 name, 2 destroy (in recorded tracks: compare with the truth), 3 re-merge, 4 end of the game.
        seconds: how long the frame stays.
        text: one sentence about what happens.
        score: hits, redundant candidates and J so far.
        samples: how many positions of the window the tracks show, from 1 to T_ob + 1.
        turn: from 0 to 1, how far the links of the orphans have moved from the old head to the new one.
    """

    round: int
    phase: int
    seconds: float
    text: str
    score: str
    samples: int
    turn: float = 0.0


def _score(record: EpisodeRecord, played: int) -> str:
    """Hits, redundant candidates and J (or F1) after ``played`` rounds; nothing where the truth is unknown."""
    if not record.labelled:
        return ""
    hits, redundant = int(record.hits[:played].sum()), int(record.redundant[:played].sum())
    name, value = name_score(record)
    value = value if record.recorded else record.objective[played - 1]
    score = f"{value:.2f}" if played else "–"
    return f"hits {hits} of {int(record.head.sum())}     redundant {redundant}     {name} {score}"


def name_answer(record: EpisodeRecord) -> str:
    """Title of the right map: the truth, or what was found where the truth is unknown."""
    return "The truth" if record.labelled else "What it found"


def scenes(record: EpisodeRecord, frames: int = 20) -> Iterator[Scene]:
    """The frames of an episode in their order.

    Args:
        record: the episode.
        frames: frames in which the tracks of one window grow.

    Yields:
        One scene for each frame.
    """
    samples = record.position.shape[1]
    for r in range(record.rounds):
        number, before, after = r + 1, _score(record, r), _score(record, r + 1)
        watch = f"The detector watches {samples - 1} steps. To it, all UAVs look alike."
        if record.recorded:
            watch = f"The detector watches {samples - 1} steps of recorded tracks."
        for grown in np.unique(np.linspace(1, samples, frames).round().astype(int)):
            yield Scene(number, _WATCH, _STEP_SECONDS, watch, before, int(grown))
        last = not record.labelled and number == record.rounds
        seconds = _END_SECONDS if last else _READ_SECONDS
        yield Scene(number, _NAME, seconds, describe_answer(record, number), before, samples)
        if not record.labelled:
            continue
        if record.recorded:
            text = f"{describe_verdict(record, number)} {describe_ending(record)}"
            yield Scene(number, _DESTROY, _END_SECONDS, text, after, samples)
            continue
        yield Scene(number, _DESTROY, _READ_SECONDS, describe_verdict(record, number), after, samples)
        if number == record.rounds:
            yield Scene(number, _END, _END_SECONDS, describe_ending(record), after, samples)
        elif record.orphans[r].any():
            text = describe_remerge(record, number)
            for turn in np.linspace(0.0, 1.0, _LINK_FRAMES):
                seconds = _READ_SECONDS if turn == 1.0 else _STEP_SECONDS
                yield Scene(number, _REMERGE, seconds, text, after, samples, float(turn))


class Painter:
    """Draws scenes of one record into one figure with fixed axes.

    Args:
        record: the episode.
    """

    def __init__(self, record: EpisodeRecord) -> None:
        self.record = record
        self.figure = new_figure(_WIDTH, _HEIGHT, _DPI)
        self.stage: tuple[int, int] | None = None  # a round and a phase, whose scenes have one header
        self.header: list[Any] = []
        self.artists: list[Any] = []
        self.background: Any = None  # what all frames share, as pixels
        self.titled: tuple[Any, Any] = (None, None)  # a stage, and the background with its header, as pixels
        gap = _WIDTH - 2 * (_PANEL + _LEFT)
        self.observed, self.truth = (
            self._panel(_LEFT + place * (_PANEL + gap), title)
            for place, title in enumerate(("What the detector sees", name_answer(record)))
        )
        self._draw_legend()

    def _panel(self, left: float, title: str) -> Axes:
        axes = self.figure.add_axes((left / _WIDTH, _BOTTOM / _HEIGHT, _PANEL / _WIDTH, _PANEL / _HEIGHT))
        known = self.record.position[self.record.seen & self.record.alive[:, None]]
        x, y, half = limits_around(known, 0.08, 1e-6 if self.record.recorded else 1.0)
        axes.set_xlim(x - half, x + half)
        axes.set_ylim(y - half, y + half)
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_facecolor("white")  # exact in the palette of a GIF
        for side in axes.spines.values():
            side.set_color("#CCCCCC")
        axes.set_title(title, fontsize=11, loc="left", pad=4)
        if 2 * half > 2 * _SCALE_BAR:
            right, bottom = x + 0.95 * half, y - 0.93 * half
            axes.plot([right - _SCALE_BAR, right], [bottom, bottom], color="#333333", linewidth=1.5)
            label = f"{_SCALE_BAR:.0f} m"
            axes.text(right - _SCALE_BAR / 2, bottom, label, ha="center", va="bottom", fontsize=8, color="#333333")
        return axes

    def _draw_legend(self) -> None:
        from matplotlib.lines import Line2D

        def mark(**style: Any) -> Line2D:
            return Line2D([], [], linestyle="none", **style)

        ring: dict[str, Any] = {"color": "none", "marker": "o", "markersize": 11, "markeredgewidth": 2}
        keys = {
            "candidate": mark(markeredgecolor=_NAMED, **ring),
            "head": mark(marker="*", color="#555555", markeredgecolor="black", markersize=13),
            "follower, colour of its head": mark(marker="o", color="#555555", markersize=5),
            "hit": mark(markeredgecolor=HIT, **ring),
            "redundant": mark(markeredgecolor=REDUNDANT, **ring | {"marker": "s", "markersize": 9}),
            "head not named": Line2D([], [], color=MISSED, linestyle=_DASHES, linewidth=1.3),
            "destroyed": mark(marker="x", color="black", markersize=7, markeredgewidth=1.8),
        }
        if not self.record.labelled:
            keys = {"leader": keys["head"], "follower, colour of its leader": keys["follower, colour of its head"]}
        elif self.record.recorded:
            del keys["destroyed"]
        if self.record.decoy.any():
            keys["decoy"] = mark(marker="D", color="white", markeredgecolor="black", markersize=6)
        self.figure.legend(
            list(keys.values()), list(keys), loc="lower center", ncols=len(keys), frameon=False, fontsize=9.5,
            handletextpad=0.3, columnspacing=1.3, bbox_to_anchor=(0.5, 0.005),
        )  # fmt: skip

    def _draw_header(self, scene: Scene) -> None:
        def write(x: float, y: float, text: str, **style: Any) -> None:
            self.header.append(self.figure.text(x / _WIDTH, 1 - y / _HEIGHT, text, va="baseline", **style))

        write(_LEFT, 0.33, f"{name_round(self.record)} {scene.round}", fontsize=15, weight="bold")
        right = 0.35 if self.record.recorded else 0.0  # the word "Window" is longer than "Round"
        known = _KNOWN_PHASES if self.record.recorded else _PHASES
        for phase, word in enumerate(known if self.record.labelled else _TRACK_PHASES):
            now = phase == scene.phase
            style: dict[str, Any] = {"weight": "bold", "color": _NAMED} if now else {"color": "#A0A0A0"}
            write(_PHASE_PLACES[phase] + right, 0.33, word, fontsize=11.5, **style)
        write(_WIDTH - _LEFT, 0.33, scene.score, fontsize=11.5, ha="right")
        write(_LEFT, 0.63, scene.text, fontsize=11.5)

    def _scatter(self, axes: Axes, place: NDArray[np.float32], who: NDArray[np.bool_], **style: Any) -> None:
        if who.any():
            self.artists.append(axes.scatter(place[who, 0], place[who, 1], **style))

    def _lines(self, axes: Axes, lines: NDArray[np.float32], **style: Any) -> None:
        from matplotlib.collections import LineCollection

        if len(lines):
            self.artists.append(axes.add_collection(LineCollection(list(lines), **style), autolim=False))

    def _draw_observed(self, scene: Scene, place: NDArray[np.float32], path: NDArray[np.float32]) -> None:
        """The left map: equal dots and tracks, rings around the candidates."""
        record, r = self.record, scene.round - 1
        gone = ~record.alive[r] | (record.destroyed[r] & (scene.phase >= _DESTROY))
        self._lines(self.observed, path[~gone], colors=_UNKNOWN, linewidths=0.9, alpha=0.75, zorder=2)
        self._scatter(self.observed, place, ~gone, s=17, c=_UNKNOWN, edgecolors="white", linewidths=0.4, zorder=3)
        self._draw_destroyed(self.observed, scene, place)
        if scene.phase in (_NAME, _DESTROY):
            ring: dict[str, Any] = {"facecolors": "none", "edgecolors": _NAMED, "linewidths": 2.0, "zorder": 6}
            self._scatter(self.observed, place, record.candidates[r], s=170, **ring)

    def _draw_destroyed(self, axes: Axes, scene: Scene, place: NDArray[np.float32]) -> None:
        """Crosses: grey for UAVs of earlier rounds, black for those of this round."""
        record, r = self.record, scene.round - 1
        style: dict[str, Any] = {"s": 30, "marker": "x", "linewidths": 1.4, "zorder": 2.5}
        self._scatter(axes, record.last_position(scene.round), ~record.alive[r], c="#B0B0B0", **style)
        if scene.phase >= _DESTROY:
            style |= {"s": 70, "linewidths": 1.9, "zorder": 7}
            self._scatter(axes, place, record.destroyed[r], c="black", **style)

    def _draw_truth(self, scene: Scene, place: NDArray[np.float32], path: NDArray[np.float32]) -> None:
        """The right map: clusters in colour, links to the heads, the verdict, and the orphans' new heads.

        Where the truth is unknown it shows what the detector found.
        """
        record, r = self.record, scene.round - 1
        head, candidates = record.head, record.candidates[r]
        root = record.root[r]
        if not record.labelled:  # the answer, once it is given
            head = candidates & (scene.phase >= _NAME)
            root = root if scene.phase >= _NAME else np.full_like(root, -1)
        gone = ~record.alive[r] | (record.destroyed[r] & (scene.phase >= _DESTROY))
        orphan = record.orphans[r] & (scene.phase >= _DESTROY)
        new = record.root[r + 1] if scene.phase == _REMERGE else np.full_like(root, -1)
        moved = orphan & (new >= 0)
        end = place[np.maximum(root, 0), :2]
        end[moved] += np.float32(scene.turn) * (place[new[moved], :2] - end[moved])
        colors = np.where(orphan, _ORPHAN, cluster_colors(head, root)[0])
        if scene.turn == 1.0:  # the orphans have the colour of their new heads
            colors = np.where(moved, cluster_colors(head, new)[0], colors)
        follower = ~gone & ~head & ~record.decoy
        linked = follower & (root >= 0) & (~orphan | moved)
        links = np.stack([place[:, :2], end], axis=1)
        self._lines(self.truth, links[linked], colors=colors[linked], linewidths=0.7, alpha=0.4, zorder=1)
        self._lines(self.truth, path[~gone], colors=colors[~gone], linewidths=1.1, alpha=0.9, zorder=2)
        self._scatter(
            self.truth, place, follower, s=17, c=colors[follower], edgecolors="white", linewidths=0.4, zorder=3
        )
        stars = head & ~gone
        self._scatter(
            self.truth, place, stars, s=150, c=colors[stars], marker="*", edgecolors="black", linewidths=0.8, zorder=5
        )
        decoys = record.decoy & ~gone
        self._scatter(
            self.truth, place, decoys, s=34, c="white", marker="D", edgecolors="black", linewidths=1, zorder=4
        )
        self._draw_destroyed(self.truth, scene, place)
        if scene.phase == _DESTROY:
            ring: dict[str, Any] = {"facecolors": "none", "linewidths": 2.2, "zorder": 6}
            self._scatter(self.truth, place, candidates & head, s=230, edgecolors=HIT, **ring)
            self._scatter(self.truth, place, candidates & ~head, s=170, marker="s", edgecolors=REDUNDANT, **ring)
            missed = head & record.alive[r] & ~candidates
            self._scatter(
                self.truth, place, missed, s=230, edgecolors=MISSED, linestyles=[_DASHES], **ring | {"linewidths": 1.3}
            )

    def _draw(self, scene: Scene) -> None:
        """Draw one scene into the figure in place of the one before."""
        record, r = self.record, scene.round - 1
        for artist in self.artists:
            artist.remove()
        self.artists = []
        if self.stage != (scene.round, scene.phase):
            for artist in self.header:
                artist.remove()
            self.stage, self.header = (scene.round, scene.phase), []
            self._draw_header(scene)
        seen = record.seen[r, : scene.samples] & record.alive[r]
        position = record.position[r, : scene.samples]
        place = last_seen_position(position, seen)
        path = np.swapaxes(np.where(seen[..., None], position[..., :2], np.float32(np.nan)), 0, 1)
        self._draw_observed(scene, place, path)
        self._draw_truth(scene, place, path)

    def _paint(self, scene: Scene, header: bool) -> NDArray[np.uint8]:
        """One scene as ``(H, W, 3)`` uint8. Writing takes most of the time, so each header is drawn once."""
        canvas: Any = self.figure.canvas
        if self.background is None:
            canvas.draw()
            self.background = canvas.copy_from_bbox(self.figure.bbox)
        self._draw(scene)
        if header and self.titled[0] != self.stage:
            canvas.restore_region(self.background)
            for artist in self.header:
                self.figure.draw_artist(artist)
            self.titled = self.stage, canvas.copy_from_bbox(self.figure.bbox)
        canvas.restore_region(self.titled[1] if header else self.background)
        for artist in sorted(self.artists, key=lambda each: float(each.get_zorder())):
            self.figure.draw_artist(artist)
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    def pixels(self, scene: Scene) -> NDArray[np.uint8]:
        """One scene, ``(H, W, 3)`` uint8."""
        return self._paint(scene, header=True)

    def maps(self, scene: Scene) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """The two maps alone, what the detector sees and the truth, ``(H, W, 3)`` uint8 each."""
        frame = self._paint(scene, header=False)
        side = int(_PANEL * _DPI)
        corners = ((int(axes.bbox.x0), len(frame) - int(axes.bbox.y1)) for axes in (self.observed, self.truth))
        left, right = (frame[y : y + side, x : x + side] for x, y in corners)
        return left, right


def reduce_colors(
    frames: Sequence[NDArray[np.uint8]], samples: Sequence[NDArray[np.uint8]], colors: int
) -> list[Image]:
    """Pictures with one palette for all frames, without dithering: unchanged areas stay equal.

    Args:
        frames: ``(H, W, 3)`` uint8 each.
        samples: the frames from which the palette is chosen, all of one width.
        colors: size of the palette, up to 256.
    """
    from PIL import Image  # comes with matplotlib, whose absence the painter reports

    palette = Image.fromarray(np.concatenate(samples)).quantize(colors, method=Image.Quantize.MAXCOVERAGE)
    return [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]


def _write_gif(record: EpisodeRecord, shown: list[Scene], path: Path) -> None:
    from PIL import Image

    painter = Painter(record)
    frames = [painter.pixels(scene) for scene in shown]
    samples = [frame for frame, scene in zip(frames, shown, strict=True) if scene.phase]
    first, *others = reduce_colors(frames, samples, _GIF_COLORS)
    colors, before, changes = first.getpalette() or [], np.asarray(first), []
    for frame in others:  # what has not changed is transparent
        now = np.asarray(frame)
        changes.append(Image.fromarray(np.where(now == before, np.uint8(_GIF_COLORS), now)))
        changes[-1].putpalette(colors)
        before = now
    durations = [round(1000 * scene.seconds) for scene in shown]
    first.save(
        path, format="GIF", save_all=True, append_images=changes, duration=durations, loop=0,
        transparency=_GIF_COLORS, disposal=1, optimize=False,
    )  # fmt: skip


def _find_ffmpeg() -> str | None:
    """The path of ffmpeg: of the one that moviepy installs, or the system's; ``None`` without any."""
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        return shutil.which("ffmpeg")


def _write_mp4(record: EpisodeRecord, shown: list[Scene], path: Path, ffmpeg: str) -> None:
    painter = Painter(record)
    height, width = painter.pixels(shown[0]).shape[:2]
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(_MP4_RATE), "-i", "-"]
    target = ["-f", "mp4", "-pix_fmt", "yuv420p", "-crf", "26", os.fspath(path)]
    process = subprocess.Popen(
        [ffmpeg, "-loglevel", "error", "-y", *source, *target], stdin=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError):  # its exit status says why
        for scene in shown:
            frame = painter.pixels(scene).tobytes()
            for _ in range(max(1, round(scene.seconds * _MP4_RATE))):
                process.stdin.write(frame)
    _, said = process.communicate()
    if process.returncode:
        raise OSError(f"ffmpeg failed: {' '.join(said.decode(errors='replace').split())}")


def animate(record: EpisodeRecord, path: str | os.PathLike[str], *, frames: int = 20) -> Path:
    """Write an animation of an episode; the file appears whole.

    Two maps from above share fixed axes. The left one shows what the detector sees: equal dots whose tracks grow, then
    rings around its candidates. The right one shows the truth: heads as stars, followers in the colour of their head,
    hits, redundant candidates, destroyed UAVs, and how followers without a head join another one.

    Args:
        record: the episode.
        path: where to; the suffix ``.gif`` or ``.mp4`` chooses the format. An existing file is replaced.
        frames: frames in which the tracks of one window grow.

    Returns:
        The path.

    Raises:
        ArgumentError: ``record`` is no record, ``path`` has another suffix or can't be written to, ``frames`` is below
            2, or an MP4 is asked for and ffmpeg is not installed.
        MissingExtraError: matplotlib is not installed.
    """
    frames = whole_number("frames", frames, 2)
    suffix = as_path("path", path).suffix.lower()
    if suffix not in (".gif", ".mp4"):
        raise ArgumentError(f"path must end in .gif or .mp4, got {quote(os.fspath(path))}.")
    shown = list(scenes(check_record(record), frames))
    ffmpeg = _find_ffmpeg() if suffix == ".mp4" else None
    if suffix == ".mp4" and ffmpeg is None:
        raise ArgumentError(f"path must end in .gif where ffmpeg is not installed, got {quote(os.fspath(path))}.")
    with atomic_write(path) as aside:
        if ffmpeg is None:
            _write_gif(record, shown, aside)
        else:
            _write_mp4(record, shown, aside, ffmpeg)
    return Path(path)

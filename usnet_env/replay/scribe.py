"""What all parts of a Rerun recording share: its timelines, its colours, and one way to write rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.drawing import last_seen_position
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.story import HIT, LEADER, MISSED, OTHER, REDUNDANT, mark_words

if TYPE_CHECKING:
    import rerun as rr

_WATCH_SECONDS, _BEAT_SECONDS = 6.0, 2.0  # of the timeline "time": a window, and the pause after each beat
HIT_COLOR = "#1ED9A0"
#: Colours of the marks in a dark view.
MARK_COLORS = {HIT: HIT_COLOR, LEADER: HIT_COLOR, REDUNDANT: "#FF7A1A", MISSED: "#F5F5F5", OTHER: "#6A6A6A"}
_USUAL_SPAN = 800.0  # metres: a swarm may be smaller or larger, and all sizes with it


def list_steps(record: EpisodeRecord) -> NDArray[np.int64]:
    """List the simulated step of every sample, ``(R, T_ob + 1)`` int64, counted from the start of the swarm.

    A round begins with ``memory`` unobserved steps after a re-merge; the window follows, with a sample every
    ``sample_every`` steps. Where ``config`` lacks these two, the steps count the samples.
    """
    every, memory = int(record.config.get("sample_every", 1)), int(record.config.get("memory", 0))
    samples = record.position.shape[1]
    flown = memory + (samples - 1) * every
    return flown * np.arange(record.rounds)[:, None] + memory + every * np.arange(samples)[None]


class Clock:
    """The timelines of a recording: ``round``, ``step`` and ``time``.

    A round has T_ob + 1 samples and three beats after them: the answer, the destruction, the re-merge. ``step`` counts
    simulated steps; the last two beats are in the unobserved steps after the window. ``time`` is in seconds of the
    replay: a window takes 6 s, and each beat is followed by a pause of 2 s.

    Attributes:
        samples: T_ob + 1.
        answer, destroy, remerge: the indices of the beats among the instants of a round.
        steps: ``(R, T_ob + 4)`` int64, the step of each instant.
        seconds: ``(R, T_ob + 4)``, the time of each instant.
    """

    def __init__(self, record: EpisodeRecord) -> None:
        steps = list_steps(record)
        self.samples = steps.shape[1]
        self.answer, self.destroy, self.remerge = range(self.samples, self.samples + 3)
        unobserved = int(record.config.get("memory", 0))
        beats = steps[:, -1:] + np.minimum([0, 1, 2], unobserved)
        self.steps = np.concatenate([steps, beats], axis=1)
        watched = np.linspace(0.0, _WATCH_SECONDS, self.samples)
        within = np.concatenate([watched, _WATCH_SECONDS + 0.25 + _BEAT_SECONDS * np.arange(3)])
        self.seconds = within + (_WATCH_SECONDS + 3 * _BEAT_SECONDS + 0.5) * np.arange(record.rounds)[:, None]

    def list_rows(self, instants: Iterable[int]) -> list[tuple[int, int]]:
        """List the rows of an entity that changes at these instants of every round: round, from 0, and instant."""
        return [(r, instant) for r in range(len(self.steps)) for instant in instants]


def parse_color(color: str, alpha: int = 255) -> tuple[int, int, int, int]:
    """Parse ``"#RRGGBB"``."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16), alpha


def lighten(colors: Iterable[str], alpha: int = 255) -> NDArray[np.uint8]:
    """Lighten colours made for white paper for a dark view: ``(n, 4)`` uint8."""
    paper = np.array([parse_color(color, alpha) for color in colors], np.float64).reshape(-1, 4)
    return np.where(np.arange(4) < 3, 90 + 0.65 * paper, paper).astype(np.uint8)


def _box(record: EpisodeRecord) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """The lowest and highest coordinates that were seen in each round; those of the round before if there are none."""
    boxes: list[tuple[NDArray[np.float32], NDArray[np.float32]]] = []
    for position, seen in zip(record.position, record.seen, strict=True):
        if seen.any():
            boxes.append((position[seen].min(axis=0), position[seen].max(axis=0)))
        else:
            boxes.append(boxes[-1] if boxes else (np.zeros(3, np.float32),) * 2)
    return boxes


class Scribe:
    """Writes rows of one episode into a stream.

    A row belongs to an instant of a round. Entities of UAVs have the same instances in every row, in the same order:
    what is not shown is NaN. So colours and labels are written once, and not with every position.

    Args:
        record: the episode.
        stream: of the recording.
        root: the first part of all paths, such as ``"a/"``, if a recording holds several episodes.
        color: of all curves of the episode; ``None``: each curve has its own.
    """

    def __init__(
        self, record: EpisodeRecord, stream: rr.RecordingStream, root: str = "", color: str | None = None
    ) -> None:
        import rerun

        self.rr, self.record, self.stream, self.root, self.color = rerun, record, stream, root, color
        self.clock = Clock(record)
        self.boxes = _box(record)
        self.span = max(*(float((high - low).max()) for low, high in self.boxes), 1e-6 if record.recorded else 1.0)
        self.scale = self.span / _USUAL_SPAN
        self.last = np.stack([last_seen_position(*each) for each in zip(record.position, record.seen, strict=True)])
        self.marks = [mark_words(record, number) for number in range(1, record.rounds + 1)]
        ids = record.config.get("ids")  # of recorded tracks
        self.names = [str(each) for each in (range(record.uavs) if ids is None else ids)]

    def send(
        self,
        path: str,
        kind: Any,
        rows: Sequence[tuple[int, int]],
        lengths: int | Sequence[int],
        look: Mapping[str, Any] | None = None,
        **columns: Any,
    ) -> None:
        """Write rows, and once the look that all rows share.

        Args:
            path: of the entity, after the root.
            kind: the archetype.
            rows: round and instant of each row, from 0.
            lengths: number of instances in each row, or in all rows.
            look: components that do not change.
            columns: components of all rows, one row after the other.
        """
        made = kind.columns(**columns).partition(np.broadcast_to(lengths, len(rows)))
        self.stream.send_columns(self.root + path, self._times(rows), made)
        if look:
            self.stream.log(self.root + path, kind.from_fields(**look), static=True)

    def show_with_answer(
        self, path: str, kind: Any, values: Sequence[Mapping[str, Any]], look: Mapping[str, Any] | None = None
    ) -> None:
        """Write instances that are shown from the answer of each round on, until the next round begins.

        Args:
            path: of the entity, after the root.
            kind: the archetype.
            values: for each round the components, each with a value for every instance.
            look: components that do not change.
        """
        counts = [count for each in values for count in (0, len(next(iter(each.values()))))]
        joined: dict[str, Any] = {}
        for name in values[0]:
            parts = [each[name] for each in values]
            joined[name] = (
                np.concatenate(parts) if isinstance(parts[0], np.ndarray) else [item for part in parts for item in part]
            )
        self.send(path, kind, self.clock.list_rows([0, self.clock.answer]), counts, look, **joined)

    def log_at(self, path: str, r: int, instant: int, value: Any) -> None:
        """Write one row that has no columns."""
        for column, number in zip(("round", "step"), (r + 1, self.clock.steps[r, instant]), strict=True):
            self.stream.set_time(column, sequence=int(number))
        self.stream.set_time("time", duration=float(self.clock.seconds[r, instant]))
        self.stream.log(self.root + path, value)
        self.stream.reset_time()

    def _times(self, rows: Sequence[tuple[int, int]]) -> list[Any]:
        r, instant = np.array(rows).T
        column = self.rr.TimeColumn
        return [
            column("round", sequence=r + 1),
            column("step", sequence=self.clock.steps[r, instant]),
            column("time", duration=self.clock.seconds[r, instant]),
        ]

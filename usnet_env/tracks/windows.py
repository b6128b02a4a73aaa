"""Cut resampled tracks into windows that detectors take, with the ids and times kept beside."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, format_number, quote
from usnet_env.window import Window

if TYPE_CHECKING:
    from usnet_env.tracks.tracks import Tracks


@dataclass(frozen=True, eq=False)
class TrackWindow:
    """A window of recorded tracks, with what a :class:`usnet_env.Window` doesn't hold.

    Args:
        window: what a detector takes. Its velocities are the differences of the positions, metres per step, and its
            ``step`` is in seconds.
        ids: the ids of the N UAVs of the window, as in the file.
        rows: ``(N,)`` int64, index of each in ``Tracks.ids``.
        start: seconds of the first instant after the start of the tracks.
        end: seconds of the last instant.
        step: seconds between instants.
        origin: ``(3,)`` metres; add it to the window's positions to get those of the tracks.
        leader: ``(N,)`` int64, index in the window of the id that each follows through most of the window (-1: none or
            one that is not in the window), or ``None`` if the file has no leaders.
        left_out: the ids that are seen in the window, but in too few of its steps.
    """

    window: Window
    ids: tuple[str | int, ...]
    rows: NDArray[np.int64]
    start: float
    end: float
    step: float
    origin: NDArray[np.float64]
    leader: NDArray[np.int64] | None = None
    left_out: tuple[str | int, ...] = ()


def count_windows(tracks: Tracks, length: int, stride: int) -> int:
    """Number of windows of ``length`` steps, every ``stride`` steps, in resampled tracks."""
    assert tracks.step is not None
    steps = round(tracks.duration / tracks.step)
    return 0 if steps < length else (steps - length) // stride + 1


def describe_rest(tracks: Tracks, length: int, stride: int) -> list[str]:
    """A sentence about the end of resampled tracks that no window covers, none if there is no such end.

    It names arguments that cover the end: the longest stride that leaves no step, with at most twice as many windows,
    or else, if windows don't overlap, the shortest longer window.
    """
    assert tracks.step is not None
    count, steps = count_windows(tracks, length, stride), round(tracks.duration / tracks.step)
    rest = tracks.duration - tracks.step * ((count - 1) * stride + length)
    if not count or rest < tracks.step / 2:
        return []
    free = steps - length
    strides = [free // more for more in range(count, 2 * count) if free % more == 0]
    lengths = [steps // fewer for fewer in range(count, count // 2, -1) if steps % fewer == 0]
    advice = ""
    if strides:
        advice = f" (stride={strides[0]} covers them)"
    elif stride == length and lengths and lengths[0] < steps:
        advice = f" (length={lengths[0]} covers them)"
    return [f"The last {format_number(rest)} s are in no window{advice}."]


def cut_windows(tracks: Tracks, length: int, stride: int, least_steps: int) -> Iterator[TrackWindow]:
    """Cut resampled tracks into windows; see :meth:`Tracks.windows`.

    Raises:
        ArgumentError: the tracks are shorter than one window.
    """
    assert tracks.step is not None
    count = count_windows(tracks, length, stride)
    if not count:
        steps = round(tracks.duration / tracks.step)
        if steps < 2:
            raise ArgumentError(f"step must be shorter: the tracks last less than two steps, got {tracks.step:g} s.")
        raise ArgumentError(
            f"length must be at most {steps}, the number of steps of {tracks.step:g} s "
            f"in the tracks, got {quote(length)}."
        )
    number = np.round(tracks.time / tracks.step).astype(np.int64)
    known = np.unique(number)
    starts = np.arange(count) * stride
    filled = np.searchsorted(known, starts + length, side="right") > np.searchsorted(known, starts)
    cuts = (_cut(tracks, number, int(first), length, least_steps) for first in starts[filled])
    return (cut for cut in cuts if cut is not None)


def _cut(tracks: Tracks, number: NDArray[np.int64], first: int, length: int, least_steps: int) -> TrackWindow | None:
    """Cut the window that begins at grid time ``first``; ``None`` if fewer than two ids are seen long enough."""
    step = float(tracks.step or 0.0)
    inside = np.flatnonzero((number >= first) & (number <= first + length))
    owner = np.searchsorted(tracks.offsets, inside, side="right") - 1
    rows, column = np.unique(owner, return_inverse=True)
    seen = np.zeros((length + 1, len(rows)), bool)
    seen[number[inside] - first, column] = True
    enough = (seen[1:] & seen[:-1]).sum(axis=0) >= least_steps
    if enough.sum() < 2:
        return None
    kept = enough[column]
    left_out = tuple(tracks.ids[i] for i in rows[~enough])
    inside, column = inside[kept], (np.cumsum(enough) - 1)[column[kept]]
    rows, seen = rows[enough], seen[:, enough]
    at = number[inside] - first
    origin = tracks.position[inside].mean(axis=0)
    position = np.zeros((length + 1, len(rows), 3))
    position[at, column] = tracks.position[inside] - origin
    both = seen[1:] & seen[:-1]
    velocity = np.where(both[..., None], np.diff(position, axis=0), 0.0)
    return TrackWindow(
        window=Window(
            position.astype(np.float32), velocity.astype(np.float32), seen, np.ones(len(rows), bool), step=step
        ),
        ids=tuple(tracks.ids[i] for i in rows),
        rows=rows.astype(np.int64),
        start=first * step,
        end=(first + length) * step,
        step=step,
        origin=origin,
        leader=None if tracks.leader is None else _usual_leaders(tracks.leader[inside], column, rows),
        left_out=left_out,
    )


def _usual_leaders(leader: NDArray[np.int64], column: NDArray[np.intp], rows: NDArray[np.intp]) -> NDArray[np.int64]:
    """The leader that each of the window's UAVs has in most of its samples, as an index in the window."""
    pairs, counts = np.unique(np.stack([column, leader], axis=1), axis=0, return_counts=True)
    order = np.lexsort((-counts, pairs[:, 0]))
    first = np.unique(pairs[order, 0], return_index=True)[1]
    usual = pairs[order][first, 1]
    place = np.searchsorted(rows, usual)
    known = (usual >= 0) & (place < len(rows))
    return np.where(known & (rows[np.minimum(place, len(rows) - 1)] == usual), place, -1).astype(np.int64)

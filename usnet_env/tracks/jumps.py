"""Steps that are much faster than the others, and single samples off the track."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats

if TYPE_CHECKING:
    from usnet_env.tracks.tracks import Tracks

JUMP = 5.0  # a jump is faster than this many times the speed that 95 % of the steps don't exceed
_USUAL_SHARE = 0.95
_GROSS = 20.0  # times the usual speed; such a jump has the squared length of more than 400 steps


class Jumps(NamedTuple):
    """The jumps of some tracks.

    Args:
        steps: indices of the samples after which a track jumps.
        spikes: indices of the samples to and from which a track jumps, although the way past them is no jump.
        speed: ``(S - 1,)`` metres per second from each sample to the next of its id; 0 between ids.
        usual: the speed that 95 % of the steps of moving ids don't exceed.
    """

    steps: NDArray[np.intp]
    spikes: NDArray[np.intp]
    speed: Floats
    usual: float


def find_jumps(tracks: Tracks) -> Jumps:
    """Find the steps that are more than 5 times as fast as 95 % of the steps, and the single samples off the track."""
    squares = np.zeros(max(tracks.samples - 1, 0))
    for axis in range(3):
        squares += np.diff(tracks.position[:, axis]) ** 2
    speed = np.sqrt(squares) / np.where(tracks.inner_steps, np.diff(tracks.time), np.inf)
    moving = speed[speed > 0]
    usual = float(np.quantile(moving, _USUAL_SHARE)) if len(moving) else 0.0
    fast = speed > JUMP * usual
    between = np.flatnonzero(fast[:-1] & fast[1:]) + 1
    past = np.linalg.norm(tracks.position[between + 1] - tracks.position[between - 1], axis=1)
    returns = past <= JUMP * usual * (tracks.time[between + 1] - tracks.time[between - 1])
    return Jumps(np.flatnonzero(fast), between[returns], speed, usual)


def leave_out_spikes(tracks: Tracks) -> Tracks:
    """The tracks without the single samples that lie off them."""
    spikes = find_jumps(tracks).spikes
    if not len(spikes):
        return tracks
    keep = np.ones(tracks.samples, bool)
    keep[spikes] = False
    time, position = tracks.time[keep], tracks.position[keep]
    for array in (time, position):
        array.setflags(write=False)
    return replace(
        tracks,
        offsets=tracks.offsets - np.searchsorted(spikes, tracks.offsets),
        time=time,
        position=position,
        velocity=None if tracks.velocity is None else tracks.velocity[keep],
        leader=None if tracks.leader is None else tracks.leader[keep],
    )


def close_jumps(tracks: Tracks) -> Tracks:
    """The tracks with gross jumps, 20 times as fast as usual, of no length: each goes on from where it was before."""
    found = find_jumps(tracks)
    jumps = found.steps[found.speed[found.steps] > _GROSS * found.usual]
    if not len(jumps):
        return tracks
    moved = np.zeros_like(tracks.position)
    moved[jumps + 1] = tracks.position[jumps + 1] - tracks.position[jumps]
    moved = np.cumsum(moved, axis=0)  # within an id: all jumps up to a sample, less those of the ids before
    first = np.repeat(tracks.offsets[:-1], np.diff(tracks.offsets))
    position = tracks.position - (moved - moved[first])
    position.setflags(write=False)
    return replace(tracks, position=position)

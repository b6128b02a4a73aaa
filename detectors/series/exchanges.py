"""Identities that a tracker exchanged: two UAVs jump at the same instant, each to where the other one goes on."""

from __future__ import annotations

import numpy as np

from usnet_env.arrays import Indices
from usnet_env.window import Window

_USUAL, _JUMP, _FIT = 0.95, 2.0, 1.3  # a quantile of the lengths of steps; a jump and what fits, by that length


def undo_exchanges(window: Window) -> Window:
    """Join the parts of tracks again where two UAVs exchanged identities.

    The usual step is at least as long as 95 % of those that are seen; a jump is over twice as long. Two UAVs
    exchanged identities if both jump at the same instant, and each ends within 1.3 usual steps of where the other one
    was. An exchange of UAVs that were hardly apart has no jumps, and stays.

    Returns:
        A window whose identities are those of its first instant; the same one if none was exchanged.

    >>> position = np.zeros((101, 2, 3))
    >>> position[..., 0], position[..., 1] = np.arange(101)[:, None], (0, 9)
    >>> position[30:] = position[30:, ::-1]
    >>> window = Window(position, np.diff(position, axis=0), np.ones((101, 2)), np.ones(2))
    >>> undo_exchanges(window).position[-1, :, 1].tolist()
    [0.0, 9.0]
    """
    moved = np.diff(window.position, axis=0)
    length = np.where(window.velocity_seen, np.linalg.norm(moved, axis=2), 0.0)  # (T, N)
    moves = length[length > 0]
    usual = float(np.quantile(moves, _USUAL)) if len(moves) else 0.0
    jumps = length > _JUMP * usual
    track = np.tile(np.arange(window.uavs), (len(window.position), 1))  # (T + 1, N), the track of each identity
    for t in np.flatnonzero(jumps.sum(axis=1) >= 2).tolist() if usual else ():
        for pair in _pair_jumps(window, t, np.flatnonzero(jumps[t]), _FIT * usual):
            identities = [int(np.flatnonzero(track[t + 1] == uav)[0]) for uav in pair]
            track[t + 1 :, identities] = track[t + 1 :, identities[::-1]]
    if (track == track[0]).all():
        return window
    instants = np.arange(len(track))[:, None]
    position, seen = window.position[instants, track], window.seen[instants, track]
    joined = (track[1:] != track[:-1])[..., None]
    flown = float(np.linalg.norm(window.velocity[window.velocity_seen], axis=1).sum())
    steps = max(round(float(length.sum()) / max(flown, 1e-9)), 1)  # from a sample to the next
    velocity = np.where(joined, np.diff(position, axis=0) / steps, window.velocity[instants[:-1], track[:-1]])
    return Window(position, velocity, seen, window.alive, window.round, window.step)


def _pair_jumps(window: Window, t: int, jumping: Indices, most: float) -> list[tuple[int, int]]:
    """Of the UAVs that jump in step t, the pairs that end at most so far from where the other one was."""
    before, after = window.position[t, jumping], window.position[t + 1, jumping]
    apart = np.linalg.norm(after - before[:, None], axis=2)
    apart = np.maximum(apart, apart.T)
    np.fill_diagonal(apart, np.inf)
    nearest = apart.argmin(axis=1)
    pairs = [(a, int(b)) for a, b in enumerate(nearest) if a < b and nearest[b] == a and apart[a, b] <= most]
    return [(int(jumping[a]), int(jumping[b])) for a, b in pairs]

"""Followers that may lead, by a clock that is late."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from usnet_env.config import format_seconds
from usnet_env.series import centre_columns, correlate_at_lag, scale_to_unit
from usnet_env.tracks.found import Found, Name
from usnet_env.tracks.links import cut_velocities
from usnet_env.tracks.tracks import Tracks, TrackWindow

_MIN_SHARE_AHEAD, _MIN_GROUP, _MAX_COMPARED = 0.75, 4, 20  # of a group: those ahead, and its size


def describe_late_clocks(found: Sequence[Found], fine: Tracks) -> list[str]:
    """A sentence about each leader of which a follower may lead, in more than half of its windows."""
    hubs_of: dict[Name, list[tuple[Name, float] | None]] = {}
    for track_window, _, window in found:
        for leader in window.leaders:
            head, *followers = map(track_window.ids.index, (leader.id, *leader.followers))
            hub = _find_late_clock(fine, track_window, head, followers)
            hubs_of.setdefault(leader.id, []).append(hub and (track_window.ids[hub[0]], hub[1]))
    sentences = []
    for name, hubs in hubs_of.items():
        if 2 * len(late_hubs := [hub for hub in hubs if hub]) > len(hubs):
            comes = f"{late_hubs[0][0]} comes {format_seconds(late_hubs[0][1], 2)} after {name}"
            agrees = f"agrees better with those that follow {name}: if its clock is late, it leads."
            sentences.append(f"{comes}, but {agrees}")
    return sentences


def _find_late_clock(
    fine: Tracks, track_window: TrackWindow, leader: int, followers: Sequence[int]
) -> tuple[int, float] | None:
    """The follower that agrees best with all others but comes last, and how many seconds after the leader.

    Ids that copy a leader agree with none as well as with it, so such a follower may lead, by a clock that is late. It
    is behind three quarters of the group, of which at most 20 are looked at, at the sampling interval.
    """
    group = [leader, *followers][:_MAX_COMPARED]
    _, velocity, seen, _, longest = cut_velocities(fine, track_window, group)
    if len(group) < _MIN_GROUP or longest < 1:
        return None
    unit = scale_to_unit(centre_columns(velocity, seen), least=0.0)
    curves = np.array([correlate_at_lag(unit, unit, lag) for lag in range(-longest, longest + 1)])
    lag, similarity = curves.argmax(axis=0) - longest, curves.max(axis=0)  # of each, after each
    np.fill_diagonal(similarity, 0.0)
    hub = int(similarity.sum(axis=1).argmax())
    if lag[hub, 0] <= 0 or (lag[hub] > 0).sum() < _MIN_SHARE_AHEAD * (len(group) - 1):
        return None
    return group[hub], float(lag[hub, 0] * (fine.step or 1.0))

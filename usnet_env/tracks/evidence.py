"""Why an id is named: how its followers repeat its velocity later, and how much of this chance would do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd

from usnet_env.arrays import Floats
from usnet_env.config import format_count, format_seconds
from usnet_env.tracks.found import Link
from usnet_env.tracks.links import compare_ways, cut_velocities, find_peak, shift_past
from usnet_env.tracks.tracks import Tracks, TrackWindow

_PARTS = 8  # of the window, the longest lag is one: then shifts in time of more than all lags are left
_SHIFTS = 19  # in time: the largest of so many is exceeded by chance in 5 %


class HeadCurves(NamedTuple):
    """How n followers repeat the velocity of their head at K lags."""

    lags: Floats  # (K,) seconds; a follower comes later if they are positive
    correlation: Floats  # (n, K)
    by_chance: Floats  # (n,) the largest correlation at any lag after 19 shifts in time
    path: Floats  # (n,) mean squared distance to where the head was, as a share of that to where it is


def compare_with_head(
    fine: Tracks, track_window: TrackWindow, head: int, followers: Sequence[int]
) -> HeadCurves | None:
    """Correlate the velocities of followers with that of their head, in a window; ``None`` if it is too short."""
    position, velocity, known, _, longest = cut_velocities(fine, track_window, [head, *followers])
    longest = min(longest, len(velocity) // _PARTS)
    if longest < 1 or not len(followers):
        return None
    step, lags = float(fine.step or 1.0), np.arange(-longest, longest + 1)
    behind, past = shift_past(velocity[:, 1:], velocity[:, :1], known[:, 1:], lags)
    then = past[0].reshape(len(lags), -1)
    size = np.sqrt(np.maximum((behind**2).sum(axis=(1, 2))[:, None] * (then**2).sum(axis=1), 1e-300))
    shifts = np.linspace(2 * longest, behind.shape[1] - 2 * longest, _SHIFTS).astype(int)
    curves = [np.roll(behind, shift, axis=1).reshape(len(behind), -1) @ then.T / size for shift in (0, *shifts)]
    path = compare_ways(position, np.zeros(1 + len(followers), np.int64), step)[1:]
    return HeadCurves(np.asarray(lags * step, np.float64), curves[0], np.max(curves[1:], axis=(0, 2)), path)


def add_evidence(links: Sequence[Link], curves: HeadCurves | None) -> list[Link]:
    """The links of a head with the numbers of their curves ``(n, K)``."""
    if curves is None:
        return list(links)
    step, last, peaks = curves.lags[1] - curves.lags[0], len(curves.lags) - 1, find_peak(curves.correlation, 1)
    return [
        replace(
            link,
            behind_head=round(float(curves.lags[0] + peak * step), 9) if 0 < peak < last else None,
            correlation=round(float(curves.correlation[k].max()), 6),
            by_chance=round(float(curves.by_chance[k]), 6),
            path=round(float(path), 6) if np.isfinite(path) else None,  # the delay may be too long to compare places
        )
        for k, (link, peak, path) in enumerate(zip(links, peaks, curves.path, strict=True))
    ]


def describe_lead(links: Sequence[Link]) -> str:
    """A sentence on the followers of a head in some windows: "6 followers repeat its velocity 0.5 to 1.5 s later …"."""
    rows = pd.DataFrame([vars(link) for link in links], columns=["follower", "behind_head", "correlation", "by_chance"])
    known = rows[rows["behind_head"].astype(float) > 0].astype(dict.fromkeys(rows.columns[1:], float))
    if known.empty:
        return f"Has {format_count(rows['follower'].nunique(), 'follower')}."
    delays = known.groupby("follower")["behind_head"].median()
    low, high = (format_seconds(each, 2) for each in (delays.min(), delays.max()))
    span = high if low == high else f"{low.removesuffix(high.partition(' ')[2]).strip()} to {high}"
    who, repeat = format_count(len(delays), "follower"), "repeats" if len(delays) == 1 else "repeat"
    r = f"r {known['correlation'].median():.2f}; by chance at most {known['by_chance'].max():.2f}"
    return f"{who} {repeat} its velocity {span} later ({r})."

"""One picture of the leaders that were found in tracks: maps of some windows."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env import drawing
from usnet_env.tracks.leaders import DetectedWindow, FoundLeaders
from usnet_env.tracks.tracks import Tracks, TrackWindow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_MAPS, _COLUMNS = 6, 3
_MAP, _MARGIN = 5.2, 2.0  # inches: a map, and the space for titles and legend
_MOST_NAMES = 12  # leaders that a map names
_LONGEST_NAME = 24  # characters
_MARKS = (drawing.HEAD_MARK, drawing.FOLLOWER_MARK, drawing.LINK_MARK, drawing.UNLED_MARK)  # of the legend


def draw_leaders(found: FoundLeaders, cuts: Iterable[TrackWindow], title: str, tracks: Tracks) -> Figure:
    """Draw up to six windows as maps from above.

    Args:
        found: the leaders.
        cuts: all windows; up to six of those with leaders are drawn, evenly spread.
        title: what the tracks are.
        tracks: the tracks, which say where their origin is.
    """
    windows = found.windows
    places = [k for k, window in enumerate(windows) if window.leaders] or [*range(len(windows))]
    chosen = [places[int(k)] for k in np.linspace(0, len(places) - 1, min(len(places), _MOST_MAPS))]
    columns = min(len(chosen), _COLUMNS)
    rows = -(-len(chosen) // columns)
    figure = drawing.new_figure(columns * _MAP + _MARGIN + 1, rows * _MAP + _MARGIN)
    figure.set_layout_engine("constrained")
    shown = f"{len(chosen)} of {len(windows)} windows, " if len(chosen) < len(windows) else ""
    about = f"{title}: {shown}by {found.detector}. Stars are leaders, lines connect followers to them."
    drawing.caption_figure(figure, "Leaders and followers", drawing.escape_math(about))
    ids = list(dict.fromkeys(str(leader.id) for leader in found.leaders))
    names = dict(zip(ids, drawing.abbreviate(ids, _LONGEST_NAME), strict=True))
    grid = figure.add_gridspec(rows, columns)
    maps: list[tuple[Any, Any, TrackWindow, DetectedWindow]] = []
    marks: dict[str, str] = {}
    for k, (cut, window) in enumerate(zip(cuts, windows, strict=True)):
        if k in chosen:
            axes = figure.add_subplot(grid[divmod(len(maps), columns)])
            place, present = _draw_map(axes, cut, window, tracks, [*found.colors])
            marks |= present
            axes.set_title(f"{window.start} to {window.end}", fontsize=9, loc="left")
            maps.append((axes, place, cut, window))
    drawing.draw_legend(maps[columns - 1][0], {mark: marks[mark] for mark in _MARKS if mark in marks})
    with warnings.catch_warnings(action="ignore"):  # the figure's file tells which characters are missing
        figure.draw_without_rendering()
    figure.set_layout_engine("none")  # the axes have their places now
    for axes, place, cut, window in maps:
        named = [leader.id for leader in window.leaders[:_MOST_NAMES]]
        points = place[[cut.ids.index(name) for name in named], :2].reshape(-1, 2)
        drawing.annotate_points(axes, points, [names[str(name)] for name in named], fontsize=8, weight="bold", zorder=7)
    return figure


def _draw_map(
    axes: Axes, cut: TrackWindow, window: DetectedWindow, tracks: Tracks, leading: Sequence[str | int]
) -> tuple[Any, dict[str, str]]:
    """Draw one window; returns where each UAV was seen last, and the marks for the legend."""
    root, none = window.roots(cut.ids), np.zeros(len(cut.ids), bool)
    head = np.isin(np.arange(len(root)), root)
    number = np.array([leading.index(name) if name in leading else 0 for name in cut.ids])
    origin = cut.origin + (tracks.origin if "degrees" not in tracks.frame else 0.0)
    position: Any = cut.window.position + origin  # in float64: coordinates may be large
    seen, alive = cut.window.seen, cut.window.alive
    limits = drawing.limits_around(position[seen], 0.08, 1e-6)
    drawing.draw_round(position, seen, alive, head, root, none, axes=axes, legend=False, number=number, limits=limits)
    place: Any = drawing.last_seen_position(position, seen)
    present = drawing.round_marks(place, alive, head, root, none)
    return place, {mark: drawing.TRACK_WORDS.get(mark, mark) for mark, who in present.items() if who.any()}

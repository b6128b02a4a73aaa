"""Pictures of found leaders: maps of windows, the network of links, the delays, and a timeline.

``rows`` are those of :meth:`usnet_env.tracks.FoundLeaders.to_frame`, and ``colors`` the colour of each id that leads.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from usnet_env import drawing
from usnet_env.tracks.found import DetectedWindow
from usnet_env.tracks.tracks import Tracks, TrackWindow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INNER = 0.42  # radius of the heads' circle
_BOX = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.8}  # behind texts
_MOST_LABELS, _LONGEST_NAME = 40, 18
_MOST_MAPS, _COLUMNS = 6, 3
_MAP, _MARGIN = 5.2, 2.0  # inches: a map, and the space for titles and legend
_MOST_NAMES = 12  # leaders that a map names
_LONGEST_ON_MAP = 24  # characters of a name
_MARKS = (drawing.HEAD_MARK, drawing.FOLLOWER_MARK, drawing.LINK_MARK, drawing.UNLED_MARK)  # of the legend

Id = str | int


def draw_maps(
    tracks: Tracks,
    track_windows: Sequence[TrackWindow],
    windows: Sequence[DetectedWindow],
    leading: Sequence[Id],
    title: str,
    detector: str,
) -> Figure:
    """Draw up to six windows as maps from above.

    Args:
        tracks: the tracks, which say where their origin is.
        track_windows: all windows; up to six of those with leaders are drawn, evenly spread.
        windows: what was found in each.
        leading: the ids that lead in any window, in the order of their colours.
        title: what the tracks are.
        detector: its label.
    """
    choice = [k for k, window in enumerate(windows) if window.leaders] or [*range(len(windows))]
    chosen = [choice[int(k)] for k in np.linspace(0, len(choice) - 1, min(len(choice), _MOST_MAPS))]
    columns = min(len(chosen), _COLUMNS)
    rows = -(-len(chosen) // columns)
    figure = drawing.new_figure(columns * _MAP + _MARGIN + 1, rows * _MAP + _MARGIN)
    figure.set_layout_engine("constrained")
    shown = f"{len(chosen)} of {len(windows)} windows, " if len(chosen) < len(windows) else ""
    about = f"{title}: {shown}by {detector}. Stars are leaders, lines connect followers to them."
    drawing.caption_figure(figure, "Leaders and followers", drawing.escape_math(about))
    names = dict(zip(leading, drawing.abbreviate([*map(str, leading)], _LONGEST_ON_MAP), strict=True))
    grid = figure.add_gridspec(rows, columns)
    maps = [figure.add_subplot(grid[divmod(n, columns)]) for n in range(len(chosen))]
    positions, marks = list[Any](), dict[str, str]()
    for axes, k in zip(maps, chosen, strict=True):
        position, present = _draw_map(axes, track_windows[k], windows[k], tracks, leading)
        positions.append(position)
        marks |= present
        axes.set_title(f"{windows[k].start} to {windows[k].end}", fontsize=9, loc="left")
    drawing.draw_legend(maps[columns - 1], {mark: marks[mark] for mark in _MARKS if mark in marks})
    with warnings.catch_warnings(action="ignore"):  # the figure's file tells which characters are missing
        figure.draw_without_rendering()
    figure.set_layout_engine("none")  # the axes have their places now
    for axes, k, position in zip(maps, chosen, positions, strict=True):
        named = [leader.id for leader in windows[k].leaders[:_MOST_NAMES]]
        points = position[[track_windows[k].ids.index(name) for name in named], :2].reshape(-1, 2)
        drawing.annotate_points(axes, points, [names[name] for name in named], fontsize=8, weight="bold", zorder=7)
    return figure


def _draw_map(
    axes: Axes, track_window: TrackWindow, window: DetectedWindow, tracks: Tracks, leading: Sequence[Id]
) -> tuple[Any, dict[str, str]]:
    """Draw one window; returns where each UAV was seen last, and the marks for the legend."""
    ids = track_window.ids
    root, none = window.roots(ids), np.zeros(len(ids), bool)
    head = np.isin(np.arange(len(root)), root)
    number = np.array([leading.index(name) if name in leading else 0 for name in ids])
    origin = track_window.origin + (tracks.origin if "degrees" not in tracks.frame else 0.0)
    position: Any = track_window.window.position + origin  # in float64: coordinates may be large
    seen, alive = track_window.window.seen, track_window.window.alive
    limits = drawing.limits_around(position[seen], 0.08, 1e-6)
    drawing.draw_round(position, seen, alive, head, root, none, axes=axes, legend=False, number=number, limits=limits)
    last: Any = drawing.last_seen_position(position, seen)
    present = drawing.round_marks(last, alive, head, root, none)
    return last, {mark: drawing.TRACK_WORDS.get(mark, mark) for mark, who in present.items() if who.any()}


def draw_network(rows: pd.DataFrame, windows: int, colors: Mapping[Id, str]) -> Figure:
    """Draw an arrow from each id to the one that it follows directly.

    It is as wide as the share of all ``windows`` in which it does so; the label is the median delay in seconds. Heads
    are in the middle. An id that leads in some window has its own colour; others, and arrows, have that of the head
    that they belong to most often.
    """
    figure = drawing.new_figure(7, 7)
    axes: Any = figure.add_axes((0.02, 0.02, 0.96, 0.9))
    most = rows.groupby("id")["head"].agg(lambda heads: heads.value_counts().index[0])
    heads = [name for name in dict.fromkeys(rows["head"]) if (most == name).any()]
    members = sorted((name for name in most.index if name not in heads), key=lambda name: heads.index(most[name]))
    position = {name: 0.0 * _circle(1)[0] for name in heads[:1]} if len(heads) < 2 else {}
    position |= dict(zip(heads, _INNER * _circle(len(heads)), strict=True)) if len(heads) > 1 else {}
    position |= dict(zip(members, _circle(len(members)), strict=True))
    pairs = rows.dropna(subset="leader").groupby(["id", "leader"])
    links = pairs.agg(times=("head", "size"), delay=("delay", "median"), head=("head", lambda head: head.mode()[0]))
    for (name, leader), (times, delay, head) in links.iterrows():
        begin, end = position[name], position[leader]
        way, width = end - begin, 0.5 + 3.5 * times / windows
        arrow = {"arrowstyle": "-|>", "lw": width, "color": colors[head], "shrinkA": 12, "shrinkB": 14}
        axes.annotate("", end, begin, arrowprops=arrow | {"alpha": 0.8, "mutation_scale": 10 + 2 * width})
        if len(links) <= _MOST_LABELS and not np.isnan(delay):
            axes.text(*(begin + 0.45 * way), f"{delay:.3g} s", fontsize=7, ha="center", va="center", bbox=_BOX)
    for name, (x, y) in position.items():
        size, color = 420 if name in heads else 200, colors.get(name, colors[most[name]])
        axes.scatter(x, y, s=size, color=color, edgecolor="black", linewidth=0.6, zorder=3)
        label = drawing.escape_math(drawing.abbreviate([str(name)], _LONGEST_NAME)[0])
        axes.annotate(
            label, (x, y), xytext=(0, 13), textcoords="offset points", fontsize=8, ha="center", zorder=4, bbox=_BOX
        )
    axes.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2), aspect="equal")
    axes.set_axis_off()
    axes.set_title("Who follows whom" if len(rows) else "No leader was found.", fontsize=11)
    return figure


def draw_delays(rows: pd.DataFrame) -> Figure:
    """Draw a matrix with a row for each follower, a column for each that is followed, and the median delay."""
    links = rows.dropna(subset="leader")
    table = links.pivot_table("delay", "id", "leader", "median", dropna=False, sort=False).astype(float)
    figure = drawing.new_figure(2.5 + 0.55 * table.shape[1], 1.5 + 0.3 * table.shape[0])
    figure.set_layout_engine("constrained")
    axes: Any = figure.add_subplot()
    axes.set_title("Median delay in seconds" if table.size else "No leader was found.", fontsize=10)
    if table.size:
        image = axes.imshow(table.to_numpy(), cmap="viridis", aspect="auto", vmin=0.0)
        figure.colorbar(image, ax=axes)
        axes.set_xticks(range(table.shape[1]), _labels(table.columns), rotation=90, fontsize=8)
        axes.set_yticks(range(table.shape[0]), _labels(table.index), fontsize=8)
        axes.set(xlabel="followed", ylabel="follower")
        for (i, j), delay in np.ndenumerate(table.to_numpy()):
            if not np.isnan(delay) and table.size <= 400:
                axes.text(j, i, f"{delay:.3g}", ha="center", va="center", fontsize=7, bbox=_BOX)
    return figure


def draw_timeline(
    rows: pd.DataFrame, ids: Sequence[Id], starts: Sequence[float | int | str], colors: Mapping[Id, str]
) -> Figure:
    """Draw a row for each id: in the window of each start, the colour of its head, and a star if it is one itself."""
    figure = drawing.new_figure(8, 1.5 + 0.24 * len(ids))
    figure.set_layout_engine("constrained")
    axes: Any = figure.add_subplot()
    column = {start: k for k, start in enumerate(starts)}
    row = {name: k for k, name in enumerate(ids)}
    for start, name, head in rows[["start", "id", "head"]].itertuples(index=False):
        axes.barh(row[name], 0.96, left=column[start], height=0.8, color=colors[head])
        if name == head:
            axes.plot(column[start] + 0.48, row[name], "*", color="white", markersize=7, markeredgewidth=0)
    axes.set_yticks(range(len(ids)), _labels(ids), fontsize=8)
    shown = np.unique(np.linspace(0, len(starts) - 1, min(len(starts), 6)).astype(int))
    axes.set_xticks(shown, [str(starts[k]) for k in shown], fontsize=8)
    axes.set(xlim=(0, len(starts)), ylim=(len(ids) - 0.4, -0.6), xlabel="start of the window")
    patches = [axes.barh([0], 0, color=color, label=str(head)) for head, color in list(colors.items())[:9]]
    if patches:
        axes.legend(title="follows", loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
    axes.set_title("Whom each id follows (star: it leads)" if patches else "No leader was found.", fontsize=10)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _circle(points: int) -> Any:
    angle = np.pi / 2 - 2 * np.pi * np.arange(points) / max(points, 1)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _labels(names: Any) -> list[str]:
    return [drawing.escape_math(name) for name in drawing.abbreviate([str(name) for name in names], _LONGEST_NAME)]

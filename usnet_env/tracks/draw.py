"""Pictures of found leaders: maps of windows, the network of links, the delays, and a timeline.

``rows`` are those of :meth:`usnet_env.tracks.FoundLeaders.to_frame`, and ``colors`` the colour of each id that leads.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from usnet_env import drawing
from usnet_env.config import choose_unit, format_seconds
from usnet_env.tracks.found import DetectedWindow, Name
from usnet_env.tracks.tracks import Tracks, TrackWindow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEADS_RADIUS = 0.42  # radius of the heads' circle
_BOX = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.8}  # behind texts
_MAX_LABELS, _MAX_NAME_LENGTH = 40, 18
_MAX_MAPS, _COLUMNS = 6, 3
_MAX_CURVES = 12  # of a picture of evidence
_MAP_SIZE, _MARGIN = 5.2, 2.0  # inches: a map, and the space for titles and legend
_MAX_NAMES = 12  # leaders that a map names
_MAX_MAP_NAME_LENGTH = 24  # characters of a name
_MARKS = (drawing.HEAD_MARK, drawing.FOLLOWER_MARK, drawing.LINK_MARK, drawing.UNLED_MARK)  # of the legend


def draw_maps(
    tracks: Tracks,
    track_windows: Sequence[TrackWindow],
    windows: Sequence[DetectedWindow],
    leading: Sequence[Name],
    title: str,
    detector: str,
) -> Figure:
    """Draw up to six of the windows with leaders, or of all, evenly spread, as maps from above.

    ``leading`` are the ids that lead in any window, in the order of their colours; ``title`` is what the tracks are.
    """
    candidates = [k for k, window in enumerate(windows) if window.leaders] or [*range(len(windows))]
    chosen = [candidates[int(k)] for k in np.linspace(0, len(candidates) - 1, min(len(candidates), _MAX_MAPS))]
    columns, rows = min(len(chosen), _COLUMNS), -(-len(chosen) // _COLUMNS)
    figure = drawing.new_figure(columns * _MAP_SIZE + _MARGIN + 1, rows * _MAP_SIZE + _MARGIN)
    figure.set_layout_engine("constrained")
    share = f"{len(chosen)} of {len(windows)} windows, " if len(chosen) < len(windows) else ""
    caption = f"{title}: {share}by {detector}. Stars are leaders, lines connect followers to them."
    drawing.caption_figure(figure, "Leaders and followers", drawing.escape_math(caption))
    names = dict(zip(leading, drawing.abbreviate([*map(str, leading)], _MAX_MAP_NAME_LENGTH), strict=True))
    grid = figure.add_gridspec(rows, columns)
    maps = [figure.add_subplot(grid[divmod(n, columns)]) for n in range(len(chosen))]
    positions, marks = list[Any](), dict[str, str]()
    for axes, k in zip(maps, chosen, strict=True):
        position, window_marks = _draw_map(axes, track_windows[k], windows[k], tracks, leading)
        positions.append(position)
        marks |= window_marks
        axes.set_title(f"{windows[k].start} to {windows[k].end}", fontsize=9, loc="left")
    drawing.draw_legend(maps[columns - 1], {mark: marks[mark] for mark in _MARKS if mark in marks})
    with warnings.catch_warnings(action="ignore"):  # the figure's file tells which characters are missing
        figure.draw_without_rendering()
    figure.set_layout_engine("none")  # the axes have their places now
    for axes, k, position in zip(maps, chosen, positions, strict=True):
        head_names = [leader.id for leader in windows[k].leaders[:_MAX_NAMES]]
        points = position[[track_windows[k].ids.index(name) for name in head_names], :2].reshape(-1, 2)
        drawing.annotate_points(axes, points, [names[name] for name in head_names], fontsize=8, weight="bold", zorder=7)
    return figure


def _draw_map(
    axes: Axes, track_window: TrackWindow, window: DetectedWindow, tracks: Tracks, leading: Sequence[Name]
) -> tuple[Any, dict[str, str]]:
    """Draw one window; returns where each UAV was seen last, and the marks for the legend."""
    ids = track_window.ids
    root, no_decoys = window.roots(ids), np.zeros(len(ids), bool)
    head = np.isin(np.arange(len(root)), root)
    color_numbers = np.array([leading.index(name) if name in leading else 0 for name in ids])
    origin = track_window.origin + (tracks.origin if "degrees" not in tracks.frame else 0.0)
    position: Any = track_window.window.position + origin  # in float64: coordinates may be large
    seen, alive = track_window.window.seen, track_window.window.alive
    limits = drawing.limits_around(position[seen], 0.08, 1e-6)
    style: Any = {"axes": axes, "legend": False, "number": color_numbers, "limits": limits}
    drawing.draw_round(position, seen, alive, head, root, no_decoys, **style)
    axes.set(xlabel=f"x in {tracks.length_unit}", ylabel=f"y in {tracks.length_unit}")
    last_position: Any = drawing.last_seen_position(position, seen)
    marks = drawing.round_marks(last_position, alive, head, root, no_decoys)
    return last_position, {mark: drawing.TRACK_WORDS.get(mark, mark) for mark, uavs in marks.items() if uavs.any()}


def draw_network(rows: pd.DataFrame, windows: int, colors: Mapping[Name, str], ax: Any = None) -> Figure:
    """Draw an arrow from each id to the one that it follows directly, and a dashed one to its head if that isn't known.

    It is as wide as the share of all ``windows`` in which it does so; the label is the median delay in seconds. Heads
    are in the middle. An id that leads in some window has its own colour; others, and arrows, have that of the head
    that they belong to most often.
    """
    figure, axes = _make_axes(ax, 7, 7, (0.02, 0.02, 0.96, 0.9))
    main_head = rows.groupby("id")["head"].agg(lambda heads: heads.value_counts().index[0])
    heads = [name for name in dict.fromkeys(rows["head"]) if (main_head == name).any()]
    members = [name for head in heads for name in main_head.index[main_head == head] if name not in heads]
    radius = _HEADS_RADIUS if len(heads) > 1 else 0.0
    position = dict(zip(heads, radius * _place_on_circle(len(heads)), strict=True))
    position |= dict(zip(members, _place_on_circle(len(members)), strict=True))
    pairs = rows.dropna(subset="leader").groupby(["id", "leader"])
    links = pairs.agg(
        times=("head", "size"),
        delay=("delay", "median"),
        head=("head", lambda head: head.mode()[0]),
        direct=("direct", lambda direct: direct.mean() >= 0.5),
    )
    for (name, leader), (times, delay, head, direct) in links.iterrows():
        begin, end = position[name], position[leader]
        vector, width = end - begin, 0.5 + 3.5 * times / windows
        arrow = {"arrowstyle": "-|>", "lw": width, "color": colors[head], "shrinkA": 12, "shrinkB": 14}
        arrow["linestyle"] = "-" if direct else (0, (4, 2))
        axes.annotate("", end, begin, arrowprops=arrow | {"alpha": 0.8, "mutation_scale": 10 + 2 * width})
        if len(links) <= _MAX_LABELS and not np.isnan(delay):
            style: Any = {"fontsize": 7, "ha": "center", "va": "center", "bbox": _BOX}
            axes.text(*(begin + 0.45 * vector), format_seconds(delay, 3), **style)
    for name, point in position.items():
        size, color = 420 if name in heads else 200, colors.get(name, colors[main_head[name]])
        axes.scatter(*point, s=size, color=color, edgecolor="black", linewidth=0.6, zorder=3)
        style = {"textcoords": "offset points", "fontsize": 8, "ha": "center", "zorder": 4, "bbox": _BOX}
        if name in heads or len(position) <= _MAX_LABELS:
            axes.annotate(_shorten_names([name])[0], point, xytext=(0, 13), **style)
    axes.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2), aspect="equal")
    axes.set_axis_off()
    note = "\n(dashed: in the group of, directly or not)" * (len(links) > 0 and not links["direct"].all())
    axes.set_title(f"Followers and their leaders{note}" if len(rows) else "No window has a leader.", fontsize=11)
    return figure


def draw_delays(rows: pd.DataFrame, ax: Any = None) -> Figure:
    """Draw a matrix with a row for each follower, a column for each that is followed, and the median delay.

    The number next to it is half of the 95 % interval of a window. Links that are not direct are in brackets.
    """
    links = rows.dropna(subset="leader")
    links = links.assign(error=(links["delay_high"].astype(float) - links["delay_low"].astype(float)) / 2)
    table, error, direct = (
        links.pivot_table(name, "id", "leader", function, dropna=False, sort=False).astype(float)
        for name, function in (("delay", "median"), ("error", "median"), ("direct", "mean"))
    )
    error, direct = (matrix.reindex_like(table).to_numpy() for matrix in (error, direct))
    unit, size = choose_unit(float(np.nan_to_num(table.to_numpy()).max(initial=0.0)))
    table, error = table / size, error / size
    figure, axes = _make_axes(ax, 2.5 + 0.9 * table.shape[1], 1.5 + 0.3 * table.shape[0])
    note = "± half of the 95 % interval" + "\n(in brackets: not surely direct)" * bool((direct < 0.5).any())
    axes.set_title(f"Median delay in {unit}\n{note}" if table.size else "No window has a leader.", fontsize=10)
    if table.size:
        image = axes.imshow(table.to_numpy(), cmap="viridis", aspect="auto", vmin=0.0)
        figure.colorbar(image, ax=axes)
        axes.set_xticks(range(table.shape[1]), _shorten_names(table.columns), rotation=90, fontsize=8)
        axes.set_yticks(range(table.shape[0]), _shorten_names(table.index), fontsize=8)
        axes.set(xlabel="followed", ylabel="follower")
        for (i, j), delay in np.ndenumerate(table.to_numpy()):
            if not np.isnan(delay) and table.size <= 400:
                text = f"{delay:.3g}" + f" ± {error[i, j]:.1g}" * bool(error[i, j] > 0)
                text = text if direct[i, j] >= 0.5 else f"({text})"
                axes.text(j, i, text, ha="center", va="center", fontsize=7, bbox=_BOX)
    return figure


def draw_timeline(
    spans: Sequence[tuple[Name, Name, float, float]],
    ids: Sequence[Name],
    starts: Sequence[float | int | str],
    colors: Mapping[Name, str],
    ax: Any = None,
) -> Figure:
    """Draw a row for each id: the colour of its head, and stars where it is one itself.

    ``spans`` are an id, its head, a begin and an end, which are numbers of windows from 0 on with the times ``starts``.
    """
    _, axes = _make_axes(ax, 8, 1.5 + 0.24 * len(ids))
    row = {name: k for k, name in enumerate(ids)}
    for name, head, begin, end in spans:
        axes.barh(row[name], end - begin - 0.04, left=begin, height=0.8, color=colors[head])
        if name == head:
            middles = np.arange(np.floor(begin), np.ceil(end)) + 0.48
            middles = middles[(middles > begin + 0.1) & (middles < end - 0.1)]
            stars = middles if len(middles) else [(begin + end) / 2]
            axes.plot(stars, [row[name]] * len(stars), "*", color="white", markersize=7, markeredgewidth=0)
    axes.set_yticks(range(len(ids)), _shorten_names(ids), fontsize=8)
    for head, color in list(colors.items())[:9]:
        axes.barh([0], 0, color=color, label=str(head))
    axes.set(ylim=(len(ids) - 0.4, -0.6))
    _label_windows(axes, starts)
    title = "Which id each id follows (star: it leads)" if colors else "No leader was found."
    return _end_picture(axes, title, fontsize=8, title="follows")


def draw_evidence(curves: pd.DataFrame, chance: float, leader: Name, ax: Any = None) -> Figure:
    """Draw the correlation of each follower's velocity with that of the leader against the time after it.

    The index of ``curves`` are seconds, and a column is a follower. ``chance`` is the largest value by chance.
    """
    _, axes = _make_axes(ax, 7.6, 3.8)
    unit, size = choose_unit(float(np.abs(curves.idxmax()).max()))
    curves = curves.set_axis(curves.index / size)
    shown_curves = curves[curves.max().sort_values(ascending=False, kind="stable").index[:_MAX_CURVES]]
    for k, (name, curve) in enumerate(shown_curves.items()):
        style = {"color": drawing.CLUSTER_COLORS[k % len(drawing.CLUSTER_COLORS)], "label": _shorten_names([name])[0]}
        axes.plot(curve.index, curve, marker=".", markersize=4, linewidth=1.2, **style)
        axes.plot(curve.idxmax(), curve.max(), "o", markersize=6, color=style["color"])
    if np.isfinite(chance):
        axes.axhline(chance, color="#777777", linestyle="--", linewidth=1)
        axes.text(curves.index[0], chance, "by chance at most", fontsize=7, va="bottom", color="#555555")
    axes.axvline(0, color="black", linewidth=0.8)
    name = _shorten_names([leader])[0]
    note = f" ({_MAX_CURVES} of {curves.shape[1]})" * (curves.shape[1] > _MAX_CURVES)
    axes.set(xlabel=f"{unit} after {name}", ylabel="correlation of velocity")
    return _end_picture(axes, f"Why {name}: its followers{note} repeat its velocity later", fontsize=7, ncols=2)


def draw_probabilities(table: pd.DataFrame, colors: Mapping[Name, str], ax: Any = None) -> Figure:
    """Draw the probability to lead of each id in each window, in colour if it leads in any, and that none does.

    The columns of ``table`` are ids, ``None`` for none, and the index are the times of the windows.
    """
    _, axes = _make_axes(ax, 8, 3)
    x = np.arange(len(table)) + 0.5
    for name in sorted(table.columns, key=lambda name: name in colors or name is None):
        style: dict[str, Any] = {"color": "#bbbbbb", "linewidth": 0.8}
        if name is None or name in colors:
            style = {"label": "no id leads" if name is None else _shorten_names([name])[0], "linewidth": 1.6}
            style |= {"color": "black", "linestyle": ":"} if name is None else {"color": colors[name]}
        axes.plot(x, table[name], marker=".", **style)
    axes.set(ylim=(-0.03, 1.03), ylabel="p")
    _label_windows(axes, [*table.index])
    return _end_picture(axes, "Probability to lead (grey: ids that lead in no window)", fontsize=8)


def _make_axes(ax: Any, width: float, height: float, box: Any = None) -> tuple[Figure, Any]:
    """The figure and axes to draw in: those given, or new ones of so many inches, at ``box`` or where they fit."""
    if ax is not None:
        return ax.get_figure(), ax
    figure = drawing.new_figure(width, height)
    figure.set_layout_engine(None if box else "constrained")
    return figure, figure.add_axes(box) if box else figure.add_subplot()


def _place_on_circle(points: int) -> Any:
    angle = np.pi / 2 - 2 * np.pi * np.arange(points) / max(points, 1)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _label_windows(axes: Axes, starts: Sequence[float | int | str]) -> None:
    """Write up to six times of the file below windows; one in ISO 8601 has two lines, the day and the time of day."""
    ticks = np.unique(np.linspace(0, len(starts) - 1, min(len(starts), 6)).astype(int))
    axes.set_xticks(ticks, [re.sub(r"(\d)T(\d.*)Z$", r"\1\n\2", str(starts[k])) for k in ticks], fontsize=8)
    axes.set(xlim=(0, len(starts)), xlabel="start of the window")


def _end_picture(axes: Any, heading: str, **legend: Any) -> Figure:
    """Write a heading, and a legend at the right if the axes have labels; leave out the upper and right lines."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, **legend)
    axes.set_title(heading, fontsize=10)
    axes.spines[["top", "right"]].set_visible(False)
    figure: Figure = axes.get_figure()
    return figure


def _shorten_names(names: Any) -> list[str]:
    return [drawing.escape_math(name) for name in drawing.abbreviate([str(name) for name in names], _MAX_NAME_LENGTH)]

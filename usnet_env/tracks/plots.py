"""Pictures of found leaders: a network of who follows whom, the delays, and a timeline."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env import drawing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from usnet_env.tracks.leaders import FoundLeaders

_INNER, _GAP = 0.42, 0.1  # radius of the heads' circle; of an arrow's length, free at its ends
_BOX = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.8}  # behind texts
_MOST_LABELS, _LONGEST_NAME = 40, 18


def draw_network(found: FoundLeaders) -> Figure:
    """Draw an arrow from each id to the one that it follows directly.

    It is as wide as the share of the windows in which it does so; the label is the median delay in seconds. Heads are
    in the middle. An id that leads in some window has its own colour; others, and arrows, have that of the head that
    they belong to most often.
    """
    figure = drawing.new_figure(7, 7)
    axes: Any = figure.add_axes((0.02, 0.02, 0.96, 0.9))
    rows, windows, colors = found.to_frame(), len(found.windows), found.colors
    most = rows.groupby("id")["head"].agg(lambda heads: heads.value_counts().index[0])
    heads = [name for name in dict.fromkeys(rows["head"]) if (most == name).any()]
    members = sorted((name for name in most.index if name not in heads), key=lambda name: heads.index(most[name]))
    place = {name: 0.0 * _circle(1)[0] for name in heads[:1]} if len(heads) < 2 else {}
    place |= dict(zip(heads, _INNER * _circle(len(heads)), strict=True)) if len(heads) > 1 else {}
    place |= dict(zip(members, _circle(len(members)), strict=True))
    pairs = rows.dropna(subset="leader").groupby(["id", "leader"])
    links = pairs.agg(times=("head", "size"), delay=("delay", "median"), head=("head", lambda head: head.mode()[0]))
    for (name, leader), (times, delay, head) in links.iterrows():
        begin, end = place[name], place[leader]
        way, width = end - begin, 0.5 + 3.5 * times / windows
        arrow = {"arrowstyle": "-|>", "lw": width, "color": colors[head], "shrinkA": 12, "shrinkB": 14}
        axes.annotate("", end, begin, arrowprops=arrow | {"alpha": 0.8, "mutation_scale": 10 + 2 * width})
        if len(links) <= _MOST_LABELS and not np.isnan(delay):
            axes.text(*(begin + 0.45 * way), f"{delay:.3g} s", fontsize=7, ha="center", va="center", bbox=_BOX)
    for name, (x, y) in place.items():
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


def draw_delays(found: FoundLeaders) -> Figure:
    """Draw a matrix with a row for each follower, a column for each that is followed, and the median delay."""
    links = found.to_frame().dropna(subset="leader")
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


def draw_timeline(found: FoundLeaders) -> Figure:
    """Draw a row for each id: in each window, the colour of its head, and a star if it is one itself."""
    rows, ids, starts = found.to_frame(), found.ids, [window.start for window in found.windows]
    figure = drawing.new_figure(8, 1.5 + 0.24 * len(ids))
    figure.set_layout_engine("constrained")
    axes: Any = figure.add_subplot()
    column = {start: k for k, start in enumerate(starts)}
    row, colors = {name: k for k, name in enumerate(ids)}, found.colors
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

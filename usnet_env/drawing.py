"""One way to draw a swarm and a round: environments' frames and the replay's figures are made here.

Matplotlib is an extra (``pip install 'usnet[render]'``) and is imported only when something is drawn. Nothing global of
it is touched: no pyplot, no ``rcParams``.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "CLUSTER_COLORS",
    "HIT",
    "MISSED",
    "REDUNDANT",
    "MissingExtraError",
    "cluster_colors",
    "draw_legend",
    "draw_round",
    "last_seen",
    "new_figure",
    "round_frame",
    "round_marks",
]

# Paul Tol's "muted" scheme (colour-blind safe) without its grey; clusters beyond it repeat colours with other markers.
CLUSTER_COLORS = ("#332288", "#88CCEE", "#44AA99", "#999933", "#DDCC77", "#CC6677", "#AA4499", "#117733", "#882255")
NOBODY = "#9A9A9A"  # UAVs without a head: decoys, orphans of the last head, the destroyed
HIT, REDUNDANT, MISSED = "#009E73", "#D55E00", "#000000"  # also told apart by shape: circle, square, dashes
HEAD_MARK, FOLLOWER_MARK, LINK_MARK = "head", "follower (colour: its head)", "link to its head"
DECOY_MARK, DESTROYED_MARK = "decoy: leads nobody", "destroyed earlier"
HIT_MARK, REDUNDANT_MARK, MISSED_MARK = "named: a head, hit", "named: redundant", "head not named"
_DASHES = (0, (2, 1.2))
_MARKERS = "o^sD"
_TRACK_PARTS = 6  # pieces of a track, from faint to strong
_TRACK_SAMPLES = 49  # a track is thinned to as many points; a picture shows no more


class MissingExtraError(ImportError):
    """An optional package is not installed; the message says which command installs it."""


def new_figure(width: float, height: float, dpi: float = 100) -> Figure:
    """An empty figure of its own, drawn by Agg, outside of pyplot.

    Args:
        width: inches.
        height: inches.
        dpi: pixels per inch.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError("Drawing needs matplotlib: pip install 'usnet[render]'.") from None
    figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def last_seen(position: NDArray[np.float32], seen: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Where each UAV was seen last in a window.

    Args:
        position: ``(T_ob + 1, N, 3)`` metres.
        seen: ``(T_ob + 1, N)`` bool.

    Returns:
        ``(N, 3)`` metres; NaN for a UAV that was never seen.
    """
    when = len(seen) - 1 - np.argmax(seen[::-1], axis=0)
    place = position[when, np.arange(position.shape[1])]
    return np.asarray(np.where(np.any(seen, axis=0, keepdims=True).T, place, np.float32(np.nan)))


def cluster_colors(head: NDArray[np.bool_], leader: NDArray[np.int64]) -> tuple[NDArray[np.str_], NDArray[np.int64]]:
    """A colour and a marker for every UAV by the head it follows; they stay the same in all rounds of an episode.

    Args:
        head: ``(N,)`` bool, H_0.
        leader: ``(N,)`` int64, the head that each UAV follows; a head's own index, -1: nobody.

    Returns:
        ``(N,)`` hexadecimal colours, and ``(N,)`` int64 numbers of markers (0 for the first nine clusters).
    """
    cluster = np.asarray(np.where((leader >= 0) & head[leader], np.cumsum(head)[leader] - 1, -1))
    colors = np.where(cluster >= 0, np.array(CLUSTER_COLORS)[cluster % len(CLUSTER_COLORS)], NOBODY)
    return colors, np.maximum(cluster, 0) // len(CLUSTER_COLORS) % len(_MARKERS)


def _tracks(axes: Axes, position: NDArray[np.float32], seen: NDArray[np.bool_], colors: NDArray[np.str_]) -> None:
    from matplotlib.collections import LineCollection
    from matplotlib.colors import to_rgb

    path = np.where(seen[..., None], position[..., :2], np.nan)
    path = path[np.unique(np.linspace(0, len(path) - 1, min(len(path), _TRACK_SAMPLES)).astype(int))]
    rgb = np.array([to_rgb(color) for color in colors]).reshape(-1, 3)
    edges = np.linspace(0, len(path) - 1, min(_TRACK_PARTS, len(path) - 1) + 1).astype(int)
    for part, (first, last) in enumerate(pairwise(edges), start=1):
        alpha = np.full((len(rgb), 1), 0.75 * part / (len(edges) - 1))
        lines = np.swapaxes(path[first : last + 1], 0, 1)
        axes.add_collection(
            LineCollection(list(lines), colors=np.hstack([rgb, alpha]), linewidths=0.9, zorder=2, capstyle="round")
        )


def _links(
    axes: Axes,
    place: NDArray[np.float32],
    linked: NDArray[np.bool_],
    leader: NDArray[np.int64],
    colors: NDArray[np.str_],
) -> None:
    from matplotlib.collections import LineCollection

    ends = np.stack([place[linked, :2], place[leader[linked], :2]], axis=1)
    axes.add_collection(LineCollection(list(ends), colors=colors[linked], alpha=0.28, linewidths=0.7, zorder=1))


def _dots(axes: Axes, place: NDArray[np.float32], who: NDArray[np.bool_], **style: Any) -> None:
    axes.scatter(place[who, 0], place[who, 1], **style)


def round_marks(
    place: NDArray[np.float32],
    alive: NDArray[np.bool_],
    head: NDArray[np.bool_],
    leader: NDArray[np.int64],
    decoy: NDArray[np.bool_],
    candidates: NDArray[np.bool_] | None = None,
    destroyed_at: NDArray[np.float32] | None = None,
) -> dict[str, NDArray[np.bool_]]:
    """Which UAVs carry which mark in a picture of a round, by the words of the legend.

    Args:
        place: ``(N, 3)`` metres, NaN for UAVs that are not shown.
        alive: ``(N,)`` bool, before the candidates are destroyed.
        head: ``(N,)`` bool, H_0.
        leader: ``(N,)`` int64.
        decoy: ``(N,)`` bool.
        candidates: ``(N,)`` bool, or ``None``: nobody has answered yet.
        destroyed_at: ``(N, 3)`` metres, NaN where unknown, or ``None``: not shown.

    Returns:
        ``(N,)`` bool for every mark.
    """
    shown = np.isfinite(place[:, 0])
    target = head & alive
    nobody = np.zeros_like(alive)
    gone = nobody if destroyed_at is None else ~alive & np.isfinite(destroyed_at[:, 0])
    follower = shown & ~head & ~decoy
    return {
        HEAD_MARK: shown & head,
        FOLLOWER_MARK: follower,
        LINK_MARK: follower & (leader >= 0) & shown[leader],
        DECOY_MARK: shown & decoy,
        HIT_MARK: nobody if candidates is None else candidates & target,
        REDUNDANT_MARK: nobody if candidates is None else candidates & ~target,
        MISSED_MARK: nobody if candidates is None else ~candidates & target,
        DESTROYED_MARK: gone,
    }


def draw_legend(axes: Axes, labels: Mapping[str, str]) -> None:
    """Explain marks at the right of ``axes``.

    Args:
        axes: where.
        labels: the words beside each mark of :func:`round_marks` that is to be explained.
    """
    from matplotlib.lines import Line2D

    def point(**style: Any) -> Line2D:
        return Line2D([], [], linestyle="none", **style)

    ring = {"color": "none", "marker": "o", "markersize": 15, "markeredgewidth": 2.4}
    keys = {
        HEAD_MARK: point(marker="*", color="#555555", markeredgecolor="black", markersize=15),
        FOLLOWER_MARK: point(marker="o", color="#777777", markersize=6),
        LINK_MARK: Line2D([], [], color="#777777", alpha=0.6, linewidth=1),
        DECOY_MARK: point(marker="D", color="white", markeredgecolor="black", markersize=7),
        HIT_MARK: point(markeredgecolor=HIT, **ring),
        REDUNDANT_MARK: point(markeredgecolor=REDUNDANT, **ring | {"marker": "s", "markersize": 12}),
        MISSED_MARK: Line2D([], [], color=MISSED, linestyle=_DASHES, linewidth=1.6),
        DESTROYED_MARK: point(marker="x", color=NOBODY, markersize=7, markeredgewidth=1.6),
    }
    axes.legend(
        [keys[mark] for mark in labels],
        list(labels.values()),
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        frameon=False,
        fontsize=9.5,
        labelspacing=0.9,
    )


def _frame(axes: Axes, place: NDArray[np.float32], title: str) -> None:
    known = place[np.isfinite(place[:, 0]), :2]
    low, high = (known.min(axis=0), known.max(axis=0)) if len(known) else (np.zeros(2), np.ones(2))
    middle, half = (low + high) / 2, 0.56 * max(float((high - low).max()), 1.0)
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal")
    axes.set_xlabel("x in m", fontsize=9)
    axes.set_ylabel("y in m", fontsize=9)
    axes.tick_params(labelsize=8, colors="#555555")
    axes.set_facecolor("#FBFBFB")
    axes.grid(color="#E8E8E8", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in axes.spines.values():
        side.set_color("#CCCCCC")
    axes.set_title(title, fontsize=11, loc="left")


def draw_round(
    position: NDArray[np.float32],
    seen: NDArray[np.bool_],
    alive: NDArray[np.bool_],
    head: NDArray[np.bool_],
    leader: NDArray[np.int64],
    decoy: NDArray[np.bool_],
    candidates: NDArray[np.bool_] | None = None,
    *,
    destroyed_at: NDArray[np.float32] | None = None,
    axes: Axes | None = None,
    title: str = "",
    legend: bool = True,
) -> Figure:
    """A window from above, who truly follows whom in it, and what a detector named.

    Tracks fade into the past; UAVs stand where they were seen last, coloured by their true cluster and linked to their
    head. Candidates are marked: a green circle for a hit, a red square for a redundant one; a dashed circle is a head
    that was missed.

    Args:
        position: ``(T_ob + 1, N, 3)`` metres.
        seen: ``(T_ob + 1, N)`` bool.
        alive: ``(N,)`` bool, before the candidates are destroyed.
        head: ``(N,)`` bool, H_0.
        leader: ``(N,)`` int64, whom each UAV follows; a head's or decoy's own index, -1: nobody.
        decoy: ``(N,)`` bool.
        candidates: ``(N,)`` bool, or ``None``: nobody has answered yet.
        destroyed_at: ``(N, 3)`` metres, where destroyed UAVs were seen last (NaN: unknown), or ``None``: not shown.
        axes: draw here, instead of in a figure of its own.
        title: stands above the picture.
        legend: explain the marks at the right.

    Returns:
        The figure.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    if axes is None:
        axes = new_figure(9.6, 7.2).add_axes((0.07, 0.08, 0.66, 0.86) if legend else (0.09, 0.08, 0.88, 0.86))
    place = last_seen(position, seen & alive)
    marks = round_marks(place, alive, head, leader, decoy, candidates, destroyed_at)
    shown = np.isfinite(place[:, 0])
    colors, marker = cluster_colors(head, leader)
    _links(axes, place, marks[LINK_MARK], leader, colors)
    _tracks(axes, position[:, shown], (seen & alive)[:, shown], colors[shown])

    for number, shape in enumerate(_MARKERS):
        who = marks[FOLLOWER_MARK] & (marker == number)
        _dots(axes, place, who, s=22, c=colors[who], marker=shape, edgecolors="white", linewidths=0.4, zorder=3)
    stars, decoys = marks[HEAD_MARK], marks[DECOY_MARK]
    _dots(axes, place, stars, s=210, c=colors[stars], marker="*", edgecolors="black", linewidths=0.8, zorder=5)
    for number, shape in enumerate(_MARKERS[1:], start=1):  # heads that share a colour carry their followers' shape
        _dots(axes, place, stars & (marker == number), s=22, c="white", marker=shape, linewidths=0, zorder=5.5)
    _dots(axes, place, decoys, s=46, c="white", marker="D", edgecolors="black", linewidths=1, zorder=4)

    everywhere = place
    if destroyed_at is not None:
        everywhere = np.asarray(np.where(marks[DESTROYED_MARK][:, None], destroyed_at, place))
        _dots(axes, everywhere, marks[DESTROYED_MARK], s=34, c=NOBODY, marker="x", linewidths=1.5, zorder=2.5)
    ring: dict[str, Any] = {"facecolors": "none", "zorder": 6}
    _dots(axes, everywhere, marks[HIT_MARK], s=400, edgecolors=HIT, linewidths=2.4, **ring)
    _dots(axes, everywhere, marks[REDUNDANT_MARK], s=130, marker="s", edgecolors=REDUNDANT, linewidths=2, **ring)
    _dots(axes, everywhere, marks[MISSED_MARK], s=400, edgecolors=MISSED, linewidths=1.6, linestyles=[_DASHES], **ring)
    _frame(axes, everywhere, title)
    if legend:
        counts = {mark: int(who.sum()) for mark, who in marks.items()}
        draw_legend(axes, {mark: f"{mark} ({count})" for mark, count in counts.items() if count})
    figure: Any = axes.get_figure(root=True)
    return figure


def round_frame(
    position: NDArray[np.float32],
    seen: NDArray[np.bool_],
    alive: NDArray[np.bool_],
    head: NDArray[np.bool_],
    leader: NDArray[np.int64],
    decoy: NDArray[np.bool_],
    candidates: NDArray[np.bool_] | None = None,
    *,
    destroyed_at: NDArray[np.float32] | None = None,
    title: str = "",
    size: tuple[int, int] = (960, 720),
) -> NDArray[np.uint8]:
    """:func:`draw_round` as pixels: ``(H, W, 3)`` uint8.

    Args:
        position: as in :func:`draw_round`, and so are the others.
        seen: see there.
        alive: see there.
        head: see there.
        leader: see there.
        decoy: see there.
        candidates: see there.
        destroyed_at: see there.
        title: see there.
        size: width and height in pixels.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    width, height = size
    figure = new_figure(9.6, 9.6 * height / width, dpi=width / 9.6)
    axes = figure.add_axes((0.07, 0.08, 0.66, 0.86))
    draw_round(
        position, seen, alive, head, leader, decoy, candidates, destroyed_at=destroyed_at, axes=axes, title=title
    )
    canvas: Any = figure.canvas
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3].copy()

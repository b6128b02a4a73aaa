"""Maps of a swarm and a round, drawn by Matplotlib, which is imported when a figure is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import MissingExtraError, how_to_install

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.path import Path

# The first nine are Paul Tol's "muted" scheme without its grey. Each of the others is as far as possible (CIELAB) from
# those before it, for normal and colour-blind eyes, on white and on black. Further clusters reuse the colours.
CLUSTER_COLORS = (
    "#332288", "#88CCEE", "#44AA99", "#999933", "#DDCC77", "#CC6677", "#AA4499", "#117733", "#882255", "#923DFF",
    "#9E92FF", "#AADB24", "#18F3B6", "#0000FF", "#AA0000", "#2461CE", "#79AA61", "#552424", "#799EDB", "#5500B6",
    "#FFAA92", "#55246D", "#925579", "#AADBDB",
)  # fmt: skip
NO_CLUSTER_COLOR = "#9A9A9A"  # UAVs without a head: decoys, destroyed UAVs, and followers if no head is left
HIT, REDUNDANT, MISSED = "#009E73", "#D55E00", "#000000"  # their shapes differ too: circle, square, dashed circle
HEAD_MARK, FOLLOWER_MARK, LINK_MARK = "head", "follower (colour = cluster)", "link from follower to head"
DECOY_MARK, DESTROYED_MARK = "decoy: has no followers", "destroyed earlier"
HIT_MARK, REDUNDANT_MARK, MISSED_MARK = "candidate: hit", "candidate: redundant", "head, not a candidate"
UNLED_MARK = "other (no leader found)"  # of recorded tracks
TRACK_WORDS = {  # for these marks, in recorded tracks
    HEAD_MARK: "leader",
    FOLLOWER_MARK: "other (colour = leader)",
    LINK_MARK: "link from follower to leader",
}
_DASHES = (0, (2, 1.2))
_MARKERS = "o^sD"
_CLUSTERS_PER_MARKER = 9  # a second sign beside the colour: clusters with the same colour have other markers
_TRACK_PARTS = 6  # number of segments of a track, from faint to strong
_TRACK_SAMPLES = 49  # maximum number of points of a track; more would not be visible


#: The square that a map shows, in metres: its centre (x, y) and half of its side.
Limits = tuple[float, float, float]


def new_figure(width: float, height: float, dpi: float = 100) -> Figure:
    """Create an empty figure with the Agg canvas, without pyplot.

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
        raise MissingExtraError(f"Drawing needs matplotlib; {how_to_install('render')}.") from None
    figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def last_seen_position(position: NDArray[np.float32], seen: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The position at which each UAV was last detected in a window.

    Args:
        position: ``(T_ob + 1, N, 3)`` metres.
        seen: ``(T_ob + 1, N)`` bool.

    Returns:
        ``(N, 3)`` metres; NaN for a UAV that was never detected.
    """
    when = len(seen) - 1 - np.argmax(seen[::-1], axis=0)
    place = position[when, np.arange(position.shape[1])]
    return np.asarray(np.where(np.any(seen, axis=0, keepdims=True).T, place, np.float32(np.nan)))


def limits_around(place: NDArray[np.floating[Any]], margin: float = 0.12, least: float = 1.0) -> Limits:
    """The smallest square around some positions, with a margin.

    Args:
        place: ``(..., 3)`` metres; NaN for what is not drawn.
        margin: share of the side that is added to it.
        least: the least side without the margin, metres; recorded tracks may be smaller than a metre.
    """
    known = place[np.isfinite(place[..., 0])][:, :2]
    low, high = (known.min(axis=0), known.max(axis=0)) if len(known) else (np.zeros(2), np.ones(2))
    x, y = ((low + high) / 2).tolist()
    return x, y, (1 + margin) / 2 * max(float((high - low).max()), least)


def cluster_colors(
    head: NDArray[np.bool_], root: NDArray[np.int64], number: NDArray[np.int64] | None = None
) -> tuple[NDArray[np.str_], NDArray[np.int64]]:
    """The colour and the marker of every UAV by its head.

    Args:
        head: ``(N,)`` bool, H_0.
        root: ``(N,)`` int64, the head of each UAV; a head's own index; -1: no head.
        number: ``(N,)`` int64, the number of each head's cluster, from 0; ``None``: heads are counted.

    Returns:
        ``(N,)`` hexadecimal colours, which differ for 24 clusters, and ``(N,)`` int64 marker numbers (0 for the first
        nine clusters). Colour and marker together differ for 72 clusters.
    """
    numbers = np.asarray(np.cumsum(head) - 1 if number is None else number)
    cluster = np.asarray(np.where((root >= 0) & head[root], numbers[root], -1))
    colors = np.where(cluster >= 0, np.array(CLUSTER_COLORS)[cluster % len(CLUSTER_COLORS)], NO_CLUSTER_COLOR)
    return colors, np.maximum(cluster, 0) // _CLUSTERS_PER_MARKER % len(_MARKERS)


def _draw_tracks(axes: Axes, position: NDArray[np.float32], seen: NDArray[np.bool_], colors: NDArray[np.str_]) -> None:
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


def _draw_points(axes: Axes, place: NDArray[np.float32], chosen: NDArray[np.bool_], **style: Any) -> None:
    if chosen.any():
        axes.scatter(place[chosen, 0], place[chosen, 1], **style)


def round_marks(
    place: NDArray[np.float32],
    alive: NDArray[np.bool_],
    head: NDArray[np.bool_],
    root: NDArray[np.int64],
    decoy: NDArray[np.bool_],
    candidates: NDArray[np.bool_] | None = None,
    destroyed_at: NDArray[np.float32] | None = None,
) -> dict[str, NDArray[np.bool_]]:
    """The mask ``(N,)`` of UAVs for each mark in the picture of a round. The keys are the texts of the legend.

    ``place`` ``(N, 3)`` holds positions, NaN for UAVs that are not drawn; all others are as in :func:`draw_round`.
    """
    shown = np.isfinite(place[:, 0])
    target = head & alive
    none = np.zeros_like(alive)
    gone = none if destroyed_at is None else ~alive & np.isfinite(destroyed_at[:, 0])
    follower = shown & ~head & ~decoy
    return {
        HEAD_MARK: shown & head,
        FOLLOWER_MARK: follower,
        LINK_MARK: follower & (root >= 0) & shown[root],
        DECOY_MARK: shown & decoy,
        HIT_MARK: none if candidates is None else candidates & target,
        REDUNDANT_MARK: none if candidates is None else candidates & ~target,
        MISSED_MARK: none if candidates is None else ~candidates & target,
        DESTROYED_MARK: gone,
    }


def dashed_ring() -> Path:
    """A marker for legends: the dashed circle around a head that is not a candidate."""
    from matplotlib.path import Path

    return Path.make_compound_path(*(Path.arc(start, start + 30) for start in range(0, 360, 45)))


def draw_legend(axes: Axes, labels: Mapping[str, str]) -> None:
    """Draw a legend at the right of ``axes``.

    Args:
        axes: the axes.
        labels: the text for each mark that the legend shows: those of :func:`round_marks`, and ``UNLED_MARK``.
    """
    from matplotlib.lines import Line2D

    def point(**style: Any) -> Line2D:
        return Line2D([], [], linestyle="none", **style)

    ring = {"color": "none", "marker": "o", "markersize": 15, "markeredgewidth": 2.4}
    keys = {
        HEAD_MARK: point(marker="*", color="#555555", markeredgecolor="black", markersize=15),
        FOLLOWER_MARK: point(marker="o", color="#777777", markersize=6),
        UNLED_MARK: point(marker="o", color=NO_CLUSTER_COLOR, markersize=6),
        LINK_MARK: Line2D([], [], color="#777777", alpha=0.6, linewidth=1),
        DECOY_MARK: point(marker="D", color="white", markeredgecolor="black", markersize=7),
        HIT_MARK: point(markeredgecolor=HIT, **ring),
        REDUNDANT_MARK: point(markeredgecolor=REDUNDANT, **ring | {"marker": "s", "markersize": 12}),
        MISSED_MARK: point(markeredgecolor=MISSED, **ring | {"marker": dashed_ring(), "markeredgewidth": 1.6}),
        DESTROYED_MARK: point(marker="x", color=NO_CLUSTER_COLOR, markersize=7, markeredgewidth=1.6),
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


def _set_up_axes(axes: Axes, limits: Limits, title: str) -> None:
    x, y, half = limits
    axes.set_xlim(x - half, x + half)
    axes.set_ylim(y - half, y + half)
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
    root: NDArray[np.int64],
    decoy: NDArray[np.bool_],
    candidates: NDArray[np.bool_] | None = None,
    *,
    number: NDArray[np.int64] | None = None,
    destroyed_at: NDArray[np.float32] | None = None,
    axes: Axes | None = None,
    title: str = "",
    legend: bool = True,
    limits: Limits | None = None,
) -> Figure:
    """Draw a window from above with the true clusters and the detector's candidates.

    Tracks fade into the past. A UAV is drawn at its last detected position, in the colour of its true cluster and with
    a line to its head. A green circle marks a hit, a red square a redundant candidate, and a dashed circle a head that
    is not a candidate.

    Args:
        position: ``(T_ob + 1, N, 3)`` metres.
        seen: ``(T_ob + 1, N)`` bool.
        alive: ``(N,)`` bool, before the candidates are destroyed.
        head: ``(N,)`` bool, H_0.
        root: ``(N,)`` int64, the head of each UAV; a head's or decoy's own index; -1: no head.
        decoy: ``(N,)`` bool.
        candidates: ``(N,)`` bool, or ``None`` before the first answer.
        number: ``(N,)`` int64, the number of each head's cluster, which gives its colour; ``None``: heads are counted.
        destroyed_at: ``(N, 3)`` metres, last positions of destroyed UAVs (NaN: unknown); ``None``: not drawn.
        axes: the axes to draw on; ``None``: a new figure.
        title: the title above the picture.
        legend: whether to draw a legend on the right.
        limits: the square to show; ``None``: the one around all that is drawn.

    Returns:
        The figure.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    from matplotlib.collections import LineCollection

    if axes is None:
        axes = new_figure(9.6, 7.2).add_axes((0.07, 0.08, 0.66, 0.86) if legend else (0.09, 0.08, 0.88, 0.86))
    place = last_seen_position(position, seen & alive)
    marks = round_marks(place, alive, head, root, decoy, candidates, destroyed_at)
    gone = marks[DESTROYED_MARK]
    everywhere = place if destroyed_at is None else np.asarray(np.where(gone[:, None], destroyed_at, place))
    # The limits come first: otherwise they are computed anew for everything that is drawn.
    _set_up_axes(axes, limits_around(everywhere) if limits is None else limits, title)
    shown = np.isfinite(place[:, 0])
    colors, marker = cluster_colors(head, root, number)
    linked = marks[LINK_MARK]
    links = np.stack([place[linked, :2], place[root[linked], :2]], axis=1)
    axes.add_collection(LineCollection(list(links), colors=colors[linked], alpha=0.28, linewidths=0.7, zorder=1))
    _draw_tracks(axes, position[:, shown], (seen & alive)[:, shown], colors[shown])

    for kind, shape in enumerate(_MARKERS):
        chosen = marks[FOLLOWER_MARK] & (marker == kind)
        _draw_points(
            axes, place, chosen, s=22, c=colors[chosen], marker=shape, edgecolors="white", linewidths=0.4, zorder=3
        )
    stars, decoys = marks[HEAD_MARK], marks[DECOY_MARK]
    _draw_points(axes, place, stars, s=210, c=colors[stars], marker="*", edgecolors="black", linewidths=0.8, zorder=5)
    for kind, shape in enumerate(_MARKERS[1:], start=1):  # heads with the same colour have their followers' marker
        _draw_points(axes, place, stars & (marker == kind), s=22, c="white", marker=shape, linewidths=0, zorder=5.5)
    _draw_points(axes, place, decoys, s=46, c="white", marker="D", edgecolors="black", linewidths=1, zorder=4)

    _draw_points(axes, everywhere, gone, s=34, c=NO_CLUSTER_COLOR, marker="x", linewidths=1.5, zorder=2.5)
    ring: dict[str, Any] = {"facecolors": "none", "zorder": 6}
    _draw_points(axes, everywhere, marks[HIT_MARK], s=400, edgecolors=HIT, linewidths=2.4, **ring)
    _draw_points(axes, everywhere, marks[REDUNDANT_MARK], s=130, marker="s", edgecolors=REDUNDANT, linewidths=2, **ring)
    _draw_points(
        axes, everywhere, marks[MISSED_MARK], s=400, edgecolors=MISSED, linewidths=1.6, linestyles=[_DASHES], **ring
    )
    if legend:
        counts = {mark: int(chosen.sum()) for mark, chosen in marks.items()}
        draw_legend(axes, {mark: f"{mark} ({count})" for mark, count in counts.items() if count})
    figure: Any = axes.get_figure(root=True)
    return figure

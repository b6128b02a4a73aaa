"""Pictures of a swarm: one drawing of a round, which ``render``, figures and animations share, and the look of figures.

Matplotlib is an extra; its global state (pyplot, ``rcParams``) is not changed.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask, Singles
from usnet_env.config import MissingExtraError, how_to_install, instance_of
from usnet_env.detection import Detection
from usnet_env.files import atomic_write
from usnet_env.objectives import find_candidates
from usnet_env.window import Window

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The first nine are Paul Tol's "muted" scheme without its grey. The others differ for normal and colour-blind eyes, on
# white and on black. Further clusters reuse the colours.
CLUSTER_COLORS = (
    "#332288", "#88CCEE", "#44AA99", "#999933", "#DDCC77", "#CC6677", "#AA4499", "#117733", "#882255", "#923DFF",
    "#9E92FF", "#AADB24", "#18F3B6", "#0000FF", "#AA0000", "#2461CE", "#79AA61", "#552424", "#799EDB", "#5500B6",
    "#FFAA92", "#55246D", "#925579", "#AADBDB",
)  # fmt: skip
NO_CLUSTER_COLOR = "#9A9A9A"  # UAVs without a head: decoys, destroyed UAVs, and followers if no head is left
HIT, REDUNDANT, MISSED = "#009E73", "#D55E00", "#000000"  # their shapes differ too: circle, square, dashed circle
#: The colours of Okabe and Ito, which colour-blind readers can distinguish, without their yellow.
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")

HEAD_MARK, FOLLOWER_MARK, LINK_MARK = "head", "follower (colour = cluster)", "link from follower to head"
DECOY_MARK, DESTROYED_MARK = "decoy: has no followers", "destroyed earlier"
HIT_MARK, REDUNDANT_MARK, MISSED_MARK = "candidate: hit", "candidate: redundant", "head, not a candidate"
CANDIDATE_MARK = "candidate"
INTRUDER_MARK = "intruder, with its track"
UNLED_MARK = "other UAV"
#: The words for these marks in recorded tracks.
TRACK_WORDS = {
    HEAD_MARK: "leader", FOLLOWER_MARK: "other (colour = leader)", LINK_MARK: "link from follower to leader",
    UNLED_MARK: "other (no leader found)",
}  # fmt: skip
_DOT = {"marker": "o", "s": 22, "edgecolors": "#555555", "linewidths": 0.4, "zorder": 3}
_RING = {"marker": "o", "facecolors": "none", "linewidths": 2.2}
_STYLES: dict[str, dict[str, Any]] = {  # of the marks, in the order of the legend
    HEAD_MARK: {"marker": "*", "s": 210, "c": "#555555", "edgecolors": "black", "linewidths": 0.8, "zorder": 5},
    FOLLOWER_MARK: _DOT | {"c": "#777777"},
    UNLED_MARK: _DOT | {"c": NO_CLUSTER_COLOR},
    DECOY_MARK: {"marker": "D", "s": 46, "c": "white", "edgecolors": "black", "linewidths": 1, "zorder": 4},
    CANDIDATE_MARK: _RING | {"s": 260, "edgecolors": "#0072B2"},
    HIT_MARK: _RING | {"s": 400, "edgecolors": HIT},
    REDUNDANT_MARK: _RING | {"s": 130, "edgecolors": REDUNDANT, "marker": "s"},
    MISSED_MARK: _RING | {"s": 400, "edgecolors": MISSED, "linestyles": [(0, (2, 1.2))], "linewidths": 1.6},
    INTRUDER_MARK: {"marker": "^", "s": 90, "c": REDUNDANT, "edgecolors": "black", "linewidths": 0.8, "zorder": 7},
    DESTROYED_MARK: {"marker": "x", "s": 34, "c": NO_CLUSTER_COLOR, "linewidths": 1.5, "zorder": 2.5},
}
MOST_LINKED = 300  # UAVs: of more, links are a ball of wool
_INK = (0.68, 0.68, 0.68, 1.0)  # of a colour in lines, which have no dark edge: a contrast of 3 to 1 on white
_TRACK_PARTS = 6  # number of segments of a track, from faint to strong
_TRACK_SAMPLES = 49  # maximum number of points of a track; more would not be visible
_FRAME_MARGIN = 0.4  # room for the swarm to drift and spread before the axes have to grow
_METADATA: dict[str, Any] = {  # without the date and the versions, so that equal figures have equal bytes
    "png": {"Software": None},
    "pdf": {"Creator": None, "Producer": None, "CreationDate": None},
}
_OFFSETS = [(side, row) for row in (1, -1, 0, 2, -2, 3, -3, 4, -4) for side in (1, -1, 0) if side or row]  # of a name

#: The square that a map shows, in metres: its centre (x, y) and half of its side.
Limits = tuple[float, float, float]


def new_figure(width: float, height: float, dpi: float = 100) -> Figure:
    """Create an empty figure of ``width`` by ``height`` inches with the Agg canvas, without pyplot.

    Jupyter shows figures after pyplot was imported, and this one also if it wasn't.

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
    figure._repr_png_ = partial(_encode_png, figure)  # type: ignore[attr-defined]  # what Jupyter asks for
    return figure


def _encode_png(figure: Figure) -> bytes:
    file = BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def last_seen_position(position: Singles, seen: Mask) -> Singles:
    """Where each UAV was last ``seen`` ``(T_ob + 1, N)`` in a window: ``(N, 3)`` metres, NaN for one never seen."""
    last = len(seen) - 1 - np.argmax(seen[::-1], axis=0)
    last_position = position[last, np.arange(position.shape[1])]
    return np.asarray(np.where(np.any(seen, axis=0, keepdims=True).T, last_position, np.float32(np.nan)))


def limits_around(position: NDArray[np.floating[Any]], margin: float = 0.12, least: float = 1.0) -> Limits:
    """The smallest square around positions ``(..., 3)`` (NaN: none), of at least ``least`` metres, and a margin."""
    points = position[np.isfinite(position[..., 0])][:, :2]
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(2), np.ones(2))
    x, y = ((low + high) / 2).tolist()
    return x, y, (1 + margin) / 2 * max(float((high - low).max()), least)


def cluster_colors(head: Mask, root: Indices, number: Indices | None = None) -> NDArray[np.str_]:
    """The colour of every UAV by its head, ``(N,)``; the arguments are as in :func:`draw_round`."""
    numbers = np.asarray(np.cumsum(head) - 1 if number is None else number)
    colors = np.array(CLUSTER_COLORS)[numbers[root] % len(CLUSTER_COLORS)]
    return np.where((root >= 0) & head[root], colors, NO_CLUSTER_COLOR)


def round_marks(
    position: Singles,
    alive: Mask,
    head: Mask,
    root: Indices,
    decoy: Mask,
    candidates: Mask | None = None,
    destroyed_at: Singles | None = None,
) -> dict[str, Mask]:
    """The UAVs ``(N,)`` of each mark, by the texts of the legend; ``position`` is NaN for UAVs that are not drawn."""
    is_shown = np.isfinite(position[:, 0])
    is_head = head & alive
    no_uavs = np.zeros_like(alive)
    is_candidate, is_missed = (no_uavs, no_uavs) if candidates is None else (candidates, is_head & ~candidates)
    is_other = is_shown & ~head & ~decoy
    is_follower = is_other & (root >= 0) & head[root]
    return {
        HEAD_MARK: is_shown & head,
        FOLLOWER_MARK: is_follower,
        UNLED_MARK: is_other & ~is_follower,
        LINK_MARK: is_follower & is_shown[root] & (len(position) <= MOST_LINKED),
        DECOY_MARK: is_shown & decoy,
        HIT_MARK: is_candidate & is_head,
        REDUNDANT_MARK: is_candidate & ~is_head,
        MISSED_MARK: is_missed,
        DESTROYED_MARK: no_uavs if destroyed_at is None else ~alive & np.isfinite(destroyed_at[:, 0]),
    }


def draw_legend(axes: Axes, labels: Mapping[str, str], **options: Any) -> None:
    """Draw a legend of texts by mark at the right of ``axes``; ``options`` are those of ``Axes.legend``."""
    from matplotlib.lines import Line2D

    link = Line2D([], [], color="#777777", alpha=0.6, linewidth=1)
    sizes = {mark: {"s": min(max(style["s"], 40), 180)} for mark, style in _STYLES.items()}
    keys = [link if mark == LINK_MARK else axes.scatter([], [], **_STYLES[mark] | sizes[mark]) for mark in labels]
    style: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.0), "fontsize": 9.5, "frameon": False}
    axes.legend(keys, list(labels.values()), **style | {"labelspacing": 0.9, "scatterpoints": 1} | options)


def _draw_tracks(axes: Axes, position: Singles, seen: Mask, colors: NDArray[np.str_]) -> None:
    from matplotlib.collections import LineCollection
    from matplotlib.colors import to_rgba_array

    path = np.where(seen[..., None], position[..., :2], np.nan)
    path = path[np.unique(np.linspace(0, len(path) - 1, min(len(path), _TRACK_SAMPLES)).astype(int))]
    edges = np.linspace(0, len(path) - 1, min(_TRACK_PARTS, len(path) - 1) + 1).astype(int)
    for part, (first, last) in enumerate(pairwise(edges), start=1):
        shades = to_rgba_array(colors.tolist(), part / (len(edges) - 1)) * _INK
        lines = list(np.swapaxes(path[first : last + 1], 0, 1))
        axes.add_collection(LineCollection(lines, colors=shades, linewidths=0.9, capstyle="round", zorder=2))


def set_up_axes(axes: Axes, limits: Limits, title: str) -> None:
    """Give a map its square, grid, ticks and title."""
    x, y, half = limits
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal", facecolor="#FBFBFB")
    axes.set(xlabel="x in m", ylabel="y in m")
    axes.tick_params(labelsize=8, colors="#555555")
    axes.grid(color="#E8E8E8", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[:].set_color("#CCCCCC")
    axes.set_title(title, fontsize=11, loc="left", y=1)  # without y, its place is looked for at every drawing


def plot_detection(detection: Detection, window: Window) -> Figure:
    """Draw a window from above: stars are the candidates, lines connect the others to those that lead them.

    Raises:
        ArgumentError: an argument is of another class.
        MissingExtraError: matplotlib is not installed.
    """
    instance_of("detection", detection, Detection)
    instance_of("window", window, Window)
    head, root, no_decoys = detection.candidates, find_candidates(detection), np.zeros(window.uavs, bool)
    return draw_round(window.position, window.seen, window.alive, head, root, no_decoys)


def draw_round(
    position: Singles,
    seen: Mask,
    alive: Mask,
    head: Mask,
    root: Indices,
    decoy: Mask,
    candidates: Mask | None = None,
    *,
    number: Indices | None = None,
    destroyed_at: Singles | None = None,
    intruders: Singles | None = None,
    axes: Axes | None = None,
    title: str = "",
    legend: bool = True,
    limits: Limits | None = None,
    truth: bool = True,
) -> Figure:
    """Draw a window and a round's answer, seen from above.

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
        intruders: ``(T_ob + 1, K, 3)`` metres, the tracks of intruders; ``None``: there are none.
        axes: the axes to draw on; ``None``: a new figure.
        title: the title above the picture.
        legend: whether to draw a legend on the right.
        limits: the square to show; ``None``: the one around all that is drawn.
        truth: whether to show roles and clusters; otherwise UAVs are equal dots, and blue circles mark candidates.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    if axes is None:
        axes = new_figure(9.6, 7.2).add_axes((0.07, 0.08, 0.66, 0.86) if legend else (0.09, 0.08, 0.88, 0.86))
    from matplotlib.collections import LineCollection
    from matplotlib.colors import to_rgba_array

    last_position = last_seen_position(position, seen & alive)
    is_shown = np.isfinite(last_position[:, 0])
    if truth:
        marks = round_marks(last_position, alive, head, root, decoy, candidates, destroyed_at)
    else:
        head, root = np.zeros_like(head), np.full_like(root, -1)
        marks = round_marks(last_position, alive, head, root, head, None, destroyed_at)
        marks[CANDIDATE_MARK] = head if candidates is None else candidates
    map_position = last_position
    if destroyed_at is not None:
        map_position = np.asarray(np.where(marks[DESTROYED_MARK][:, None], destroyed_at, last_position))
    # The limits come first: otherwise they are computed anew for everything that is drawn.
    set_up_axes(axes, limits_around(map_position) if limits is None else limits, title)
    colors = cluster_colors(head, root, number)
    is_linked = marks[LINK_MARK]
    links = list(np.stack([last_position[is_linked, :2], last_position[root[is_linked], :2]], axis=1))
    shades = to_rgba_array(colors[is_linked].tolist(), 0.35) * _INK
    axes.add_collection(LineCollection(links, colors=shades, linewidths=0.7, zorder=1))
    _draw_tracks(axes, position[:, is_shown], (seen & alive)[:, is_shown], colors[is_shown])

    for mark, uavs in marks.items():
        if mark != LINK_MARK and uavs.any():
            style = {"zorder": 6} | _STYLES[mark] | ({"c": colors[uavs]} if mark in (HEAD_MARK, FOLLOWER_MARK) else {})
            axes.scatter(map_position[uavs, 0], map_position[uavs, 1], **style)
    if intruders is not None:
        axes.plot(*np.moveaxis(intruders[..., :2], 2, 0), color=REDUNDANT, linewidth=1.4, zorder=6)
        axes.scatter(*intruders[-1, :, :2].T, **_STYLES[INTRUDER_MARK])
    if legend:
        counts = {mark: int(uavs.sum()) for mark, uavs in marks.items()}
        counts[INTRUDER_MARK] = 0 if intruders is None else intruders.shape[1]
        draw_legend(axes, {mark: f"{mark} ({count})" for mark, count in counts.items() if count})
    figure: Any = axes.get_figure(root=True)
    return figure


def pixels_of(figure: Figure) -> NDArray[np.uint8]:
    """Draw a figure and return its pixels, ``(H, W, 3)`` uint8."""
    canvas: Any = figure.canvas
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


class EpisodeFrames:
    """Renders the frames of one episode: on axes that only grow, with the UAVs destroyed in earlier rounds."""

    def __init__(self) -> None:
        self.limits: Limits | None = None
        self._last: Singles | None = None  # where each UAV was seen last

    def watch(self, position: Singles, seen: Mask) -> None:
        """Take note of a window, once for each, in their order; the arrays are those of :func:`draw_round`."""
        last = last_seen_position(position, seen)
        self._last = last if self._last is None else np.where(np.isfinite(last), last, self._last)
        x, y, half = self.limits or (0.0, 0.0, -1.0)
        if (np.abs(last[:, :2] - (x, y)) > half).any():
            self.limits = limits_around(self._last, _FRAME_MARGIN)

    def render(self, **scene: Any) -> NDArray[np.uint8]:
        """Render a window, ``(720, 960, 3)`` uint8; ``scene`` holds arguments of :func:`draw_round` by name."""
        return pixels_of(draw_round(**scene, destroyed_at=self._last, limits=self.limits))


def abbreviate(names: Sequence[str], max_length: int) -> list[str]:
    """Shorten names in their middle to ``max_length`` characters, at least 5, unless two would become equal."""
    half = (max_length - 1) // 2
    start = max_length - 1 - half
    short = {name: name if len(name) <= max_length else f"{name[:start]}…{name[-half:]}" for name in names}
    counts = Counter(short.values())
    return [short[name] if counts[short[name]] == 1 else name for name in names]


def escape_math(text: str) -> str:
    """Text that matplotlib shows as it is: a dollar sign begins no formula."""
    return text.replace("$", r"\$")


def annotate_points(axes: Axes, points: Floats, names: Sequence[str], **style: Any) -> None:
    """Write names beside points ``(n, 2)`` of final ``axes`` where they cover the fewest other names and points."""
    figure: Any = axes.get_figure(root=True)
    pixels = figure.dpi / 72
    frame = axes.get_window_extent().padded(-4 * pixels)
    pixel_points = axes.transData.transform(points)
    boxes = np.hstack([pixel_points - 6 * pixels, pixel_points + 6 * pixels])  # what names should leave free
    for k, (name, point) in enumerate(zip(names, pixel_points, strict=True)):
        text = axes.annotate(
            escape_math(name), points[k].tolist(), (0, 0), textcoords="offset points", annotation_clip=False, **style
        )
        with warnings.catch_warnings(action="ignore"):  # of missing characters, which the file shows as boxes
            size = np.array(text.get_window_extent().size)
        centres = point + np.array(_OFFSETS) * (size / (2, 1) + (7 * pixels, 0))
        low = np.clip(centres - size / 2, (frame.x0, frame.y0), (frame.x1, frame.y1) - size)
        overlap = np.minimum(low[:, None] + size, boxes[:, 2:]) - np.maximum(low[:, None], boxes[:, :2])
        weight = np.where(np.arange(len(boxes)) < len(pixel_points), 1, 10)  # a name on a name is worse than on a point
        best = low[int(np.argmin(np.maximum(overlap, 0).prod(axis=2) @ weight))]
        text.set_position(((best - point) / pixels).tolist())
        boxes = np.vstack([boxes, [*best, *(best + size)]])


def caption_figure(figure: Figure, title: str, caption: str) -> None:
    """Write a title above a figure, and below it a caption: what is shown, n, and the meaning of intervals."""
    lines = fill(caption, int(12.5 * figure.get_figwidth()))
    figure.suptitle(f"{title}\n{lines}", x=0.01, ha="left", fontsize=10.5)


def write_figure(figure: Figure, path: Path) -> Path:
    """Write a figure as ``.png`` (200 pixels per inch) or ``.pdf`` (vectors); the file appears whole.

    The same figure gives the same bytes.

    Raises:
        ArgumentError: the place can't be written to.
    """
    from matplotlib import rc_context

    kind, fonts = path.suffix.lower()[1:], rc_context({"pdf.fonttype": 42})
    with warnings.catch_warnings(record=True, action="always") as caught, fonts, atomic_write(path) as temporary:
        figure.savefig(temporary, format=kind, dpi=200, metadata=_METADATA[kind])
    if any("missing from font" in str(warning.message) for warning in caught):
        warnings.warn("The fonts of this machine lack some characters of the figure: it has boxes there.", stacklevel=2)
    return path

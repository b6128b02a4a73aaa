"""One picture of the leaders that were found in tracks: maps of some windows, and who leads when."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.drawing import (
    CLUSTER_COLORS,
    FOLLOWER_MARK,
    HEAD_MARK,
    LINK_MARK,
    TRACK_WORDS,
    UNLED_MARK,
    abbreviate,
    annotate_points,
    draw_legend,
    draw_round,
    escape_math,
    last_seen_position,
    limits_around,
    new_figure,
    round_marks,
    text_size,
)
from usnet_env.tracks.leaders import DetectedWindow, FoundLeaders, find_date, format_time
from usnet_env.tracks.tracks import Tracks
from usnet_env.tracks.windows import TrackWindow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_MAPS, _COLUMNS = 6, 3
_MAP, _GAP, _LEGEND, _HEADER = 4.6, 0.75, 2.7, 1.3  # inches
_TITLES = 0.4  # inches between rows of maps, for titles of two lines
_MOST_ROWS, _ROW = 16, 0.27  # of the lower chart; inches
_MOST_NAMES = 12  # leaders that a map names
_MOST_REJECTED = 3  # candidates in the title of a map
_LONGEST_TITLE = 40  # characters of a line
_LONGEST_NAME = 24  # characters of an id
_MARGIN = 1.9  # inches at the left of the lower chart, or more for its names
_MARKS = (HEAD_MARK, FOLLOWER_MARK, LINK_MARK, UNLED_MARK)  # of the legend, in its order
#: A window of a map, its leader by index ``(N,)`` (-1: none; a leader has its own index), and the leaders.
Map = tuple[TrackWindow, NDArray[np.int64], DetectedWindow]


def draw_leaders(found: FoundLeaders, maps: Sequence[Map], title: str, tracks: Tracks) -> Figure:
    """Draw up to six windows as maps from above, and below them the windows in which each id leads.

    Long ids are abbreviated in the middle, in all places alike.

    Args:
        found: the leaders.
        maps: the windows to draw.
        title: what the tracks are.
        tracks: the tracks, which say where their origin is and the unit of their times.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    columns = min(max(len(maps), 1), _COLUMNS)
    lines = -(-len(maps) // columns)
    bars = found.leaders[:_MOST_ROWS]
    chart = 1.1 + _ROW * max(len(bars), 1)
    width = max(columns * (_MAP + _GAP) + _LEGEND, 9.0)
    height = _HEADER + lines * (_MAP + _GAP + _TITLES) + chart
    figure = new_figure(width, height)
    figure.text(0.5 / width, 1 - 0.25 / height, "Leaders and followers", fontsize=17, weight="bold", va="top")
    shown = f"{len(maps)} of {len(found.windows)} windows, " if len(maps) < len(found.windows) else ""
    words = _Words(found, tracks)
    marks: dict[str, str] = {}
    beside: Axes | None = None
    for k, (cut, leader, window) in enumerate(maps):
        left, top = 0.7 + k % columns * (_MAP + _GAP), _HEADER + k // columns * (_MAP + _GAP + _TITLES)
        axes = figure.add_axes((left / width, 1 - (top + _MAP) / height, _MAP / width, _MAP / height))
        marks |= _draw_map(axes, cut, leader, window, words, tracks)
        if k % columns:
            axes.set_ylabel("")
        if k == columns - 1:
            beside = axes
    if beside is not None:
        draw_legend(beside, {mark: marks[mark] for mark in _MARKS if mark in marks})
    day = f" {words.date} (UTC)," if words.date else ""
    stars = " Stars are leaders." if HEAD_MARK in marks else ""
    if LINK_MARK in marks:
        stars = " Stars are leaders, lines connect followers to them."
    about = f"{title}:{day} {shown}by {found.detector}.{stars}"
    figure.text(0.5 / width, 1 - 0.65 / height, escape_math(about), fontsize=10, va="top", color="#333333")
    bottom = 0.55
    axes = figure.add_axes((_MARGIN / width, bottom / height, (width - _MARGIN - 0.5) / width, (chart - 1.0) / height))
    _draw_times(axes, found, words)
    names = max((text_size(each)[0] / figure.dpi for each in axes.get_yticklabels()), default=0.0)
    margin = max(_MARGIN, names + 0.5)
    axes.set_position((margin / width, bottom / height, (width - margin - 0.5) / width, (chart - 1.0) / height))
    return figure


class _Words:
    """How times and ids are written in the picture.

    Args:
        found: the leaders.
        tracks: the tracks.
    """

    def __init__(self, found: FoundLeaders, tracks: Tracks) -> None:
        self.date = find_date(found)
        self.unit = tracks.clock.unit_name
        named = [leader.id for leader in found.leaders] + [each for one in found.windows for each in one.not_confirmed]
        ids = list(dict.fromkeys(map(str, named)))
        self._short = dict(zip(ids, abbreviate(ids, _LONGEST_NAME), strict=True))

    def name(self, who: str | int) -> str:
        """An id that leads, or is not confirmed, abbreviated if it is long."""
        return self._short[str(who)]


def _draw_map(
    axes: Axes, cut: TrackWindow, leader: NDArray[np.int64], window: DetectedWindow, words: _Words, tracks: Tracks
) -> dict[str, str]:
    """Draw one window; returns the marks that it shows, for the legend."""
    from matplotlib.patheffects import Normal, Stroke

    uavs = len(cut.ids)
    groups = {each.id: each.group - 1 for each in window.leaders}
    head = np.array([each in groups for each in cut.ids])
    number = np.array([groups.get(each, 0) for each in cut.ids])  # a group has one colour in all windows
    none = np.zeros(uavs, bool)
    origin = cut.origin + (tracks.origin if tracks.frame == "metres" else 0.0)
    position: Any = cut.window.position + origin  # in float64: coordinates may be large
    title = escape_math(_title_map(window, words))
    draw_round(
        position, cut.window.seen, cut.window.alive, head, leader, none,
        axes=axes, title=title, legend=False, limits=limits_around(position[cut.window.seen], 0.08, 1e-6),
        number=number,
    )  # fmt: skip
    place = last_seen_position(position, cut.window.seen)
    names = {each: i for i, each in enumerate(cut.ids)}
    halo = [Stroke(linewidth=2.5, foreground="white"), Normal()]  # a name can be read where marks and tracks crowd
    named = window.leaders[:_MOST_NAMES]
    points: Any = place[[names[each.id] for each in named], :2].reshape(-1, 2)
    annotate_points(
        axes, points, [words.name(each.id) for each in named], fontsize=8, weight="bold", zorder=7, path_effects=halo
    )
    present = round_marks(place, cut.window.alive, head, leader, none)
    present[UNLED_MARK] = present[FOLLOWER_MARK] & ~present[LINK_MARK]
    present[FOLLOWER_MARK] = present[LINK_MARK]  # those with a leader
    return {mark: TRACK_WORDS.get(mark, mark) for mark, who in present.items() if who.any()}


def _title_map(window: DetectedWindow, words: _Words) -> str:
    """The times of a window and, in a second line, its candidates that are not confirmed."""
    day = words.date or str(window.start).partition("T")[0]
    title = f"{format_time(window.start, words.date)} to {format_time(window.end, day)} {words.unit}".rstrip()
    if window.not_confirmed:
        named = f"not confirmed: {', '.join(map(words.name, window.not_confirmed[:_MOST_REJECTED]))}"
        more = "" if len(window.not_confirmed) <= _MOST_REJECTED else ", …"
        title += f"\n{named if len(named) <= _LONGEST_TITLE else named[: _LONGEST_TITLE - 1] + '…'}{more}"
    return title


def _draw_times(axes: Axes, found: FoundLeaders, words: _Words) -> None:
    """Draw a row for each leader over the file, with a bar for each window in which it leads."""
    bars = found.leaders[:_MOST_ROWS]
    for row, each in enumerate(bars):
        led = [
            k
            for k, window in enumerate(found.windows)
            if any(leader.id == each.id and leader.group == each.group for leader in window.leaders)
        ]
        color = CLUSTER_COLORS[(each.group - 1) % len(CLUSTER_COLORS)]
        axes.barh([row] * len(led), [1.0] * len(led), left=led, height=0.7, color=color)
    axes.set_yticks(range(len(bars)), [escape_math(words.name(each.id)) for each in bars], fontsize=8)
    axes.set_ylim(max(len(bars), 1) - 0.5, -0.5)
    count = len(found.windows)
    longest = max(len(format_time(window.start, words.date)) for window in found.windows)
    ticks = np.unique(np.linspace(0, count - 1, min(count, max(2, min(8, 80 // longest)))).astype(int))
    axes.set_xlim(0, count)
    axes.set_xticks(ticks, [format_time(found.windows[k].start, words.date) for k in ticks], fontsize=8)
    more = f", {len(bars)} of {len(found.leaders)} leaders" if len(bars) < len(found.leaders) else ""
    unit = f" in {words.unit}" if words.unit else ""
    heading = f"Windows in which each id leads (colour = group){more}; time of their start{unit} below"
    axes.set_title(heading, fontsize=10, loc="left")
    if not bars:
        axes.text(0.5, 0.5, "No leader was found.", transform=axes.transAxes, ha="center", va="center", color="#555555")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)

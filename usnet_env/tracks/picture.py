"""One picture of the leaders that were found in tracks: maps of some windows, and who leads when."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env import drawing
from usnet_env.tracks.leaders import DetectedWindow, FoundLeaders, find_date, format_time
from usnet_env.tracks.tracks import Tracks, TrackWindow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_MAPS, _COLUMNS = 6, 3
_MAP, _GAP, _LEGEND, _HEADER = 4.6, 0.75, 2.7, 1.3  # inches
_TITLES = 0.4  # inches between rows of maps, for titles of two lines
_MOST_ROWS, _ROW = 16, 0.27  # of the lower chart; inches
_MOST_NAMES = 12  # leaders that a map names
_MOST_REJECTED = 3  # candidates in the title of a map
_LONGEST_TITLE = 40  # characters of a line
_LONGEST_NAME = 24  # characters of an id
_MARKS = (
    drawing.HEAD_MARK,
    drawing.FOLLOWER_MARK,
    drawing.LINK_MARK,
    drawing.UNLED_MARK,
)  # of the legend, in its order


def draw_leaders(found: FoundLeaders, cuts: Iterable[TrackWindow], title: str, tracks: Tracks) -> Figure:
    """Draw up to six windows as maps from above, and below them the windows in which each id leads.

    Long ids are abbreviated in the middle, in all places alike.

    Args:
        found: the leaders.
        cuts: all windows; up to six are drawn, evenly spread, those with leaders first.
        title: what the tracks are.
        tracks: the tracks, which say where their origin is and the unit of their times.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    chosen = _choose_windows(found)
    columns = min(len(chosen), _COLUMNS)
    bars = min(len(found.leaders), _MOST_ROWS)
    chart = 1.1 + _ROW * max(bars, 1)
    width = max(columns * (_MAP + _GAP) + _LEGEND, 9.0)
    height = _HEADER + -(-len(chosen) // columns) * (_MAP + _GAP + _TITLES) + chart
    figure = drawing.new_figure(width, height)
    figure.text(0.5 / width, 1 - 0.25 / height, "Leaders and followers", fontsize=17, weight="bold", va="top")
    words = _Words(found, tracks)
    marks: dict[str, str] = {}
    drawn = ((cut, window) for k, (cut, window) in enumerate(zip(cuts, found.windows, strict=True)) if k in chosen)
    maps = []
    for k, (cut, window) in enumerate(drawn):
        left, top = 0.7 + k % columns * (_MAP + _GAP), _HEADER + k // columns * (_MAP + _GAP + _TITLES)
        maps.append(figure.add_axes((left / width, 1 - (top + _MAP) / height, _MAP / width, _MAP / height)))
        marks |= _draw_map(maps[-1], cut, window, words, tracks)
        if k % columns:
            maps[-1].set_ylabel("")
    drawing.draw_legend(maps[columns - 1], {mark: marks[mark] for mark in _MARKS if mark in marks})
    day = f" {words.date} (UTC)," if words.date else ""
    shown = f"{len(chosen)} of {len(found.windows)} windows, " if len(chosen) < len(found.windows) else ""
    stars = " Stars are leaders." if drawing.HEAD_MARK in marks else ""
    if drawing.LINK_MARK in marks:
        stars = " Stars are leaders, lines connect followers to them."
    about = f"{title}:{day} {shown}by {found.detector}.{stars}"
    figure.text(0.5 / width, 1 - 0.65 / height, drawing.escape_math(about), fontsize=10, va="top", color="#333333")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    _draw_times(axes, found, words)
    names = max((drawing.text_size(label)[0] / figure.dpi for label in axes.get_yticklabels()), default=0.0)
    margin = max(1.9, names + 0.5)
    axes.set_position((margin / width, 0.55 / height, (width - margin - 0.5) / width, (chart - 1.0) / height))
    return figure


def _choose_windows(found: FoundLeaders) -> set[int]:
    """The numbers of up to six windows, evenly spread, those with leaders first."""
    chosen: set[int] = set()
    for with_leaders in (True, False):
        places = [k for k, window in enumerate(found.windows) if bool(window.leaders) == with_leaders]
        most = min(len(places), _MOST_MAPS - len(chosen))
        chosen |= {places[int(k)] for k in np.linspace(0, len(places) - 1, most)}
    return chosen


class _Words:
    """How times and ids are written in the picture."""

    def __init__(self, found: FoundLeaders, tracks: Tracks) -> None:
        self.date = find_date(found)
        self.unit = tracks.clock.unit_name
        named = [leader.id for leader in found.leaders]
        named += [name for window in found.windows for name in window.not_confirmed]
        ids = list(dict.fromkeys(map(str, named)))
        self._short = dict(zip(ids, drawing.abbreviate(ids, _LONGEST_NAME), strict=True))

    def name(self, who: str | int) -> str:
        """An id that leads, or is not confirmed, abbreviated if it is long."""
        return self._short[str(who)]


def _draw_map(axes: Axes, cut: TrackWindow, window: DetectedWindow, words: _Words, tracks: Tracks) -> dict[str, str]:
    """Draw one window; returns the marks that it shows, for the legend."""
    from matplotlib.patheffects import Normal, Stroke

    root = window.roots(cut.ids)
    groups = {leader.id: leader.group - 1 for leader in window.leaders}
    head, none = np.array([name in groups for name in cut.ids]), np.zeros(len(cut.ids), bool)
    number = np.array([groups.get(name, 0) for name in cut.ids])  # a group has one colour in all windows
    origin = cut.origin + (tracks.origin if tracks.frame == "metres" else 0.0)
    position: Any = cut.window.position + origin  # in float64: coordinates may be large
    seen, alive = cut.window.seen, cut.window.alive
    look: Any = {
        "axes": axes,
        "legend": False,
        "number": number,
        "limits": drawing.limits_around(position[seen], 0.08, 1e-6),
    }
    drawing.draw_round(
        position, seen, alive, head, root, none, title=drawing.escape_math(_title_map(window, words)), **look
    )
    place: Any = drawing.last_seen_position(position, seen)
    halo = [Stroke(linewidth=2.5, foreground="white"), Normal()]  # a name can be read where marks and tracks crowd
    named = [leader.id for leader in window.leaders[:_MOST_NAMES]]
    points = place[[cut.ids.index(name) for name in named], :2].reshape(-1, 2)
    style: Any = {"fontsize": 8, "weight": "bold", "zorder": 7, "path_effects": halo}
    drawing.annotate_points(axes, points, [words.name(name) for name in named], **style)
    present = drawing.round_marks(place, alive, head, root, none)
    present[drawing.UNLED_MARK] = present[drawing.FOLLOWER_MARK] & ~present[drawing.LINK_MARK]
    present[drawing.FOLLOWER_MARK] = present[drawing.LINK_MARK]  # those with a leader
    return {mark: drawing.TRACK_WORDS.get(mark, mark) for mark, who in present.items() if who.any()}


def _title_map(window: DetectedWindow, words: _Words) -> str:
    """The times of a window and, in a second line, its candidates that are not confirmed."""
    day = words.date or str(window.start).partition("T")[0]
    title = f"{format_time(window.start, words.date)} to {format_time(window.end, day)} {words.unit}".rstrip()
    if window.not_confirmed:
        named = f"not confirmed: {', '.join(map(words.name, window.not_confirmed[:_MOST_REJECTED]))}"
        ending = "" if len(window.not_confirmed) <= _MOST_REJECTED else ", …"
        title += f"\n{named if len(named) <= _LONGEST_TITLE else named[: _LONGEST_TITLE - 1] + '…'}{ending}"
    return title


def _draw_times(axes: Axes, found: FoundLeaders, words: _Words) -> None:
    """Draw a row for each leader over the file, with a bar for each window in which it leads."""
    bars, count = found.leaders[:_MOST_ROWS], len(found.windows)
    for row, bar in enumerate(bars):
        places = [
            k
            for k, window in enumerate(found.windows)
            if (bar.id, bar.group) in {(leader.id, leader.group) for leader in window.leaders}
        ]
        axes.barh(
            [row] * len(places),
            1.0,
            left=places,
            height=0.7,
            color=drawing.CLUSTER_COLORS[(bar.group - 1) % len(drawing.CLUSTER_COLORS)],
        )
    axes.set_yticks(range(len(bars)), [drawing.escape_math(words.name(bar.id)) for bar in bars], fontsize=8)
    times = [format_time(window.start, words.date) for window in found.windows]
    ticks = np.unique(np.linspace(0, count - 1, min(count, max(2, min(8, 80 // max(map(len, times)))))).astype(int))
    axes.set(xlim=(0, count), ylim=(max(len(bars), 1) - 0.5, -0.5))
    axes.set_xticks(ticks, [times[k] for k in ticks], fontsize=8)
    shown = f", {len(bars)} of {len(found.leaders)} leaders" if len(bars) < len(found.leaders) else ""
    unit = f" in {words.unit}" if words.unit else ""
    heading = f"Windows in which each id leads (colour = group){shown}; time of their start{unit} below"
    axes.set_title(heading, fontsize=10, loc="left")
    if not bars:
        axes.text(0.5, 0.5, "No leader was found.", transform=axes.transAxes, ha="center", va="center", color="#555555")
    axes.spines[["top", "right"]].set_visible(False)

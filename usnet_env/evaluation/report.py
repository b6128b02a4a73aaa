"""What reports of rows share: groups, means by episode, intervals, tables and panels.

A row is a mapping or an object with attributes; numbers may be texts, as a CSV file has them.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from usnet_env.drawing import new_figure, style_axes, write_figure
from usnet_env.evaluation.statistics import Interval, mean_interval
from usnet_env.evaluation.store import write_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "add_legend",
    "draw_intervals",
    "episode_means",
    "format_counts",
    "format_interval",
    "format_latex",
    "format_markdown",
    "group_rows",
    "keep_report",
    "make_panels",
    "mean_over_episodes",
]

RowT = TypeVar("RowT")
KeyT = TypeVar("KeyT", bound=Hashable)


def group_rows(rows: Iterable[RowT], key: Callable[[RowT], KeyT]) -> dict[KeyT, list[RowT]]:
    """Group rows by a key, in the order in which the keys appear."""
    found: dict[KeyT, list[RowT]] = {}
    for row in rows:
        found.setdefault(key(row), []).append(row)
    return found


def episode_means(rows: Iterable[Any], field: str, episode: str = "episode") -> list[float]:
    """Mean of a field over the rows of each episode, without NaN.

    Cells share the seeds of an episode: their rows are not independent, and these means are.

    Args:
        rows: the rows.
        field: name of the field.
        episode: name of the field with the number of the episode.
    """
    groups = group_rows(((_get(row, episode), float(_get(row, field))) for row in rows), lambda pair: pair[0])
    finite = ([value for _, value in own if isfinite(value)] for own in groups.values())
    return [sum(own) / len(own) for own in finite if own]


def mean_over_episodes(rows: Iterable[Any], field: str, episode: str = "episode") -> Interval:
    """The mean of :func:`episode_means`, with the bootstrap's interval."""
    return mean_interval(episode_means(rows, field, episode))


def _get(row: Any, name: str) -> Any:
    return row[name] if isinstance(row, Mapping) else getattr(row, name)


def format_interval(interval: Interval, form: str = ".2f", scale: float = 1.0, short: bool = False) -> str:
    """Format a mean with its interval, such as ``1.02 (1.00–1.05)``.

    Args:
        interval: the mean and its interval.
        form: how Python formats each number.
        scale: what the numbers are multiplied by.
        short: the mean alone if all values were equal.
    """
    mean, low, high = (format(scale * value, form) for value in interval)
    return mean if short and interval.low == interval.high else f"{mean} ({low}–{high})"


def format_markdown(
    header: Sequence[str | None], lines: Iterable[Sequence[str | None]], rule: str = "---"
) -> list[str]:
    """Format the lines of a Markdown table.

    Args:
        header: headings of the columns.
        lines: texts of the cells; ``None`` is an empty cell of one space, as ``""`` is one of two.
        rule: what a column has below its heading.
    """

    def join(line: Sequence[str | None]) -> str:
        return "|" + "|".join(" " if text is None else f" {text} " for text in line) + "|"

    return [join(header), "|" + f"{rule}|" * len(header), *map(join, lines)]


_LATEX = str.maketrans(
    {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "|": r"\textbar{}"}
    | {"↓": r"$\downarrow$", "↑": r"$\uparrow$", "<": r"\textless{}", ">": r"\textgreater{}", "–": "--"}
    | {sign: f"\\{sign}" for sign in "&%$#_{}"}
)


def format_latex(header: Sequence[str], lines: Iterable[Sequence[str]], text_columns: int | None = None) -> list[str]:
    """Format the lines of a LaTeX table, for the package ``booktabs``; the first column is left-aligned.

    Args:
        header: headings of the columns.
        lines: texts of the cells.
        text_columns: how many columns hold plain text, whose special signs are escaped; the other ones hold LaTeX.
            ``None``: all.
    """
    escaped = [[text.translate(_LATEX) for text in header]]
    for line in lines:
        latex = [] if text_columns is None else [text.replace("–", "--") for text in line[text_columns:]]
        escaped.append([*(text.translate(_LATEX) for text in line[:text_columns]), *latex])
    first, *others = (" & ".join(line) + r" \\" for line in escaped)
    return [
        rf"\begin{{tabular}}{{l{'r' * (len(header) - 1)}}}", r"\toprule", first, r"\midrule", *others, r"\bottomrule",
        r"\end{tabular}",
    ]  # fmt: skip


def keep_report(path: Path, markdown: str, picture: Figure, formats: Sequence[str] = ("png",)) -> None:
    """Keep the table and the picture of a suite beside its rows, as ``.md`` and in some formats."""
    write_text(path.with_suffix(".md"), markdown)
    write_figure(picture, path, formats)


def make_panels(
    width: float, height: float, rows: int = 1, columns: int = 1, **how: Any
) -> tuple[Figure, NDArray[np.object_]]:
    """Make a figure with a grid of panels in the look that all figures share.

    Args:
        width: of the figure, in inches.
        height: of the figure, in inches.
        rows: number of lines of panels.
        columns: number of panels of a line.
        how: further arguments of ``figure.subplots``.

    Returns:
        The figure, and its panels ``(rows, columns)``.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    figure = new_figure(width, height)
    figure.set_layout_engine("constrained")
    panels = figure.subplots(rows, columns, squeeze=False, **how)
    for axes in panels.ravel():
        style_axes(axes)
    return figure, panels


def draw_intervals(axes: Axes, intervals: Mapping[float, Interval], scale: float = 1.0, **look: Any) -> None:
    """Draw means with error bars.

    Args:
        axes: where to draw.
        intervals: the means with their intervals, by their places on the first axis.
        scale: what the numbers are multiplied by.
        look: further arguments of ``axes.errorbar``.
    """
    means = [scale * one.mean for one in intervals.values()]
    down = [scale * (one.mean - one.low) for one in intervals.values()]
    up = [scale * (one.high - one.mean) for one in intervals.values()]
    axes.errorbar(list(intervals), means, [down, up], **look)


def add_legend(figure: Figure, axes: Iterable[Axes], columns: int = 4) -> None:
    """Add a legend below all panels; what has the same label in several panels is listed once."""
    handles = {label: line for panel in axes for line, label in zip(*panel.get_legend_handles_labels(), strict=True)}
    look: dict[str, Any] = {"loc": "outside lower center", "ncols": columns, "fontsize": 9, "frameon": False}
    figure.legend(list(handles.values()), list(handles), **look)


def format_counts(counts: Iterable[int], noun: str) -> str:
    """Format the numbers of what points are means of: ``n = 30 episodes a point``, or ``n = 10 to 30 …``."""
    low, high = min(known := list(counts)), max(known)
    return f"n = {low}{f' to {high}' if high > low else ''} {noun} a point"

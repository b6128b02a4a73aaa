"""Markdown tables of rows: one function that groups them, and what stands in the cells of a group."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import pandas as pd
from paper.shared import interval

from usnet_env.evaluation.tables import format_markdown

CellFormatter = Callable[[pd.DataFrame], str]  # the text of a cell of a table, from the rows of the cell


def pivot(rows: pd.DataFrame, lines: Mapping[str, str], columns: Mapping[str, CellFormatter]) -> str:
    """A Markdown table with a line for each group of rows, in the order of the rows.

    Args:
        rows: the rows.
        lines: the columns of rows that name a group, by heading.
        columns: the texts of the other cells, from the rows of a group, by heading.
    """
    body = []
    for key, part in rows.groupby(list(lines.values()), sort=False, dropna=False):
        names = [f"`{name}`" if heading == "detector" else f"{name}" for heading, name in zip(lines, key, strict=True)]
        body.append([*names, *(format_cell(part) for format_cell in columns.values())])
    return markdown([*lines, *columns], body)


def markdown(header: Iterable[str], body: Iterable[Iterable[str]]) -> str:
    """A Markdown table of texts."""
    return format_markdown(list(header), [list(line) for line in body], numbers=False).strip()


def fold(title: str, *parts: str) -> str:
    """Parts of a page that a click opens."""
    return "\n\n".join([f"<details><summary>{title}</summary>", *parts, "</details>"])


def mean(metric: str, digits: int = 2, scale: float = 1.0, group: str = "episode") -> CellFormatter:
    """The mean with its interval, such as ``1.02 (1.00–1.05)``; alone if all values are equal, – if there is none."""

    def format_cell(rows: pd.DataFrame) -> str:
        if not rows[metric].notna().any():
            return "–"
        bounds = interval(rows, metric, group)
        centre, low, high = (f"{scale * value:.{digits}f}" for value in bounds)
        return centre if bounds.low == bounds.high else f"{centre} ({low}–{high})"

    return format_cell


def rate(metric: str, count: bool = False, group: str = "episode") -> CellFormatter:
    """The share of ones in percent with its interval, and n if ``count``."""

    def format_cell(rows: pd.DataFrame) -> str:
        if not len(rows):
            return "–"
        centre, low, high = (f"{100 * value:.1f}" for value in interval(rows, metric, group))
        return f"{centre} % ({low}–{high})" + (f"; {len(rows):,}" if count else "")

    return format_cell


def mean_by_recording(metric: str) -> CellFormatter:
    """The mean with its interval; a recording is one value."""
    return lambda rows: mean(metric, group="recording")(rows.groupby("recording", as_index=False)[metric].mean())


def share(part: str, whole: str, digits: int = 1) -> CellFormatter:
    """The sum of one column as a share of another one's, in percent; – if there is none."""
    return lambda rows: f"{rows[part].sum() / rows[whole].sum():.{digits}%}" if rows[whole].any() else "–"


def median(metric: str, form: str = ".2g") -> CellFormatter:
    """The median, without an interval."""
    return lambda rows: format(rows[metric].median(), form) if rows[metric].notna().any() else "–"


def across(
    column: str, values: Iterable[Any], format_cell: CellFormatter, heading: str = "{}"
) -> dict[str, CellFormatter]:
    """Columns of a table with the same text of the rows with each value of a column."""
    return {
        heading.format(value): lambda rows, value=value: format_cell(rows[rows[column] == value]) for value in values
    }


def size(rows: pd.DataFrame) -> str:
    """The number of rows."""
    return f"{len(rows):,}"

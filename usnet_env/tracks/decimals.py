"""Decimal commas in text files: whether a file has them, and numbers with points in their place."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from usnet_env.config import ArgumentError, quote

__all__ = ["has_decimal_commas", "is_comma_number", "to_points"]

_COMMA = re.compile(r"\s*[+-]?(\d*,\d+|\d+,)([eE][+-]?\d+)?\s*")
_POINT = re.compile(r"\s*[+-]?(\d*\.\d+|\d+\.)([eE][+-]?\d+)?\s*")
_THOUSANDS = re.compile(r"\s*[+-]?[1-9]\d{0,2},\d{3}\s*")  # 1,234 may be a whole number with a separator


def is_comma_number(cell: str) -> bool:
    """Whether a text is a number with one comma and no point."""
    return "," in cell and _COMMA.fullmatch(cell) is not None


def has_decimal_commas(columns: Sequence[Sequence[str]]) -> bool:
    """Whether the commas in some columns of numbers can only be decimal signs.

    They can where no number has a point, and one of them has another number of digits than 3 after its comma, or more
    than 3 digits or a 0 before it.

    Args:
        columns: the cells of each column of numbers or times.
    """
    commas = [cell for cells in columns for cell in cells if is_comma_number(cell)]
    sure = any(not _THOUSANDS.fullmatch(cell) for cell in commas)
    return sure and not any(_POINT.fullmatch(cell) for cells in columns for cell in cells if "." in cell)


def to_points(cells: Sequence[str], role: str, about: Callable[[str, int], str]) -> list[str]:
    """Numbers with a decimal comma as numbers with a point; other texts, such as timestamps, stay as they are.

    Args:
        cells: the cells of a column.
        role: what the column holds.
        about: names the place of a row of a role, for messages.

    Raises:
        ArgumentError: a number has a point.
    """
    for k, cell in enumerate(cells):
        if "." in cell and _POINT.fullmatch(cell):
            raise ArgumentError(
                f"{role} must be a number with a decimal comma in every row, as decimal=',' or the other numbers of "
                f"the file say, got {quote(cell)} in {about(role, k)}."
            )
    return [cell.replace(",", ".") if is_comma_number(cell) else cell for cell in cells]

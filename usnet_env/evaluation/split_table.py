"""A table for a terminal that is printed as several where it is too wide; imported when a table is made."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.table import Table

_SHARE = 4  # the first column is folded, but not below a quarter of the width
_UNLIMITED = 10_000  # columns


class SplitTable(Table):
    """A table that is printed as several if it is too wide: each has the first columns, and some of the others.

    Attributes:
        repeated: number of columns that each part has. The first one is folded before another part begins.
    """

    repeated: int = 1

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        parts: list[list[int]] = [[]]
        for number in range(self.repeated, len(self.columns)):
            if parts[-1] and self._least_width([*parts[-1], number], console, options) > options.max_width:
                parts.append([])
            parts[-1].append(number)
        for part in parts:
            yield from Table.__rich_console__(self._take(part), console, options)

    def _take(self, numbers: Sequence[int]) -> SplitTable:
        """The table with the repeated columns and those of these numbers."""
        part = copy(self)
        chosen = enumerate([*range(self.repeated), *numbers])
        part.columns = [replace(self.columns[number], _index=place) for place, number in chosen]
        return part

    def _least_width(self, numbers: Sequence[int], console: Console, options: ConsoleOptions) -> int:
        part = self._take(numbers)
        part.columns[0].max_width = max(1, options.max_width // _SHARE)
        return Measurement.get(console, options.update(max_width=_UNLIMITED), part).maximum

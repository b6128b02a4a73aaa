"""Rows as typed columns: a table that grows row by row and needs eight bytes for a number."""

from __future__ import annotations

import csv
import io
import math
import sys
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from itertools import islice
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError

#: Names of columns with their types: ``str``, ``int``, ``float``, ``bool`` or ``float | None``, in their order.
Columns = Mapping[str, str]

_CODES = {"int": "q", "float": "d", "bool": "b", "float | None": "d"}
_ROWS_AT_ONCE = 10_000  # that are read


def columns_of(record: type) -> dict[str, str]:
    """The columns for a dataclass of ``str``, ``int``, ``float`` and ``bool``, written as types or as texts."""
    return {each.name: each.type.__name__ if isinstance(each.type, type) else str(each.type) for each in fields(record)}


class RowTable(Sequence[dict[str, Any]]):
    """A sequence of rows, stored as one array (for texts, a list) for each column; each row is a dictionary.

    Equal texts are stored once: a column of texts should have few different ones.

    Args:
        columns: names and types of the columns.
        rows: the first rows.
    """

    def __init__(self, columns: Columns, rows: Iterable[Mapping[str, Any]] = ()) -> None:
        self.columns = dict(columns)
        self._values: dict[str, Any] = {
            name: [] if kind == "str" else array(_CODES[kind]) for name, kind in self.columns.items()
        }
        self.extend(rows)

    def extend(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Append several rows, see :meth:`append`."""
        for row in rows:
            self.append(row)

    def append(self, row: Mapping[str, Any]) -> None:
        """Append a row.

        Raises:
            KeyError: the row lacks a column.
            TypeError, OverflowError: a value has another type, or is too large an integer.
        """
        stored = [self._store(name, row[name]) for name in self.columns]  # all of them before any is appended
        for values, value in zip(self._values.values(), stored, strict=True):
            values.append(value)

    def _store(self, name: str, value: Any) -> Any:
        kind = self.columns[name]
        if kind == "str":
            return sys.intern(str(value))
        if kind == "int" and not -(2**63) <= value < 2**63:
            raise OverflowError(f"{name} must fit into 64 bits, got {value}.")
        return math.nan if value is None else value

    def _read(self, name: str, stored: Sequence[Any]) -> Sequence[Any]:
        """The values of a column that are stored as these numbers."""
        match self.columns[name]:
            case "bool":
                return [bool(number) for number in stored]
            case "float | None":
                return [None if math.isnan(number) else number for number in stored]
        return stored

    def append_texts(self, columns: Sequence[Sequence[str]]) -> None:
        """Append rows that were read from a file.

        Args:
            columns: the texts of each column.

        Raises:
            KeyError, ValueError, OverflowError: a text is no value of its column.
        """
        for (name, kind), texts in zip(self.columns.items(), columns, strict=True):
            values = self._values[name]
            if kind == "str":
                values.extend(map(sys.intern, texts))
            elif kind == "int":
                values.extend(map(int, texts))
            elif kind == "bool":
                values.extend([{"True": True, "False": False}[text] for text in texts])
            elif kind == "float":
                values.extend(map(float, texts))
            else:
                values.extend([float(text) if text else math.nan for text in texts])

    def column(self, name: str) -> NDArray[Any]:
        """A copy of a column ``(n,)``: int64, float64, bool, or objects of ``str``; an absent number is NaN."""
        dtypes = {"str": object, "bool": bool}
        return np.array(self._values[name], dtypes.get(self.columns[name]))

    def take(self, places: Sequence[int] | NDArray[np.int64]) -> RowTable:
        """The rows at these places, in their order."""
        chosen = RowTable(self.columns)
        for name, values in chosen._values.items():
            part = self.column(name)[places]
            values.extend(part) if self.columns[name] == "str" else values.frombytes(part.tobytes())
        return chosen

    def format_csv(self, first: int = 0, last: int | None = None, digits: int | None = None) -> str:
        """Lines of CSV without a header.

        Args:
            first: the first row.
            last: the row after the last one; ``None``: up to the end.
            digits: decimals of ``float``; ``None``: as many as are needed to read the same value again.
        """
        columns = []
        for name, kind in self.columns.items():
            values = self._read(name, self._values[name][first:last])
            rounded = kind == "float" and digits is not None
            columns.append([f"{value:.{digits}f}" for value in values] if rounded else values)
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(zip(*columns, strict=True))
        return text.getvalue()

    def __len__(self) -> int:
        return len(next(iter(self._values.values())))

    @overload
    def __getitem__(self, place: int) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, place: slice) -> RowTable: ...
    def __getitem__(self, place: int | slice) -> dict[str, Any] | RowTable:
        if isinstance(place, slice):
            return self.take(np.arange(len(self))[place])
        return {name: self._read(name, [values[place]])[0] for name, values in self._values.items()}

    def __iter__(self) -> Iterator[dict[str, Any]]:
        for first in range(0, len(self), _ROWS_AT_ONCE):
            columns = [self._read(name, values[first : first + _ROWS_AT_ONCE]) for name, values in self._values.items()]
            for row in zip(*columns, strict=True):
                yield dict(zip(self.columns, row, strict=True))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sequence) or len(other) != len(self):
            return False
        return all(ours == theirs for ours, theirs in zip(self, other, strict=True))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"<{len(self):,} rows of {', '.join(self.columns)}>"


def read_table(path: Path, columns: Columns) -> RowTable:
    """Read a CSV file; a last line without a line break, which an interrupted program has left, is not read.

    Args:
        path: the file; if it is missing, the table is empty.
        columns: names and types of the columns; the file may have others as well.

    Raises:
        ArgumentError: the file holds something else.
    """
    table = RowTable(columns)
    if not path.exists():
        return table
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.reader((line for line in file if line.endswith("\n")), strict=True)
            header = next(reader, [])
            places = [header.index(name) for name in columns]
            while rows := list(islice(reader, _ROWS_AT_ONCE)):
                every = list(zip(*rows, strict=True))  # refuses lines of different lengths
                if len(every) != len(header):
                    raise ValueError("a line has too few or too many values")
                table.append_texts([every[place] for place in places])
    except (KeyError, ValueError, OverflowError, csv.Error) as error:
        raise ArgumentError(
            f"out must hold rows of this measurement, got something else in {path.name!r}: {error}."
        ) from None
    return table

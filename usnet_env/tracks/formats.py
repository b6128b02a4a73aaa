"""Read blocks of rows from CSV, Parquet and ULog files; every format gives the same roles."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Indices
from usnet_env.config import ArgumentError, how_to_install, quote
from usnet_env.tracks.columns import choose_columns, is_movebank, keep_fixed
from usnet_env.tracks.labels import Labels, to_text
from usnet_env.tracks.opening import check_expanded_size, damaged_file, open_expanded, read_lines
from usnet_env.tracks.values import has_decimal_commas, to_points

_ROWS = 50_000  # rows of a block: some megabytes
_DELIMITERS = ",;\t|"


@dataclass(frozen=True)
class ReadOptions:
    """What the caller of ``read_tracks`` has chosen.

    Args:
        columns: names of columns by role; ``""`` leaves one out.
        encoding: of text files.
        max_bytes: the most bytes that a compressed file may expand to, or ``None``.
        decimal: ``"."`` or ``","`` in the numbers of CSV files; ``None``: as the first rows say.
    """

    columns: Mapping[str, str]
    encoding: str
    max_bytes: int | None
    decimal: str | None


@dataclass(frozen=True)
class Block:
    """Some rows of a file.

    Args:
        values: the values by role, ``(rows,)`` each, and by the names of Movebank's marks of outliers.
        names: the name of the column by role, for messages.
        rows: ``(rows,)`` int64, the number of each row in the file; that of the column names is 1.
        unit: what is numbered, for messages.
        movebank: whether the file has the columns of Movebank.
        commas: whether its numbers had decimal commas, which are points in ``values``.
        own_ids: whether an id means nothing in another file, as the name of a track in a GPX file.
    """

    values: Mapping[str, Labels | Sequence[Any] | NDArray[Any]]
    names: Mapping[str, str]
    rows: Indices
    unit: str = "row"
    movebank: bool = False
    commas: bool = False
    own_ids: bool = False

    def about(self, path: Path) -> Callable[[str, int], str]:
        """What names the place of a value in a file by its role and row, which is counted from 0, for messages."""

        def name_place(role: str, k: int) -> str:
            return f"{self.unit} {self.rows[k]} of column {quote(self.names[role])} in {quote(os.fspath(path))}"

        return name_place

    def take(self, rows: Indices) -> Block:
        """Only some of the rows, which are counted from 0."""
        values = {
            role: each[rows] if isinstance(each, np.ndarray | Labels) else [each[k] for k in rows.tolist()]
            for role, each in self.values.items()
        }
        return replace(self, values=values, rows=self.rows[rows])


def _missing_package(what: str, package: str) -> ArgumentError:
    """The error for a format whose package is not installed."""
    return ArgumentError(
        f"path must be in a format that can be read, got {what}, which needs {package}; {how_to_install('tracks')}."
    )


def read_csv(path: Path, options: ReadOptions) -> Iterator[Block]:
    """Read a CSV file with names in row 1, separated by commas, semicolons, tabs or bars.

    Raises:
        ArgumentError: the file is empty or damaged, a column is missing, or a row has another number of cells, or
            decimal commas and points are mixed.
    """
    where = quote(os.fspath(path))
    with open_expanded(path, options.max_bytes) as file:
        lines = read_lines(file, path, options.encoding)
        first = next(lines, "")
        if not first.strip():
            raise ArgumentError(f"path must be a file with columns and rows, got {where}, which is empty.")
        delimiter = max(_DELIMITERS, key=first.count)
        header = [name.strip() for name in next(csv.reader([first], delimiter=delimiter))]
        found, marks = choose_columns(header, options.columns, where)
        places = {role: header.index(name) for role, name in (found | marks).items()}
        movebank = is_movebank(header)
        reader = csv.reader(lines, delimiter=delimiter)
        decimal, numeric = options.decimal, [role for role in found if role not in ("id", "leader")]
        try:
            while (some := _read_rows(reader, len(header), where))[0]:
                rows, numbers = some
                values = {role: [cells[k] for cells in rows] for role, k in places.items()}
                decimal = decimal or ("," if has_decimal_commas([values[role] for role in numeric]) else ".")
                block = Block(values, found, np.array(numbers, np.int64), movebank=movebank)
                if decimal == ",":
                    points = {role: to_points(values[role], role, block.about(path)) for role in numeric}
                    block = replace(block, values=values | points, commas=True)
                yield block
        except csv.Error as error:
            raise ArgumentError(
                f"path must be an intact CSV file, got {where}, not readable after row {reader.line_num + 1}: {error}."
            ) from None


def _read_rows(reader: Any, cells: int, where: str) -> tuple[list[list[str]], list[int]]:
    """The next rows of a ``csv.reader`` after the column names, and the number of the line in which each begins.

    Empty rows are left out. At the end of the file, there are no more rows.

    Raises:
        ArgumentError: a row has another number of cells than the column names have.
    """
    rows: list[list[str]] = []
    numbers: list[int] = []
    line = reader.line_num + 2
    for row in reader:
        if len(row) == cells:
            rows.append(row)
            numbers.append(line)
            if len(rows) == _ROWS:
                break
        elif row:
            raise ArgumentError(
                f"path must have {cells} cells in every row, as in row 1, got {where} with {len(row)} in row {line}."
            )
        line = reader.line_num + 2
    return rows, numbers


def read_parquet(path: Path, options: ReadOptions) -> Iterator[Block]:
    """Read a Parquet file in blocks.

    Raises:
        ArgumentError: pyarrow is not installed, the file is damaged, or a column is missing.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise _missing_package("Parquet", "pyarrow") from None
    where = quote(os.fspath(path))
    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            metadata, schema = file.metadata, file.schema_arrow
    except (pyarrow.ArrowException, OSError) as error:
        raise damaged_file(path, error, "Parquet") from None
    found, marks = choose_columns(schema.names, options.columns, where)
    read, movebank = found | marks, is_movebank(schema.names)
    names = list(dict.fromkeys(read.values()))
    texts = [name for name in names if _is_text(schema.field(name).type)]
    for role, name in read.items():
        if pyarrow.types.is_nested(schema.field(name).type):
            kind = schema.field(name).type
            raise ArgumentError(
                f"{role} must be a number or text in every row of {where}, got {kind} in {quote(name)}."
            )
    check_expanded_size(path, _count_bytes(metadata, schema, names), options.max_bytes)
    try:
        # Texts are read as dictionaries: a long one that stands in every row is held once.
        with pyarrow.parquet.ParquetFile(path, metadata=metadata, read_dictionary=texts) as file:
            row = 2
            for batch in file.iter_batches(_ROWS, columns=names):
                values = {role: _from_arrow(batch.column(name)) for role, name in read.items()}
                yield Block(values, found, np.arange(row, row + batch.num_rows), movebank=movebank)
                row += batch.num_rows
    except (pyarrow.ArrowException, OSError) as error:
        raise damaged_file(path, error, "Parquet") from None


def _is_text(kind: Any) -> bool:
    """Whether cells of an Arrow type are texts or bytes of any length."""
    return str(kind).removeprefix("large_").removesuffix("_view") in ("string", "binary")


def _count_bytes(metadata: Any, schema: Any, names: Sequence[str]) -> int:
    """The bytes that some columns of a Parquet file expand to: 8 or more for each cell, or their pages."""

    def width(kind: Any) -> int:
        try:
            return max(8, kind.bit_width // 8)
        except ValueError:  # of any length: the number of a text, which stands once in the pages
            return 8

    cells = metadata.num_rows * sum(width(schema.field(name).type) for name in names)
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    pages = [group.column(k) for group in groups for k in range(group.num_columns)]
    return max(cells, sum(each.total_uncompressed_size for each in pages if each.path_in_schema in names))


def _from_arrow(column: Any) -> Any:
    """A column as an array of numbers or times (missing values NaN or NaT), as labels, or as a list of other values."""
    import pyarrow

    kind = column.type
    if pyarrow.types.is_dictionary(kind) and _is_text(kind.value_type):
        used, index = np.unique(column.indices.fill_null(-1).to_numpy(zero_copy_only=False), return_inverse=True)
        names = column.dictionary.take(pyarrow.array(used, mask=used < 0)).to_pylist()
        return Labels(index.astype(np.int64), ["" if each is None else to_text(each) for each in names])
    if pyarrow.types.is_dictionary(kind):
        column = column.dictionary_decode()
        kind = column.type
    if pyarrow.types.is_timestamp(kind):
        return column.cast(pyarrow.timestamp("ns" if kind.unit == "ns" else "us", kind.tz), safe=False).to_numpy(
            zero_copy_only=False
        )
    if pyarrow.types.is_floating(kind) or (pyarrow.types.is_integer(kind) and not column.null_count):
        return column.to_numpy(zero_copy_only=False)
    return ["" if each is None else to_text(each) for each in column.to_pylist()]


def read_ulog(path: Path, options: ReadOptions) -> Iterator[Block]:
    """Read the estimated positions of a PX4 ULog file: ``vehicle_global_position``, or else the local one.

    Raises:
        ArgumentError: pyulog is not installed, or the file is damaged or holds no positions.
    """
    try:
        import pyulog
    except ImportError:
        raise _missing_package("PX4 ULog", "pyulog") from None
    topics = {
        "vehicle_global_position": {"lon": "lon", "lat": "lat", "z": "alt"},
        # The columns of a local position are north, east and down.
        "vehicle_local_position": {"x": "y", "y": "x", "z": "z", "vx": "vy", "vy": "vx", "vz": "vz"},
    }
    try:
        with path.open("rb") as file:
            log = pyulog.ULog(file, list(topics))
    except Exception as error:  # pyulog raises many kinds for damaged files
        raise damaged_file(path, error, "ULog") from None
    found = {each.name: each.data for each in reversed(log.data_list)}
    topic = next((name for name in topics if name in found), None)
    if topic is None:
        raise ArgumentError(f"path must be a ULog file with {' or '.join(topics)}, got {quote(os.fspath(path))}.")
    data, names = found[topic], topics[topic]
    values: dict[str, Any] = {role: np.asarray(data[name], np.float64) for role, name in names.items() if name in data}
    for role in {"z", "vz"} & values.keys() if topic == "vehicle_local_position" else ():
        values[role] = -values[role]
    values["t"] = np.asarray(data["timestamp"], np.float64) / 1e6
    rows = len(values["t"])
    values["id"] = Labels(np.zeros(rows, np.int64), [path.stem])
    own = {role: f"{topic}.{names.get(role, 'timestamp')}" for role in values} | {"id": "name of the file"}
    found = keep_fixed(own, options.columns, quote(os.fspath(path)))
    values = {role: values[role] for role in found}
    yield Block(values, found, np.arange(1, rows + 1), "sample", own_ids=True)

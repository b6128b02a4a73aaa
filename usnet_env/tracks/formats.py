"""Read blocks of rows from CSV, Parquet, NPZ, GPX and ULog files; every format gives the same roles."""

from __future__ import annotations

import csv
import os
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, how_to_install, quote
from usnet_env.tracks.columns import choose_columns, find_marks, is_movebank
from usnet_env.tracks.opening import expanded_limit, open_expanded, read_lines

__all__ = ["Block", "ReadOptions", "missing_package", "read_csv", "read_npz", "read_parquet", "read_ulog"]

_ROWS = 50_000  # rows of a block: some megabytes
_DELIMITERS = ",;\t|"


@dataclass(frozen=True)
class ReadOptions:
    """What the caller of ``read_tracks`` has chosen.

    Args:
        columns: names of columns by role.
        encoding: of text files.
        max_bytes: the most bytes that a compressed file may expand to, or ``None``.
    """

    columns: Mapping[str, str]
    encoding: str
    max_bytes: int | None


@dataclass(frozen=True)
class Block:
    """Some rows of a file.

    Args:
        values: the values by role, as texts or as an array, and by the names of Movebank's marks of outliers; a file
            without ids has no ``"id"``.
        names: the name of the column by role, for messages.
        first_row: number of the first row in the file; that of the column names is 1.
        movebank: whether the file has the columns of Movebank.
    """

    values: Mapping[str, Sequence[Any] | NDArray[Any]]
    names: Mapping[str, str]
    first_row: int
    movebank: bool = False


def missing_package(what: str, package: str) -> ArgumentError:
    """The error for a format whose package is not installed."""
    return ArgumentError(
        f"path must be in a format that can be read, got {what}, which needs {package}; {how_to_install('tracks')}."
    )


def _damaged(path: Path, kind: str, error: Exception) -> ArgumentError:
    why = " ".join(str(error).split()).rstrip(".") or type(error).__name__
    return ArgumentError(f"path must be an intact {kind} file, got {quote(os.fspath(path))}, not readable: {why}.")


def read_csv(path: Path, options: ReadOptions) -> Iterator[Block]:
    """Read a CSV file with names in row 1, separated by commas, semicolons, tabs or bars.

    Raises:
        ArgumentError: the file is empty or damaged, a column is missing, or a row has another number of cells.
    """
    where = quote(os.fspath(path))
    with open_expanded(path, options.max_bytes) as file:
        lines = read_lines(file, path, options.encoding)
        first = next(lines, "")
        if not first.strip():
            raise ArgumentError(f"path must be a file with columns and rows, got {where}, which is empty.")
        delimiter = max(_DELIMITERS, key=first.count)
        header = [name.strip() for name in next(csv.reader([first], delimiter=delimiter))]
        found = choose_columns(header, options.columns, where)
        places = {role: header.index(name) for role, name in (found | find_marks(header)).items()}
        movebank = is_movebank(header)
        rows = csv.reader(lines, delimiter=delimiter)
        row = 2
        try:
            while block := list(islice(rows, _ROWS)):
                count = len(block)
                if any(len(cells) != len(header) for cells in block):
                    block = _check_lengths(block, len(header), where, row)
                yield Block({role: [cells[k] for cells in block] for role, k in places.items()}, found, row, movebank)
                row += count
        except csv.Error as error:
            raise ArgumentError(
                f"path must be an intact CSV file, got {where}, not readable after row {row}: {error}."
            ) from None


def _check_lengths(block: list[list[str]], cells: int, where: str, row: int) -> list[list[str]]:
    """Leave out empty rows, and refuse others that don't have ``cells`` cells."""
    for number, each in enumerate(block, start=row):
        if each and len(each) != cells:
            raise ArgumentError(
                f"path must have {cells} cells in every row, as in row 1, got {where} with {len(each)} in row {number}."
            )
    return [each for each in block if each]


def read_parquet(path: Path, options: ReadOptions) -> Iterator[Block]:
    """Read a Parquet file in blocks.

    Raises:
        ArgumentError: pyarrow is not installed, the file is damaged, or a column is missing.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise missing_package("Parquet", "pyarrow") from None
    try:
        file = pyarrow.parquet.ParquetFile(path)
    except (pyarrow.ArrowException, OSError) as error:
        raise _damaged(path, "Parquet", error) from None
    with file:
        header = file.schema_arrow.names
        found = choose_columns(header, options.columns, quote(os.fspath(path)))
        read, movebank = found | find_marks(header), is_movebank(header)
        most, needed = expanded_limit(path, options.max_bytes), 8 * file.metadata.num_rows * len(read)
        if needed > most:
            raise ArgumentError(
                f"max_bytes must be at least the {needed} bytes that {quote(os.fspath(path))} expands to, got {most}."
            )
        row = 2
        try:
            for batch in file.iter_batches(_ROWS, columns=list(dict.fromkeys(read.values()))):
                values = {role: _from_arrow(batch.column(name)) for role, name in read.items()}
                yield Block(values, found, row, movebank)
                row += batch.num_rows
        except (pyarrow.ArrowException, OSError) as error:
            raise _damaged(path, "Parquet", error) from None


def _from_arrow(column: Any) -> Any:
    """A column as an array of numbers or times (missing values NaN or NaT), or as a list of texts and whole numbers."""
    import pyarrow

    kind = column.type
    if pyarrow.types.is_dictionary(kind):
        column = column.dictionary_decode()
        kind = column.type
    if pyarrow.types.is_timestamp(kind):
        return column.cast(pyarrow.timestamp("ns" if kind.unit == "ns" else "us", kind.tz), safe=False).to_numpy(
            zero_copy_only=False
        )
    if pyarrow.types.is_floating(kind) or (pyarrow.types.is_integer(kind) and not column.null_count):
        return column.to_numpy(zero_copy_only=False)
    return ["" if each is None else each for each in column.to_pylist()]


def read_npz(path: Path, options: ReadOptions) -> Iterator[Block]:
    """Read an NPZ file: 1-D arrays of one length by role, or ``position`` ``(T, N, 2 or 3)``.

    With ``position`` there may be ``t`` ``(T,)`` (otherwise the numbers of the instants count), ``id`` ``(N,)`` and
    ``seen`` ``(T, N)``; NaN is unseen as well.

    Raises:
        ArgumentError: the file is damaged, needs too much memory, lacks an array, or shapes differ.
    """
    where = quote(os.fspath(path))
    try:
        with zipfile.ZipFile(path) as archive:
            needed, most = sum(each.file_size for each in archive.infolist()), expanded_limit(path, options.max_bytes)
        if needed > most:
            raise ArgumentError(f"max_bytes must be at least the {needed} bytes that {where} expands to, got {most}.")
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except ArgumentError:
        raise
    except Exception as error:  # a damaged header makes NumPy raise whatever Python's own tokenizer raises
        raise _damaged(path, "NPZ", error) from None
    if "position" in arrays and arrays["position"].ndim == 3:
        yield _unfold(arrays, where)
        return
    found = choose_columns(list(arrays), options.columns, where)
    read = found | find_marks(list(arrays))
    lengths = {name: arrays[name].shape for name in read.values()}
    if any(len(shape) != 1 or shape != lengths[found["id"]] for shape in lengths.values()):
        raise ArgumentError(f"path must hold 1-D arrays of one length, got {where} with the shapes {quote(lengths)}.")
    yield Block({role: _plain(arrays[name]) for role, name in read.items()}, found, 2, is_movebank(list(arrays)))


def _plain(array: NDArray[Any]) -> Any:
    return array if array.dtype.kind in "fiuM" else array.tolist()


def _unfold(arrays: Mapping[str, NDArray[Any]], where: str) -> Block:
    """The rows of ``position`` ``(T, N, 2 or 3)``, id by id."""
    position = arrays["position"]
    instants, uavs, axes = position.shape
    time, ids = arrays.get("t", arrays.get("time")), arrays.get("id", arrays.get("ids"))
    shapes = {"t": (time, (instants,)), "id": (ids, (uavs,)), "seen": (arrays.get("seen"), (instants, uavs))}
    for name, (array, shape) in shapes.items():
        if array is not None and array.shape != shape:
            raise ArgumentError(f"{name} must have shape {shape} in {where}, got {array.shape}.")
    if axes not in (2, 3) or position.dtype.kind not in "fiu":
        raise ArgumentError(
            f"position must have shape (any, any, 2 or 3) and hold numbers in {where}, got {quote(position)}."
        )
    seen = np.isfinite(position).all(axis=2) & (True if arrays.get("seen") is None else arrays["seen"].astype(bool))
    when, who = np.nonzero(seen.T)[::-1]
    values: dict[str, Any] = {
        "id": [(_plain(ids)[i] if ids is not None else int(i)) for i in who],
        "t" if time is not None else "frame": when if time is None else time[when],
        **{axis: position[when, who, k] for k, axis in enumerate("xyz"[:axes])},
    }
    return Block(values, {role: role for role in values}, 2)


def read_ulog(path: Path, options: ReadOptions) -> Iterator[Block]:
    """Read the estimated positions of a PX4 ULog file: ``vehicle_global_position``, or else the local one.

    Raises:
        ArgumentError: pyulog is not installed, or the file is damaged or holds no positions.
    """
    try:
        import pyulog
    except ImportError:
        raise missing_package("PX4 ULog", "pyulog") from None
    topics = {
        "vehicle_global_position": {"lon": "lon", "lat": "lat", "z": "alt"},
        "vehicle_local_position": {
            "x": "y",
            "y": "x",
            "z": "z",
            "vx": "vy",
            "vy": "vx",
            "vz": "vz",
        },  # north, east, down
    }
    try:
        with path.open("rb") as file:
            log = pyulog.ULog(file, list(topics))
    except Exception as error:  # pyulog raises many kinds for damaged files
        raise _damaged(path, "ULog", error) from None
    found = {each.name: each.data for each in reversed(log.data_list)}
    topic = next((name for name in topics if name in found), None)
    if topic is None:
        raise ArgumentError(f"path must be a ULog file with {' or '.join(topics)}, got {quote(os.fspath(path))}.")
    data, names = found[topic], topics[topic]
    values: dict[str, Any] = {role: np.asarray(data[name], np.float64) for role, name in names.items() if name in data}
    for role in {"z", "vz"} & values.keys() if topic == "vehicle_local_position" else ():
        values[role] = -values[role]
    values["t"] = np.asarray(data["timestamp"], np.float64) / 1e6
    yield Block(values, {role: f"{topic}.{names.get(role, 'timestamp')}" for role in values}, 2)

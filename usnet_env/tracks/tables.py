"""The tables of the leaders found in tracks, as CSV and Parquet files."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from usnet_env.files import atomic_write
from usnet_env.tracks.leaders import FoundLeaders

_INT64 = range(-(2**63), 2**63)
#: The columns of each table and their types, of which "id" and "time" depend on the tracks; in brackets: a list.
_TABLES = {
    "windows": {
        "start": "time", "end": "time", "group": "int64", "id": "id", "probability": "double", "score": "double",
        "followers": "[id]", "reason": "string", "not_confirmed": "[id]", "left_out": "[id]",
    },
    "leaders": {
        "id": "id", "probability": "double", "followers": "[id]", "reason": "string", "group": "int64",
        "score": "double", "share": "double",
    },
    "links": {"start": "time", "end": "time", "follower": "id", "leader": "id", "head": "id", "delay": "double"},
}  # fmt: skip


def write_tables(found: FoundLeaders, folder: Path, ids: Sequence[str | int]) -> None:
    """Write ``windows``, ``leaders`` and ``links`` as CSV, and as Parquet if pyarrow is installed.

    The types of the Parquet columns depend on the ids and times of the tracks only, not on what was found. In CSV,
    lists are joined by semicolons; a semicolon or a backslash in an id has a backslash before it. A text that a
    spreadsheet would read as a formula has an apostrophe before it.

    Args:
        found: the leaders.
        folder: where the files are written; existing ones are replaced.
        ids: those of the tracks.

    Raises:
        ArgumentError: a file can't be written.
    """
    rows = {"windows": found.rows(), "leaders": [*map(asdict, found.leaders)], "links": found.link_rows()}
    times = [time for window in found.windows for time in (window.start, window.end)]
    types = {"id": _name_type(ids), "time": _name_type(times)}
    for name, columns in _TABLES.items():
        with atomic_write(folder / f"{name}.csv") as aside, aside.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(columns))
            writer.writeheader()
            writer.writerows({key: _cell(value) for key, value in row.items()} for row in rows[name])
        _write_parquet(folder / f"{name}.parquet", rows[name], columns, types)


def _name_type(values: Sequence[str | int | float]) -> str:
    """The type of a column with these values; whole numbers are texts if one of them doesn't fit into int64."""
    kinds = {type(value) for value in values}
    if kinds <= {int} and all(value in _INT64 for value in values):
        return "int64"
    return "double" if float in kinds and kinds <= {int, float} else "string"


def _cell(value: Any) -> Any:
    """A value in a cell of CSV."""
    if isinstance(value, tuple):
        value = ";".join(re.sub(r"([;\\])", r"\\\1", str(name)) for name in value)
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@")) else value


def _write_parquet(path: Path, rows: Sequence[dict[str, Any]], columns: dict[str, str], types: dict[str, str]) -> None:
    try:
        import pyarrow as pa
        import pyarrow.parquet
    except ImportError:
        path.unlink(missing_ok=True)  # that of an earlier run
        return

    def make_type(text: str) -> Any:
        if text.startswith("["):
            return pa.list_(make_type(text[1:-1]))
        return pa.type_for_alias(types.get(text, text))

    def convert(value: Any, kind: Any) -> Any:
        if isinstance(value, tuple):
            return [convert(name, kind.value_type) for name in value]
        return str(value) if kind == pa.string() and value is not None else value

    schema = pa.schema([(name, make_type(text)) for name, text in columns.items()])
    values = [{name: convert(value, schema.field(name).type) for name, value in row.items()} for row in rows]
    with atomic_write(path) as aside:
        pa.parquet.write_table(pa.Table.from_pylist(values, schema), aside)

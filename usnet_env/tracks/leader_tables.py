"""The tables of the leaders found in tracks, as CSV and Parquet files."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from usnet_env.files import atomic_write
from usnet_env.tracks.leaders import FoundLeaders

_ID, _TIME = "id", "time"  # types that depend on the tracks
_LARGEST = 2**63  # of int64, exclusive
#: The columns of each table and their types; in brackets: a list.
_TABLES: dict[str, dict[str, str]] = {
    "windows": {
        "start": _TIME,
        "end": _TIME,
        "group": "int64",
        "id": _ID,
        "probability": "double",
        "score": "double",
        "followers": "[id]",
        "reason": "string",
        "not_confirmed": "[id]",
        "left_out": "[id]",
    },
    "leaders": {
        "id": _ID,
        "probability": "double",
        "followers": "[id]",
        "reason": "string",
        "group": "int64",
        "score": "double",
        "share": "double",
    },
    "links": {"start": _TIME, "end": _TIME, "follower": _ID, "leader": _ID, "head": _ID, "delay": "double"},
}


def write_tables(found: FoundLeaders, folder: Path, ids: Sequence[str | int]) -> None:
    """Write ``windows``, ``leaders`` and ``links`` as CSV, and as Parquet if pyarrow is installed.

    The types of the Parquet columns depend on the ids and times of the tracks only, not on what was found. In CSV,
    lists are joined by semicolons; a semicolon or a backslash in an id has a backslash before it.

    Args:
        found: the leaders.
        folder: where the files are written; existing ones are replaced.
        ids: those of the tracks.

    Raises:
        ArgumentError: a file can't be written.
    """
    rows = {
        "windows": found.rows(),
        "leaders": [leader.as_dict() for leader in found.leaders],
        "links": found.link_rows(),
    }
    times = [time for window in found.windows for time in (window.start, window.end)]
    types = {_ID: _name_type(ids), _TIME: _name_type(times)}
    for name, columns in _TABLES.items():
        _write_csv(folder / f"{name}.csv", rows[name], list(columns))
        _write_parquet(folder / f"{name}.parquet", rows[name], columns, types)


def _name_type(values: Sequence[str | int | float]) -> str:
    """The type of a column with these values; whole numbers are texts if one of them doesn't fit into int64."""
    kinds = {type(value) for value in values}
    if kinds <= {int}:
        return "int64" if all(-_LARGEST <= int(value) < _LARGEST for value in values) else "string"
    return "double" if kinds <= {int, float} else "string"


def _write_csv(path: Path, rows: Sequence[dict[str, Any]], columns: Sequence[str]) -> None:
    with atomic_write(path) as aside, aside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        for row in rows:
            writer.writerow({k: _join(v) if isinstance(v, list) else v for k, v in row.items()})


def _join(ids: Sequence[str | int]) -> str:
    """A list in one cell, from which it can be read again whatever the ids are."""
    return ";".join(re.sub(r"([;\\])", r"\\\1", str(each)) for each in ids)


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
        if isinstance(value, list):
            return [convert(each, kind.value_type) for each in value]
        return str(value) if kind == pa.string() and value is not None else value

    schema = pa.schema([(name, make_type(text)) for name, text in columns.items()])
    values = [{name: convert(value, schema.field(name).type) for name, value in row.items()} for row in rows]
    with atomic_write(path) as aside:
        pa.parquet.write_table(pa.Table.from_pylist(values, schema), aside)

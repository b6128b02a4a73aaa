"""Open the table of a file: the frame of a reader, or a text with names in row 1 or in a comment before it."""

from __future__ import annotations

import csv
import io
import os
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from itertools import islice, takewhile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal

import pandas as pd
from pandas.errors import DtypeWarning, ParserWarning
from pydantic import Field

from usnet_env.config import ArgumentError, Config, format_count, quote
from usnet_env.files import read_csv
from usnet_env.tracks import columns as roles
from usnet_env.tracks.columns import Table
from usnet_env.tracks.readers import READERS, check_archive, unpack

_DELIMITERS = ",;\t|"
_TEXTS = ("", "csv", "tsv", "txt", "tab", "dat", "asc", "zip")  # suffixes of texts with a table
_MAX_UNIT_ROWS = 4
_NUMBER_START = re.compile(r"[+-]?\.?\d")  # of a number or a date
_RATE = re.compile(r"(?:frame ?rate|fps)\W{0,3}(\d[\d.]*)|(\d[\d.]*) ?fps", re.IGNORECASE)
_EMPTY_CELLS = ["", "NA", "na", "N/A", "n/a", "NaN", "nan", "NULL", "null", "None", "none"]  # of columns of numbers
_OTHER_FORMATS = {  # suffixes and beginnings of files that other programs read, and what they are
    r"\.(xml|kml|kmz|tcx)|\s*<": "XML, of which only GPX is read; kloppy reads football's, and GPSBabel writes GPX",
    r"\.igc|A[A-Z]{3}[^,;]{0,40}\r?\nH": "a flight log (IGC); GPSBabel writes it as GPX",
    r"\.(nmea|ais)|(\\[^\\]*\\)?[!$][A-Z]{5},": "NMEA; pyais decodes that of ships, and GPSBabel writes others as GPX",
    r"\.fit": "FIT; GPSBabel writes it as GPX",
    r"\d+:-?\d+,-?\d+,|\d+;\d+,\d+,\d+:": "football of TRACAB or Stats Perform; kloppy makes a frame of it",
    r"\s*(\{|\[\s*\{)": "JSON; --format json reads records, and --format jsonl one on each line",
}


class Options(Config):
    """The arguments of :func:`usnet_env.tracks.read_tracks` but for the files."""

    format: str | None
    columns: Mapping[roles.Role, str] | None
    header: Sequence[str] | None
    time_unit: Annotated[float, Field(ge=1e-12, le=1e9)] | None
    time_format: str | None
    length_unit: Literal["m", "cm", "mm", "km", "ft", "px"] | None
    missing: Literal["refuse", "skip"]
    missing_place: tuple[float, float] | None
    min_confidence: float | None
    split_gap: Annotated[float, Field(gt=0)] | None
    duplicates: Literal["error", "first", "mean"]
    pool: bool
    pool_by: str | None
    max_size: Annotated[float, Field(gt=0)]
    encoding: str
    decimal: Literal[".", ","]


def open_table(path: Path, options: Options) -> Table:
    """The table of a file."""
    is_packed = path.suffix.lower() in (".gz", ".zip")
    data, name = unpack(path, options.max_size) if is_packed else (b"", path.name)
    rosbag = (path / "metadata.yaml").exists()  # a folder, in ROS 2
    suffix = Path(name).suffix.lower()
    kind = options.format or ("db3" if rosbag else suffix[1:])
    if kind in READERS or options.format not in (None, "csv"):
        reader = READERS.find(kind)
        with TemporaryDirectory() as folder:
            if is_packed:
                path = Path(folder, Path(name).name)
                path.write_bytes(data)
            check_archive(path, options.max_size)
            frame = reader(path)
        if not isinstance(frame, pd.DataFrame):
            raise ArgumentError(f"reader {kind!r} must return a pandas.DataFrame, got {quote(frame)}.")
        return roles.as_long(roles.as_table(frame), options.columns)
    data = data if is_packed else unpack(path, options.max_size)[0]
    first_text = data[:200].decode("latin-1").removeprefix("\u00ef\u00bb\u00bf")
    for pattern, words in _OTHER_FORMATS.items():
        if options.format is None and any(re.match(pattern, text) for text in (suffix, first_text)):
            raise ArgumentError(f"path must be in a format that is read, got {quote(os.fspath(path))}: it is {words}.")
    table = roles.as_long(read_text(data, options), options.columns)
    is_unknown = options.format is None and kind not in _TEXTS
    return table._replace(details={**table.details, "suffix": suffix}) if is_unknown else table


def read_text(data: bytes, options: Options) -> Table:
    """Read a text with columns that are separated by commas, semicolons, tabs, bars or blanks."""
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else options.encoding
    if encoding == "utf-8" and b"\0" in data[:1024]:
        raise ValueError("it is no text, and its suffix names no format that is read (--format does)")
    comments = []
    with io.TextIOWrapper(io.BytesIO(data), encoding) as lines:
        while (first := lines.readline(2**20).removeprefix("\ufeff")).startswith("#"):
            comments.append(first.lstrip("# ").rstrip())
        next_lines = [*islice(lines, _MAX_UNIT_ROWS)]
    delimiter = max(_DELIMITERS, key=first.count)
    if has_blanks := delimiter not in first and len(first.split()) > 1:
        delimiter = r"\s+"

    def split(line: str) -> list[str]:
        cells = line.split() if has_blanks else next(csv.reader([line], delimiter=delimiter), [])
        return [cell.strip() for cell in cells]

    cells = split(first)
    header = [name.strip() for name in options.header or cells]
    if len(header) != len(cells):
        raise ValueError(f"row 1 has {len(cells)} cells for {len(header)} names in header (--columns)")
    skipped, details = len(comments), dict[str, Any]()
    if options.header is None and any(map(roles.is_number, cells)):
        header = _find_names(comments, split, len(cells)) or header
    elif options.header is None:
        rows = map(split, next_lines)
        units = [*takewhile(lambda row: len(row) == len(cells) and not any(map(_NUMBER_START.match, row)), rows)]
        header, skipped = _add_units(header, units), skipped + 1 + len(units)
        if units:
            details["notes"] = [f"{format_count(len(units), 'row')} without a number below the names, skipped."]
    rates = [float(rate[1] or rate[2]) for line in comments if (rate := _RATE.search(line))]

    def read(names: Mapping[str, str]) -> pd.DataFrame:
        role_of = {header.index(name): role for role, name in names.items()}
        number_roles = roles.NUMBERS - set(roles.TIMES if options.time_format is not None else ())  # others are texts
        numbers = [number for number, role in role_of.items() if role.partition(":")[0] in number_roles]
        with warnings.catch_warnings():
            warnings.simplefilter("error", ParserWarning)  # a row has more cells than the header
            warnings.simplefilter("ignore", DtypeWarning)  # texts among numbers are read, or refused by name, later
            rows = read_csv(
                io.BytesIO(data),
                sep=delimiter,
                encoding=encoding,
                decimal=options.decimal,
                header=None,
                skiprows=skipped,
                names=list(range(len(header))),
                index_col=False,
                dtype={k: object for k in range(len(header)) if k not in numbers},  # the text, also of 007
                skipinitialspace=True,
                keep_default_na=False,
                na_values=dict.fromkeys(numbers, _EMPTY_CELLS),
            )
        return rows[list(role_of)].rename(columns=role_of)

    return Table(header, read, details | ({"rate": rates[-1]} if rates else {}))


def _find_names(comments: Sequence[str], split: Callable[[str], list[str]], count: int) -> list[str]:
    """The names of so many columns in the last comment that holds as many, or none."""
    for line in reversed(comments):
        for names in (split(line), re.split(r"[\s,;|]+", line)):
            if len(names) == count and not any(map(roles.is_number, names)):
                return names
    return []


def _add_units(header: list[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """The names with the units of rows below them, as ``x (cm)``."""
    units = roles.TIME_UNITS | roles.LENGTH_UNITS
    for row in rows:
        words = [cell.strip("()[] ").lower() for cell in row] + [""] * len(header)
        header = [f"{name} ({word})" if word in units else name for name, word in zip(header, words, strict=False)]
    return header

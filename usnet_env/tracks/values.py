"""Convert the values of rows to numbers: coordinates, velocities and times, also with decimal commas."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError, quote

_NO_VALUE = {"", "na", "n/a", "nan", "null", "none", "nat"}
_LONGEST = 1e19  # of times: nanoseconds since 1970 until the year 2286
_LIMITS = {"lon": 360.0, "lat": 90.0, "t": _LONGEST, "frame": _LONGEST}  # lon and lat: degrees
_EPOCH, _MICROSECOND = datetime(1970, 1, 1, tzinfo=UTC), timedelta(microseconds=1)
_UNITS = {  # of times, in seconds, with the words that names of columns end with
    1e-3: {"ms", "msec", "msecs", "millis", "millisecond", "milliseconds"},
    1e-6: {"us", "µs", "usec", "usecs", "micros", "microsecond", "microseconds"},
    1e-9: {"ns", "nsec", "nsecs", "nanos", "nanosecond", "nanoseconds"},
}
_RECORDED = (315_532_800, 4_102_444_800)  # seconds from 1970 to 1980 and to 2100
_LARGEST = 1e15  # of other numbers in a file: float64 has no fractions beyond
_COMMA = re.compile(r"\s*[+-]?(\d*,\d+|\d+,)([eE][+-]?\d+)?\s*")
_POINT = re.compile(r"\s*[+-]?(\d*\.\d+|\d+\.)([eE][+-]?\d+)?\s*")
_THOUSANDS = re.compile(r"\s*[+-]?[1-9]\d{0,2},\d{3}\s*")  # 1,234 may be a whole number with a separator


def is_none(value: Any) -> bool:
    """Whether a cell holds no value, as files write it: empty, ``NA``, ``nan`` and the like."""
    return str(value).strip().lower() in _NO_VALUE


def read_times(values: Any, role: str, about: Callable[[str, int], str]) -> tuple[Floats, bool]:
    """Convert times to numbers of the file's unit, or timestamps to whole microseconds since 1970.

    Args:
        values: ``(rows,)`` an array of numbers or times, or a sequence of texts, numbers or times.
        role: ``t`` or ``frame``.
        about: names the place of a row of a role, for messages.

    Returns:
        ``(rows,)`` numbers, NaN where there is none, and whether they are timestamps.

    Raises:
        ArgumentError: a value is neither a number nor a timestamp, or another kind than the first one, or too large.
    """
    if isinstance(values, np.ndarray) and values.dtype.kind == "M":
        half = np.timedelta64(500, "ns") if values.dtype == "datetime64[ns]" else np.timedelta64(0, "us")
        rounded = (values + half).astype("datetime64[us]").astype(np.float64)
        return np.where(np.isnat(values), np.nan, rounded), True
    if not isinstance(values, np.ndarray):
        first = next((each for each in values if not is_none(each)), "0")
        if isinstance(first, datetime) or not _is_number(first):
            return _timestamps(values, role, about), True
    return read_numbers(values, role, about), False


def guess_time_unit(name: str, times: Floats) -> float | None:
    """The unit of times, 0.001, 1e-6 or 1e-9 seconds, if their numbers or the name of their column say one of them.

    Args:
        name: of the column; its last word may be a unit, as in ``time_ms``, ``Time [ms]`` or ``timeMs``.
        times: ``(S,)`` numbers; those of a time since 1970 are dates from 1980 to 2100 in one of these units.
    """
    for unit in _UNITS:
        if is_epoch(float(times.min()), unit) and is_epoch(float(times.max()), unit):
            return unit
    words = re.findall(r"[a-zµ]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower().replace("μ", "µ"))
    return next((unit for unit, names in _UNITS.items() if words and words[-1] in names), None)


def is_epoch(time: float, unit: float) -> bool:
    """Whether ``time`` units of ``unit`` seconds after 1970 are a date from 1980 to 2100."""
    return _RECORDED[0] <= time * unit <= _RECORDED[1]


def _is_number(text: Any) -> bool:
    try:
        float(text)
    except (TypeError, ValueError):
        return False
    return True


def read_numbers(values: Any, role: str, about: Callable[[str, int], str]) -> Floats:
    """Convert values to float64; missing ones become NaN.

    Raises:
        ArgumentError: a value is another text, or too large.
    """
    if isinstance(values, np.ndarray):
        if values.dtype.kind not in "fiu":
            raise ArgumentError(f"{role} must be a number in every row, got {quote(values[0])} in {about(role, 0)}.")
        numbers = values.astype(np.float64)
    else:
        if bool in set(map(type, values)):
            k = list(map(type, values)).index(bool)
            raise ArgumentError(f"{role} must be a number in every row, got {values[k]} in {about(role, k)}.")
        try:
            numbers = np.fromiter(map(float, values), np.float64, len(values))
        except (TypeError, ValueError):
            numbers = np.array([_number(each, role, about, k) for k, each in enumerate(values)])
    limit = _LIMITS.get(role, _LARGEST)
    wild = np.isinf(numbers) | (np.abs(numbers) > limit)
    if wild.any():
        k = int(wild.argmax())
        raise ArgumentError(
            f"{role} must be a number from {-limit:g} to {limit:g}, got {numbers[k]:g} in {about(role, k)}."
        )
    return numbers


def _number(value: Any, role: str, about: Callable[[str, int], str], k: int) -> float:
    if is_none(value):
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ArgumentError(
            f"{role} must be a number in every row, got {quote(value)} in {about(role, k)}{_hint(value)}."
        ) from None


def _hint(value: Any) -> str:
    """What to do about a value that is no number, for messages."""
    return " (decimal=',' reads decimal commas)" if isinstance(value, str) and _is_comma_number(value) else ""


def _timestamps(values: Sequence[Any], role: str, about: Callable[[str, int], str]) -> Floats:
    """Convert ISO 8601 timestamps to microseconds since 1970; without a time zone they are UTC."""
    micros = np.empty(len(values))
    for k, value in enumerate(values):
        try:
            moment = value if isinstance(value, datetime) else datetime.fromisoformat(value.strip())
        except (AttributeError, ValueError):
            if not is_none(value):
                raise ArgumentError(
                    f"{role} must be a number or an ISO 8601 timestamp in every row, got {quote(value)} in "
                    f"{about(role, k)}{_hint(value)}."
                ) from None
            micros[k] = math.nan
        else:
            micros[k] = ((moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - _EPOCH) // _MICROSECOND
    return micros


def _is_comma_number(cell: str) -> bool:
    """Whether a text is a number with one comma and no point."""
    return "," in cell and _COMMA.fullmatch(cell) is not None


def has_decimal_commas(columns: Sequence[Sequence[str]]) -> bool:
    """Whether the commas in some columns of numbers can only be decimal signs.

    They can where no number has a point, and one of them has another number of digits than 3 after its comma, or more
    than 3 digits or a 0 before it.

    Args:
        columns: the cells of each column of numbers or times.
    """
    commas = [cell for cells in columns for cell in cells if _is_comma_number(cell)]
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
    return [cell.replace(",", ".") if _is_comma_number(cell) else cell for cell in cells]

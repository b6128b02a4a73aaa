"""Convert the values of rows to numbers: coordinates, velocities and times."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError, quote

__all__ = ["is_none", "read_numbers", "read_times"]

_NO_VALUE = {"", "na", "n/a", "nan", "null", "none", "nat"}
_LONGEST = 1e19  # of times: nanoseconds since 1970 until the year 2286
_LIMITS = {"lon": 360.0, "lat": 90.0, "t": _LONGEST, "frame": _LONGEST}  # lon and lat: degrees
_EPOCH, _MICROSECOND = datetime(1970, 1, 1, tzinfo=UTC), timedelta(microseconds=1)
_LARGEST = 1e15  # of other numbers in a file: float64 has no fractions beyond


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
        raise ArgumentError(f"{role} must be a number in every row, got {quote(value)} in {about(role, k)}.") from None


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
                    f"{about(role, k)}."
                ) from None
            micros[k] = math.nan
        else:
            micros[k] = ((moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - _EPOCH) // _MICROSECOND
    return micros

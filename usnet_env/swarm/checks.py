"""The checks of what users register: the kind of a part, and what its functions return."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, quote

LARGEST = float(np.finfo(np.float32).max)


def check_part(subject: str, part: Any, kind: type | None, make: Callable[[Any], Any] | None = None) -> Any:
    """Return a part of a kind (``None``: functions are the only ones); a function becomes a part by ``make``.

    Raises:
        ArgumentError: ``part`` is of another kind.
    """
    if kind is not None and isinstance(part, kind):
        return part
    if make is not None and callable(part) and not isinstance(part, type):
        return make(part)
    names = ([] if kind is None else [kind.__name__]) + ([] if make is None else ["function"])
    raise ArgumentError(f"{subject} must be a {' or a '.join(names)}, got {quote(part)}.")


def check_returned(function: str, value: Any, shape: tuple[int, ...], most: float = LARGEST) -> NDArray[Any]:
    """Return what a registered function has returned, as an array.

    Args:
        function: its kind, for messages: ``"follow"``.
        value: what it has returned.
        shape: the expected shape.
        most: the largest absolute value of a number.

    Raises:
        ArgumentError: another shape, or values that are no real numbers within the limit.
    """
    array = np.asarray(value)
    if array.shape != shape or array.dtype.kind not in "biuf" or not (np.abs(array) <= most).all():
        raise ArgumentError(
            f"{function} function must return an array of shape {shape} with numbers from {-most:g} to {most:g}, "
            f"got shape {array.shape}: {quote(value)}."
        )
    return array

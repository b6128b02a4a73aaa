"""Check what functions that users register return."""

from __future__ import annotations

from typing import Any

import numpy as np

from usnet_env.arrays import Singles
from usnet_env.config import ArgumentError, quote


def read_directions(function: str, value: Any, shape: tuple[int, ...]) -> Singles:
    """The directions that a registered function has returned, as float32.

    Args:
        function: its kind in error messages, ``"follow"`` or ``"mobility"``.
        value: what it has returned.
        shape: the expected shape.

    Raises:
        ArgumentError: another shape, or values that are not finite real numbers.
    """
    try:
        array = np.asarray(value)
    except ValueError:  # a ragged list
        array = np.empty(0, object)
    if array.dtype.kind not in "biuf":
        raise ArgumentError(f"{function} function must return an array of real numbers, got {quote(value)}.")
    if array.shape != shape:
        raise ArgumentError(f"{function} function must return an array of shape {shape}, got {array.shape}.")
    with np.errstate(over="ignore"):  # refused below
        directions = array.astype(np.float32)
    if not np.isfinite(directions).all():
        raise ArgumentError(f"{function} function must return finite numbers, got NaN or infinity.")
    return directions

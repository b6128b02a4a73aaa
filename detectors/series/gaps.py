"""Samples that the observer missed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["fill_with_nearest"]


def fill_with_nearest(position: NDArray[np.float32], seen: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Positions with every missed one replaced by the nearest seen one in time.

    Args:
        position: ``(T, n, 3)`` metres.
        seen: ``(T, n)``. A UAV that was never seen keeps its values.
    """
    if seen.all():
        return position
    instants = np.arange(len(position))
    filled = position.copy()
    for i in np.flatnonzero(~seen.all(axis=0)):
        known = np.flatnonzero(seen[:, i])
        if len(known):
            filled[:, i] = position[known[np.abs(instants[:, None] - known).argmin(axis=1)], i]
    return filled

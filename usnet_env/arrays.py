"""Short names for the types of arrays, and for the lengths of their axes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Indices = NDArray[np.int64]  # indices, labels and counts
Mask = NDArray[np.bool_]
Observation = dict[str, NDArray[Any]]  # what an environment shows, by name


class AxisLength:
    """An attribute of a class: the length of one axis of an array (or tensor) that is another attribute.

    Args:
        array: the name of the other attribute.
        axis: the number of the axis.
    """

    def __init__(self, array: str, axis: int) -> None:
        self.array, self.axis = array, axis

    def __get__(self, owner: Any, kind: type) -> int:
        """The length; of the class, which has no array, the attribute itself."""
        if owner is None:
            return self  # type: ignore[return-value]  # of the class, by the rule of descriptors
        return int(getattr(owner, self.array).shape[self.axis])

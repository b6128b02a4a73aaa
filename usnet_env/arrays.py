"""Short names for the types of arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Indices = NDArray[np.int64]  # indices, labels and counts
Mask = NDArray[np.bool_]
Observation = dict[str, NDArray[Any]]  # what an environment shows, by name

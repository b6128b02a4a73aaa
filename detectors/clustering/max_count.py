"""The largest number of clusters that the gap statistic and the eigengap consider."""

from __future__ import annotations

import numpy as np

__all__ = ["compute_max_count"]


def compute_max_count(uavs: int) -> int:
    """Return K_max for n UAVs: 1.5 sqrt(n) rounded up, but at most n / 2 and at least 1."""
    return max(1, min(uavs // 2, int(np.ceil(1.5 * np.sqrt(uavs)))))

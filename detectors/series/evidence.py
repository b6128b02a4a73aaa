"""Pairwise evidence: how well UAV j's past predicts UAV i's velocity, and how well it does by chance.

The evidence is computed a second time for a surrogate, in which UAV i is shifted in time by half a window against all
other UAVs (:func:`detectors.series.designs.shift_in_time`). The surrogate's row maxima estimate, without a model of the
motion, how high the best of N entries rises by chance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.series.designs import compute_chance
from usnet_env.arrays import Floats

_SIGNIFICANT_SPREADS = 3.0  # robust standard deviations between the surrogate's median row maximum and the threshold
_MAD_TO_SPREAD = 1.4826  # median absolute deviation to standard deviation, for a normal variable


@dataclass(frozen=True, eq=False)
class Evidence:
    """Pairwise evidence among the n living UAVs.

    Entry (i, j) of ``pairs`` ``(n, n)`` is the evidence that i follows j, about 0 or below if not; -inf for i = j.
    ``surrogate`` ``(n, n)`` is the same with the voters (rows) shifted in time, and ``spread`` a lower bound of the
    standard deviation of an entry by chance, for very few UAVs.
    """

    pairs: Floats
    surrogate: Floats
    spread: float

    def __post_init__(self) -> None:
        np.fill_diagonal(self.pairs, -np.inf)
        np.fill_diagonal(self.surrogate, -np.inf)

    @property
    def chance(self) -> float:
        """Expected row maximum of a UAV that follows no UAV."""
        return compute_chance(self.surrogate)

    @property
    def threshold(self) -> float:
        """A voter is significant if its row maximum is above this value."""
        best = self.surrogate.max(axis=1)
        spread = _MAD_TO_SPREAD * float(np.median(np.abs(best - self.chance)))
        return self.chance + _SIGNIFICANT_SPREADS * max(spread, self.spread)


def adjust_shares(shares: Floats, rows: int, freedom: Floats, own: float = 0.0) -> Evidence:
    """Adjust the shares ``(2, n, n)``, of the pairs and of their surrogate, for the number of parameters.

    ``freedom`` ``(n,)`` are the degrees of freedom of j's features, ``own`` those of i's own past.
    """
    pairs, surrogate = 1.0 - (1.0 - shares) * (rows - 1) / np.maximum(rows - 1 - freedom - own, 1.0)
    # The standard deviation of R² over three axes for independent samples of which nothing is explained.
    return Evidence(pairs, surrogate, float(np.sqrt(2.0 * max(freedom.mean(), 1.0) / 3.0) / rows))

"""Hard EM: a shared strategy, the heads and who follows whom, each fitted to the others until nothing changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.facility import Heads, locate_heads
from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.samples import Samples
from detectors.follow_mixture.strategy import Library, Strategy, fit_strategy, gain_matrix

__all__ = ["Mixture", "fit_mixture", "head_price"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_ROUNDS = 12


@dataclass(frozen=True, eq=False)
class Mixture:
    """A swarm explained.

    Args:
        strategy: the shared strategy.
        heads: heads and followers.
        gain: ``(n, c)`` of following each of ``columns``.
        columns: ``(c,)`` the candidates that were scored.
        value: log-likelihood gained over nobody following anybody, less all prices.
    """

    strategy: Strategy
    heads: Heads
    gain: Floats
    columns: Indices
    value: float


def head_price(uavs: int) -> float:
    """To name a head among n UAVs."""
    return float(np.log(max(uavs, 2)))


def fit_mixture(
    samples: Samples,
    history: OwnHistory,
    leader: Indices,
    library: Library,
    columns: Indices,
    most: int | None = None,
    first: Strategy | None = None,
    by_head: bool = False,
) -> Mixture | None:
    """Climb from one assignment.

    Args:
        samples: n UAVs.
        history: the null.
        leader: ``(n,)`` the assignment to begin with.
        library: the class of strategies.
        columns: candidates for heads.
        most: the largest number of heads.
        first: the strategy that fits ``leader``, where it is known.
        by_head: strategies are fitted with the same say for every head.

    Returns:
        The best state on the way, or ``None`` where no strategy can be fitted.
    """
    best: Mixture | None = None
    for _ in range(_ROUNDS):
        strategy = first or fit_strategy(samples, leader, library, by_head=by_head)
        first = None
        if strategy is None:
            break
        gain = gain_matrix(samples, history, strategy, columns)
        start = np.unique(leader[leader >= 0])
        heads = locate_heads(gain, columns, head_price(samples.uavs), most, start)
        value = heads.value - strategy.price
        if best is not None and value <= best.value + 1e-6:
            break
        best = Mixture(strategy, heads, gain, columns, value)
        if np.array_equal(heads.leader, leader) or not len(heads.heads):
            break
        leader = heads.leader
    return best

"""Hard EM: fits the shared strategy, the heads and the assignment alternately until nothing changes."""

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
    """A fitted swarm.

    Args:
        strategy: the shared strategy.
        heads: heads and followers.
        gain: ``(n, c)``: the gain by following each of ``columns``.
        columns: ``(c,)``: the scored candidates.
        value: the penalised log-likelihood gain over the hypothesis that no UAV follows another one.
    """

    strategy: Strategy
    heads: Heads
    gain: Floats
    columns: Indices
    value: float


def head_price(uavs: int) -> float:
    """Penalty of one head: the description length log n of its index among n UAVs."""
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
    """Fit a mixture by hard EM from one assignment.

    Args:
        samples: samples of n UAVs.
        history: the null model.
        leader: ``(n,)`` the initial assignment.
        library: the class of strategies.
        columns: candidates for heads.
        most: the largest number of heads.
        first: the strategy fitted to ``leader``, if it is known.
        by_head: whether all heads have equal weight in the fit of the strategy.

    Returns:
        The best state; ``None`` if no strategy can be fitted.
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

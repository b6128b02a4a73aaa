"""Swarms too large for all pairs: some UAVs are asked, few are candidates, and who stays unexplained is asked next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.evidence import affordable_kinds, gain_and_chance
from detectors.follow_mixture.facility import Heads, locate_heads
from detectors.follow_mixture.flock_search import flights, flock_search, seen_spectra
from detectors.follow_mixture.flocks import flocks_of
from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.mixture import Mixture, head_price
from detectors.follow_mixture.samples import Samples
from detectors.follow_mixture.search import led, quick
from detectors.follow_mixture.strategy import Strategy, fit_strategy, gain_matrix

__all__ = ["ALL_PAIRS", "sampled_search"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

ALL_PAIRS = 500  # UAVs up to which every pair is looked at
_VOTERS = 300
_CANDIDATES = 150
_ROUNDS = 30
_CHUNK = 1000


def sampled_search(samples: Samples, history: OwnHistory, most: int | None, rng: np.random.Generator) -> Mixture | None:
    """The best explanation of a large swarm.

    1. ``_VOTERS`` random UAVs are asked about everybody; the ``_CANDIDATES`` with the most evidence and the voters make
       a small swarm, which is explained as any other.
    2. Its strategy and heads explain everybody else, or not. Some of those who are left are asked about everybody
       under the strategy found, which adds heads; until nobody new is explained.

    Args:
        samples: n UAVs.
        history: the null.
        most: the largest number of heads.
        rng: draws the voters.

    Returns:
        A mixture of all n, scored for its heads alone; ``None`` where nobody seems to follow anybody.
    """
    everybody = np.arange(samples.uavs)
    voters = np.sort(rng.choice(samples.uavs, min(_VOTERS, samples.uavs), replace=False))
    kind = affordable_kinds(samples.rows, samples.memory)[0]
    observed, chance = gain_and_chance(samples, history.surprise, kind, voters)
    worth = np.maximum(observed - chance, 0.0).sum(axis=0)
    few = np.union1d(voters, np.argsort(-worth, kind="stable")[:_CANDIDATES])
    found = _explained(samples.take(few), history.take(few), most)
    if found is None:
        return None
    heads = few[found.heads.heads]
    strategy = found.strategy
    for _ in range(_ROUNDS):
        gain = _gain(samples, history, strategy, heads)
        left = np.setdiff1d(everybody[gain.max(axis=1) <= 0.0], heads)
        if not len(left) or (most is not None and len(heads) >= most):
            break
        asked = np.sort(rng.choice(left, min(_VOTERS, len(left)), replace=False))
        whom = gain_matrix(samples, history, strategy, everybody, asked)
        # Only who was asked votes; a candidate that is a voter itself loses its own vote, as in any swarm.
        columns = np.setdiff1d(np.flatnonzero((whom > 0).sum(axis=0) >= 2), heads)
        if not len(columns):
            break
        new = _located(whom[:, columns], asked, columns, samples.uavs)
        if not len(new):
            break
        heads = np.union1d(heads, new)
    gain = _gain(samples, history, strategy, heads)
    located = locate_heads(gain, heads, head_price(samples.uavs), most, heads)
    strategy = fit_strategy(samples.take(few), _within(located.leader, few), strategy.library) or strategy
    gain = _gain(samples, history, strategy, located.heads)
    final = locate_heads(gain, located.heads, head_price(samples.uavs), most, located.heads)
    place = np.searchsorted(located.heads, final.heads)
    return Mixture(strategy, final, gain[:, place], final.heads, final.value - strategy.price)


def _explained(samples: Samples, history: OwnHistory, most: int | None) -> Mixture | None:
    """The explanation of a small swarm: the quick way, else by flocks."""
    found = quick(samples, history, most)
    if found is not None:
        return found[0]
    if not samples.complete:
        return None
    spectra = seen_spectra(samples)
    watch, flocks = flock_search(samples, spectra, flocks_of(flights(samples), spectra), most)
    return None if flocks is None else led(samples, history, flocks.head[watch.label], most)


def _gain(samples: Samples, history: OwnHistory, strategy: Strategy, heads: Indices) -> Floats:
    """``(n, M)`` of following each head, a thousand UAVs at a time."""
    voters = np.arange(samples.uavs)
    parts = [
        gain_matrix(samples, history, strategy, heads, voters[first : first + _CHUNK])
        for first in range(0, len(voters), _CHUNK)
    ]
    return np.concatenate(parts)


def _located(gain: Floats, asked: Indices, columns: Indices, uavs: int) -> Indices:
    """Heads among ``columns`` by the votes of those who were asked."""
    members = np.union1d(asked, columns)
    votes = np.zeros((len(members), len(columns)))
    votes[np.searchsorted(members, asked)] = gain
    found: Heads = locate_heads(votes, np.searchsorted(members, columns), head_price(uavs))
    return members[found.heads]


def _within(leader: Indices, few: Indices) -> Indices:
    """Leaders ``(n,)`` as indices among ``few``; -1 where the leader is not one of them."""
    mine = leader[few]
    place = np.minimum(np.searchsorted(few, np.maximum(mine, 0)), len(few) - 1)
    return np.where((mine >= 0) & (few[place] == mine), place, -1)

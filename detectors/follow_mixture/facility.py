"""Selects heads and assigns followers: uncapacitated facility location with a penalty per head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Heads", "locate_heads"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

LEAST_VOTERS = 2  # m_j >= 2
_ROUNDS = 50


@dataclass(frozen=True, eq=False)
class Heads:
    """A set of heads with its followers.

    Args:
        heads: ``(M,)`` indices, ascending.
        leader: ``(n,)`` index of the head of each UAV, -1 for none (heads included).
        value: the penalised gain over the hypothesis that no UAV follows another one.
    """

    heads: Indices
    leader: Indices
    value: float


def locate_heads(
    gain: Floats,
    columns: Indices,
    price: float,
    most: int | None = None,
    start: Indices | None = None,
    votes: Indices | None = None,
) -> Heads:
    """Select the heads with the highest value by greedy additions, removals and swaps.

    A UAV follows the head with its highest gain if this gain is positive. A head follows no UAV, so selecting it loses
    its own gain as a follower. Heads with fewer than ``LEAST_VOTERS`` followers are removed.

    Args:
        gain: ``(n, c)``; entry (i, k) is the log-likelihood that UAV i gains by following UAV ``columns[k]``.
        columns: ``(c,)`` indices of the UAVs that may be heads.
        price: the penalty of one head.
        most: the largest number of heads, or ``None``.
        start: the initial heads.
        votes: ``(n,)`` the number of UAVs that each row represents; 1 by default.

    Returns:
        The set of heads; empty if no head gains more than its penalty.
    """
    place = np.full(len(gain), -1)
    place[columns] = np.arange(len(columns))
    positive = np.maximum(gain, 0.0)
    own = np.arange(len(columns))
    positive[columns, own] = 0.0
    limit = len(columns) if most is None else min(most, len(columns))
    chosen: list[int] = [] if start is None else [int(place[head]) for head in start if place[head] >= 0][:limit]
    value = _value(positive, columns, chosen, price)
    for _ in range(_ROUNDS):
        before = value
        chosen, value = _add(positive, columns, chosen, price, limit, value)
        chosen, value = _drop(positive, columns, chosen, price, value)
        chosen, value = _swap(positive, columns, chosen, price, value)
        if value <= before + 1e-9:
            break
    chosen = _with_enough(positive, columns, chosen, np.ones(len(gain), np.int64) if votes is None else votes)
    heads = np.sort(columns[chosen]) if chosen else np.empty(0, np.int64)
    leader = np.full(len(gain), -1, np.int64)
    if chosen:
        best = positive[:, chosen].argmax(axis=1)
        follows = positive[np.arange(len(gain)), np.asarray(chosen)[best]] > 0
        leader[follows] = columns[np.asarray(chosen)[best[follows]]]
        leader[heads] = -1
    return Heads(heads.astype(np.int64), leader, _value(positive, columns, chosen, price))


def _followers(positive: Floats, columns: Indices, chosen: list[int]) -> Floats:
    """``(n,)``: the gain of each UAV; 0 for heads."""
    if not chosen:
        return np.zeros(len(positive))
    gained: Floats = positive[:, chosen].max(axis=1)
    gained[columns[chosen]] = 0.0
    return gained


def _value(positive: Floats, columns: Indices, chosen: list[int], price: float) -> float:
    # Description length: the choice among |S| heads costs each follower log |S|.
    gained = _followers(positive, columns, chosen)
    naming = np.log(len(chosen)) * np.count_nonzero(gained) if len(chosen) > 1 else 0.0
    return float(gained.sum()) - price * len(chosen) - float(naming)


def _add(
    positive: Floats, columns: Indices, chosen: list[int], price: float, limit: int, value: float
) -> tuple[list[int], float]:
    while len(chosen) < limit:
        gained = _followers(positive, columns, chosen)
        voters = np.ones(len(positive), bool)
        voters[columns[chosen]] = False
        rise = np.maximum(positive[voters] - gained[voters, None], 0.0).sum(axis=0) - gained[columns]
        rise[chosen] = -np.inf
        best = int(rise.argmax())
        trial = [*chosen, best]
        worth = _value(positive, columns, trial, price)
        if worth <= value + 1e-9:
            break
        chosen, value = trial, worth
    return chosen, value


def _drop(positive: Floats, columns: Indices, chosen: list[int], price: float, value: float) -> tuple[list[int], float]:
    while len(chosen) > 1:
        trials = [chosen[:k] + chosen[k + 1 :] for k in range(len(chosen))]
        worths = [_value(positive, columns, trial, price) for trial in trials]
        best = int(np.argmax(worths))
        if worths[best] <= value + 1e-9:
            break
        chosen, value = trials[best], worths[best]
    return chosen, value


def _swap(positive: Floats, columns: Indices, chosen: list[int], price: float, value: float) -> tuple[list[int], float]:
    for k in range(len(chosen)):
        rest = chosen[:k] + chosen[k + 1 :]
        gained = _followers(positive, columns, rest)
        voters = np.ones(len(positive), bool)
        voters[columns[rest]] = False
        rise = np.maximum(positive[voters] - gained[voters, None], 0.0).sum(axis=0) - gained[columns]
        rise[rest] = -np.inf
        best = int(rise.argmax())
        if best == chosen[k]:
            continue
        trial = [*rest[:k], best, *rest[k:]]
        worth = _value(positive, columns, trial, price)
        if worth > value + 1e-9:
            chosen, value = trial, worth
    return chosen, value


def _with_enough(positive: Floats, columns: Indices, chosen: list[int], votes: Indices) -> list[int]:
    """Remove heads with too few followers, the weakest first; their followers move to other heads."""
    while chosen:
        gained = _followers(positive, columns, chosen)
        best = np.asarray(positive[:, chosen]).argmax(axis=1)
        count = np.bincount(best[gained > 0], weights=votes[gained > 0], minlength=len(chosen))
        if count.min() >= LEAST_VOTERS:
            break
        weakest = int(count.argmin())
        chosen = chosen[:weakest] + chosen[weakest + 1 :]
    return chosen

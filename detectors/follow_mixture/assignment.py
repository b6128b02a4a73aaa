"""Selects heads and assigns groups to them: facility location, with a price of each head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.compiling import compiled

_ROUNDS = 50
_LITTLE = 1e-9


@dataclass(frozen=True, eq=False)
class Assignment:
    """The head ``(C,)`` of each group, -1 for none; the gain of all groups, less the prices."""

    head: Indices
    value: float

    @property
    def heads(self) -> Indices:
        """``(M,)`` the heads, ascending."""
        return np.unique(self.head[self.head >= 0])


def assign_groups(gain: Floats, candidates: Indices, itself: Indices, sizes: Indices, most: int | None) -> Assignment:
    """Choose the heads with the highest value by greedy removals and additions.

    A group follows the chosen head with its highest gain if that is positive. The value is the sum of these gains, less
    log n for each of the heads (n UAVs), less log(M + 1) for each group that names one of M heads or none: the
    description length of the choice. A candidate that is a group of one follows no UAV while it is chosen.

    Args:
        gain: ``(C, c)`` log-likelihood that each group gains by each candidate.
        candidates: ``(c,)`` their indices among the UAVs.
        itself: ``(c,)`` the group that is the candidate alone, -1 if it is in a group with others.
        sizes: ``(C,)`` number of UAVs of each group.
        most: the largest number of heads, or ``None``.
    """
    if not len(candidates):
        return Assignment(np.full(len(gain), -1), 0.0)
    several, price = sizes > 1, float(np.log(max(sizes.sum(), 2)))
    names = ~several & np.isfinite(gain).any(axis=1)  # groups of one that name a head, or none
    positive = np.maximum(gain, 0.0)
    preferred = np.zeros(len(candidates), bool)
    preferred[gain.argmax(axis=1)[(gain > 0).any(axis=1)]] = True
    best, place = -np.inf, np.full(len(gain), -1)
    for start in (preferred, np.zeros(len(candidates), bool)):  # each group's best candidate, or none
        value, found = _search(positive, itself, several, names, price, most or len(candidates), start)
        if value > best + _LITTLE:
            best, place = value, found
    return Assignment(np.where(place >= 0, candidates[place], -1), best)


@compiled()
def _search(
    gain: Floats, itself: Indices, several: Mask, names: Mask, price: float, most: int, chosen: Mask
) -> tuple[float, Indices]:
    """Remove and add heads in turn; return the value, and the place ``(C,)`` of each group's head, -1 for none."""
    chosen = chosen.copy()
    value = _rank(gain, itself, several, names, price, chosen)[3]
    for _ in range(_ROUNDS):
        before = value
        _drop(gain, itself, several, names, price, most, chosen)
        value = _add(gain, itself, several, names, price, most, chosen)
        if value <= before + _LITTLE:
            break
    best, first, _, value, follows = _rank(gain, itself, several, names, price, chosen)
    for group in range(len(gain)):
        if not follows[group] or not first[group] > 0.0:
            best[group] = -1
    return value, best


@compiled()
def _rank(
    gain: Floats, itself: Indices, several: Mask, names: Mask, price: float, chosen: Mask
) -> tuple[Indices, Floats, Floats, float, Mask]:
    """The chosen head ``(C,)`` with the highest gain, its gain, the second highest gain, the value, and who follows."""
    there = np.flatnonzero(chosen)
    count = len(gain)
    best, first, second, follows = np.full(count, -1), np.zeros(count), np.zeros(count), np.ones(count, np.bool_)
    for k in there:
        if itself[k] >= 0:
            follows[itself[k]] = False
    for group in range(count):
        for k in there:
            gained = gain[group, k]
            if best[group] < 0 or gained > first[group]:
                second[group] = first[group]
                best[group], first[group] = k, gained
            elif gained > second[group]:
                second[group] = gained
    return best, first, second, _value(first, follows, several, names, price, len(there)), follows


@compiled()
def _value(gained: Floats, follows: Mask, several: Mask, names: Mask, price: float, count: int) -> float:
    """Gain of all groups less the prices of ``count`` heads and of their names."""
    total, of_several, of_one = 0.0, 0, 0
    for group in range(len(gained)):
        if follows[group]:
            total += gained[group]
            of_several += several[group] and gained[group] > 0.0
            of_one += names[group]
    return total - price * count - np.log(max(count, 1)) * of_several - np.log(count + 1) * of_one


@compiled()
def _drop(gain: Floats, itself: Indices, several: Mask, names: Mask, price: float, most: int, chosen: Mask) -> None:
    """Remove the head whose removal raises the value most, again and again; more than ``most`` always go."""
    while chosen.any():
        best, first, second, _, follows = _rank(gain, itself, several, names, price, chosen)
        count, following, alone = chosen.sum(), 0, 0
        lost, quits = np.zeros(len(chosen)), np.zeros(len(chosen), np.int64)
        for group in range(len(gain)):
            if follows[group]:
                lost[best[group]] += first[group] - second[group]
                alone += names[group]
                if several[group] and first[group] > 0.0:
                    following += 1
                    quits[best[group]] += second[group] <= 0.0
        worst, highest = -1, -np.inf
        for k in range(len(chosen)):
            single = itself[k] >= 0
            rise = price - lost[k] + (first[itself[k]] if single else 0.0)
            rise += alone * np.log(count + 1) - (alone + single) * np.log(count)
            rise += following * np.log(count) - (following - quits[k]) * np.log(max(count - 1, 1))
            if chosen[k] and rise > highest:
                worst, highest = k, rise
        if highest <= _LITTLE and count <= most:
            break
        chosen[worst] = False


@compiled()
def _add(gain: Floats, itself: Indices, several: Mask, names: Mask, price: float, most: int, chosen: Mask) -> float:
    """Add the head that raises the gains most, as long as the value rises; return the value."""
    _, gained, _, value, follows = _rank(gain, itself, several, names, price, chosen)
    groups, candidates = gain.shape
    rise = np.zeros(candidates)  # what all groups gain by each candidate beyond what they have
    for group in range(groups):
        if follows[group]:
            for k in range(candidates):
                rise[k] += max(gain[group, k] - gained[group], 0.0)
    while chosen.sum() < most:
        best, highest = -1, -np.inf
        for k in range(candidates):
            own = gained[itself[k]] if itself[k] >= 0 and follows[itself[k]] else 0.0  # what it gains as a follower
            if not chosen[k] and rise[k] - own > highest:
                best, highest = k, rise[k] - own
        after, may = np.maximum(gained, gain[:, best]), follows.copy()
        if itself[best] >= 0:
            may[itself[best]] = False
        trial = _value(after, may, several, names, price, chosen.sum() + 1)
        if trial <= value + _LITTLE:
            break
        for group in range(groups):
            if follows[group] and (after[group] != gained[group] or not may[group]):
                for k in range(candidates):
                    rise[k] -= max(gain[group, k] - gained[group], 0.0)
                    if may[group]:
                        rise[k] += max(gain[group, k] - after[group], 0.0)
        chosen[best] = True
        gained, follows, value = after, may, trial
    return value

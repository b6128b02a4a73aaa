"""Selects heads and assigns groups to them: facility location, with a price of each head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from usnet_env.arrays import Floats, Indices, Mask

_ROUNDS = 50
_LITTLE = 1e-9


@dataclass(frozen=True, eq=False)
class Assignment:
    """A set of heads, and the head of each group.

    Args:
        head: ``(C,)`` index of the head of each group, -1 for none.
        value: the gain of all groups, less the prices.
    """

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

    Returns:
        The best set found.
    """
    if not len(candidates):
        return Assignment(np.full(len(gain), -1), 0.0)
    search = _Search(gain, itself, sizes > 1, float(np.log(max(sizes.sum(), 2))))
    best, chosen = -np.inf, np.zeros(len(candidates), bool)
    preferred = np.isin(np.arange(len(candidates)), gain.argmax(axis=1)[(gain > 0).any(axis=1)])
    for some in (preferred, chosen):  # each group's best candidate, or none
        for _ in range(_ROUNDS):
            before = search.value(some)
            some = search.add(search.drop(some, most), most)
            if search.value(some) <= before + _LITTLE:
                break
        if search.value(some) > best + _LITTLE:
            best, chosen = search.value(some), some
    place = search.follow(chosen)
    return Assignment(np.where(place >= 0, candidates[place], -1), search.value(chosen))


class _Search:
    """Moves of the search; ``chosen`` is a mask ``(c,)`` of the candidates."""

    def __init__(self, gain: Floats, itself: Indices, several: Mask, price: float) -> None:
        self.gain, self.itself, self.price = np.maximum(gain, 0.0), itself, price
        self.several = several
        self.alone = ~several & np.isfinite(gain).any(axis=1)  # groups of one that name a head, or none

    def _follows(self, chosen: Mask) -> Mask:
        """``(C,)``: which groups may follow: all but the chosen heads that are groups of one."""
        may = np.ones(len(self.gain), bool)
        single = self.itself[chosen]
        may[single[single >= 0]] = False
        return may

    def follow(self, chosen: Mask) -> Indices:
        """``(C,)``: place of the head of each group among the candidates, -1 for none."""
        if not chosen.any():
            return np.full(len(self.gain), -1)
        there = np.flatnonzero(chosen)
        best = self.gain[:, there].argmax(axis=1)
        gained = self.gain[np.arange(len(best)), there[best]]
        return np.where(self._follows(chosen) & (gained > 0), there[best], -1)

    def _gained(self, chosen: Mask) -> Floats:
        """``(C,)``: gain of each group by its head."""
        return np.where(self._follows(chosen), self.gain[:, chosen].max(axis=1, initial=0.0), 0.0)

    def value(self, chosen: Mask) -> float:
        """Gain of all groups less the prices."""
        return self._value(self._gained(chosen), self._follows(chosen), int(chosen.sum()))

    def _value(self, gained: Floats, follows: Mask, count: int) -> float:
        naming = np.log(max(count, 1)) * np.count_nonzero(gained[self.several])
        naming += np.log1p(count) * (self.alone & follows).sum()
        return float(gained.sum() - self.price * count - naming)

    def drop(self, chosen: Mask, most: int | None) -> Mask:
        """Remove the head whose removal raises the value most, again and again; more than ``most`` always go."""
        chosen = chosen.copy()
        while chosen.any():
            there = np.flatnonzero(chosen)
            ranked = self.gain[:, there]
            best = ranked.argmax(axis=1)
            first = ranked[np.arange(len(best)), best]
            second = np.partition(ranked, -2, axis=1)[:, -2] if len(there) > 1 else np.zeros(len(best))
            may = self._follows(chosen)
            lost = np.bincount(best, weights=(first - second) * may, minlength=len(there))
            single = self.itself[there]
            returned = np.where(single >= 0, ranked[np.maximum(single, 0)].max(axis=1), 0.0)
            follow = may & (first > 0) & self.several
            quit_ = np.bincount(best, weights=follow & (second <= 0), minlength=len(there))
            count = len(there)
            alone = (self.alone & may).sum()
            naming = alone * np.log1p(count) - (alone + (single >= 0)) * np.log(count)
            naming += np.log(count) * follow.sum() - np.log(max(count - 1, 1)) * (follow.sum() - quit_)
            rise = self.price - lost + returned + naming
            worst = int(rise.argmax())
            if rise[worst] <= _LITTLE and (most is None or len(there) <= most):
                break
            chosen[there[worst]] = False
        return chosen

    def add(self, chosen: Mask, most: int | None) -> Mask:
        """Add the head that raises the gains most, as long as the value rises."""
        chosen, gained, follows = chosen.copy(), self._gained(chosen), self._follows(chosen)
        value = self._value(gained, follows, int(chosen.sum()))
        rise = self._sum_rises(np.flatnonzero(follows), gained)
        while chosen.sum() < (len(chosen) if most is None else most) and not chosen.all():
            own = np.where(self.itself >= 0, gained[self.itself], 0.0)  # what each gains as a follower
            best = int(np.where(chosen, -np.inf, rise - own).argmax())
            may, after = follows.copy(), np.where(follows, np.maximum(gained, self.gain[:, best]), 0.0)
            if self.itself[best] >= 0:
                may[self.itself[best]], after[self.itself[best]] = False, 0.0
            trial = self._value(after, may, int(chosen.sum()) + 1)
            if trial <= value + _LITTLE:
                break
            changed = (after != gained) | (may != follows)  # the sums over all other groups stay
            rise = rise - self._sum_rises(np.flatnonzero(changed & follows), gained)
            rise += self._sum_rises(np.flatnonzero(changed & may), after)
            chosen[best], gained, follows, value = True, after, may, trial
        return chosen

    def _sum_rises(self, groups: Indices, gained: Floats) -> Floats:
        """``(c,)``: what some groups gain by each candidate beyond ``gained`` ``(C,)``, summed over them."""
        return np.asarray(np.maximum(self.gain[groups] - gained[groups, None], 0.0).sum(axis=0))

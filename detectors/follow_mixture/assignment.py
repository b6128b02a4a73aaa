"""Selects heads and assigns groups to them: facility location, with a price of each head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from usnet_env.arrays import Floats, Indices, Mask

LEAST_FOLLOWERS = 2  # m_j >= 2
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
    """Choose the heads with the highest value by greedy removals, additions and swaps.

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
        The best set found, in which each head has at least two followers.
    """
    search = _Search(gain, itself, sizes > 1, float(np.log(max(sizes.sum(), 2))))
    chosen = np.zeros(len(candidates), bool)
    if len(candidates):
        best = gain.argmax(axis=1)
        chosen[best[gain.max(axis=1) > 0]] = True
    for _ in range(_ROUNDS):
        before = search.value(chosen)
        chosen = search.drop(chosen, most)
        chosen = search.add(chosen, most)
        chosen = search.swap(chosen)
        if search.value(chosen) <= before + _LITTLE:
            break
    chosen = search.drop_small(chosen, sizes)
    place = search.follow(chosen)
    return Assignment(np.where(place >= 0, candidates[place] if len(candidates) else -1, -1), search.value(chosen))


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
        if not chosen.any():
            return np.zeros(len(self.gain))
        return np.where(self._follows(chosen), self.gain[:, chosen].max(axis=1), 0.0)

    def value(self, chosen: Mask) -> float:
        """Gain of all groups less the prices."""
        gained, count = self._gained(chosen), int(chosen.sum())
        naming = (
            np.log(max(count, 1)) * np.count_nonzero(gained[self.several])
            + np.log1p(count) * (self.alone & self._follows(chosen)).sum()
        )
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
            returned = np.where(single >= 0, self._best_of_others(there, single), 0.0)
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

    def _best_of_others(self, there: Indices, single: Indices) -> Floats:
        """``(M,)``: what each chosen head would gain as a follower of the other heads; unused if it is in a group."""
        rows = self.gain[np.maximum(single, 0)][:, there].copy()
        rows[np.arange(len(there)), np.arange(len(there))] = 0.0
        return np.asarray(rows.max(axis=1))

    def _rises(self, chosen: Mask) -> Floats:
        """``(c,)``: rise of the gains by one more head, without prices; -inf for chosen ones."""
        gained = self._gained(chosen)
        return self._less_own(self._sum_rises(np.flatnonzero(self._follows(chosen)), gained), gained, chosen)

    def _sum_rises(self, groups: Indices, gained: Floats) -> Floats:
        """``(c,)``: what some groups gain by each candidate beyond ``gained`` ``(C,)``, summed over them."""
        return np.asarray(np.maximum(self.gain[groups] - gained[groups, None], 0.0).sum(axis=0))

    def _less_own(self, rise: Floats, gained: Floats, chosen: Mask) -> Floats:
        """The rises less what each candidate gains as a follower; -inf for chosen ones."""
        rise = rise - np.where(self.itself >= 0, gained[self.itself], 0.0)
        rise[chosen] = -np.inf
        return rise

    def add(self, chosen: Mask, most: int | None) -> Mask:
        """Add the head that raises the gains most, as long as the value rises."""
        value = self.value(chosen)
        while chosen.sum() < (len(chosen) if most is None else min(most, len(chosen))):
            trial = chosen.copy()
            trial[self._rises(chosen).argmax()] = True
            if self.value(trial) <= value + _LITTLE:
                break
            chosen, value = trial, self.value(trial)
        return chosen

    def swap(self, chosen: Mask) -> Mask:
        """Exchange each head for the best other candidate, if the value rises.

        Without a head only its followers, and itself if it is a group, gain anything else: the sums over all other
        groups stay, so that a pass takes about as long as two sums over all groups.
        """
        value, changed = self.value(chosen), True
        for place in np.flatnonzero(chosen):
            if changed:
                gained, head, changed = self._gained(chosen), self.follow(chosen), False
                summed = self._sum_rises(np.flatnonzero(self._follows(chosen)), gained)
            trial = chosen.copy()
            trial[place] = False
            led = np.flatnonzero(head == place)
            freed = np.append(led, self.itself[place]) if self.itself[place] >= 0 else led
            after = gained.copy()
            after[freed] = self.gain[np.ix_(freed, trial)].max(axis=1, initial=0.0)
            rise = summed - self._sum_rises(led, gained) + self._sum_rises(freed, after)
            best = int(self._less_own(rise, after, trial).argmax())
            trial[best] = True
            if best != place and self.value(trial) > value + _LITTLE:
                chosen, value, changed = trial, self.value(trial), True
        return chosen

    def drop_small(self, chosen: Mask, sizes: Indices) -> Mask:
        """Remove heads with too few followers, the smallest first; their groups move to other heads."""
        chosen = chosen.copy()
        while chosen.any():
            place = self.follow(chosen)
            count = np.bincount(place[place >= 0], weights=sizes[place >= 0], minlength=len(chosen))
            count[~chosen] = np.inf
            if count.min() >= LEAST_FOLLOWERS:
                break
            chosen[count.argmin()] = False
        return chosen

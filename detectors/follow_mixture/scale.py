"""Swarms too large for all pairs: some UAVs are asked, few are candidates, and who stays unexplained is asked next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.evidence import affordable_kinds, gain_and_chance
from detectors.follow_mixture.facility import LEAST_VOTERS, Heads
from detectors.follow_mixture.flock_search import flights, flock_search, seen_spectra
from detectors.follow_mixture.flocks import flocks_of
from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.mixture import Mixture, head_price
from detectors.follow_mixture.pair_evidence import fly_alone, pair_evidence
from detectors.follow_mixture.samples import Samples
from detectors.follow_mixture.search import MISFIT, led, misfit, quick, shortcut
from detectors.follow_mixture.strategy import Strategy, fit_strategy, gain_matrix

__all__ = ["ALL_PAIRS", "pruned", "sampled_search"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

ALL_PAIRS = 500  # UAVs up to which every pair is looked at
_VOTERS = 300
_ASKED = 600  # of those who are left, at once: a round costs all pasts, however few are asked
_CANDIDATES = 150
_ROUNDS = 30
_CHUNK = 1000
_ACCOUNTED = 0.9  # share of a swarm that the strategy of a few agreeing voters must account for,
_HALF = 0.5  # or where it leaves nothing but noise: the others may be decoys


def sampled_search(samples: Samples, history: OwnHistory, most: int | None, rng: np.random.Generator) -> Mixture | None:
    """The best explanation of a large swarm.

    1. ``_VOTERS`` random UAVs are asked about everybody. Those of them who name the same UAV as others do show the
       strategy: with many heads a random follower is often the only one of its head that was asked, and can't.
    2. The strategy and its heads explain everybody else, or not. Some of those who are left are asked about everybody
       under the strategy found, which adds heads; until nobody new is explained.
    3. Where that leaves many unexplained, the voters and the ``_CANDIDATES`` with the most evidence make a small swarm,
       which is explained as any other, and step 2 follows from there.

    Args:
        samples: n UAVs.
        history: the null.
        most: the largest number of heads.
        rng: draws the voters.

    Returns:
        A mixture of all n, scored for its heads alone; ``None`` where nobody seems to follow anybody.
    """
    voters = np.sort(rng.choice(samples.uavs, min(_VOTERS, samples.uavs), replace=False))
    kind = affordable_kinds(samples.rows, samples.memory)[0]
    observed, chance = gain_and_chance(samples, history.surprise, kind, voters)
    evidence = observed - chance
    agreeing = _agreeing(evidence - 0.5 * chance, voters)  # one that agrees by chance asks for a richer class
    best: Mixture | None = None
    if len(agreeing):
        found = _at_once(samples.take(agreeing), history.take(agreeing), most)
        if found is not None:
            best = _spread(samples, history, found.strategy, agreeing[found.heads.heads], voters, most, rng)
            left_over = misfit(samples.take(agreeing), found.strategy, found.heads.leader).worst
            if _accounted(best) >= (_HALF if left_over <= MISFIT else _ACCOUNTED):
                return best
    worth = np.maximum(evidence, 0.0).sum(axis=0)
    few = np.union1d(voters, np.argsort(-worth, kind="stable")[:_CANDIDATES])
    found = _explained(samples.take(few), history.take(few), most)
    if found is not None:
        other = _spread(samples, history, found.strategy, few[found.heads.heads], voters, most, rng)
        best = other if best is None or other.value > best.value else best
    return best


def _agreeing(evidence: Floats, voters: Indices) -> Indices:
    """Voters who name a UAV that others name too, and whom they name: indices, ascending.

    Args:
        evidence: ``(v, n)`` above what a voter must be sure by.
        voters: ``(v,)``.
    """
    named = evidence.argmax(axis=1)
    sure = evidence[np.arange(len(voters)), named] > 0
    count = np.bincount(named[sure], minlength=evidence.shape[1])
    agree = sure & (count[named] >= LEAST_VOTERS)
    return np.union1d(voters[agree], named[agree])


def _at_once(samples: Samples, history: OwnHistory, most: int | None) -> Mixture | None:
    """The quick explanation of voters who agree; whether it leaves few unexplained shows later, in the whole swarm."""
    pairs = pair_evidence(samples, history, most)
    found = shortcut(samples, history, pairs, most) if len(pairs.heads) else None
    if found is None or not len(found.heads.heads):
        return None
    return found if fly_alone(samples, history, found.heads.heads, found.heads.leader) else None


def _explained(samples: Samples, history: OwnHistory, most: int | None) -> Mixture | None:
    """The explanation of a small swarm: the quick way, else by flocks."""
    found = quick(samples, history, pair_evidence(samples, history, most), most)
    if found is not None:
        return found
    if not samples.complete:
        return None
    spectra = seen_spectra(samples)
    watch, flocks = flock_search(samples, spectra, flocks_of(flights(samples), spectra), most)
    return None if flocks is None else led(samples, history, flocks.head[watch.label], most)


def _spread(
    samples: Samples,
    history: OwnHistory,
    strategy: Strategy,
    heads: Indices,
    voters: Indices,
    most: int | None,
    rng: np.random.Generator,
) -> Mixture:
    """All heads that a strategy finds, from some on, and who follows them; the strategy is fitted to voters anew."""
    price = head_price(samples.uavs)
    everybody = np.arange(samples.uavs)
    gain = _gain(samples, history, strategy, heads, everybody)
    for _ in range(_ROUNDS):
        left = np.setdiff1d(everybody[(gain <= 0.0).all(axis=1)], heads)
        if not len(left) or (most is not None and len(heads) >= most):
            break
        asked = np.sort(rng.choice(left, min(_ASKED, len(left)), replace=False))
        whom = gain_matrix(samples, history, strategy, everybody, asked)
        named = whom.argmax(axis=1)
        new = np.setdiff1d(named[whom[np.arange(len(asked)), named] > 0.0], heads)
        # Everybody who is left votes, so that one follower of a head is enough to find it.
        new = new[pruned(_gain(samples, history, strategy, new, left), new, left, price)]
        if not len(new):
            break
        heads = np.concatenate([heads, new])
        gain = np.concatenate([gain, _gain(samples, history, strategy, new, everybody)], axis=1)
    found = _kept(strategy, gain, heads, price, most)
    leader = found.heads.leader
    shown = np.union1d(voters, leader[voters][leader[voters] >= 0])
    refined = fit_strategy(samples.take(shown), _within(leader, shown), strategy.library)
    if refined is None:
        return found
    gain = _gain(samples, history, refined, found.columns, everybody)
    better = _kept(refined, gain, found.columns, price, most)
    return better if better.value > found.value else found


def _kept(strategy: Strategy, gain: Floats, heads: Indices, price: float, most: int | None) -> Mixture:
    """The mixture of all UAVs with those of ``heads`` that are worth their price."""
    kept = np.flatnonzero(pruned(gain, heads, np.arange(len(gain)), price, most))
    kept = kept[np.argsort(heads[kept])]
    final = _heads(gain[:, kept], heads[kept], price)
    return Mixture(strategy, final, gain[:, kept], final.heads, final.value - strategy.price)


def _gain(samples: Samples, history: OwnHistory, strategy: Strategy, heads: Indices, voters: Indices) -> Floats:
    """``(v, M)`` of following each head, a thousand UAVs at a time."""
    gain = np.empty((len(voters), len(heads)))
    if len(heads):
        for first in range(0, len(voters), _CHUNK):
            part = slice(first, first + _CHUNK)
            gain[part] = gain_matrix(samples, history, strategy, heads, voters[part])
    return gain


def pruned(gain: Floats, columns: Indices, rows: Indices, price: float, most: int | None = None) -> Mask:
    """Which of many candidates to keep: the least worthy is dropped as long as that gains.

    The value is that of ``locate_heads``, whose additions and swaps would look at every pair of columns.

    Args:
        gain: ``(v, c)`` of following each candidate; 0 where a UAV meets itself.
        columns: ``(c,)`` the candidates, indices of UAVs, none twice.
        rows: ``(v,)`` the UAVs that vote, ascending. A candidate among them has no vote while it is kept.
        price: of one head.
        most: the largest number that is kept.

    Returns:
        ``(c,)`` bool; those kept have ``LEAST_VOTERS`` followers or more.
    """
    kept = np.ones(len(columns), bool)
    if not len(columns) or not len(rows):
        return ~kept
    place = np.minimum(np.searchsorted(rows, columns), len(rows) - 1)
    votes_too = rows[place] == columns
    voting = np.ones(len(rows), bool)
    voting[place[votes_too]] = False
    first, best, second = _two_best(gain, kept)
    while kept.any():
        heads = int(kept.sum())
        follows = voting & (best > 0.0)
        count = np.bincount(first[follows], minlength=len(columns))
        lost = np.bincount(first[follows], weights=(best - second)[follows], minlength=len(columns))
        stay = np.bincount(first[follows & (second > 0.0)], minlength=len(columns))
        returns = np.where(votes_too, best[place], 0.0)  # what it gains as a follower once it is no head
        fewer = follows.sum() - count + stay + (returns > 0.0)
        names = np.log(heads) * follows.sum() - np.log(max(heads - 1, 1)) * fewer
        rise = np.where(kept, price - lost + returns + names, -np.inf)
        worst = int(rise.argmax())
        if rise[worst] <= 1e-9 and (most is None or heads <= most):
            count = np.where(kept, count, len(rows) + LEAST_VOTERS)
            worst = int(count.argmin())
            if count[worst] >= LEAST_VOTERS:
                break
        kept[worst] = False
        if votes_too[worst]:
            voting[place[worst]] = True
        again = np.flatnonzero((first == worst) | (second > 0.0))
        again = again[(first[again] == worst) | (gain[again, worst] >= second[again])]
        first[again], best[again], second[again] = _two_best(gain[again], kept)
    return kept


def _two_best(gain: Floats, kept: Mask) -> tuple[Indices, Floats, Floats]:
    """Column of each row's highest gain, and its two highest, 0 at least; all ``(v,)``."""
    columns = np.flatnonzero(kept)
    if not len(columns) or not len(gain):
        return np.zeros(len(gain), np.int64), np.zeros(len(gain)), np.zeros(len(gain))
    among = gain if len(columns) == gain.shape[1] else gain[:, columns]
    place = among.argmax(axis=1)
    rows = np.arange(len(gain))
    best = among[rows, place]
    second = np.partition(among, -2, axis=1)[:, -2] if len(columns) > 1 else np.zeros(len(gain))
    return columns[place], np.maximum(best, 0.0), np.maximum(second, 0.0)


def _heads(gain: Floats, heads: Indices, price: float) -> Heads:
    """Heads ``(M,)`` and the followers that ``gain`` ``(n, M)`` gives them."""
    leader = np.full(len(gain), -1, np.int64)
    if not len(heads):
        return Heads(heads, leader, 0.0)
    first, best, _ = _two_best(gain, np.ones(len(heads), bool))
    best[heads] = 0.0
    leader[best > 0.0] = heads[first[best > 0.0]]
    naming = float(np.log(len(heads))) * int((best > 0.0).sum())
    return Heads(heads, leader, float(best.sum()) - price * len(heads) - naming)


def _accounted(mixture: Mixture) -> float:
    """Share of the UAVs that are heads or follow one."""
    return ((mixture.heads.leader >= 0).sum() + len(mixture.heads.heads)) / len(mixture.heads.leader)


def _within(leader: Indices, few: Indices) -> Indices:
    """Leaders ``(n,)`` as indices among ``few``; -1 where the leader is not one of them."""
    mine = leader[few]
    place = np.minimum(np.searchsorted(few, np.maximum(mine, 0)), len(few) - 1)
    return np.where((mine >= 0) & (few[place] == mine), place, -1)

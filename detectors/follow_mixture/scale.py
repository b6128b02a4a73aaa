"""Fits swarms that are too large for all pairs: by random voters and few candidates, then by the unassigned UAVs."""

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

ALL_PAIRS = 500  # largest number of UAVs for which all pairs are used
_VOTERS = 300
_ASKED = 600  # unassigned UAVs that vote per round; the cost of a round hardly depends on their number
_CANDIDATES = 150
_ROUNDS = 30
_CHUNK = 1000
_ACCOUNTED = 0.9  # share of a swarm that the strategy of a few agreeing voters must assign,
_HALF = 0.5  # or this share if only noise is left: the other UAVs may be decoys


def sampled_search(samples: Samples, history: OwnHistory, most: int | None, rng: np.random.Generator) -> Mixture | None:
    """Fit a large swarm.

    1. ``_VOTERS`` random UAVs vote for their head among all UAVs. The voters that share their vote with another one
       determine the strategy. (With many heads, a voter is often the only follower of its head in the sample.)
    2. The strategy and its heads assign the other UAVs. Some of the unassigned UAVs vote among all UAVs under this
       strategy, which adds heads; this is repeated until no head is added.
    3. If many UAVs are unassigned, the voters and the ``_CANDIDATES`` UAVs with the most evidence are fitted as a small
       swarm, and step 2 is repeated from the result.

    Args:
        samples: samples of n UAVs.
        history: the null model.
        most: the largest number of heads.
        rng: draws the voters.

    Returns:
        A mixture of all n UAVs, scored for its heads only; ``None`` if no UAV seems to follow another one.
    """
    voters = np.sort(rng.choice(samples.uavs, min(_VOTERS, samples.uavs), replace=False))
    kind = affordable_kinds(samples.rows, samples.memory)[0]
    observed, chance = gain_and_chance(samples, history.surprise, kind, voters)
    evidence = observed - chance
    agreeing = _agreeing(evidence - 0.5 * chance, voters)  # a voter that agrees by chance would require a richer class
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
    """Indices, ascending, of the voters that share their vote with another voter, and of the UAVs they vote for.

    Args:
        evidence: ``(v, n)``, the evidence less the threshold of a significant vote.
        voters: ``(v,)``, indices of the voters.
    """
    named = evidence.argmax(axis=1)
    sure = evidence[np.arange(len(voters)), named] > 0
    count = np.bincount(named[sure], minlength=evidence.shape[1])
    agree = sure & (count[named] >= LEAST_VOTERS)
    return np.union1d(voters[agree], named[agree])


def _at_once(samples: Samples, history: OwnHistory, most: int | None) -> Mixture | None:
    """Fit the agreeing voters by the first search; the number of unassigned UAVs is tested later on the whole swarm."""
    pairs = pair_evidence(samples, history, most)
    found = shortcut(samples, history, pairs, most) if len(pairs.heads) else None
    if found is None or not len(found.heads.heads):
        return None
    return found if fly_alone(samples, history, found.heads.heads, found.heads.leader) else None


def _explained(samples: Samples, history: OwnHistory, most: int | None) -> Mixture | None:
    """Fit a small swarm by the first search, or else by flocks."""
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
    """Add heads under a strategy, assign all UAVs, and fit the strategy to the voters again."""
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
        # All unassigned UAVs vote, so that one sampled follower is enough to find a head.
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
    """The mixture of all UAVs with those of ``heads`` that gain more than their penalty."""
    kept = np.flatnonzero(pruned(gain, heads, np.arange(len(gain)), price, most))
    kept = kept[np.argsort(heads[kept])]
    final = _heads(gain[:, kept], heads[kept], price)
    return Mixture(strategy, final, gain[:, kept], final.heads, final.value - strategy.price)


def _gain(samples: Samples, history: OwnHistory, strategy: Strategy, heads: Indices, voters: Indices) -> Floats:
    """``(v, M)``: the gain by following each head, computed in chunks of voters."""
    gain = np.empty((len(voters), len(heads)))
    if len(heads):
        for first in range(0, len(voters), _CHUNK):
            part = slice(first, first + _CHUNK)
            gain[part] = gain_matrix(samples, history, strategy, heads, voters[part])
    return gain


def pruned(gain: Floats, columns: Indices, rows: Indices, price: float, most: int | None = None) -> Mask:
    """Backward elimination of candidates: drop the least valuable one as long as the value rises.

    The value is that of ``locate_heads``; additions and swaps would cost too much for many candidates.

    Args:
        gain: ``(v, c)``, the gain by following each candidate; 0 for a UAV with itself.
        columns: ``(c,)``, indices of the candidates, without repetition.
        rows: ``(v,)``, indices of the voters, ascending. A candidate among them has no vote while it is kept.
        price: the penalty of one head.
        most: the largest number of kept candidates.

    Returns:
        ``(c,)`` bool; each kept candidate has at least ``LEAST_VOTERS`` followers.
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
        returns = np.where(votes_too, best[place], 0.0)  # its gain as a follower if it is no head
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
    """Column of each row's highest gain, and its two highest gains, clipped at 0; all ``(v,)``."""
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
    """Assign followers to the heads ``(M,)`` by ``gain`` ``(n, M)``."""
    leader = np.full(len(gain), -1, np.int64)
    if not len(heads):
        return Heads(heads, leader, 0.0)
    first, best, _ = _two_best(gain, np.ones(len(heads), bool))
    best[heads] = 0.0
    leader[best > 0.0] = heads[first[best > 0.0]]
    naming = float(np.log(len(heads))) * int((best > 0.0).sum())
    return Heads(heads, leader, float(best.sum()) - price * len(heads) - naming)


def _accounted(mixture: Mixture) -> float:
    """Share of the UAVs that are heads or followers."""
    return ((mixture.heads.leader >= 0).sum() + len(mixture.heads.heads)) / len(mixture.heads.leader)


def _within(leader: Indices, few: Indices) -> Indices:
    """Leaders ``(n,)`` as indices among ``few``; -1 where the leader is not one of them."""
    mine = leader[few]
    place = np.minimum(np.searchsorted(few, np.maximum(mine, 0)), len(few) - 1)
    return np.where((mine >= 0) & (few[place] == mine), place, -1)

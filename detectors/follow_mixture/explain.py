"""Who leads whom in one window: the ways to find it, and when each is asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.explanation import KINDS, Explanation
from detectors.follow_mixture.facility import LEAST_VOTERS
from detectors.follow_mixture.flock_evidence import explained_by_flocks
from detectors.follow_mixture.flock_heads import watch_flocks
from detectors.follow_mixture.flock_leads import PHASES_TELL, explained_by_leads, leads_of_flocks
from detectors.follow_mixture.flock_search import first_guesses, flights, flock_search, seen_spectra
from detectors.follow_mixture.flocks import flocks_of
from detectors.follow_mixture.history import own_history
from detectors.follow_mixture.mixture_evidence import explained_by_mixture
from detectors.follow_mixture.noise import SMOOTH, FlightSpectra
from detectors.follow_mixture.pair_evidence import explained_by_pairs, pair_evidence
from detectors.follow_mixture.samples import Samples, filled, samples_of
from detectors.follow_mixture.scale import ALL_PAIRS, sampled_search
from detectors.follow_mixture.search import LEFT_OUT, climb_together, climbed, explains, misfit, unexplained
from usnet_env.window import Window

__all__ = ["by_everybody", "by_flocks", "explain", "in_doubt"]

_LAGS = 4  # of a head's past for a flock, where the window can feed them
_STEPS_A_LAG = 5
_LONG_ROWS = 60  # from which on twice the lags are looked at where these explain few


def explain(
    window: Window, samples: Samples, living: NDArray[np.int64], most: int | None, rng: np.random.Generator
) -> Explanation | None:
    """Who leads whom: at once where pairwise evidence shows it, else by flocks, else by everybody together.

    Args:
        window: what was seen.
        samples: of its living UAVs.
        living: ``(n,)`` their indices in the window.
        most: the largest number of heads, or ``None``.
        rng: draws the voters of a large swarm.

    Returns:
        ``None`` where nobody seems to follow anybody.
    """
    if samples.uavs > ALL_PAIRS:
        history = own_history(samples)
        return explained_by_mixture(samples, history, sampled_search(samples, history, most, rng))
    first, held = at_once(samples, most) if samples.unit else (None, None)  # one speed: seen without noise
    if first is not None and settles(first):
        return first
    complete = filled(window)
    lags = int(np.clip(window.observation_steps // _STEPS_A_LAG, 1, _LAGS))
    rows = flown(complete, samples, living, lags)
    if rows is None:
        return first
    spectra = seen_spectra(rows)
    if spectra.noise == 0 and not samples.unit:
        first, held = at_once(samples, most)
        if first is not None and settles(first):
            return first
    found = by_flocks(rows, spectra, most)
    if found is not None and 2 * (found.leader >= 0).sum() < samples.uavs:
        # There are flocks, and most of them follow nobody: followers may be late.
        longer = flown(complete, samples, living, 2 * lags) if rows.rows >= _LONG_ROWS else None
        late = None if longer is None else by_flocks(longer, spectra, most)
        if late is not None and late.value > found.value:
            found = late
    if found is not None and len(found.heads) and samples.complete and in_doubt(found):
        found = by_everybody(samples, rows, spectra, found, most) or found
    if first is not None and (found is None or unled(first) < unled(found)):
        return first
    return found if found is None or held is None else (missed_by_flocks(held, found) or found)


def flown(window: Window, samples: Samples, living: NDArray[np.int64], lags: int) -> Samples | None:
    """The samples of a window without gaps. A gap that was filled is flown more slowly; one speed stays one speed."""
    rows = samples_of(window, living, lags)
    return None if rows is None else replace(rows, unit=samples.unit)


def by_flocks(rows: Samples, spectra: FlightSpectra, most: int | None) -> Explanation | None:
    """What flocks say: behind noise by the phases of smooth flights, where these tell anything."""
    velocity = flights(rows)
    flocks = flocks_of(velocity, spectra)
    if spectra.noise > PHASES_TELL and np.median(spectra.memory) >= SMOOTH:
        leads = leads_of_flocks(velocity, spectra, flocks)
        if leads is not None:
            return explained_by_leads(leads, flocks)
    return explained_by_flocks(*flock_search(rows, spectra, flocks, most), float(np.median(spectra.memory)))


def at_once(samples: Samples, most: int | None) -> tuple[Explanation | None, Explanation | None]:
    """What pairwise evidence leads to: a shared strategy, or else a law for each pair, that leaves hardly anybody over.

    Of smooth flights few moments are independent: there pairs alone say too little.

    Returns:
        The explanation, and one of a shared strategy that nearly holds and leaves some over.
    """
    history = own_history(samples)
    evidence = pair_evidence(samples, history, most)
    mixture = climbed(samples, history, evidence, most)
    held = None
    if mixture is not None:
        if explains(samples, history, mixture):
            return explained_by_mixture(samples, history, mixture), None
        if samples.complete and misfit(samples, mixture.strategy, mixture.heads.leader).nearly_holds:
            held = explained_by_mixture(samples, history, mixture)
    pairs = explained_by_pairs(samples, history, evidence) if history.memory < SMOOTH else None
    return pairs if pairs is not None and nearly_all(pairs) else None, held


def missed_by_flocks(held: Explanation, found: Explanation) -> Explanation | None:
    """A strategy's explanation where flocks lead astray those whom it leaves over: their head may be among them.

    Flights that are straight in one direction are one flock, whoever leads them.
    """
    left = held.leader < 0
    left[held.heads] = False
    left_over, astray = int(left.sum()), left & (found.leader >= 0)
    if left[found.heads[found.passed]].any() or astray.sum() <= max(LEAST_VOTERS, left_over / 2):
        return None
    assert held.kind is not None
    return replace(held, kind=np.where(left, KINDS.index("missing"), held.kind))


def settles(found: Explanation) -> bool:
    """Whether nobody else need be asked: all share a strategy, or nobody is left over."""
    return bool(found.strategy["shared"]) or unled(found) == 0


def nearly_all(found: Explanation) -> bool:
    """Whether hardly anybody is left over."""
    return unled(found) <= max(LEAST_VOTERS - 1, LEFT_OUT * len(found.leader))


def in_doubt(found: Explanation) -> bool:
    """Whether flocks found no strategy that all share, or left many out."""
    return not found.strategy["shared"] or unled(found) > LEFT_OUT * len(found.leader)


def unled(found: Explanation) -> int:
    """How many are neither heads nor follow one."""
    return int((found.leader < 0).sum()) - len(found.heads)


def by_everybody(
    samples: Samples, rows: Samples, spectra: FlightSpectra, found: Explanation, most: int | None
) -> Explanation | None:
    """What everybody says together, where flocks ``found`` heads in doubt; ``None`` if that is no better.

    Where delays differ from follower to follower the earlier explain the later as well as their head does. But they fly
    at once with others who have the same delay, and these follow somebody else. And heads that flocks found are not
    dropped for those who are left out without.
    """
    flocks = flocks_of(flights(rows), spectra)
    start = found.leader.copy()
    start[found.heads] = -1
    starts = [start, *first_guesses(rows, watch_flocks(rows, flocks), most)]
    history = own_history(samples)
    mixture = climb_together(samples, history, starts, most)
    if mixture is None:
        return None
    heads, leader = mixture.heads.heads, mixture.heads.leader
    for head in heads:
        mates = np.setdiff1d(np.flatnonzero(flocks.label == flocks.label[head]), heads)
        if len(mates) and 2 * (leader[mates] != head).sum() > len(mates):
            return None
    fewer = not len(np.setdiff1d(heads, found.heads)) and len(heads) < len(found.heads)
    if fewer and unexplained(mixture) >= LEAST_VOTERS:
        return None
    return explained_by_mixture(samples, history, mixture)

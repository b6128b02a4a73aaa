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
from detectors.follow_mixture.flocks import Flocks, flocks_of
from detectors.follow_mixture.history import OwnHistory, own_history
from detectors.follow_mixture.mixture import Mixture
from detectors.follow_mixture.mixture_evidence import explained_by_mixture
from detectors.follow_mixture.noise import SMOOTH, FlightSpectra
from detectors.follow_mixture.pair_evidence import (
    PairEvidence,
    explained_by_pairs,
    flies_with,
    fly_alone,
    pair_evidence,
    plain_evidence,
)
from detectors.follow_mixture.samples import Samples, filled, samples_of
from detectors.follow_mixture.scale import ALL_PAIRS, sampled_search
from detectors.follow_mixture.search import LEFT_OUT, climb_together, climbed, explains, misfit, unexplained, with_led
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
    seen = evidence_of(samples, most)
    first, held = at_once(samples, *seen, most) if samples.unit else (None, None)  # one speed: seen without noise
    if first is not None and settles(first):
        return first
    complete = filled(window)
    lags = int(np.clip(window.observation_steps // _STEPS_A_LAG, 1, _LAGS))
    rows = flown(complete, samples, living, lags)
    if rows is None:
        return first
    spectra = seen_spectra(rows)
    if spectra.noise == 0 and not samples.unit:
        first, held = at_once(samples, *seen, most)
        if first is not None and settles(first):
            return first
    flocks = flocks_of(flights(rows), spectra)
    found = by_flocks(rows, spectra, flocks, most)
    if found is not None and 2 * (found.leader >= 0).sum() < samples.uavs:
        # There are flocks, and most of them follow nobody: followers may be late.
        longer = flown(complete, samples, living, 2 * lags) if rows.rows >= _LONG_ROWS else None
        late = None if longer is None else by_flocks(longer, spectra, flocks, most)
        if late is not None and late.value > found.value:
            found = late
    everybody = None
    if found is not None and len(found.heads) and samples.complete and in_doubt(found):
        starts = first_guesses(rows, watch_flocks(rows, flocks), most)
        everybody = by_everybody(samples, *seen, flocks, starts, found, most)
    if everybody is None and found is not None and held is not None:
        found = missed_by_flocks(held, found)
    found = everybody or found
    return first if first is not None and (found is None or unled(first) < unled(found)) else found


def evidence_of(samples: Samples, most: int | None) -> tuple[OwnHistory, PairEvidence]:
    """What the own past of everybody foretells, and what everybody else's adds."""
    history = own_history(samples)
    return history, pair_evidence(samples, history, most)


def flown(window: Window, samples: Samples, living: NDArray[np.int64], lags: int) -> Samples | None:
    """The samples of a window without gaps. A gap that was filled is flown more slowly; one speed stays one speed."""
    rows = samples_of(window, living, lags)
    return None if rows is None else replace(rows, unit=samples.unit)


def by_flocks(rows: Samples, spectra: FlightSpectra, flocks: Flocks, most: int | None) -> Explanation | None:
    """What flocks say: behind noise by the phases of smooth flights, where these tell anything."""
    if spectra.noise > PHASES_TELL and np.median(spectra.memory) >= SMOOTH:
        leads = leads_of_flocks(flights(rows), spectra, flocks)
        if leads is not None:
            return explained_by_leads(leads, flocks)
    return explained_by_flocks(*flock_search(rows, spectra, flocks, most), float(np.median(spectra.memory)))


def at_once(
    samples: Samples, history: OwnHistory, evidence: PairEvidence, most: int | None
) -> tuple[Explanation | None, Explanation | None]:
    """What pairwise evidence leads to: a shared strategy, or else a law for each pair, that leaves hardly anybody over.

    Of smooth flights few moments are independent: there pairs alone say too little.

    Returns:
        The explanation, and one of a shared strategy that nearly holds and leaves some over.
    """
    mixture = climbed(samples, history, evidence, most)
    held = None
    if mixture is not None:
        if explains(samples, history, mixture):
            return explained_by_mixture(samples, history, mixture), None
        holds = samples.complete and misfit(samples, mixture.strategy, mixture.heads.leader).nearly_holds
        if holds and fly_alone(samples, history, mixture.heads.heads, mixture.heads.leader):
            held = explained_by_mixture(samples, history, mixture)
    if history.memory >= SMOOTH:
        return None, held
    pairs = explained_by_pairs(samples, history, plain_evidence(samples, history, evidence, most))
    return pairs if pairs is not None and nearly_all(pairs) else None, held


def missed_by_flocks(held: Explanation, found: Explanation) -> Explanation:
    """A strategy's explanation where flocks lead astray those whom it leaves over: their head may be among them.

    Flights that are straight in one direction are one flock, whoever leads them.
    """
    left = held.leader < 0
    left[held.heads] = False
    left_over, astray = int(left.sum()), left & (found.leader >= 0)
    if left[found.heads[found.passed]].any() or astray.sum() <= max(LEAST_VOTERS, left_over / 2):
        return found
    assert held.kind is not None
    return replace(held, kind=np.where(left, KINDS.index("missing"), held.kind))


def settles(found: Explanation) -> bool:
    """Whether nobody else need be asked: all share a strategy, or nobody is left over."""
    return bool(found.strategy["shared"]) or unled(found) == 0


def nearly_all(found: Explanation) -> bool:
    """Whether hardly anybody is left over."""
    return unled(found) <= max(LEAST_VOTERS - 1, LEFT_OUT * len(found.leader))


def in_doubt(found: Explanation) -> bool:
    """Whether flocks left many out, or found no strategy that all share and left somebody out or had a gate fail."""
    sure = found.strategy["shared"] or (unled(found) <= 0 and found.passed.all())
    return not sure or unled(found) > LEFT_OUT * len(found.leader)


def followed(found: Explanation) -> NDArray[np.int64]:
    """``(n,)`` whom each follows, -1 for heads too."""
    leader = found.leader.copy()
    leader[found.heads] = -1
    return leader


def unled(found: Explanation) -> int:
    """How many are neither heads nor follow one."""
    return int((found.leader < 0).sum()) - len(found.heads)


def by_everybody(
    samples: Samples,
    history: OwnHistory,
    pairs: PairEvidence,
    flocks: Flocks,
    starts: list[NDArray[np.int64]],
    found: Explanation,
    most: int | None,
) -> Explanation | None:
    """What everybody says together, where flocks ``found`` heads in doubt; ``None`` if that is no better.

    Where delays differ from follower to follower the earlier explain the later as well as their head does. But they fly
    at once with others who have the same delay, and these follow somebody else. And where no head of flocks passed its
    gate, it must be shown that anybody is followed.
    """
    for mixture in climb_together(samples, history, pairs, [followed(found), *starts], most):
        if leads_its_flock(mixture, flocks) or drops(samples, history, mixture, found):
            continue
        better = with_led(samples, history, pairs, mixture) if unexplained(mixture) else mixture
        answer = explained_by_mixture(samples, history, better)
        if answer is not None and (found.passed.any() or 2 * answer.passed.sum() > len(answer.heads)):
            return answer
    return None


def leads_its_flock(mixture: Mixture, flocks: Flocks) -> bool:
    """Whether a head flies at once with others, most of whom follow somebody else."""
    heads, leader = mixture.heads.heads, mixture.heads.leader
    for head in heads:
        mates = np.setdiff1d(np.flatnonzero(flocks.label == flocks.label[head]), heads)
        if len(mates) and 2 * (leader[mates] != head).sum() > len(mates):
            return True
    return False


def drops(samples: Samples, history: OwnHistory, mixture: Mixture, found: Explanation) -> bool:
    """Whether a head of flocks is dropped that does not fly as those do whom it is put among.

    Where others take the place of some, flocks were wrong about more than these.
    """
    heads, leader = mixture.heads.heads, mixture.heads.leader
    if len(np.setdiff1d(heads, found.heads)):
        return False
    for head in np.setdiff1d(found.heads[found.passed], heads):
        fellows = np.flatnonzero((leader == leader[head]) & (leader >= 0))
        if not flies_with(samples, history, int(head), fellows[fellows != head]):
            return True
    return False

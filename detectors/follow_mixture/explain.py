"""Fits one window: the methods, and the rules that decide which of them is used."""

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

_LAGS = 4  # lags of a head's past for a flock, if the window is long enough
_STEPS_A_LAG = 5
_LONG_ROWS = 60  # number of rows from which twice the lags are tried, if these explain few UAVs


def explain(
    window: Window, samples: Samples, living: NDArray[np.int64], most: int | None, rng: np.random.Generator
) -> Explanation | None:
    """Fit one window: first from pairwise evidence; if that fails, by flocks; if in doubt, by a joint fit of all UAVs.

    Args:
        window: the window.
        samples: the samples of its living UAVs.
        living: ``(n,)`` their indices in the window.
        most: the largest number of heads, or ``None``.
        rng: draws the voters of a large swarm.

    Returns:
        ``None`` if no UAV seems to follow another one.
    """
    if samples.uavs > ALL_PAIRS:
        history = own_history(samples)
        return explained_by_mixture(samples, history, sampled_search(samples, history, most, rng))
    seen = evidence_of(samples, most)
    first, held = at_once(samples, *seen, most) if samples.unit else (None, None)  # equal speeds: no observation noise
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
        # There are flocks, but most UAVs are unassigned: lags may be longer.
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
    """Fit the null model of all UAVs and the pairwise evidence beyond it."""
    history = own_history(samples)
    return history, pair_evidence(samples, history, most)


def flown(window: Window, samples: Samples, living: NDArray[np.int64], lags: int) -> Samples | None:
    """Samples of a window with filled gaps, which lower the speed: so ``unit`` is taken from ``samples``."""
    return samples_of(window, living, lags, like=samples)


def by_flocks(rows: Samples, spectra: FlightSpectra, flocks: Flocks, most: int | None) -> Explanation | None:
    """Fit heads of flocks; for smooth, noisy motion by cross-spectral phases, if these are informative."""
    if spectra.noise > PHASES_TELL and np.median(spectra.memory) >= SMOOTH:
        leads = leads_of_flocks(flights(rows), spectra, flocks)
        if leads is not None:
            return explained_by_leads(leads, flocks)
    return explained_by_flocks(*flock_search(rows, spectra, flocks, most), float(np.median(spectra.memory)))


def at_once(
    samples: Samples, history: OwnHistory, evidence: PairEvidence, most: int | None
) -> tuple[Explanation | None, Explanation | None]:
    """Fit from pairwise evidence: a shared strategy, or else one regression per pair, with few unassigned UAVs.

    Smooth motion has few independent samples; there a regression per pair is not used.

    Returns:
        The result or ``None``; and the result for a shared strategy that nearly fits but leaves UAVs unassigned.
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
    """Prefer the shared strategy if flocks assign many of its unassigned UAVs: a missed head may be among them.

    UAVs that fly straight in one direction form one flock, whichever heads they follow.
    """
    left = held.leader < 0
    left[held.heads] = False
    left_over, astray = int(left.sum()), left & (found.leader >= 0)
    if left[found.heads[found.passed]].any() or astray.sum() <= max(LEAST_VOTERS, left_over / 2):
        return found
    assert held.kind is not None
    return replace(held, kind=np.where(left, KINDS.index("missing"), held.kind))


def settles(found: Explanation) -> bool:
    """Whether no further method is needed: all followers share a strategy, or no UAV is unassigned."""
    return bool(found.strategy["shared"]) or unled(found) == 0


def nearly_all(found: Explanation) -> bool:
    """Whether very few UAVs are unassigned."""
    return unled(found) <= max(LEAST_VOTERS - 1, LEFT_OUT * len(found.leader))


def in_doubt(found: Explanation) -> bool:
    """Whether many UAVs are unassigned, or no strategy is shared and a UAV is unassigned or a head failed its test."""
    sure = found.strategy["shared"] or (unled(found) <= 0 and found.passed.all())
    return not sure or unled(found) > LEFT_OUT * len(found.leader)


def followed(found: Explanation) -> NDArray[np.int64]:
    """``(n,)``: the head of each UAV, -1 for none and for heads."""
    leader = found.leader.copy()
    leader[found.heads] = -1
    return leader


def unled(found: Explanation) -> int:
    """Number of unassigned UAVs: neither heads nor followers."""
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
    """Fit all UAVs jointly if the heads ``found`` by flocks are in doubt; ``None`` if that is no better.

    If followers have different delays, an early follower predicts a later one as well as their head does. But an early
    follower moves simultaneously with others of the same delay, which follow another UAV; so such a head is refused. If
    no head of flocks passed its test, more than half of the new heads must pass.
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
    """Whether a head is in one flock with other UAVs, most of which follow another head."""
    heads, leader = mixture.heads.heads, mixture.heads.leader
    for head in heads:
        mates = np.setdiff1d(np.flatnonzero(flocks.label == flocks.label[head]), heads)
        if len(mates) and 2 * (leader[mates] != head).sum() > len(mates):
            return True
    return False


def drops(samples: Samples, history: OwnHistory, mixture: Mixture, found: Explanation) -> bool:
    """True if a head found by flocks was demoted although its motion does not match its new cluster.

    If the mixture has a head that flocks did not find, the whole flock fit is suspect and the result is False.
    """
    heads, leader = mixture.heads.heads, mixture.heads.leader
    if len(np.setdiff1d(heads, found.heads)):
        return False
    for head in np.setdiff1d(found.heads[found.passed], heads):
        fellows = np.flatnonzero((leader == leader[head]) & (leader >= 0))
        if not flies_with(samples, history, int(head), fellows[fellows != head]):
            return True
    return False

"""The follow-mixture detector: every follower obeys one strategy with respect to one of M heads; find all of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
from detectors.follow_mixture.calibration import calibrated
from detectors.follow_mixture.explanation import Explanation
from detectors.follow_mixture.facility import LEAST_VOTERS
from detectors.follow_mixture.flock_evidence import explained_by_flocks
from detectors.follow_mixture.flock_heads import watch_flocks
from detectors.follow_mixture.flock_leads import PHASES_TELL, explained_by_leads, leads_of_flocks
from detectors.follow_mixture.flock_search import first_guesses, flights, flock_search, seen_spectra
from detectors.follow_mixture.flocks import flocks_of
from detectors.follow_mixture.history import own_history
from detectors.follow_mixture.mixture_evidence import explained_by_mixture
from detectors.follow_mixture.noise import SMOOTH, FlightSpectra
from detectors.follow_mixture.policy import Policy, choose
from detectors.follow_mixture.samples import Samples, filled, samples_of
from detectors.follow_mixture.scale import ALL_PAIRS, sampled_search
from detectors.follow_mixture.search import LEFT_OUT, climb_together, quick, unexplained
from usnet_env.config import InvalidArgument
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["FollowMixture"]

Floats = NDArray[np.float64]

_LAGS = 4  # of a head's past for a flock, where the window can feed them
_STEPS_A_LAG = 5
_LONG_ROWS = 60  # from which on twice the lags are looked at where these explain few


class _Arguments(Policy):
    clusters: Annotated[int, Field(ge=1)] | None = None
    memory: Annotated[int, Field(ge=1, le=64)] = 4


class FollowMixture(Detector):
    """All heads of an unknown swarm at once: a mixture over heads with one follow strategy that all followers share.

    Pairwise evidence gives a first assignment; then the shared strategy, the heads, their number and who follows whom
    are fitted to each other, in classes of strategies of growing power; a time-shift surrogate gates every head; the
    probabilities that remain are played by the expected cost of the objective. See the page on the method.

    Args:
        clusters: an upper bound on the number of heads, or ``None``; the number is found from the data.
        memory: how many past velocities of a head may matter, at least 1.
        policy: ``"cost"``: the candidates that cost least, at least one; ``"map"``: those more likely heads than not,
            perhaps nobody.
        objective: ``"P2"`` or ``"P1"``.
        shot_budget: the most candidates of a round, or ``None``.
        redundancy_price: of a redundant candidate.
        round_price: what one more round of P2 costs; ``None``: 1 where the swarm is explained, N / 4 where
            nobody seems to follow anybody and heads could only be guessed.

    Raises:
        InvalidArgument: from :meth:`reset` and :meth:`detect`, if an argument is refused.
    """

    def __init__(
        self,
        clusters: int | None = None,
        memory: int = 4,
        policy: Literal["cost", "map"] = "cost",
        objective: Literal["P1", "P2"] = "P2",
        shot_budget: int | None = None,
        redundancy_price: float = 1.0,
        round_price: float | None = None,
    ) -> None:
        self.clusters = clusters
        self.memory = memory
        self.policy = policy
        self.objective = objective
        self.shot_budget = shot_budget
        self.redundancy_price = redundancy_price
        self.round_price = round_price

    def _arguments(self) -> _Arguments:
        return _Arguments(**self.get_params())

    def reset(self, seed: int | None = None) -> None:
        """Start an episode; the generator serves to break ties only.

        Raises:
            InvalidArgument: an argument of the constructor is refused.
        """
        self._arguments()
        super().reset(seed)

    def detect(self, window: Window) -> Detection:
        """Explain one window.

        Returns:
            Candidates by the policy, scores (log-odds of being a head), clusters and leader; in ``extras``:
            ``probability`` ``(N,)``, ``strategy`` (class, lag profile, spread of the noise), ``explained`` ``(N,)``
            (share of each UAV's surprise that its head explains), ``gain`` ``(N,)`` in nats, ``heads`` (indices) and
            ``gate`` (one sentence each), ``nats`` (what the whole explanation gains, after prices).

        Raises:
            InvalidArgument: an argument of the constructor is refused, or ``clusters`` exceeds the window's N.
        """
        arguments = self._arguments()
        if arguments.clusters is not None and arguments.clusters > window.uavs:
            raise InvalidArgument(
                f"clusters must be at most the number of UAVs in the window ({window.uavs}), got {arguments.clusters}."
            )
        rng = getattr(self, "rng", None) or np.random.default_rng()
        living = np.flatnonzero(window.alive)
        most = 1 if arguments.objective == "P1" else arguments.clusters
        samples = samples_of(window, living, arguments.memory)
        probability = np.zeros(window.uavs)
        scores = np.zeros(window.uavs)
        leader = np.full(window.uavs, -1, np.int64)
        clusters = np.full(window.uavs, -1, np.int64)
        gain, share = np.zeros(window.uavs), np.zeros(window.uavs)
        extras: dict[str, Any] = {"strategy": None, "heads": np.empty(0, np.int64), "gate": [], "nats": 0.0}
        probability[living] = 1.0 / (len(living) + 1.0)  # as long as nobody seems to follow anybody
        given, doubt = probability.copy(), 0.0
        if samples is not None:
            found = explain(window, samples, living, most, rng)
            if found is not None:
                probability[living], given[living], doubt = calibrated(found)
                leader[living] = np.where(found.leader >= 0, living[found.leader], -1)
                heads = living[found.heads]
                leader[heads] = heads
                for label, head in enumerate(heads):
                    clusters[leader == head] = label
                gain[living], share[living] = found.gain, found.explained
                extras |= {
                    "strategy": found.strategy,
                    "heads": heads,
                    "gate": found.reasons,
                    "nats": found.value,
                }
        odds = np.clip(probability[living], 1e-12, 1 - 1e-12)
        scores[living] = np.log(odds) - np.log1p(-odds)
        if samples is not None:
            scores[window.alive] -= scores[window.alive].min()
        extras["probability"] = probability
        extras["gain"] = gain
        extras["explained"] = share
        if arguments.policy == "map":
            given, doubt = probability, 0.0
        candidates = choose(given, window.alive, arguments, rng.random(window.uavs), doubt)
        return Detection(candidates=candidates, scores=scores, clusters=clusters, leader=leader, extras=extras)


def explain(
    window: Window, samples: Samples, living: NDArray[np.int64], most: int | None, rng: np.random.Generator
) -> Explanation | None:
    """Who leads whom: at once where pairwise evidence shows it, else by flocks."""
    if samples.uavs > ALL_PAIRS:
        history = own_history(samples)
        return explained_by_mixture(samples, history, sampled_search(samples, history, most, rng))
    if samples.unit:  # seen without noise
        found = at_once(samples, most)
        if found is not None:
            return found
    complete = filled(window)
    lags = int(np.clip(window.observation_steps // _STEPS_A_LAG, 1, _LAGS))
    rows = flown(complete, samples, living, lags)
    if rows is None:
        return None
    spectra = seen_spectra(rows)
    if spectra.noise == 0 and not samples.unit:
        found = at_once(samples, most)
        if found is not None:
            return found
    found = by_flocks(rows, spectra, most)
    if found is not None and 2 * (found.leader >= 0).sum() < samples.uavs:
        # There are flocks, and most of them follow nobody: followers may be late.
        longer = flown(complete, samples, living, 2 * lags) if rows.rows >= _LONG_ROWS else None
        late = None if longer is None else by_flocks(longer, spectra, most)
        if late is not None and late.value > found.value:
            found = late
    if found is not None and len(found.heads) and samples.complete and in_doubt(found):
        return by_everybody(samples, rows, spectra, found, most) or found
    return found


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


def at_once(samples: Samples, most: int | None) -> Explanation | None:
    """What the quick way says, if it explains the swarm."""
    history = own_history(samples)
    found = quick(samples, history, most)
    return None if found is None else explained_by_mixture(samples, history, *found)


def in_doubt(found: Explanation) -> bool:
    """Whether flocks found no strategy that all share, or left many out."""
    left = int((found.leader < 0).sum()) - len(found.heads)
    return not found.strategy["shared"] or left > LEFT_OUT * len(found.leader)


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

"""The follow-mixture detector: every follower obeys one strategy with respect to one of M heads; find all of it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
from detectors.follow_mixture.fellows import FELLOW, heads_of_fellows, present_to_past
from detectors.follow_mixture.gate import gate_heads
from detectors.follow_mixture.history import OwnHistory, own_history
from detectors.follow_mixture.mixture import Mixture
from detectors.follow_mixture.noise import noisy_problem
from detectors.follow_mixture.policy import Policy, choose
from detectors.follow_mixture.probability import head_probability
from detectors.follow_mixture.samples import Samples, samples_of
from detectors.follow_mixture.scale import ALL_PAIRS, sampled_search
from detectors.follow_mixture.search import MISFIT, misfit, search
from detectors.follow_mixture.strategy import directions
from usnet_env.config import InvalidArgument
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["FollowMixture"]

Floats = NDArray[np.float64]

_NOISE_ROWS = 12  # fewer can't tell noise from flight


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
        probability[living] = head_probability(None, None, len(living))
        if samples is not None:
            samples, history, mixture = explain(samples, most, rng)
            if mixture is not None:
                gate = gate_heads(samples, history, mixture)
                probability[living] = head_probability(
                    mixture, gate, len(living), misfit(samples, mixture.strategy, mixture.heads.leader).worst <= MISFIT
                )
                leader[living] = np.where(mixture.heads.leader >= 0, living[mixture.heads.leader], -1)
                heads = living[mixture.heads.heads]
                leader[heads] = heads
                for label, head in enumerate(heads):
                    clusters[leader == head] = label
                place = np.searchsorted(mixture.columns, np.maximum(mixture.heads.leader, 0))
                place = np.minimum(place, len(mixture.columns) - 1)
                follows = mixture.heads.leader >= 0
                gain[living] = np.where(follows, mixture.gain[np.arange(len(living)), place], 0.0)
                share[living] = _explained(samples, history, mixture)
                extras |= {
                    "strategy": _described(mixture, samples),
                    "heads": heads,
                    "gate": gate.reasons(),
                    "nats": mixture.value,
                }
        odds = np.clip(probability[living], 1e-12, 1 - 1e-12)
        scores[living] = np.log(odds) - np.log1p(-odds)
        if samples is not None:
            scores[window.alive] -= scores[window.alive].min()
        extras["probability"] = probability
        extras["gain"] = gain
        extras["explained"] = share
        candidates = choose(probability, window.alive, arguments, rng.random(window.uavs))
        return Detection(candidates=candidates, scores=scores, clusters=clusters, leader=leader, extras=extras)


def explain(samples: Samples, most: int | None, rng: np.random.Generator) -> tuple[Samples, OwnHistory, Mixture | None]:
    """The likelier of two explanations: of the velocities as they were seen, and of flights behind an observer's noise.

    An explanation whose heads are fellow followers gives way to one whose heads are not.
    """
    history = own_history(samples)
    if samples.uavs > ALL_PAIRS:
        return samples, history, sampled_search(samples, history, most, rng)
    plain = search(samples, history, most)
    if samples.unit or not samples.complete or samples.rows < _NOISE_ROWS:
        return samples, history, plain
    velocity = np.concatenate([samples.lagged[:, 0, ::-1], samples.target], axis=1)
    noisy = noisy_problem(samples, velocity)
    if noisy is None:
        return samples, history, plain
    behind, null, jacobian = noisy
    ways = ((samples, history, plain, 0.0), (behind, null, search(behind, null, most), jacobian))
    choices = []
    for rows, law, found, omitted in ways:
        honest = found is None or present_to_past(rows, found) <= FELLOW
        if found is not None and not honest:
            instead = heads_of_fellows(rows, law, found, most)
            if instead is not None and instead.value > 0 and present_to_past(rows, instead) <= FELLOW:
                found, honest = instead, True
        worth = float(law.log_likelihood.sum()) + omitted + (found.value if found is not None else 0.0)
        choices.append((honest and found is not None, honest, worth, (rows, law, found)))
    return max(choices, key=lambda choice: choice[:3])[3]


def _explained(samples: Samples, history: OwnHistory, mixture: Mixture) -> Floats:
    """``(n,)`` share of each follower's surprise that its head explains; 0 for all others."""
    share = np.zeros(samples.uavs)
    followers = np.flatnonzero(mixture.heads.leader >= 0)
    predicted, valid = directions(samples, mixture.strategy, followers, mixture.heads.leader[followers])
    if samples.unit:
        predicted = predicted / np.maximum(np.sqrt((predicted**2).sum(axis=2, keepdims=True)), 1e-12)
    keep = (valid & samples.seen[followers])[..., None]
    left = ((samples.target[followers] - predicted) ** 2 * keep).sum(axis=(1, 2))
    whole = (history.surprise[followers] ** 2 * keep).sum(axis=(1, 2))
    share[followers] = np.clip(1.0 - left / np.maximum(whole, 1e-12), 0.0, 1.0)
    return share


def _lag_profile(mixture: Mixture) -> Floats:
    """``(L,)`` share of each lag in the squared weights of the head's velocities and their functions."""
    library = mixture.strategy.library
    groups = int(library.linear) + int(library.squares) + int(library.products)
    weights = mixture.strategy.coefficients[-1 - 3 * library.lags * groups : -1]
    power = (weights**2).reshape(groups, library.lags, 9).sum(axis=(0, 2))
    return np.asarray(power / max(float(power.sum()), 1e-12))


def _described(mixture: Mixture, samples: Samples) -> dict[str, Any]:
    """The strategy found, for people."""
    strategy = mixture.strategy
    library = strategy.library
    return {
        "lag_profile": _lag_profile(mixture),
        "class": library.name,
        "coefficients": strategy.coefficients,
        "spread": strategy.noise.spread,
        "floor": strategy.noise.floor,
        "parameters": strategy.parameters,
        "unit_speed": samples.unit,
    }

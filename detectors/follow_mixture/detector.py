"""The follow-mixture detector: every follower obeys one strategy with respect to one of M heads; find all of it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
from detectors.follow_mixture.calibration import calibrated
from detectors.follow_mixture.explain import explain
from detectors.follow_mixture.policy import Policy, choose
from detectors.follow_mixture.samples import samples_of
from usnet_env.config import ArgumentError
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["FollowMixture"]

Floats = NDArray[np.float64]


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
        ArgumentError: from :meth:`reset` and :meth:`detect`, if an argument is refused.
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
            ArgumentError: an argument of the constructor is refused.
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
            ArgumentError: an argument of the constructor is refused, or ``clusters`` exceeds the window's N.
        """
        arguments = self._arguments()
        if arguments.clusters is not None and arguments.clusters > window.uavs:
            raise ArgumentError(
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

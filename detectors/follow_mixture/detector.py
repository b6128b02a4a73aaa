"""The follow-mixture detector: all followers use one strategy, each with one of M heads; it estimates all of this."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
from detectors.follow_mixture.calibration import calibrated
from detectors.follow_mixture.explain import explain
from detectors.follow_mixture.samples import samples_of
from detectors.policy import Policy, choose
from usnet_env.config import ArgumentError
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["FollowMixture"]

Floats = NDArray[np.float64]


class _Arguments(Policy):
    clusters: Annotated[int, Field(ge=1, le=100_000)] | None = None
    memory: Annotated[int, Field(ge=1, le=64)] = 4


class FollowMixture(Detector):
    """Finds all heads by a mixture model over heads with one follow strategy that all followers share.

    Pairwise evidence gives a first assignment. Then the shared strategy, the heads, their number and the assignment are
    fitted alternately, in increasingly rich classes of strategies. A test against time-shift surrogates is applied to
    each head. The result is a probability of each UAV of being a head, from which the policy chooses the candidates.
    docs/follow_mixture.md describes the method.

    Args:
        clusters: an upper bound on the number of heads, or ``None``; the number is estimated.
        memory: the number of past velocities of a head that the strategy may use, at least 1.
        policy: how candidates are chosen from the probabilities.

            * ``"cost"`` (default) minimises the expected J_m (J_s for ``objective="P1"``). A missed head costs another
              round and a redundant candidate only 1/N of a round; so it also names doubtful UAVs. Where the detector
              believes that no UAV follows, it therefore names all UAVs. It names at least one UAV.
            * ``"map"`` names only probable heads: the UAVs with a probability of being a head above 1/2. It may name
              no UAV.
        objective: ``"P2"`` (destroy all heads in few rounds) or ``"P1"`` (name the single head in one round).
        shot_budget: the largest number of candidates per round, or ``None``.
        redundancy_price: the cost of a redundant candidate, in units of the objective (1/N of a round in P2).
        round_price: the cost of one more round of P2. ``None``: 1 if the fit explains the swarm, and N / 4 if no UAV
            seems to follow another one, so that heads could only be guessed.

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
        """Start an episode; the generator breaks ties and draws samples of large swarms.

        Raises:
            ArgumentError: an argument of the constructor is refused.
        """
        self._arguments()
        super().reset(seed)

    def detect(self, window: Window) -> Detection:
        """Name the heads of one window.

        Returns:
            Candidates by the policy, scores (log-odds of being a head), clusters and leader; in ``extras``:
            ``probability`` ``(N,)``; ``strategy`` (class, lag profile, noise); ``explained`` ``(N,)``, the share of
            each UAV's innovation that its head explains; ``gain`` ``(N,)``, the log-likelihood gained by its head, in
            nats; ``heads`` (indices) and ``gate`` (one sentence per head); ``nats``, the penalised log-likelihood gain
            of the whole fit.

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
        probability[living] = 1.0 / (len(living) + 1.0)  # if no UAV seems to follow another one
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

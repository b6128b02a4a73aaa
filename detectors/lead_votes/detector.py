"""Cluster a swarm by votes for leads, find a head in each cluster, and test each against the whole swarm."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
from detectors.clustering import Clustering, make_clusterer
from detectors.neural_granger import NeuralGranger
from detectors.neural_granger.inputs import samples_of
from detectors.neural_granger.per_candidate import PerCandidate
from detectors.neural_granger.shared_network import Following, follow_by_shared_network
from usnet_env.config import ArgumentError, Config, quote
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["LeadVotes"]

_LEAST_UAVS = 3  # of a cluster in which a head can be found
_BATCH_UAVS = 256  # UAVs whose clusters train side by side
_ALL_SOURCES = 256  # up to so many UAVs, each may be chosen as leader; above, the candidates


class _Arguments(Config):
    """The plain arguments, checked."""

    clusterer: str | Any
    features: str | Any
    count: Annotated[int, Field(ge=1)] | str | None
    gate: bool
    followers: Annotated[int, Field(ge=1)]
    gate_threshold: float
    passes: Annotated[int, Field(ge=1, le=100)]
    gate_steps: Annotated[int, Field(ge=1, le=100_000)]
    memory: Annotated[int, Field(ge=1, le=1000)]


class LeadVotes(Detector):
    """Clusters by votes for leads, neural Granger causality in each cluster, and a gate over the whole swarm (P2).

    A round: each UAV votes for the UAV whose past predicts it best, which gives the clusters and their number M̂; in
    each cluster :class:`detectors.neural_granger.NeuralGranger` finds a head; the gate keeps those candidates that a
    network shared by all UAVs finds followed. The order of the stages is that of the paper's Algorithm 2
    (:class:`detectors.mc_gassl.McGassl`), the stages are not: there is no GRU network and no metric learning, and the
    candidates are tested before they are destroyed.

    Edge cases: all UAVs of a cluster of one or two are candidates for the gate; without the gate one of them is named
    at random. If no candidate passes the gate, the one with the most followers is named, as in the game a head is
    always left. With fewer than three living UAVs, one is named at random; with none, the answer is empty.

    Args:
        clusterer: a name of :func:`detectors.clustering.clusterers`, or an object with ``cluster(window, rng)``.
        features: what is clustered, see :class:`detectors.clustering.Clusterer`.
        count: M̂: a whole number, or a rule's name, see :class:`detectors.clustering.Clusterer`; ``None``: as the
            clusterer finds it (``"lead-votes"`` and ``"hdbscan"``), ``"eigengap"`` for the others.
        head_detector: the detector that looks at one cluster, with ``reset`` and ``detect_batch``; ``None``:
            :class:`detectors.neural_granger.NeuralGranger`.
        gate: whether candidates are tested against the whole swarm.
        followers: how many UAVs must be predicted best from a candidate for the gate to keep it.
        gate_threshold: by how much at least, over their own past, as the logarithm of the errors' ratio on times that
            were not trained on.
        passes, gate_steps: trainings of the shared network and steps of each, see
            :func:`detectors.neural_granger.shared_network.follow_by_shared_network`.
        memory: T_0.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`: an argument is refused, or a window with clusters to
            look at has no more than T_0 velocities.
    """

    def __init__(
        self,
        clusterer: Any = "lead-votes",
        features: Any = "velocities",
        count: int | str | None = None,
        head_detector: Any = None,
        gate: bool = True,
        followers: int = 2,
        gate_threshold: float = 0.25,
        passes: int = 2,
        gate_steps: int = 200,
        memory: int = 4,
    ) -> None:
        self.clusterer = clusterer
        self.features = features
        self.count = count
        self.head_detector = head_detector
        self.gate = gate
        self.followers = followers
        self.gate_threshold = gate_threshold
        self.passes = passes
        self.gate_steps = gate_steps
        self.memory = memory

    def _make_clusterer(self) -> Any:
        """The clusterer; checks every argument."""
        plain = _Arguments(**{name: getattr(self, name) for name in _Arguments.model_fields})
        if self.head_detector is not None and not callable(getattr(self.head_detector, "detect_batch", None)):
            raise ArgumentError(
                f"head_detector must have reset(seed) and detect_batch(windows), got {quote(self.head_detector)}."
            )
        if not isinstance(plain.clusterer, str):
            if not callable(getattr(plain.clusterer, "cluster", None)):
                raise ArgumentError(
                    f"clusterer must be a name or have cluster(window, rng), got {quote(plain.clusterer)}."
                )
            return plain.clusterer
        own = plain.clusterer in ("lead-votes", "hdbscan")
        count = plain.count if plain.count is not None else ("own" if own else "eigengap")
        return make_clusterer(plain.clusterer, features=plain.features, count=count, memory=plain.memory)

    def reset(self, seed: int | None = None) -> None:
        """Start an episode.

        Raises:
            ArgumentError: an argument of the constructor is refused.
        """
        self._make_clusterer()
        super().reset(seed)
        self._heads = self.head_detector or NeuralGranger(memory=self.memory)
        self._heads.reset(int(self.rng.integers(2**31)))

    def detect(self, window: Window) -> Detection:
        """Answer one round.

        Returns:
            Candidates; scores: with the gate the number of UAVs that are predicted best from each UAV plus the head
            detector's score as a fraction below 1, else that score; clusters; leader; attention within the clusters;
            in ``extras``: ``count`` (M̂), ``proposed`` (the candidates before the gate, ``(N,)`` bool), and ``followed``
            ``(N,)``, how many UAVs are predicted best from each.
        """
        clusterer = self._make_clusterer()
        if not hasattr(self, "_heads"):
            self.reset()
        living = np.flatnonzero(window.alive)
        followed = np.zeros(window.uavs)
        if len(living) < _LEAST_UAVS:
            candidates = np.zeros(window.uavs, bool)
            candidates[self.rng.permutation(living)[:1]] = True
            few = {"count": min(1, len(living)), "proposed": candidates, "followed": followed}
            return Detection(candidates, followed, np.where(window.alive, 0, -1), extras=few)
        clustering = clusterer.cluster(window, self.rng)
        proposed, score, leader, attention = self._propose_heads(window, clustering)
        candidates = proposed
        if self.gate:
            following = self._follow(window, clustering, proposed, score, living)
            followed[living] = following.count_followers(self.gate_threshold).double().numpy()
            leader = np.full(window.uavs, -1, np.int64)
            leader[living] = living[following.leader.numpy()]
            score = followed + score / (1.0 + score.sum())
            candidates = self._keep_followed(proposed, followed, score, window.alive)
        extras = {"count": clustering.count, "proposed": proposed, "followed": followed}
        return Detection(candidates, score, clustering.labels, leader, attention, extras)

    def _propose_heads(
        self, window: Window, clustering: Clustering
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
        """The head detector in every cluster: candidates, scores, choices ``(N,)`` and attention ``(N, N)``."""
        uavs = window.uavs
        proposed, score = np.zeros(uavs, bool), np.zeros(uavs)
        leader, attention = np.full(uavs, -1, np.int64), np.zeros((uavs, uavs))
        clusters = [clustering.labels == label for label in range(clustering.count)]
        evident = [
            members.sum() >= _LEAST_UAVS and bool(window.velocity_seen[:, members].any()) for members in clusters
        ]
        for members, enough in zip(clusters, evident, strict=True):
            if not enough:
                proposed |= members if self.gate else self._draw_one(members)
        large = sorted((members for members, enough in zip(clusters, evident, strict=True) if enough), key=np.sum)
        while large:
            size = max(1, _BATCH_UAVS // int(large[0].sum()))
            part, large = large[:size], large[size:]
            windows = [
                Window(window.position, window.velocity, window.seen, window.alive & members, window.round)
                for members in part
            ]
            for members, found in zip(part, self._heads.detect_batch(windows), strict=True):
                proposed |= found.candidates & members
                score[members] = found.scores[members]
                if found.leader is not None:
                    leader[members] = found.leader[members]
                if found.attention is not None:
                    attention[np.ix_(members, members)] = found.attention[np.ix_(members, members)]
        return proposed, score, leader, attention

    def _draw_one(self, members: NDArray[np.bool_]) -> NDArray[np.bool_]:
        chosen = np.zeros(len(members), bool)
        chosen[self.rng.choice(np.flatnonzero(members))] = True
        return chosen

    def _follow(
        self,
        window: Window,
        clustering: Clustering,
        proposed: NDArray[np.bool_],
        score: NDArray[np.float64],
        living: NDArray[np.intp],
    ) -> Following:
        """The shared network over the whole swarm: the UAV from which each living UAV is predicted best."""
        samples = samples_of([window], [living], self.memory, torch.device("cpu"))
        labels, named = clustering.labels[living], np.flatnonzero(proposed[living])
        head = np.arange(len(living))
        for label in range(clustering.count):
            heads = named[labels[named] == label]
            if len(heads) and (labels == label).sum() >= _LEAST_UAVS:
                members = labels == label
                members[named] = False
                head[members] = heads[score[living][heads].argmax()]
        every_source = len(living) <= _ALL_SOURCES or len(named) < 2
        sources = np.arange(len(living)) if every_source else named
        return follow_by_shared_network(
            samples,
            torch.from_numpy(head),
            torch.from_numpy(sources),
            PerCandidate(steps=self.gate_steps),
            torch.Generator().manual_seed(int(self.rng.integers(2**63))),
            self.passes,
        )

    def _keep_followed(
        self,
        proposed: NDArray[np.bool_],
        followed: NDArray[np.float64],
        score: NDArray[np.float64],
        alive: NDArray[np.bool_],
    ) -> NDArray[np.bool_]:
        """The candidates that enough UAVs follow; the best one if there are none."""
        passed = proposed & (followed >= self.followers)
        if passed.any():
            return passed
        order = self.rng.permutation(np.flatnonzero(proposed if proposed.any() else alive))
        best = np.zeros_like(proposed)
        best[order[score[order].argmax()]] = True
        return best

"""The detector ``lead-votes``: clusters by votes, a head in each cluster, and a test of each head."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
from detectors.clustering import Clustering, check_clusterer, make_clusterer
from detectors.neural_granger import NeuralGranger
from detectors.neural_granger.inputs import build_samples
from detectors.neural_granger.per_candidate import PerCandidate
from detectors.neural_granger.shared_network import Following, follow_by_shared_network
from detectors.parameters import Count, Lags
from detectors.series.designs import check_pairs
from detectors.series.votes import LEAST_UAVS, name_at_random, shows_evidence, spread
from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.config import ArgumentError, quote
from usnet_env.detection import Detection, Tags
from usnet_env.window import Window

_BATCH_UAVS = 256  # UAVs of the clusters that are trained side by side
_ALL_SOURCES = 256  # up to this number of UAVs, each can be a leader; in larger swarms, only the candidates can


class LeadVotes(Detector):
    """Clusters by votes, neural Granger causality in each cluster, and a gate over the whole swarm (P2).

    In each round

    1. each UAV votes for the UAV whose past predicts it best; the votes give the clusters and their number M̂;
    2. :class:`detectors.neural_granger.NeuralGranger` proposes a head in each cluster;
    3. the gate keeps the proposed heads that have followers: a network shared by the whole swarm finds each UAV's
       leader.

    The order of the stages is that of the paper's Algorithm 2 (:class:`detectors.mc_gassl.McGassl`), but the stages are
    different: there is no GRU network and no metric learning, and the candidates are tested before they are destroyed.

    Edge cases: in a cluster of one or two UAVs, or of which no velocity was seen, all UAVs are proposed to the gate;
    without the gate, one of them is named at random. If no proposed UAV passes the gate, the one with the highest score
    is named, because at least one head is alive until the game ends. With fewer than three living UAVs, one is named at
    random; with none, the answer is empty.

    Args:
        clusterer: a name of :func:`detectors.clustering.clusterers`, or an object with ``cluster(window, rng)``.
        features: of the UAVs, see :class:`detectors.clustering.Clusterer`.
        count: M̂: a whole number, or the name of a rule, see :class:`detectors.clustering.Clusterer`; ``None``: the
            number that the clusterer finds (``"lead-votes"`` and ``"hdbscan"``), ``"eigengap"`` for the others.
        head_detector: the detector for one cluster, with ``reset(seed)`` and ``detect_batch(windows)``; ``None``:
            :class:`detectors.neural_granger.NeuralGranger`.
        gate: whether the proposed heads are tested on the whole swarm.
        followers: the number of followers that a UAV needs to pass the gate.
        gate_threshold: the gain that a UAV needs to count as a follower of its leader: the logarithm of the null
            model's error divided by the network's error, on times that were not trained on.
        passes, gate_steps: the number of trainings of the shared network and the steps of each, see
            :func:`detectors.neural_granger.shared_network.follow_by_shared_network`.
        memory: T_0.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`: an argument is invalid, or a window has no more than T_0
            velocities or more than 10,000 UAVs.
    """

    tags = Tags(needs=("torch",), most_uavs=10_000, least_steps=5, takes_clusters=True, needs_unit_speed=True)
    _made_by_reset = "_heads"

    clusterer: Any = "lead-votes"
    features: Any = "velocities"
    count: Count | str | None = None
    head_detector: Any = None
    gate: bool = True
    followers: Count = 2
    gate_threshold: float = 0.25
    passes: Annotated[int, Field(ge=1, le=100)] = 2
    gate_steps: Count = 200
    memory: Lags = 4

    def check_arguments(self) -> Any:
        """Check all arguments and return the clusterer."""
        plain = super().check_arguments()
        if self.head_detector is not None and not callable(getattr(self.head_detector, "detect_batch", None)):
            raise ArgumentError(
                f"head_detector must have reset(seed) and detect_batch(windows), got {quote(self.head_detector)}."
            )
        check_clusterer(plain.clusterer)
        if not isinstance(plain.clusterer, str):
            return plain.clusterer
        own = plain.clusterer in ("lead-votes", "hdbscan")
        count = plain.count if plain.count is not None else ("own" if own else "eigengap")
        return make_clusterer(plain.clusterer, features=plain.features, count=count, memory=plain.memory)

    @cached_property
    def _heads(self) -> Any:
        """The detector for one cluster in this episode."""
        heads = self.head_detector or NeuralGranger(memory=self.memory)
        heads.reset(int(self.rng.integers(2**31)))
        return heads

    def detect(self, window: Window) -> Detection:
        """Answer one round.

        Returns:
            Candidates; scores: with the gate, the number of followers of each UAV plus the head detector's score,
            scaled to a fraction below 1; without the gate, the head detector's score; clusters; leader; attention
            within the clusters; in ``extras``: ``count`` (M̂), ``proposed`` ``(N,)`` bool, the candidates before the
            gate, ``followed`` ``(N,)``, the number of followers of each UAV (0 without the gate), and ``features``,
            those that were clustered, or ``None``.
        """
        clusterer = self.check_arguments()
        check_pairs(window.uavs)
        living = np.flatnonzero(window.alive)
        followed = np.zeros(window.uavs)
        if not shows_evidence(window, living):  # decision (x)
            candidates = name_at_random(living, 1, window.uavs, self.rng)
            few = {"count": min(1, len(living)), "proposed": candidates, "followed": followed}
            return Detection(candidates, followed, np.where(window.alive, 0, -1), extras=few)
        clustering = clusterer.cluster(window, self.rng)
        proposed, score, leader, attention = self._propose_heads(window, clustering)
        candidates = proposed
        if self.gate:
            following = self._find_leaders(window, clustering, proposed, score, living)
            followed[living] = following.count_followers(self.gate_threshold).double().numpy()
            leader = spread(living[following.leader.numpy()], living, window.uavs, fill=-1)
            score = followed + score / (1.0 + score.sum())
            candidates = self._keep_followed(proposed, followed, score, window.alive)
        extras = {
            "count": clustering.count,
            "proposed": proposed,
            "followed": followed,
            "features": clustering.features,
        }
        return Detection(candidates, score, clustering.labels, leader, attention, extras)

    def _propose_heads(self, window: Window, clustering: Clustering) -> tuple[Mask, Floats, Indices, Floats]:
        """Apply the head detector to every cluster.

        Returns:
            Candidates ``(N,)``, scores ``(N,)``, leaders ``(N,)``, -1 without one, and attention ``(N, N)``.
        """
        uavs = window.uavs
        proposed, score = np.zeros(uavs, bool), np.zeros(uavs)
        leader, attention = np.full(uavs, -1, np.int64), np.zeros((uavs, uavs))
        large = []
        for label in range(clustering.count):
            members = clustering.labels == label
            if shows_evidence(window, np.flatnonzero(members)):
                large.append(members)
            elif self.gate:
                proposed |= members
            else:
                proposed[self.rng.choice(np.flatnonzero(members))] = True
        large.sort(key=np.sum)
        while large:
            size = max(1, _BATCH_UAVS // int(large[0].sum()))
            part, large = large[:size], large[size:]
            windows = [replace(window, alive=window.alive & members) for members in part]
            for members, found in zip(part, self._heads.detect_batch(windows), strict=True):
                proposed |= found.candidates & members
                score[members] = found.scores[members]
                if found.leader is not None:
                    leader[members] = found.leader[members]
                if found.attention is not None:
                    attention[np.ix_(members, members)] = found.attention[np.ix_(members, members)]
        return proposed, score, leader, attention

    def _find_leaders(
        self, window: Window, clustering: Clustering, proposed: Mask, score: Floats, living: NDArray[np.intp]
    ) -> Following:
        """Train the shared network on the whole swarm and find the leader of each living UAV."""
        samples = build_samples([window], [living], self.memory, torch.device("cpu"))
        labels, named = clustering.labels[living], np.flatnonzero(proposed[living])
        head = np.arange(len(living))
        for label in range(clustering.count):
            heads = named[labels[named] == label]
            if len(heads) and (labels == label).sum() >= LEAST_UAVS:
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

    def _keep_followed(self, proposed: Mask, followed: Floats, score: Floats, alive: Mask) -> Mask:
        """Keep the proposed UAVs that have enough followers; the one with the highest score if there are none."""
        passed = proposed & (followed >= self.followers)
        if passed.any():
            return passed
        order = self.rng.permutation(np.flatnonzero(proposed if proposed.any() else alive))
        best = np.zeros_like(proposed)
        best[order[score[order].argmax()]] = True
        return best

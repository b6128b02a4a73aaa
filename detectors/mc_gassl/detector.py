"""MC-GASSL, the paper's Algorithm 2: cluster the swarm, find each cluster's head with GASSL, learn from the result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
from detectors.clustering import Clustering, make_clusterer
from detectors.gassl import Gassl
from detectors.gassl.inputs import samples_of
from detectors.gassl.prediction_pooling import PredictionPooling
from detectors.gassl.shared import Following, follow_by_shared_network
from detectors.mc_gassl.features import MODES, gru_features, inputs_of
from detectors.mc_gassl.gru import GruParameters, GruSizes, draw_parameters
from detectors.mc_gassl.metric import Metric
from detectors.mc_gassl.online import OnlineTraining, train_online
from detectors.mc_gassl.weights import load_meta_weights
from usnet_env.config import ArgumentError, Config, quote, unknown_name
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["GATES", "PRESETS", "McGassl"]

GRU = "gru"  # features= that belong to this detector and not to detectors.clustering
GATES = ("ifsn", "none")
STARTS = ("meta", "random")


@dataclass(frozen=True)
class Preset:
    """The stages of Algorithm 2.

    Args:
        clusterer: a name of :func:`detectors.clustering.clusterers`.
        features: what is clustered.
        gru_mode: which times the GRU's features come from.
        count: how M̂ is found.
        head_detector: arguments of the GASSL in each cluster.
        gate: whether candidates are held against the whole swarm before they are named.
        online: whether the GRU network learns from the re-clustered swarm after each round.
        sampling: of triplets on line.
    """

    clusterer: str
    features: str
    gru_mode: str
    count: int | str
    head_detector: Mapping[str, Any]
    gate: str
    online: bool
    sampling: str


PRESETS = {
    "default": Preset("lead-votes", "velocities", "series", "own", {}, "ifsn", False, "semi-hard"),
    "paper": Preset("kmeans", GRU, "single", "gap-one-se", {"preset": "paper"}, "none", True, "hard"),
}

_LEAST_UAVS = 3  # of a cluster that GASSL can look at
_BATCH_UAVS = 256  # UAVs whose clusters are put to GASSL at once
_ALL_SOURCES = 256  # up to so many UAVs, everybody may be chosen as leader; above, the candidates


class _Arguments(Config):
    """The plain arguments, checked."""

    preset: str
    clusterer: str | Any
    features: str | Any
    gru_mode: str | None
    count: Annotated[int, Field(ge=1)] | str | None
    gate: str | None
    followers: Annotated[int, Field(ge=1)]
    gate_threshold: float
    passes: Annotated[int, Field(ge=1, le=100)]
    gate_steps: Annotated[int, Field(ge=1, le=100_000)]
    online: bool | None
    online_steps: Annotated[int, Field(ge=0, le=1_000_000)]
    online_rate: Annotated[float, Field(gt=0)]
    sampling: str | None
    start: str
    memory: Annotated[int, Field(ge=1, le=1000)]


class McGassl(Detector):
    """Multi-cluster GASSL (the paper's Algorithm 2), whose stages can be exchanged one by one.

    A round: features of all UAVs; their number of clusters M̂ and the clusters; in each cluster a head by GASSL; with a
    gate, only those candidates stay that the shared IFSN finds followed over the whole swarm; with on-line training,
    the swarm is re-clustered by the same IFSN, and the GRU network learns from that for the next round.

    What happens at the edges: a cluster of one or two holds no evidence for GASSL, so with a gate all of its UAVs are
    put to the gate, and without one of them is named at random. Where the gate lets nobody through, the candidate with
    the most followers is named: in the game a head is always left. Where fewer than three UAVs live, one is named at
    random. A round of which nobody lives gives nobody.

    Args:
        preset: ``"default"``, or ``"paper"``: K-Means on the single-window features of the meta-trained GRU network, M̂
            by the gap statistic's one-standard-error rule, GASSL as written, no gate, on-line training with hard
            sampling. The following arguments exchange single stages; ``None``: the preset's.
        clusterer: a name of :func:`detectors.clustering.clusterers`, or an object with ``cluster(window, rng)``.
        features: ``"gru"``, or what :class:`detectors.clustering.Clusterer` takes.
        gru_mode: ``"single"``, ``"mean"`` or ``"series"``, see :func:`detectors.mc_gassl.features.gru_features`.
        count: M̂: a whole number, or a rule's name, see :class:`detectors.clustering.Clusterer`.
        head_detector: the detector that looks at one cluster, with ``reset`` and ``detect_batch``; ``None``: the
            preset's :class:`detectors.gassl.Gassl`.
        gate: ``"ifsn"`` or ``"none"``.
        followers: how many UAVs must be predicted best from a candidate for the gate to let it through.
        gate_threshold: by how much at least, over their own histories, as the logarithm of the errors' ratio on times
            that were not trained on.
        passes, gate_steps: trainings of the shared IFSN and steps of each, see
            :func:`detectors.gassl.shared.follow_by_shared_network`.
        online: whether the GRU network learns between rounds; without ``features="gru"`` there is nothing to learn.
        online_steps, online_rate: gradient steps a round and beta'.
        sampling: of triplets: ``"hard"``, ``"semi-hard"`` or ``"random"``.
        start: the GRU network's parameters before round 1: ``"meta"`` (shipped, from ``usnet train meta``) or
            ``"random"``.
        memory: T_0.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`: an argument is refused, or a window with clusters to
            look at has no more than T_0 velocities.
    """

    def __init__(
        self,
        preset: str = "default",
        clusterer: Any = None,
        features: Any = None,
        gru_mode: str | None = None,
        count: int | str | None = None,
        head_detector: Any = None,
        gate: str | None = None,
        followers: int = 2,
        gate_threshold: float = 0.25,
        passes: int = 2,
        gate_steps: int = 200,
        online: bool | None = None,
        online_steps: int = 100,
        online_rate: float = 1.0,
        sampling: str | None = None,
        start: str = "meta",
        memory: int = 4,
    ) -> None:
        self.preset = preset
        self.clusterer = clusterer
        self.features = features
        self.gru_mode = gru_mode
        self.count = count
        self.head_detector = head_detector
        self.gate = gate
        self.followers = followers
        self.gate_threshold = gate_threshold
        self.passes = passes
        self.gate_steps = gate_steps
        self.online = online
        self.online_steps = online_steps
        self.online_rate = online_rate
        self.sampling = sampling
        self.start = start
        self.memory = memory

    def stages(self) -> Preset:
        """The preset with the arguments that were given in their places; checks every argument.

        Raises:
            ArgumentError: an argument is refused.
        """
        plain = _Arguments(**{name: getattr(self, name) for name in _Arguments.model_fields})
        if plain.preset not in PRESETS:
            raise unknown_name("preset", plain.preset, PRESETS)
        preset = PRESETS[plain.preset]
        names = ("clusterer", "features", "gru_mode", "count", "gate", "online", "sampling")
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        if "clusterer" in given and given["clusterer"] != preset.clusterer and "count" not in given:
            # "own" is a count of those clusterers alone that find the number as they cluster.
            given["count"] = "own" if given["clusterer"] in ("lead-votes", "hdbscan") else "eigengap"
        stages = Preset(**{**vars(preset), **given})
        if stages.gate not in GATES:
            raise unknown_name("gate", stages.gate, GATES)
        if stages.gru_mode not in MODES:
            raise unknown_name("gru_mode", stages.gru_mode, MODES)
        if plain.start not in STARTS:
            raise unknown_name("start", plain.start, STARTS)
        Metric(sampling=stages.sampling)  # type: ignore[arg-type]  # this is where it is checked
        if isinstance(stages.clusterer, str):
            make_clusterer(stages.clusterer)
        elif not callable(getattr(stages.clusterer, "cluster", None)):
            raise ArgumentError(
                f"clusterer must be a name or have cluster(window, rng), got {quote(stages.clusterer)}."
            )
        if self.head_detector is not None and not callable(getattr(self.head_detector, "detect_batch", None)):
            raise ArgumentError(
                f"head_detector must have reset(seed) and detect_batch(windows), got {quote(self.head_detector)}."
            )
        return stages

    def reset(self, seed: int | None = None) -> None:
        """Start an episode: the GRU network is what it was off line.

        Raises:
            ArgumentError: an argument of the constructor is refused.
        """
        stages = self.stages()
        super().reset(seed)
        self._heads = self.head_detector or Gassl(memory=self.memory, **stages.head_detector)
        self._heads.reset(int(self.rng.integers(2**31)))
        self._parameters: GruParameters | None = None
        if stages.features == GRU:
            self._parameters = load_meta_weights() if self.start == "meta" else self._drawn()

    def _drawn(self) -> GruParameters:
        return draw_parameters(GruSizes(), self._generator())

    def _generator(self) -> torch.Generator:
        return torch.Generator().manual_seed(int(self.rng.integers(2**63)))

    def detect(self, window: Window) -> Detection:
        """One round of Algorithm 2.

        Returns:
            Candidates; scores: with a gate or on-line training the number of UAVs that are predicted best from each UAV
            plus GASSL's c_i as a fraction below 1, else c_i; clusters; leader (i_H, or GASSL's choice within the
            cluster); attention, alpha within the clusters; in ``extras``: ``count`` (M̂), ``proposed`` (the candidates
            before the gate, ``(N,)`` bool), ``followed`` ``(N,)``, how many UAVs are predicted best from each, and
            ``online_loss``, the losses of on-line training (empty without).
        """
        stages = self.stages()
        if not hasattr(self, "_heads"):
            self.reset()
        living = np.flatnonzero(window.alive)
        if len(living) < _LEAST_UAVS:
            return self._too_few(window, living)
        clustering = self._cluster(window, stages)
        proposed, score, leader, attention = self._heads_of(window, clustering, stages.gate == "ifsn")
        followed = np.zeros(window.uavs)
        candidates = proposed
        losses: list[float] = []
        learns = stages.online and self._parameters is not None
        if stages.gate == "ifsn" or learns:
            following = self._follow(window, clustering, proposed, score, living)
            followed[living] = following.followed(self.gate_threshold).double().numpy()
            leader = np.full(window.uavs, -1, np.int64)
            leader[living] = living[following.leader.numpy()]
            score = followed + score / (1.0 + score.sum())
            if stages.gate == "ifsn":
                candidates = self._gated(proposed, followed, score, window.alive)
            if learns:
                losses = self._learn(window, stages, clustering.count, score, leader)
        extras = {"count": clustering.count, "proposed": proposed, "followed": followed, "online_loss": losses}
        return Detection(candidates, score, clustering.labels, leader, attention, extras)

    def _too_few(self, window: Window, living: NDArray[np.intp]) -> Detection:
        """Who is left is named one by one, at random."""
        candidates = np.zeros(window.uavs, bool)
        candidates[self.rng.permutation(living)[:1]] = True
        nobody = {"count": min(1, len(living)), "proposed": candidates, "followed": np.zeros(window.uavs)}
        return Detection(
            candidates, np.zeros(window.uavs), np.where(window.alive, 0, -1), extras={**nobody, "online_loss": []}
        )

    def _cluster(self, window: Window, stages: Preset) -> Clustering:
        """Features, M̂ and clusters."""
        clusterer = stages.clusterer
        if isinstance(clusterer, str):
            features: Any = stages.features
            if self._parameters is not None:
                features = partial(gru_features, parameters=self._parameters, mode=stages.gru_mode, memory=self.memory)
            clusterer = make_clusterer(clusterer, features=features, count=stages.count, memory=self.memory)
        return clusterer.cluster(window, self.rng)

    def _heads_of(
        self, window: Window, clustering: Clustering, gated: bool
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
        """GASSL in every cluster: candidates, c_i, choices ``(N,)`` and attention ``(N, N)``."""
        uavs = window.uavs
        proposed, score = np.zeros(uavs, bool), np.zeros(uavs)
        leader, attention = np.full(uavs, -1, np.int64), np.zeros((uavs, uavs))
        clusters = [clustering.labels == label for label in range(clustering.count)]
        evident = [
            members.sum() >= _LEAST_UAVS and bool(window.velocity_seen[:, members].any()) for members in clusters
        ]
        for members, tells in zip(clusters, evident, strict=True):
            if not tells:
                proposed |= members if gated else self._one_of(members)
        large = sorted((members for members, tells in zip(clusters, evident, strict=True) if tells), key=np.sum)
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

    def _one_of(self, members: NDArray[np.bool_]) -> NDArray[np.bool_]:
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
        """The shared IFSN over the whole swarm: whom every living UAV is predicted best from, see paper §IV-A-6."""
        samples = samples_of([window], [living], self.memory, torch.device("cpu"))
        labels, who = clustering.labels[living], np.flatnonzero(proposed[living])
        head = np.arange(len(living))
        for label in range(clustering.count):
            heads = who[labels[who] == label]
            if len(heads) and (labels == label).sum() >= _LEAST_UAVS:
                members = labels == label
                members[who] = False
                head[members] = heads[score[living][heads].argmax()]
        everybody = len(living) <= _ALL_SOURCES or len(who) < 2
        sources = np.arange(len(living)) if everybody else who
        return follow_by_shared_network(
            samples,
            torch.from_numpy(head),
            torch.from_numpy(sources),
            PredictionPooling(steps=self.gate_steps),
            self._generator(),
            self.passes,
        )

    def _gated(
        self,
        proposed: NDArray[np.bool_],
        followed: NDArray[np.float64],
        score: NDArray[np.float64],
        alive: NDArray[np.bool_],
    ) -> NDArray[np.bool_]:
        """The candidates that enough UAVs follow; the best one where there are none."""
        passed = proposed & (followed >= self.followers)
        if passed.any():
            return passed
        order = self.rng.permutation(np.flatnonzero(proposed if proposed.any() else alive))
        best = np.zeros_like(proposed)
        best[order[score[order].argmax()]] = True
        return best

    def _learn(
        self, window: Window, stages: Preset, count: int, score: NDArray[np.float64], leader: NDArray[np.int64]
    ) -> list[float]:
        """On-line training on the top M̂ UAVs by score and those who are predicted best from them."""
        assert self._parameters is not None
        order = self.rng.permutation(np.flatnonzero(window.alive))
        heads = order[np.argsort(-score[order], kind="stable")[:count]]
        labels = np.full(window.uavs, -1, np.int64)
        for label, one in enumerate(heads):
            labels[(leader == one) & window.alive] = label
        labels[heads] = np.arange(len(heads))
        self._parameters, losses = train_online(
            self._parameters,
            inputs_of(window, self.memory),
            torch.from_numpy(labels),
            OnlineTraining(
                steps=self.online_steps,
                rate=self.online_rate,
                metric=Metric(sampling=stages.sampling),  # type: ignore[arg-type]  # checked above
            ),
            self._generator(),
        )
        return losses

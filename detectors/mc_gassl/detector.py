"""MC-GASSL, the paper's Algorithm 2, as a detector."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property, partial
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import Field

from detectors.base import Detector
from detectors.clustering import CLUSTERERS, make_clusterer
from detectors.gassl import Gassl
from detectors.mc_gassl.algorithm_2 import run_round
from detectors.mc_gassl.gru import GruParameters, compute_gru_features, draw_parameters, load_meta_weights
from detectors.parameters import Count, Lags
from detectors.series.designs import check_steps
from detectors.series.votes import name_at_random, shows_evidence
from usnet_env.detection import Detection, Tags
from usnet_env.window import Window


class McGassl(Detector):
    """Multi-cluster GASSL, the paper's Algorithm 2 as it is printed.

    A round: the GRU network's features of all UAVs; the number of clusters M̂ by the gap statistic, and K-Means; in each
    cluster a head by GASSL (Algorithm 1), with one IFSN for all clusters; then the swarm is re-clustered by that IFSN,
    and the GRU network learns from the clusters for the next round. The arguments exchange single stages; their
    defaults are the paper's.

    Edge cases: in a cluster of one or two UAVs, or of which no velocity was seen, one UAV is named at random. With
    fewer than three living UAVs, or where no velocity of the whole swarm was seen, one is named at random; with no
    living UAV, the answer is empty.

    Args:
        clusterer: a name of :func:`detectors.clustering.clusterers`, or an object with ``cluster(window, rng)``.
        features: ``"gru"``, or what :class:`detectors.clustering.Clusterer` takes.
        count: M̂: a whole number, or a rule's name, see :class:`detectors.clustering.Clusterer`.
        gassl: arguments of :class:`detectors.gassl.Gassl` that differ from its defaults.
        online_steps, online_rate: gradient steps a round, and β' of equation (39); no steps: W stays as it is.
        start: the GRU network's parameters before round 1: ``"meta"`` (shipped, from ``usnet train meta``) or
            ``"random"``.
        memory: T_0.
    """

    tags = Tags(needs=("torch",), most_uavs=10_000, least_steps=5, takes_clusters=True, needs_unit_speed=True)
    _made_by_reset = "_parameters"

    clusterer: Any = "kmeans"
    features: Any = "gru"
    count: Count | str = "gap"
    gassl: Mapping[str, Any] | None = None
    online_steps: Annotated[int, Field(ge=0, le=1_000_000)] = 1
    online_rate: Annotated[float, Field(gt=0)] = 1.0
    start: Literal["meta", "random"] = "meta"
    memory: Lags = 4

    def check_arguments(self) -> Gassl:
        """Check every argument; return the settings of GASSL."""
        arguments = super().check_arguments()
        if not hasattr(arguments.clusterer, "cluster"):
            CLUSTERERS.find(arguments.clusterer)
        gassl = Gassl(memory=arguments.memory, **(arguments.gassl or {}))
        gassl.check_arguments()
        return gassl

    @cached_property
    def _parameters(self) -> GruParameters:
        """The parameters of the GRU network in this episode; off-line ones before round 1."""
        if self.start == "meta":
            return load_meta_weights()
        return draw_parameters(torch.Generator().manual_seed(int(self.rng.integers(2**63))))

    def detect(self, window: Window) -> Detection:
        """One round of Algorithm 2.

        Returns:
            Candidates; scores c_i of equation (20), within the clusters; clusters; leader, the other UAV that each UAV
            attends to most within its cluster; attention, alpha within the clusters; in ``extras``:
            ``attention_heads`` ``(T_0 + 1, N, N)``, alpha_l within the clusters, ``count`` (M̂), ``followed`` ``(N,)``,
            c_{i'} of equation (38), ``features``, those that were clustered, and ``online_loss``, the losses of
            on-line training.
        """
        gassl, online = self.check_arguments(), (self.online_steps, self.online_rate)
        living = np.flatnonzero(window.alive)
        check_steps(window, self.memory)
        if not shows_evidence(window, living):  # decision (x)
            candidates = name_at_random(living, 1, window.uavs, self.rng)
            extras = {"count": min(1, len(living)), "followed": np.zeros(window.uavs), "online_loss": []}
            return Detection(candidates, np.zeros(window.uavs), np.where(window.alive, 0, -1), extras=extras)
        clusterer, features = self.clusterer, self.features
        if isinstance(clusterer, str):
            if isinstance(features, str) and features == "gru":
                features = partial(compute_gru_features, parameters=self._parameters, memory=self.memory)
            clusterer = make_clusterer(clusterer, features=features, count=self.count, memory=self.memory)
        detection, self._parameters = run_round(window, self._parameters, clusterer, gassl, online, self.rng)
        return detection

"""Factions and their leaders from a network of followers (after mFLICA, Amornbunchornvej and Berger-Wolf, 2018)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.sparse.csgraph import dijkstra

from detectors.base import Detector
from detectors.parameters import Lags
from detectors.series.votes import rank_uavs
from usnet_env.arrays import Floats
from usnet_env.detection import Detection, Tags
from usnet_env.series import centre_columns, correlate_over_lags, scale_to_unit
from usnet_env.window import Window

_DAMPING = 0.85
_ITERATIONS = 100


class Factions(Detector):
    """Names the leaders of factions: UAVs that have followers and follow no UAV themselves.

    UAV i follows UAV j if the lagged correlation of i's velocity with j's past is at least ``threshold``, and higher
    than that of j's velocity with i's past. These relations form a directed network. A leader is a node with incoming
    but no outgoing edges; its faction consists of all UAVs with a path to it. Leaders are ranked by PageRank.

    Args:
        max_lag: the largest lag in samples, at least 1.
        threshold: the smallest correlation that counts as following, from 0 to 1.
    """

    tags = Tags(most_uavs=10_000, uses_positions=False, false_leaders=True)

    max_lag: Lags = 4
    threshold: Annotated[float, Field(ge=0, le=1)] = 0.4

    def detect(self, window: Window) -> Detection:
        """Name the leaders of all factions, or the UAV with the highest PageRank if there is no leader.

        Returns:
            Candidates, scores (PageRank), clusters (factions; -1: in no faction) and leader (-1: none).
        """
        living = np.flatnonzero(window.alive)
        scores = np.zeros(window.uavs)
        leader, clusters = np.full((2, window.uavs), -1, np.int64)
        candidates = np.zeros(window.uavs, bool)
        if len(living):
            velocity, seen = window.velocity[:, living].astype(np.float64), window.velocity_seen[:, living]
            unit = scale_to_unit(centre_columns(velocity, seen))
            best = correlate_over_lags(unit, unit, min(self.max_lag, len(velocity) - 2))
            network = np.where((best >= self.threshold) & (best > best.T), best, 0.0)  # (i, j): i follows j
            scores[living] = compute_pagerank(network)
            follows = network > 0
            leads = np.flatnonzero(follows.any(axis=0) & ~follows.any(axis=1))
            candidates[living[leads]] = True
            if len(leads):
                distance = dijkstra(network.T, indices=leads, unweighted=True)
                reached = np.isfinite(distance).T
                in_faction = reached.any(axis=1)
                clusters[living[in_faction]] = reached[in_faction].argmax(axis=1)
                leader[living[in_faction]] = living[leads[clusters[living[in_faction]]]]
            else:
                candidates[rank_uavs(scores, window.alive, self.rng)[:1]] = True
        return Detection(candidates=candidates, scores=scores, clusters=clusters, leader=leader)


def compute_pagerank(network: Floats) -> Floats:
    """Compute the PageRank ``(n,)`` of the nodes of a network ``(n, n)`` (Page et al., 1999)."""
    uavs = len(network)
    out = network.sum(axis=1, keepdims=True)
    transition, is_dangling = network / np.where(out > 0, out, 1.0), ~(out[:, 0] > 0)
    rank = np.full(uavs, 1.0 / uavs)
    for _ in range(_ITERATIONS):  # a node without links has one to every node; summed apart, equal ranks stay equal
        rank = (1.0 - _DAMPING) / uavs + _DAMPING * (rank @ transition + rank[is_dangling].sum() / uavs)
    return rank

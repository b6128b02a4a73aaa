"""Detectors that are blind to links: one sees a single instant, the other each track alone.

Where such a detector is better than chance, a score is no proof that a detector found links.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from detectors.base import Detector
from detectors.series.designs import check_steps
from detectors.series.gaps import fill_gaps
from usnet_env.arrays import Floats, Indices
from usnet_env.detection import Detection, Tags
from usnet_env.window import Window

_ROUNDING = 1e-5  # smaller differences of features are rounding errors


class CentralMost(Detector):
    """Names the UAV in the middle of each group; it sees where the UAVs are at first, and no motion.

    Groups are single-linkage clusters of at least 3 UAVs. Scores fall with the distance from the middle of the group.

    Args:
        reach: the longest link, in units of the median distance from a UAV to the nearest other one.
    """

    tags = Tags(most_uavs=10_000)

    reach: Annotated[float, Field(gt=0, le=100)] = 3.0

    def detect(self, window: Window) -> Detection:
        """Name a UAV in each group; clusters are the groups."""
        scores, clusters = np.zeros(window.uavs), np.full(window.uavs, -1, np.int64)
        candidates, seen = np.zeros(window.uavs, bool), window.alive & window.seen.any(axis=0)
        position = fill_gaps(window).position[0].astype(np.float64)
        if seen.sum() > 1:
            clusters[seen] = group_by_distance(position[seen], self.reach)
        for group in range(clusters.max() + 1):
            members = np.flatnonzero(clusters == group)
            distance = np.linalg.norm(position[members] - position[members].mean(axis=0), axis=1)
            scores[members] = 1.0 / (1.0 + distance / max(float(distance.mean()), 1e-9))
            candidates[members[distance.argmin()]] = True
        return Detection(candidates=candidates, scores=scores, clusters=clusters)


def group_by_distance(position: Floats, reach: float) -> Indices:
    """Groups ``(n,)`` of at least 3 points ``(n, 3)``, by links up to ``reach`` median distances; -1: in no group."""
    tree = KDTree(position)
    nearest = np.median(tree.query(position, 2)[0][:, 1])
    pairs = tree.query_pairs(reach * float(nearest), output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(position),) * 2)
    group = connected_components(links, directed=False)[1]
    large = np.bincount(group) >= 3
    return np.where(large[group], np.cumsum(large)[group] - 1, -1).astype(np.int64)


class TrackOutlier(Detector):
    """Names the UAVs whose track, seen alone, is unlike the others: by its speed, turns and memory.

    Scores are the root mean square of the features' distances from their medians, in units of the median distance.

    Args:
        threshold: the distance from which a UAV is named; the farthest one is named if there is none.
    """

    tags = Tags(least_steps=2, uses_positions=False)

    threshold: Annotated[float, Field(ge=0, le=1000)] = 4.0

    def detect(self, window: Window) -> Detection:
        """Name the outliers among the living UAVs."""
        check_steps(window, 1)
        scores, alive = np.zeros(window.uavs), window.alive
        if alive.any():
            features = describe_tracks(fill_gaps(window).velocity[:, alive].astype(np.float64))
            distance = np.abs(features - np.median(features, axis=0))
            spread = np.median(distance, axis=0)
            distance = np.where(spread > _ROUNDING, distance / np.maximum(spread, _ROUNDING), 0.0)
            scores[alive] = np.sqrt((distance**2).mean(axis=1))
        least = min(self.threshold, scores.max(initial=0.0))
        return Detection(candidates=alive & (scores >= least) & (scores > 0), scores=scores)


def describe_tracks(velocity: Floats) -> Floats:
    """Features ``(n, 5 to 8)`` of each of the velocities ``(T, n, 3)``: speed, turns, and memory at up to 4 lags."""
    speed = np.linalg.norm(velocity, axis=2)
    speed /= max(speed.mean(), 1e-12)
    course = velocity / np.maximum(np.linalg.norm(velocity, axis=2, keepdims=True), 1e-12)
    turn = 1.0 - (course[1:] * course[:-1]).sum(axis=2)
    centred = course - course.mean(axis=0)
    power = np.maximum((centred**2).sum(axis=2).mean(axis=0), 1e-12)
    lags = np.unique(np.geomspace(1, max(1, len(velocity) // 4), 4).astype(int))
    memory = [(centred[lag:] * centred[:-lag]).sum(axis=2).mean(axis=0) / power for lag in lags]
    return np.stack([speed.mean(axis=0), speed.std(axis=0), turn.mean(axis=0), turn.std(axis=0), *memory], axis=1)

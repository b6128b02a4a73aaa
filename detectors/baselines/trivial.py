"""Trivial policies, which ignore the motion of the UAVs: a random choice, all UAVs, and no UAV."""

from __future__ import annotations

import numpy as np

from detectors.base import Detector
from detectors.parameters import Count
from usnet_env.detection import Detection, Tags
from usnet_env.window import Window


class RandomDetector(Detector):
    """Names living UAVs at random; the scores are random numbers.

    Args:
        count: the number of candidates per round, at least 1; all living UAVs if fewer are alive.
    """

    tags = Tags(uses_positions=False)

    count: Count = 1

    def detect(self, window: Window) -> Detection:
        """Name the living UAVs with the ``count`` highest of N random scores in (0, 1]; a destroyed UAV has score 0."""
        scores = np.where(window.alive, 1.0 - self.rng.random(window.uavs), 0.0)
        candidates = np.isin(np.arange(window.uavs), np.argsort(-scores)[: self.count])
        return Detection(candidates=candidates & window.alive, scores=scores)


class DestroyAll(Detector):
    """Names every living UAV; its J_m is exactly 1 + (N - M) / N."""

    tags = Tags(uses_positions=False)

    def detect(self, window: Window) -> Detection:
        """Name all living UAVs, each with score 1; a destroyed UAV has score 0."""
        return Detection(candidates=window.alive, scores=window.alive.astype(np.float64))


class NoCandidates(Detector):
    """Names no UAV, so that no head is ever destroyed."""

    tags = Tags(uses_positions=False)

    def detect(self, window: Window) -> Detection:
        """Return a detection without candidates; every score is 0."""
        return Detection(candidates=np.zeros(window.uavs, bool), scores=np.zeros(window.uavs))

"""One candidate per round: no redundant candidate if the ranking is right, but as many rounds as heads."""

from __future__ import annotations

import numpy as np

from detectors.base import Detector
from detectors.lagged.regression import LaggedRegression
from detectors.lagged.selection import rank_uavs
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["OnePerRound"]


class OnePerRound(Detector):
    """Names the UAV with the highest score of lagged regression in each round, without clustering.

    With a perfect ranking an episode takes M rounds and has no redundant candidate, so J_m = M.
    """

    def detect(self, window: Window) -> Detection:
        """Name the UAV with the highest score of :class:`LaggedRegression`; scores and attention are from there."""
        whole = LaggedRegression().detect(window)
        rng = getattr(self, "rng", None) or np.random.default_rng()
        candidates = np.zeros(window.uavs, bool)
        candidates[rank_uavs(whole.scores, window.alive, rng)[:1]] = True
        return Detection(candidates=candidates, scores=whole.scores, attention=whole.attention)

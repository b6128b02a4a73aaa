"""One candidate a round: the slow but thrifty end of what a good ranking can do."""

from __future__ import annotations

import numpy as np

from detectors.base import Detector
from detectors.lagged.regression import LaggedRegression
from detectors.lagged.selection import rank_uavs
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["OnePerRound"]


class OnePerRound(Detector):
    """Names the single best candidate of lagged regression in every round; no clustering.

    With a perfect ranking it plays M rounds without a redundant shot, so that its J_m is M.
    """

    def detect(self, window: Window) -> Detection:
        """The UAV with the highest score of :class:`LaggedRegression`, with its scores and attention."""
        whole = LaggedRegression().detect(window)
        rng = getattr(self, "rng", None) or np.random.default_rng()
        candidates = np.zeros(window.uavs, bool)
        candidates[rank_uavs(whole.scores, window.alive, rng)[:1]] = True
        return Detection(candidates=candidates, scores=whole.scores, attention=whole.attention)

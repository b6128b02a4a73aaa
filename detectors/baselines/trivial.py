"""The trivial policies: what an answer is worth that looks at nobody's flight.

They stand beside every published table, as the paper's J_m alone prefers destroying everybody to any detector that
needs two rounds (decision (l) of the paper's silent points).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from detectors.base import Detector
from usnet_env.config import Config
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["DestroyAll", "NoCandidates", "RandomDetector"]


class _RandomArguments(Config):
    count: Annotated[int, Field(ge=1)]


class RandomDetector(Detector):
    """Names a few living UAVs at random; the scores are random numbers.

    Args:
        count: how many UAVs to name in a round, at least 1; all the living ones where fewer live.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`, if ``count`` is not a whole number from 1.
    """

    def __init__(self, count: int = 1) -> None:
        self.count = count

    def reset(self, seed: int | None = None) -> None:
        """Start an episode with a generator of one's own."""
        _RandomArguments(count=self.count)
        super().reset(seed)

    def detect(self, window: Window) -> Detection:
        """The living UAVs with the ``count`` highest of N random scores in (0, 1]; a destroyed UAV scores 0."""
        count = _RandomArguments(count=self.count).count
        rng = getattr(self, "rng", None) or np.random.default_rng()
        scores = np.where(window.alive, 1.0 - rng.random(window.uavs), 0.0)
        candidates = np.zeros(window.uavs, bool)
        candidates[np.argsort(-scores)[:count]] = True
        return Detection(candidates=candidates & window.alive, scores=scores)


class DestroyAll(Detector):
    """Names every living UAV; its J_m is 1 + (N - M) / N, exactly."""

    def detect(self, window: Window) -> Detection:
        """All living UAVs, each with score 1; a destroyed UAV scores 0."""
        return Detection(candidates=window.alive, scores=window.alive.astype(np.float64))


class NoCandidates(Detector):
    """Names nobody, so that rounds pass and every head stays."""

    def detect(self, window: Window) -> Detection:
        """No candidates; every score is 0."""
        return Detection(candidates=np.zeros(window.uavs, bool), scores=np.zeros(window.uavs))

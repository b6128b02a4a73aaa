"""A custom detector: it names the UAVs whose velocity other UAVs copy one step later."""

from typing import Annotated

import numpy as np
from pydantic import Field

from detectors import Detector
from usnet_env import Detection, Window
from usnet_env.detection import Tags


class MostCopied(Detector):
    """Every UAV votes for the UAV whose velocity it copies best one step later.

    Args:
        clusters: the number of UAVs to name in each round.
    """

    tags = Tags(uses_positions=False, takes_clusters=True)

    clusters: Annotated[int, Field(ge=1)] = 5

    def detect(self, window: Window) -> Detection:
        """Count the votes. Destroyed UAVs do not vote and get no votes."""
        velocity = np.where(window.velocity_seen[..., None], window.velocity, 0.0)
        agreement = np.einsum("tic,tjc->ij", velocity[1:], velocity[:-1])  # row i: how well i copies each j
        np.fill_diagonal(agreement, -np.inf)
        agreement[:, ~window.alive] = -np.inf
        order = self.rng.permutation(window.uavs)  # ties are broken at random, not in favour of low indices
        copied = order[agreement[:, order].argmax(axis=1)]
        votes = np.bincount(copied[window.alive], minlength=window.uavs)
        best = order[np.argsort(-votes[order], kind="stable")]
        candidates = np.zeros(window.uavs, bool)
        candidates[best[: self.clusters]] = True
        return Detection(candidates=candidates & (votes > 0), scores=votes)

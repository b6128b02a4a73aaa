"""A custom detector: it names the UAVs whose velocity several other UAVs copy one step later."""

from typing import Annotated

import numpy as np
from pydantic import Field

from detectors import Detector
from usnet_env import Detection, Window
from usnet_env.detection import Tags


class MostCopied(Detector):
    """Every UAV votes for the UAV that it copies most, one step later, beyond what is copied from it.

    Args:
        votes: the fewest votes of a UAV that is named.
    """

    tags = Tags(uses_positions=False)

    votes: Annotated[int, Field(ge=1)] = 3

    def detect(self, window: Window) -> Detection:
        """Count the votes. Destroyed UAVs do not vote and get no votes."""
        velocity = np.where(window.velocity_seen[..., None], window.velocity, 0.0)
        copied = np.einsum("tic,tjc->ij", velocity[1:], velocity[:-1])  # row i: how much i copies each j
        lead = copied - copied.T
        np.fill_diagonal(lead, -np.inf)
        lead[:, ~window.alive] = -np.inf
        order = self.rng.permutation(window.uavs)  # ties are broken at random, not in favour of low indices
        leader = order[lead[:, order].argmax(axis=1)]
        votes = np.bincount(leader[window.alive], minlength=window.uavs)
        return Detection(candidates=(votes >= self.votes) & window.alive, scores=votes)

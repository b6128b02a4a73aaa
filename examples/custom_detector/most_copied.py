"""A detector of one's own: who is copied one step later?"""

import numpy as np

from detectors import Detector
from usnet_env import Detection, Window


class MostCopied(Detector):
    """Every UAV votes for the one whose velocity it repeats best one step later.

    Args:
        clusters: how many UAVs to name in a round.
    """

    def __init__(self, clusters: int = 5) -> None:
        self.clusters = clusters

    def detect(self, window: Window) -> Detection:
        """Count the votes; a destroyed UAV neither votes nor stands."""
        velocity = np.where(window.velocity_seen[..., None], window.velocity, 0.0)
        agreement = np.einsum("tic,tjc->ij", velocity[1:], velocity[:-1])  # row i repeats column j
        np.fill_diagonal(agreement, -np.inf)
        agreement[:, ~window.alive] = -np.inf
        order = self.rng.permutation(window.uavs)  # ties go to whoever comes first here, not to low indices
        copied = order[agreement[:, order].argmax(axis=1)]
        votes = np.bincount(copied[window.alive], minlength=window.uavs)
        best = order[np.argsort(-votes[order], kind="stable")]
        candidates = np.zeros(window.uavs, bool)
        candidates[best[: self.clusters]] = True
        return Detection(candidates=candidates & (votes > 0), scores=votes)

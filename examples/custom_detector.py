"""A detector of one's own: who is copied one step later? Beside it, the same scores for those that ship.

python examples/custom_detector.py
"""

import numpy as np

import usnet_env
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
        copied = agreement.argmax(axis=1)
        votes = np.bincount(copied[window.alive], minlength=window.uavs)
        candidates = np.zeros(window.uavs, bool)
        candidates[np.argsort(-votes)[: self.clusters]] = True
        return Detection(candidates=candidates & (votes > 0), scores=votes)


if __name__ == "__main__":
    for follow in ("f1", "f4"):
        result = usnet_env.evaluate(
            "USNET/MultiCluster-v0",
            [MostCopied(clusters=5), "lagged-regression(clusters=5)"],
            episodes=5,
            env_kwargs={"follow": follow},
        )
        for entry in result.summary:
            ap = entry["metrics"]["ap_first"]
            print(f"{follow}  {entry['detector']:32} average precision of round 1: {ap['mean']:.2f}")

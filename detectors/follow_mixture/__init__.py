"""Groups of UAVs that move together, and the heads whose pasts predict them."""

from detectors.follow_mixture.detector import FollowMixture

__all__ = ["FollowMixture"]

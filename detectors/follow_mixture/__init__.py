"""Follow-mixture: one shared follow strategy, heads and assignment fitted together."""

from detectors.follow_mixture.detector import FollowMixture

__all__ = ["FollowMixture"]

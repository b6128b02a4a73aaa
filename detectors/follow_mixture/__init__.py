"""Follow-mixture: fits one shared follow strategy, the heads and the assignment of followers together."""

from detectors.follow_mixture.detector import FollowMixture

__all__ = ["FollowMixture"]

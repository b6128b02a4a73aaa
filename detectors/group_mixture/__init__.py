"""Group-mixture: groups of UAVs that move together, and the heads whose pasts predict them."""

from detectors.group_mixture.detector import GroupMixture

__all__ = ["GroupMixture"]

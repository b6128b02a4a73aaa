"""A learned detector: an attention network, trained on simulated swarms with random follow strategies."""

from detectors.learned.detector import Learned

__all__ = ["Learned"]

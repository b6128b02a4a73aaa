"""Detectors: each takes a window of an observed swarm and names its cluster heads."""

from detectors.base import Detector

__all__ = ["Detector"]

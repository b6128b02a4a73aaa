"""Detectors: everything that answers a window with the cluster heads it sees."""

from detectors.base import Detector, DetectorPolicy

__all__ = ["Detector", "DetectorPolicy"]

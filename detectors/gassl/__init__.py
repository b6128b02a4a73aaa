"""GASSL, §III: the paper's Algorithm 1 as it is printed."""

from detectors.gassl.detector import Gassl

__all__ = ["Gassl"]

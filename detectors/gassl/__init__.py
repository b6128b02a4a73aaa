"""GASSL: the paper's Algorithm 1, and the project's own step beyond it."""

from detectors.gassl.detector import PRESETS, Gassl

__all__ = ["PRESETS", "Gassl"]

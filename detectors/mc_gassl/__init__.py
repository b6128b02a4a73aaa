"""MC-GASSL, §IV: clustering by metric learning, then GASSL in every cluster; the paper's Algorithm 2."""

from detectors.mc_gassl.detector import McGassl

__all__ = ["McGassl"]

"""Probabilities of being a head, from what each head adds to the explanation and from what it leaves unexplained."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.gate import Gate
from detectors.follow_mixture.mixture import Mixture

__all__ = ["head_probability"]

Floats = NDArray[np.float64]

# Rough shares on tuning seeds, not yet a calibration: see the page.
_PASSED, _FAILED = 0.995, 0.2
_FOLLOWER = 2e-4
_LEFT_OVER = 0.1  # unexplained beside a strategy that leaves more than noise: perhaps a cluster that was not found
_ALONE = 0.003  # unexplained beside a strategy that leaves nothing but noise: a decoy, most likely
_SMALLEST_CLUSTER = 3


def head_probability(mixture: Mixture, gate: Gate, holds: bool) -> Floats:
    """``(n,)`` probability of being a head.

    Args:
        mixture: the explanation.
        gate: its heads, judged.
        holds: the strategy found leaves nothing but noise.
    """
    left = mixture.heads.leader < 0
    left[mixture.heads.heads] = False
    missing = not holds and left.sum() >= _SMALLEST_CLUSTER
    probability = np.where(left, _LEFT_OVER if missing else _ALONE, _FOLLOWER)
    probability[mixture.heads.heads] = np.where(gate.passed, _PASSED, _FAILED)
    return probability

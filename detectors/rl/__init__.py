"""Policies that learn from raw windows, as torch modules; :mod:`detectors.rl.sb3` is for Stable-Baselines3."""

from detectors.rl.attention import AttentionNetwork
from detectors.rl.pair import PairNetwork

__all__ = ["AttentionNetwork", "PairNetwork"]

"""Policies that learn from raw windows, as torch modules; :mod:`detectors.rl.sb3` is for Stable-Baselines3."""

from detectors.rl.pair import PairNetwork

__all__ = ["PairNetwork"]

"""Baselines: the trivial policies, factions with their leaders, and pairwise Granger causality."""

from detectors.baselines.factions import Factions
from detectors.lagged import Granger

__all__ = ["Factions", "Granger"]

"""Baselines: the trivial policies, pairwise Granger causality, and factions with their leaders."""

from detectors.baselines.factions import Factions
from detectors.baselines.granger import Granger

__all__ = ["Factions", "Granger"]

"""Peers by method, re-implemented from their papers: pairwise Granger causality, and factions with their leaders."""

from detectors.peers.factions import Factions
from detectors.peers.granger import Granger

__all__ = ["Factions", "Granger"]

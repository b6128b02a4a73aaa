"""Baselines: the trivial policies, factions with their leaders, Granger causality, and networks of pairs."""

from detectors.baselines.blind import CentralMost, TrackOutlier
from detectors.baselines.correlations import DirectionalDelays, FrontMost, LaggedNetwork, NetLagRegression
from detectors.baselines.factions import Factions
from detectors.baselines.networks import NetworkDetector
from detectors.baselines.transfer_entropy import TransferEntropy
from detectors.baselines.warping import Flica, Mflica
from detectors.lagged import Granger

__all__ = ["CentralMost", "DirectionalDelays", "Factions", "Flica", "FrontMost", "Granger", "LaggedNetwork", "Mflica"]
__all__ += ["NetLagRegression", "NetworkDetector", "TrackOutlier", "TransferEntropy"]

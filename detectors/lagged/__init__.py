"""Detectors without training: they measure how well one UAV's past velocities predict another UAV's velocity."""

from detectors.lagged.correlation import LaggedCorrelation
from detectors.lagged.one_per_round import OnePerRound
from detectors.lagged.regression import LaggedRegression

__all__ = ["LaggedCorrelation", "LaggedRegression", "OnePerRound"]

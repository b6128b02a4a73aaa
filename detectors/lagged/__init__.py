"""Training-free detectors: who flies now as somebody else flew some steps ago?"""

from detectors.lagged.correlation import LaggedCorrelation
from detectors.lagged.one_per_round import OnePerRound
from detectors.lagged.regression import LaggedRegression

__all__ = ["LaggedCorrelation", "LaggedRegression", "OnePerRound"]

"""Neural Granger causality: one network for each candidate head of a cluster."""

from detectors.neural_granger.detector import NeuralGranger

__all__ = ["NeuralGranger"]

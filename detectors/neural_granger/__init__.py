"""Neural Granger causality: one additive network for each candidate head, predictions pooled."""

from detectors.neural_granger.detector import NeuralGranger

__all__ = ["NeuralGranger"]

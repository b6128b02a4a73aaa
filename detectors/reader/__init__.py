"""The reader: one network that reads who leads a swarm, trained on everything that the prior draws."""

from detectors.reader.detector import Reader

__all__ = ["Reader"]

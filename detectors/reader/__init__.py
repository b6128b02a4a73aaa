"""The reader: one network that reads who leads a swarm, trained on everything that the prior draws."""

from typing import Any

__all__ = ["Reader"]


def __getattr__(name: str) -> Any:
    """Import the detector when it is asked for: the prior and the training don't need it."""
    if name == "Reader":
        from detectors.reader.detector import Reader

        return Reader
    raise AttributeError(name)

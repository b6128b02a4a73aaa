"""The contract that every detector satisfies, our own and a stranger's alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator

from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["Detector", "DetectorPolicy"]


class Detector(BaseEstimator):  # type: ignore[misc]  # scikit-learn ships no types
    """A detector: window in, detection out.

    Subclass it and write :meth:`detect`; anything with the same methods serves as well. The constructor stores its
    keyword arguments and nothing else (scikit-learn's rule), which gives ``get_params``, ``set_params`` and
    ``sklearn.base.clone``. State that lives across the rounds of an episode is made in :meth:`reset`.

    Attributes:
        side_by_side: whether :meth:`detect_batch` trains on all windows together, so that an answer depends on the
            windows that it is given with. A table of results records the batch of such a detector.
    """

    side_by_side: ClassVar[bool] = False

    def reset(self, seed: int | None = None) -> None:
        """Start an episode: forget the last one and own a fresh generator ``self.rng``.

        Args:
            seed: seeds the detector's own generator. It is never the environment's seed.
        """
        self.rng = np.random.default_rng(seed)

    def detect(self, window: Window) -> Detection:
        """Name the candidates of one round.

        Args:
            window: what the observer saw. Its arrays are read-only.

        Returns:
            Candidates and scores for all N UAVs; a destroyed UAV is never a candidate.
        """
        raise NotImplementedError(f"{type(self).__name__} must define detect(window) -> Detection.")

    def detect_batch(self, windows: Sequence[Window]) -> list[Detection]:
        """Answer several windows; loops over :meth:`detect` unless a detector does better."""
        return [self.detect(window) for window in windows]

    def as_policy(self) -> DetectorPolicy:
        """This detector in the ``predict`` form that reinforcement-learning agents have."""
        return DetectorPolicy(self)


class DetectorPolicy:
    """A detector behind Stable-Baselines3's ``predict``: observation in, action (and no hidden state) out.

    Args:
        detector: the detector to ask. It is reset at every episode start.
        seed: seed of the sequence from which each episode's ``reset`` seed is drawn.
    """

    def __init__(self, detector: Detector, seed: int | None = None) -> None:
        self.detector = detector
        self._seeds = np.random.default_rng(seed)
        self._begun = False

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.int8], tuple[NDArray[Any], ...] | None]:
        """Candidates for one observation.

        Args:
            observation: one observation of a USNET environment (a mapping).
            state: passed through; detectors keep their own.
            episode_start: true at the first step of an episode; a first call always starts one.
            deterministic: ignored; a detector's randomness is its own seed's.

        Returns:
            The action ``(N,)`` int8 and ``state``.
        """
        if not self._begun or (episode_start is not None and bool(np.any(episode_start))):
            self.detector.reset(int(self._seeds.integers(2**31)))
            self._begun = True
        detection = self.detector.detect(Window.from_observation(observation))
        return detection.candidates.astype(np.int8), state

"""Everything that can be evaluated, in one form: a player is reset and then answers observations, one a round."""

from __future__ import annotations

import copy
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, quote
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["Answer", "DetectorPlayer", "Player", "PolicyPlayer", "as_player"]


@dataclass(frozen=True)
class Answer:
    """One answer to one observation.

    Args:
        candidates: ``(N,)`` bool.
        scores: ``(N,)`` float64, higher is more head-like.
        clusters: ``(N,)`` int64, or ``None``.
        seconds: wall time that the answer took.
    """

    candidates: NDArray[np.bool_]
    scores: NDArray[np.float64]
    clusters: NDArray[np.int64] | None
    seconds: float


class Player(Protocol):
    """What the referee plays with."""

    def reset(self, seed: int) -> None:
        """Start an episode with the player's own seed."""

    def answer(self, observation: Any) -> Answer:
        """Answer one observation of the environment."""

    def warm_up(self, observation: Any) -> None:
        """Answer once, apart: what runs only the first time (compiling, loading) is in no episode's seconds."""


class DetectorPlayer:
    """A detector: it sees a :class:`usnet_env.Window` made from the observation, and nothing else."""

    def __init__(self, detector: Any) -> None:
        self.detector = detector

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self.detector.reset(seed)

    def answer(self, observation: Any) -> Answer:
        """The detector's answer; only ``detect`` is timed."""
        window = Window.from_observation(observation)
        begin = time.perf_counter()
        detection = self.detector.detect(window)
        seconds = time.perf_counter() - begin
        if not isinstance(detection, Detection):
            raise ArgumentError(f"detect must return a usnet_env.Detection, got {quote(detection)}.")
        if len(detection.candidates) != window.uavs:
            raise ArgumentError(
                f"detect must answer for all {window.uavs} UAVs, got candidates for {len(detection.candidates)}."
            )
        return Answer(detection.candidates, detection.scores, detection.clusters, seconds)

    def warm_up(self, observation: Any) -> None:
        """Answer once with a copy."""
        try:
            detector = copy.deepcopy(self.detector)
        except Exception:  # whatever stands in the way of a copy; reset forgets what this one sees
            detector = self.detector
        player = DetectorPlayer(detector)
        player.reset(0)
        player.answer(observation)


class PolicyPlayer:
    """Anything with Stable-Baselines3's ``predict``: its state is handed back to it, its actions are deterministic.

    A policy gives no scores: its candidates stand for them. It has no ``reset``, so draws of its own are not seeded
    here.
    """

    def __init__(self, policy: Any) -> None:
        self.policy = policy
        self._state: Any = None
        self._start = True

    def reset(self, seed: int) -> None:
        """Start an episode; the seed is not used."""
        self._state, self._start = None, True

    def answer(self, observation: Any) -> Answer:
        """The policy's action; only ``predict`` is timed."""
        begin = time.perf_counter()
        action, state = self.policy.predict(
            observation, state=self._state, episode_start=np.array([self._start]), deterministic=True
        )
        seconds = time.perf_counter() - begin
        self._state, self._start = state, False
        values = np.asarray(action)
        if values.dtype.kind not in "biuf" or not ((values == 0) | (values == 1)).all():
            raise ArgumentError(f"predict must return an action of 0 and 1, got {quote(action)}.")
        uavs = len(observation["alive"]) if isinstance(observation, Mapping) else values.size
        if values.shape != (uavs,):
            raise ArgumentError(f"predict must return an action of shape ({uavs},), got {values.shape}.")
        return Answer(values.astype(bool), values.astype(np.float64), None, seconds)

    def warm_up(self, observation: Any) -> None:
        """Answer once; the state that comes back is dropped."""
        PolicyPlayer(self.policy).answer(observation)


def as_player(detector: Any) -> Player:
    """The player for a detector, or for anything with ``predict``.

    Raises:
        ArgumentError: neither of the two, or a class in place of an object.
    """
    if not isinstance(detector, type):
        if callable(getattr(detector, "detect", None)) and callable(getattr(detector, "reset", None)):
            return DetectorPlayer(detector)
        if callable(getattr(detector, "predict", None)):
            return PolicyPlayer(detector)
    raise ArgumentError(
        f"detector must be a name, or an object with detect and reset, or one with predict, got {quote(detector)}."
    )

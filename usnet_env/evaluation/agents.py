"""One interface for everything that can be evaluated: an agent is reset, then answers one observation a round."""

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

__all__ = ["Agent", "Answer", "DetectorAgent", "PolicyAgent", "as_agent"]


@dataclass(frozen=True)
class Answer:
    """The answer of an agent to one observation.

    Args:
        candidates: ``(N,)`` bool, the UAVs to destroy.
        scores: ``(N,)`` float64, higher for UAVs that are more likely heads.
        clusters: ``(N,)`` int64, a cluster for each UAV, or ``None``.
        seconds: wall time of the answer.
    """

    candidates: NDArray[np.bool_]
    scores: NDArray[np.float64]
    clusters: NDArray[np.int64] | None
    seconds: float


class Agent(Protocol):
    """What the evaluator needs of a detector or a policy."""

    def reset(self, seed: int) -> None:
        """Start an episode; ``seed`` seeds the agent's own random numbers."""

    def answer(self, observation: Any) -> Answer:
        """Answer one observation of the environment."""

    def warm_up(self, observation: Any) -> None:
        """Answer once without being timed, so that compiling and loading do not count as time of the first episode."""


class DetectorAgent:
    """A detector as an agent: it receives a :class:`usnet_env.Window` made from the observation, and nothing else."""

    def __init__(self, detector: Any) -> None:
        self.detector = detector

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self.detector.reset(seed)

    def answer(self, observation: Any) -> Answer:
        """Return the detector's answer; only the call of ``detect`` is timed."""
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
        """Answer once with a copy of the detector."""
        try:
            detector = copy.deepcopy(self.detector)
        except Exception:  # it cannot be copied; its reset must then discard what it learns here
            detector = self.detector
        agent = DetectorAgent(detector)
        agent.reset(0)
        agent.answer(observation)


class PolicyAgent:
    """Any object with the ``predict`` method of Stable-Baselines3, called with ``deterministic=True``.

    A policy returns no scores, so its candidates serve as scores (0 and 1). It has no ``reset``, so its own random
    numbers are not seeded here.
    """

    def __init__(self, policy: Any) -> None:
        self.policy = policy
        self._state: Any = None
        self._start = True

    def reset(self, seed: int) -> None:
        """Start an episode with an empty state; the seed is not used."""
        self._state, self._start = None, True

    def answer(self, observation: Any) -> Answer:
        """Return the policy's action; only the call of ``predict`` is timed."""
        begin = time.perf_counter()
        action, state = self.policy.predict(
            observation, state=self._state, episode_start=np.array([self._start]), deterministic=True
        )
        seconds = time.perf_counter() - begin
        self._state, self._start = state, False
        values = np.asarray(action)
        if values.dtype.kind not in "biuf" or not ((values == 0) | (values == 1)).all():
            raise ArgumentError(f"predict must return an action that holds only 0 and 1, got {quote(action)}.")
        uavs = len(observation["alive"]) if isinstance(observation, Mapping) else values.size
        if values.shape != (uavs,):
            raise ArgumentError(f"predict must return an action of shape ({uavs},), got {values.shape}.")
        return Answer(values.astype(bool), values.astype(np.float64), None, seconds)

    def warm_up(self, observation: Any) -> None:
        """Answer once and discard the state that ``predict`` returns."""
        PolicyAgent(self.policy).answer(observation)


def as_agent(detector: Any) -> Agent:
    """Wrap a detector, or an object with ``predict``, as an agent.

    Raises:
        ArgumentError: the object is neither of the two, or it is a class instead of an object.
    """
    if not isinstance(detector, type):
        if callable(getattr(detector, "detect", None)) and callable(getattr(detector, "reset", None)):
            return DetectorAgent(detector)
        if callable(getattr(detector, "predict", None)):
            return PolicyAgent(detector)
    raise ArgumentError(
        f"detector must be a name, an object with detect and reset, or an object with predict, got {quote(detector)}."
    )

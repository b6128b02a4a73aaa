"""Scripted policies for every role, so that each game runs without training.

A policy is reset with a seed and the agent's action space, and then answers observations. Detectors serve as observers
in both games; they see a window that is made of the observation, and nothing else.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, quote
from usnet_env.detection import Detection
from usnet_env.plugins import DetectorLike
from usnet_env.window import Window

__all__ = ["CamouflagedHead", "DetectorObserver", "Policy", "RandomHead", "RandomObserver", "TruthfulHead"]

Observation = Mapping[str, Any]
Array = NDArray[Any]


class Policy(ABC):
    """How one agent acts. Subclass it, or write anything with the same two methods."""

    def reset(self, seed: int, action_space: spaces.Space[Any]) -> None:
        """Start a game: own a fresh generator ``self.rng``, and remember the actions that can be taken."""
        self.rng = np.random.default_rng(seed)
        self.action_space = action_space

    @abstractmethod
    def act(self, observation: Observation) -> Array:
        """The action for one observation."""


class TruthfulHead(Policy):
    """A head that flies as it always does: 0 for every choice."""

    def act(self, observation: Observation) -> Array:
        """Zeros."""
        return np.zeros(len(_choices(self.action_space)), np.int64)


class RandomHead(Policy):
    """A head that draws each choice anew for every window, uniformly from what it can carry out."""

    def act(self, observation: Observation) -> Array:
        """One legal value of every choice."""
        return np.array(
            [self.rng.choice(np.flatnonzero(mask)) for mask in _legal(observation, self.action_space)], np.int64
        )


class CamouflagedHead(Policy):
    """A head that always hides in the same way.

    Args:
        mobility: index of the mobility; ``None``: the last on offer.
        jitter: whether it flies with the followers' noise.
        decoys: how many followers play decoys, as far as there are enough; ``None``: as many as can be.
        delay: how late its followers follow; ``None``: as late as can be.
    """

    def __init__(
        self, mobility: int | None = None, jitter: bool = False, decoys: int | None = None, delay: int | None = None
    ) -> None:
        self.mobility = mobility
        self.jitter = jitter
        self.decoys = decoys
        self.delay = delay

    def act(self, observation: Observation) -> Array:
        """The same choice every time, cut down to what can be carried out."""
        wanted = (self.mobility, int(self.jitter), self.decoys, self.delay)
        most = [int(np.flatnonzero(mask)[-1]) for mask in _legal(observation, self.action_space)]
        return np.array([top if wish is None else min(wish, top) for wish, top in zip(wanted, most, strict=True)])


class RandomObserver(Policy):
    """An observer that names a few UAVs at random among those that it may name.

    Args:
        count: how many; all of them where there are fewer.
    """

    def __init__(self, count: int = 1) -> None:
        self.count = count

    def act(self, observation: Observation) -> Array:
        """The vote, and an empty message."""
        legal = np.flatnonzero(observation["legal"])
        vote = np.zeros(len(observation["legal"]))
        vote[self.rng.permutation(legal)[: self.count]] = 1
        return _vote(vote, self.action_space)


class DetectorObserver(Policy):
    """A detector as an observer: it looks at those UAVs that the observer saw, and its candidates are the vote.

    Where votes are scores, a UAV gets the detector's probability if it gives one (``extras["probability"]``), and else
    its score relative to the lowest score among the candidates, at most 1: a candidate gets 1.

    Args:
        detector: anything with ``reset(seed)`` and ``detect(window) -> Detection``; every agent gets a copy of it.
    """

    def __init__(self, detector: DetectorLike) -> None:
        if isinstance(detector, type) or not isinstance(detector, DetectorLike):
            raise ArgumentError(f"detector must have the methods reset and detect, got {quote(detector)}.")
        self.detector = detector

    def reset(self, seed: int, action_space: spaces.Space[Any]) -> None:
        """Start a game: reset the detector, with a seed that is not the game's."""
        super().reset(seed, action_space)
        self.detector.reset(int(self.rng.integers(2**31)))

    def act(self, observation: Observation) -> Array:
        """The vote, and an empty message; nobody is named where nobody may be."""
        window = Window.from_observation(observation)
        legal = np.asarray(observation["legal"]).astype(bool)
        if not legal.any():
            return _vote(np.zeros(window.uavs), self.action_space)
        seen = window.alive & legal & window.seen.any(axis=0)
        part = Window(window.position, window.velocity, window.seen & seen, seen, window.round)
        detection = self.detector.detect(part)
        if not isinstance(detection, Detection) or detection.candidates.shape != (window.uavs,):
            raise ArgumentError(f"detector must answer a Detection for {window.uavs} UAVs, got {quote(detection)}.")
        named = detection.candidates & legal
        as_scores = isinstance(self.action_space, spaces.Box)
        return _vote(_shares(detection, named) if as_scores else named, self.action_space)


def _shares(detection: Detection, named: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Scores as numbers from 0 to 1."""
    if "probability" in detection.extras:
        return np.clip(np.asarray(detection.extras["probability"], np.float64), 0.0, 1.0)
    lowest = detection.scores[named].min() if named.any() else 0.0
    if lowest <= 0:  # scores of another kind than votes: only the candidates are sure
        return named.astype(np.float64)
    return np.clip(detection.scores / lowest, 0.0, 1.0)


def _vote(vote: Array, space: spaces.Space[Any]) -> Array:
    """A vote of N numbers in the form that the action space has, followed by zeros for a message."""
    if not isinstance(space, spaces.MultiBinary | spaces.Box):
        raise ArgumentError(f"action_space must be MultiBinary or Box for an observer, got {quote(space)}.")
    action = np.zeros(space.shape, space.dtype)
    action[: len(vote)] = vote
    return action


def _choices(space: spaces.Space[Any]) -> NDArray[np.int64]:
    """How many values each of a head's choices has."""
    if not isinstance(space, spaces.MultiDiscrete):
        raise ArgumentError(f"action_space must be MultiDiscrete for a head, got {quote(space)}.")
    return np.asarray(space.nvec, np.int64)


def _legal(observation: Observation, space: spaces.Space[Any]) -> list[Array]:
    """The mask of each choice."""
    return np.split(np.asarray(observation["legal"]), np.cumsum(_choices(space))[:-1])

"""Scripted policies for every role, so that both games can be played without training.

A policy is reset with a seed and the action space of its agent, and then returns an action for each observation. A
detector can act as an observer in both games; it receives a window made from the observation, and nothing else.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Mask
from usnet_env.config import ArgumentError, quote, whole_number
from usnet_env.detection import Detection
from usnet_env.plugins import DetectorLike
from usnet_env.window import Window

Observation = Mapping[str, Any]
Array = NDArray[Any]


class Policy(ABC):
    """Base class of policies for one agent; any class with the same two methods can be used instead."""

    def reset(self, seed: int, action_space: spaces.Space[Any]) -> None:
        """Start a game: create the generator ``self.rng`` and store the action space."""
        self.rng = np.random.default_rng(seed)
        self.action_space: Any = action_space

    @abstractmethod
    def act(self, observation: Observation) -> Array:
        """Return the action for one observation."""


class TruthfulHead(Policy):
    """A head that never evades: it chooses 0 everywhere."""

    def act(self, observation: Observation) -> Array:
        """Return zeros."""
        return np.zeros(self.action_space.shape, np.int64)


class RandomHead(Policy):
    """A head that draws each choice uniformly from the legal values, anew for every window."""

    def act(self, observation: Observation) -> Array:
        """Return a random legal value of each choice."""
        return np.array(
            [self.rng.choice(np.flatnonzero(mask)) for mask in _split_masks(observation, self.action_space)], np.int64
        )


class CamouflagedHead(Policy):
    """A head that evades in the same way in every window.

    Args:
        mobility: index of the mobility; ``None`` for the last one.
        jitter: whether the head flies with the followers' noise.
        decoys: number of followers that become decoys, limited by what is legal; ``None`` for the largest number.
        delay: delay of its followers in steps; ``None`` for the largest delay.
    """

    def __init__(
        self, mobility: int | None = None, jitter: bool = False, decoys: int | None = None, delay: int | None = None
    ) -> None:
        self.wanted = mobility, int(jitter), decoys, delay

    def act(self, observation: Observation) -> Array:
        """Return the same choices every time, reduced to the largest legal values where necessary."""
        limits = [int(np.flatnonzero(mask)[-1]) for mask in _split_masks(observation, self.action_space)]
        return np.array(
            [limit if value is None else min(value, limit) for value, limit in zip(self.wanted, limits, strict=True)]
        )


class RandomObserver(Policy):
    """An observer that names a few random UAVs among the legal ones.

    Args:
        count: number of UAVs to name; if fewer are legal, it names them all.
    """

    def __init__(self, count: int = 1) -> None:
        self.count = whole_number("count", count, 0)

    def act(self, observation: Observation) -> Array:
        """Return the vote, and a message of zeros."""
        legal = np.flatnonzero(observation["legal"])
        vote = np.zeros(len(observation["legal"]))
        vote[self.rng.permutation(legal)[: self.count]] = 1
        return _pad_vote(vote, self.action_space)


class DetectorObserver(Policy):
    """A detector as an observer: it receives the UAVs that the observer saw, and its candidates are the vote.

    If votes are scores, the vote for a UAV is the detector's probability (``extras["probability"]``) if it returns one.
    Otherwise it is the detector's score divided by the lowest score of a candidate, at most 1, so that each candidate
    gets 1.

    Args:
        detector: an object with ``reset(seed)`` and ``detect(window) -> Detection``.
    """

    def __init__(self, detector: DetectorLike) -> None:
        if isinstance(detector, type) or not isinstance(detector, DetectorLike):
            raise ArgumentError(f"detector must have the methods reset and detect, got {quote(detector)}.")
        self.detector = detector

    def reset(self, seed: int, action_space: spaces.Space[Any]) -> None:
        """Start a game: reset the detector with a seed drawn from the policy's generator."""
        super().reset(seed, action_space)
        self.detector.reset(int(self.rng.integers(2**31)))

    def act(self, observation: Observation) -> Array:
        """Return the vote, and a message of zeros; without a legal UAV the vote is empty."""
        window = Window.from_observation(observation)
        legal = np.asarray(observation["legal"]).astype(bool)
        if not legal.any():
            return _pad_vote(np.zeros(window.uavs), self.action_space)
        seen = window.alive & legal & window.seen.any(axis=0)
        visible = Window(window.position, window.velocity, window.seen & seen, seen, window.round, window.step)
        detection = self.detector.detect(visible)
        named = detection.candidates & legal
        as_scores = isinstance(self.action_space, spaces.Box)
        return _pad_vote(_scale_scores(detection, named) if as_scores else named, self.action_space)


def _scale_scores(detection: Detection, named: Mask) -> Floats:
    """Convert a detector's scores to numbers from 0 to 1."""
    if (probability := detection.extras.get("probability")) is not None:
        return np.clip(np.asarray(probability, np.float64), 0.0, 1.0)
    lowest = detection.scores[named].min() if named.any() else 0.0
    if lowest <= 0:  # a ratio of such scores has no meaning: vote with the candidates
        return named.astype(np.float64)
    return np.clip(detection.scores / lowest, 0.0, 1.0)


def _pad_vote(vote: Array, space: Any) -> Array:
    """Convert a vote of N numbers to an action of the space, with zeros for the message."""
    action: Array = np.zeros(space.shape, space.dtype)
    action[: len(vote)] = vote
    return action


def _split_masks(observation: Observation, space: Any) -> list[Array]:
    """Split ``legal`` into the mask of each choice of a head, whose action space is ``MultiDiscrete``."""
    return np.split(np.asarray(observation["legal"]), np.cumsum(space.nvec)[:-1])

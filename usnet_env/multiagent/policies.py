"""Scripted policies for every role, so that both games can be played without training."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from usnet_env.plugins import DetectorLike, find_detector
from usnet_env.window import Window

Observation = Mapping[str, Any]
Array = NDArray[Any]


class Policy(ABC):
    """Base class of policies for one agent."""

    def reset(self, seed: int, action_space: spaces.Space[Any]) -> None:
        """Start a game: create the generator ``self.rng`` and store the action space."""
        self.rng = np.random.default_rng(seed)
        self.action_space: Any = action_space

    @abstractmethod
    def act(self, observation: Observation) -> Array:
        """Return the action for one observation."""

    def legal_values(self, observation: Observation) -> list[Array]:
        """The legal values of each choice of a head."""
        masks = np.split(np.asarray(observation["legal"]), np.cumsum(self.action_space.nvec)[:-1])
        return [np.flatnonzero(mask) for mask in masks]

    def pad_vote(self, vote: Array) -> Array:
        """The action of an observer: a vote of N numbers, with zeros for the message and the flight."""
        action: Array = np.zeros(self.action_space.shape, self.action_space.dtype)
        action[: len(vote)] = vote
        return action


class TruthfulHead(Policy):
    """A head that never evades: it chooses 0 everywhere."""

    def act(self, observation: Observation) -> Array:
        """Return zeros."""
        return np.zeros(self.action_space.shape, np.int64)


class RandomHead(Policy):
    """A head that draws each choice uniformly from the legal values, anew for every window."""

    def act(self, observation: Observation) -> Array:
        """Return a random legal value of each choice."""
        return np.array([self.rng.choice(values) for values in self.legal_values(observation)], np.int64)


class CamouflagedHead(Policy):
    """A head that makes the same choices in every window, as far as they are legal; ``None`` is the largest value."""

    def __init__(
        self, mobility: int | None = None, jitter: bool = False, decoys: int | None = None, delay: int | None = None
    ) -> None:
        self.wanted = [np.inf if value is None else value for value in (mobility, int(jitter), decoys, delay)]

    def act(self, observation: Observation) -> Array:
        """Return the choices."""
        limits = [values[-1] for values in self.legal_values(observation)]
        return np.minimum(self.wanted, limits).astype(np.int64)


class RandomObserver(Policy):
    """An observer that names ``count`` random UAVs, or all legal ones if there are fewer."""

    def __init__(self, count: int = 1) -> None:
        self.count = count

    def act(self, observation: Observation) -> Array:
        """Return the vote, and a message of zeros."""
        legal = np.flatnonzero(observation["legal"])
        vote = np.zeros(len(observation["legal"]))
        vote[self.rng.permutation(legal)[: self.count]] = 1
        return self.pad_vote(vote)


class DetectorObserver(Policy):
    """A detector, or that of a name, as an observer: it receives the UAVs that the observer saw.

    Its candidates are the vote. If votes are scores, the vote for a UAV is the detector's probability
    (``extras["probability"]``) if it returns one, else its score divided by the lowest score of a candidate, at most 1.
    """

    def __init__(self, detector: DetectorLike | str) -> None:
        self.detector = find_detector(detector)

    def reset(self, seed: int, action_space: spaces.Space[Any]) -> None:
        """Start a game: reset the detector with a seed drawn from the policy's generator."""
        super().reset(seed, action_space)
        self.detector.reset(int(self.rng.integers(2**31)))

    def act(self, observation: Observation) -> Array:
        """Return the vote, and a message of zeros; without a legal UAV the vote is empty."""
        window = Window.from_observation(observation)
        legal = np.asarray(observation["legal"]).astype(bool)
        if not legal.any():
            return self.pad_vote(legal)
        seen = window.alive & legal & window.seen.any(axis=0)
        visible = Window(window.position, window.velocity, window.seen & seen, seen, window.round, window.step)
        detection = self.detector.detect(visible)
        named, probability = detection.candidates & legal, detection.extras.get("probability")
        if not isinstance(self.action_space, spaces.Box) or self.action_space.low[0] < 0:  # not scores
            return self.pad_vote(named)
        if probability is not None:
            return self.pad_vote(np.clip(probability, 0.0, 1.0))
        lowest = min(detection.scores[named], default=0.0)  # if it is not positive, a ratio to it has no meaning
        return self.pad_vote(np.clip(detection.scores / lowest, 0.0, 1.0) if lowest > 0 else named)

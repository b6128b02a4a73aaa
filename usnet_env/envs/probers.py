"""Scripted probers of ``USNET/Probing-v1``: who is copied, or probable by a detector, and who reacts to intruders."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from usnet_env.arrays import Floats, Singles
from usnet_env.config import unknown_name
from usnet_env.detection import ask
from usnet_env.drawing import last_seen_position
from usnet_env.envs.probing import ProbingArguments
from usnet_env.swarm.kinematics import find_push
from usnet_env.window import Window

REACTION = 3  # steps in which followers react
LAGS = 1, 2, 3  # steps after which followers copy their head


class Prober:
    """Tests UAVs with the intruders, and names the UAV that is the head with enough confidence.

    The belief ``(N,)`` in each UAV as the head is the likelihood that the others copy it (:func:`weigh_copies`), or its
    probability by a detector for the window so far, times the likelihood of how the others flew after the UAV was
    pushed (:func:`weigh_reactions`).

    Args:
        detector: ``None``: the likelihood of copies; or any detector. Of one without probabilities, candidates are
            taken for more probable than others.
        target: UAVs to test: ``"none"``, ``"random"``, or ``"nearest"`` of those that are more probable than 1/N.
        confidence: the belief from which on a UAV is named; when the window is full, the most probable one is.

    Example:
        >>> import gymnasium, usnet_env
        >>> from usnet_env.envs.play import play_probe
        >>> played, total = play_probe(gymnasium.make("USNET/Probing-v1"), Prober(), seed=0)
        >>> int(played.answer.candidates.sum())
        1
    """

    def __init__(self, detector: Any = None, target: str = "nearest", confidence: float = 0.95) -> None:
        if target not in TARGETS:
            raise unknown_name("target", target, TARGETS)
        self.detector, self.target, self.confidence = detector, target, confidence

    def reset(self, arguments: ProbingArguments, seed: int) -> None:
        """Start an episode of an environment with these arguments."""
        self.arguments, self.rng = arguments, np.random.default_rng(seed)
        if self.detector is not None:
            self.detector.reset(int(self.rng.integers(2**31)))

    def act(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """The action for an observation, with the belief as ``self.belief``."""
        self.look(observation)
        if self.belief.max() >= self.confidence or self.full:
            return self.stay(int(self.belief.argmax()))
        return self.stay() if self.target == "none" else self.fly(partial(TARGETS[self.target], self))

    def look(self, observation: Mapping[str, Any]) -> None:
        """Take in an observation: the belief, where UAVs and intruders are, and whether the window is ``full``."""
        elapsed, uavs = int(observation["elapsed"][0]), len(observation["alive"])
        self.full = elapsed == self.arguments.observation_steps
        evidence = self._weigh(observation, elapsed) if elapsed else np.zeros(uavs)
        belief = np.exp(evidence - evidence.max())
        self.belief = belief / belief.sum()
        self._place = last_seen_position(observation["position"], observation["seen"].astype(bool)).astype(float)
        self._intruders = observation["intruders"][elapsed]

    def _weigh(self, observation: Mapping[str, Any], elapsed: int) -> Floats:
        cut = {name: observation[name][: elapsed + 1] for name in ("position", "seen")}
        window = Window.from_observation({**observation, **cut, "velocity": observation["velocity"][:elapsed]})
        reactions = weigh_reactions(window, observation["intruders"][:elapsed], self.arguments)
        if self.detector is None:
            return weigh_copies(window) + reactions
        answer, _ = ask(self.detector, window)
        probability = np.asarray(answer.extras.get("probability", answer.candidates), float)
        return np.log(np.clip(probability, 1e-3, 1)) + reactions

    def stay(self, named: int | None = None) -> dict[str, Any]:
        """The action that leaves the intruders where they are, and names a UAV; ``None``: none yet."""
        name = len(self.belief) if named is None else named
        return {"steer": np.zeros(self._intruders.shape, np.float32), "name": name}

    def fly(self, judge: Callable[[Floats], Floats]) -> dict[str, Any]:
        """The action that flies each intruder to the outer side of another UAV, so that it pushes few others.

        Args:
            judge: the gain of a test of each UAV, ``(N,)``, given its distances from an intruder, ``(N,)`` metres.
        """
        free, goals = np.isfinite(self._place[:, 0]), np.zeros(self._intruders.shape)
        for k, intruder in enumerate(self._intruders):
            distance = np.linalg.norm(self._place - intruder, axis=1)
            chosen = int(np.where(free, judge(distance), -np.inf).argmax())
            free[chosen] = False
            outward = self._place[chosen] - self.middle
            goals[k] = self._place[chosen] + self.arguments.reach / 3 * outward / max(np.linalg.norm(outward), 1e-6)
        return self.steer_to(goals)

    @property
    def middle(self) -> Floats:
        """The mean position of the UAVs that have been seen, ``(3,)`` metres."""
        return np.asarray(np.nanmean(self._place, axis=0))

    def steer_to(self, goals: Floats) -> dict[str, Any]:
        """The action that flies the intruders to goals, ``(K, 3)`` or ``(3,)`` metres, until the next look."""
        way = self.arguments.top_speed * self.arguments.sample_every * self.arguments.look_every
        steer = (goals - self._intruders) / way
        length = np.linalg.norm(steer, axis=1, keepdims=True)
        return self.stay() | {"steer": (steer / np.maximum(length, 1 + 1e-6)).astype(np.float32)}


def weigh_copies(window: Window) -> Floats:
    """For each UAV the log-likelihood ratio that the others copy it, ``(N,)``.

    If UAV i is the head, the mean velocity of the others is a multiple of its own velocity one of ``LAGS`` steps
    before, plus normal noise of unknown size. With the correlation r of both over t instants, the ratio to noise alone
    is (1 − r²)^(−3t/2), here that of the best lag.
    """
    velocity, best = window.velocity.astype(float), np.zeros(window.uavs)
    others = (velocity.sum(axis=1, keepdims=True) - velocity) / (window.uavs - 1)
    for lag in LAGS:
        copied, copies = velocity[:-lag], others[lag:]
        if len(copied) < 2:
            break
        dot = (copied * copies).sum(axis=(0, 2)).clip(0)
        size = np.square(copied).sum(axis=(0, 2)) * np.square(copies).sum(axis=(0, 2))
        square = np.minimum(dot**2 / np.maximum(size, 1e-9), 1 - 1e-6)
        best = np.maximum(best, -1.5 * len(copied) * np.log1p(-square))
    return best


def weigh_reactions(window: Window, intruders: Singles, arguments: ProbingArguments) -> Floats:
    """For each UAV the log-likelihood ratio that the others turned with it when it was pushed, ``(N,)``.

    The mean velocity of the UAVs that no intruder pushes is an autoregressive process of order 1. If UAV i is the head,
    its mean turn in the last ``REACTION`` steps is added to it. A push p turns the velocity norm(u + p), on average
    over all directions u, by 2p/3, or by (1 − 1/(3 |p|²)) p/|p| where |p| > 1.
    """
    if window.observation_steps < 2:
        return np.zeros(window.uavs)
    seen = window.velocity_seen
    push = arguments.push * find_push(window.position[:-1], intruders, arguments.reach) * seen[..., None]
    alone = seen & ~push.any(axis=2)
    mean = (window.velocity * alone[..., None]).sum(axis=1) / np.maximum(alone.sum(axis=1), 1)[:, None]
    keep = (mean[1:] * mean[:-1]).sum() / np.maximum((mean * mean).sum(), 1e-6)
    size = np.maximum(np.linalg.norm(push, axis=2, keepdims=True), 1e-9)
    turn = push * np.where(size <= 1, 2 / 3, (1 - 1 / (3 * size**2)) / size)
    expected = np.stack([turn[max(t + 1 - REACTION, 0) : t + 1].mean(axis=0) for t in range(len(turn) - 1)])
    expected[1:] -= keep * expected[:-1].copy()
    turned = mean[1:] - keep * mean[:-1]
    spread = max(float(np.square(turned).mean()), 0.01)
    return np.asarray(np.einsum("tnc,tc->n", expected, turned) - np.square(expected).sum(axis=(0, 2)) / 2) / spread


#: The gain of a test of each UAV, given the prober and the distances from an intruder, by the name of ``target``.
TARGETS: dict[str, Callable[[Prober, Floats], Floats]] = {
    "none": lambda prober, distance: -distance,
    "random": lambda prober, distance: prober.rng.random(len(distance)),
    "nearest": lambda prober, distance: np.where(prober.belief >= 1 / len(distance), -distance, -np.inf),
}

"""Scripted probers of ``USNET/Probing-v1``: a detector's probabilities, and what the reactions to intruders add."""

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
STAY = 10.0  # steps that a test takes, beside the way


class Prober:
    """Tests UAVs with the intruders, and names the UAV that is the head with enough confidence.

    The belief ``(N,)`` in each UAV as the head is its probability by the detector for the window so far, times the
    likelihood of how the others flew after the UAV was pushed: turned with it if it is the head, else not.

    Args:
        detector: any detector; of one without probabilities, candidates are taken for more probable than others.
        target: whom to test: ``"none"``, ``"random"``, ``"nearest"`` of the UAVs that are more probable than 1/N, or
            ``"information"``, where the expected information by the belief in the time of the test is greatest.
        confidence: the belief from which on a UAV is named; when the window is full, the most probable one is.
    """

    def __init__(self, detector: Any, target: str = "information", confidence: float = 0.95) -> None:
        if target not in TARGETS:
            raise unknown_name("target", target, TARGETS)
        self.detector, self.target, self.confidence = detector, target, confidence

    def reset(self, arguments: ProbingArguments, seed: int) -> None:
        """Start an episode of an environment with these arguments."""
        self.arguments, self.rng = arguments, np.random.default_rng(seed)
        self.detector.reset(int(self.rng.integers(2**31)))

    def act(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """The action for an observation, with the belief as ``self.belief``."""
        self.look(observation)
        if self.belief.max() >= self.confidence or self.full:
            return self.stay(int(self.belief.argmax()))
        return self.stay() if self.target == "none" else self.fly(partial(TARGETS[self.target], self))

    def look(self, observation: Mapping[str, Any]) -> None:
        """Take in an observation: the belief, where UAVs and intruders are, and whether the window is ``full``.

        ``self.evidence`` ``(2, N)`` has the logarithms that the belief is made of: the probability by the detector, and
        the likelihood of the reactions.
        """
        elapsed, uavs = int(observation["elapsed"][0]), len(observation["alive"])
        self.full = elapsed == self.arguments.observation_steps
        self.evidence = self._weigh(observation, elapsed) if elapsed else np.zeros((2, uavs))
        total = self.evidence.sum(axis=0)
        belief = np.exp(total - total.max())
        self.belief = belief / belief.sum()
        self._place = last_seen_position(observation["position"], observation["seen"].astype(bool)).astype(float)
        self._intruders = observation["intruders"][elapsed]

    def _weigh(self, observation: Mapping[str, Any], elapsed: int) -> Floats:
        cut = {name: observation[name][: elapsed + 1] for name in ("position", "seen")}
        window = Window.from_observation({**observation, **cut, "velocity": observation["velocity"][:elapsed]})
        answer, _ = ask(self.detector, window)
        probability = np.asarray(answer.extras.get("probability", answer.candidates), float)
        reactions = weigh_reactions(window, observation["intruders"][:elapsed], self.arguments)
        return np.stack([np.log(np.clip(probability, 1e-3, 1)), reactions])

    def stay(self, named: int | None = None) -> dict[str, Any]:
        """The action that leaves the intruders where they are, and names a UAV; ``None``: none yet."""
        name = len(self.belief) if named is None else named
        return {"steer": np.zeros(self._intruders.shape, np.float32), "name": name}

    def count_steps(self) -> Floats:
        """The steps of the way of each intruder to each UAV, ``(K, N)``; NaN to one that has not been seen."""
        speed = self.arguments.top_speed * self.arguments.sample_every
        return np.asarray(np.linalg.norm(self._place - self._intruders[:, None], axis=2) / speed)

    def fly(self, judge: Callable[[Floats], Floats]) -> dict[str, Any]:
        """The action that flies each intruder to the outer side of another UAV, so that it pushes few others.

        Args:
            judge: what it is worth to test each UAV, ``(N,)``, given the steps of the way there, ``(N,)``.
        """
        free, velocity = np.isfinite(self._place[:, 0]), np.zeros(self._intruders.shape)
        middle, speed = self._place[free].mean(axis=0), self.arguments.top_speed * self.arguments.sample_every
        for k, steps in enumerate(self.count_steps()):
            chosen = int(np.where(free, judge(steps), -np.inf).argmax())
            free[chosen] = False
            outward = self._place[chosen] - middle
            goal = self._place[chosen] + self.arguments.reach / 3 * outward / max(float(np.linalg.norm(outward)), 1e-6)
            velocity[k] = (goal - self._intruders[k]) / (speed * self.arguments.look_every)
        length = np.linalg.norm(velocity, axis=1, keepdims=True)
        return self.stay() | {"steer": (velocity / np.maximum(length, 1 + 1e-6)).astype(np.float32)}


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


def _entropy(belief: Floats) -> Floats:
    part = np.clip(belief, 1e-9, 1 - 1e-9)
    return np.asarray(-part * np.log(part) - (1 - part) * np.log(1 - part))


#: How much it is worth to test each UAV, given the prober and the steps of the way there, by the name of ``target``.
TARGETS: dict[str, Callable[[Prober, Floats], Floats]] = {
    "none": lambda prober, steps: -steps,
    "random": lambda prober, steps: prober.rng.random(len(steps)),
    "nearest": lambda prober, steps: np.where(prober.belief >= 1 / len(steps), -steps, -np.inf),
    "information": lambda prober, steps: _entropy(prober.belief) / (steps + STAY),
}

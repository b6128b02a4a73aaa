"""Random laws: follow strategies that are networks, with random weights, of what a follower knows.

The inputs are six vectors: the head's late course, its change, the follower's own course, the way to the head, the own
course turned as the head turned, and the own last turn. So many laws with names are near a draw, and most draws are
near none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from usnet_env.arrays import Floats, Indices, Singles
from usnet_env.swarm import kernels
from usnet_env.swarm.field_follow import Chain
from usnet_env.swarm.state import Roles
from usnet_env.swarm.strategy import FollowStrategy, TrajectoryBatch

MOST_LAGS = 48  # steps of the past that a law uses at most
_ACTIVATIONS: dict[str, Callable[[Floats], Floats]] = {
    "plain": lambda x: x,
    "tanh": np.tanh,
    "sine": np.sin,
    "absolute": np.abs,
    "positive": lambda x: np.maximum(x, 0.0),
    "sign": np.sign,
    "step": lambda x: (x > 0).astype(float),
    "threshold": lambda x: x * (np.abs(x) > 0.4),
}
_INPUT_RATES = (0.5, 0.45, 0.4, 0.35, 0.55, 0.3)  # how often a law has each input
_INPUT_SIZES = (1.0, 2.0, 1.0, 1.0, 2.5, 1.0)  # typical weights, as changes and turns are small
_HEAD_INPUTS = (0, 1, 3, 4)  # inputs that depend on the head
_SAMPLES = 400  # moments at which a drawn law is tried


def _unit(x: Floats) -> Floats:
    return np.asarray(x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-9))


def list_inputs(heard: Floats, heard_before: Floats, course: Floats, course_before: Floats, offset: Floats) -> Floats:
    """The inputs ``(n, 18)`` of a law: from courses of the head and of the follower, now and earlier, and the way."""
    turned = np.cross(np.cross(_unit(heard_before), _unit(heard)), course)
    return np.concatenate([heard, heard - heard_before, course, offset, turned, course - course_before], axis=1)


@dataclass(frozen=True, eq=False)
class RandomLaw(FollowStrategy):
    """norm((1 - g) v_i + g B w + kappa n): w is a network's output, or the own course plus this output.

    Args:
        delay, spread, back: steps after which a follower hears its head, steps more by a share of its own, and steps
            between the two courses of which a change consists.
        depth: levels of the tree in which followers hear the one above them; 1: all hear their head.
        forgetting: the head is heard as an average in which each step weighs so much less; 0: at one step.
        reach: metres; up to this distance the way to the head grows.
        gain: g, of the answer.
        steers: whether the output is a change of course, else it is the course.
        inner, bias, outer, activation: the network, ``(18, H)``, ``(H,)``, ``(H, 3)``.
        centre, size: subtracted from its output ``(3,)``, and its factor.
        bend: B ``(3, 3)``, what becomes of the answer.
        favoured: the gain is larger along this course ``(3,)``; ``None``: equal.
        grain: outputs are multiples of it; 0: any.
    """

    equation = "v_{i,t+1} = norm((1 − g) v_{i,t} + g B w(head, own) + κ n) with a random network w"
    delay: int
    spread: int
    back: int
    forgetting: float
    reach: float
    gain: float
    steers: bool
    inner: Floats
    bias: Floats
    outer: Floats
    activation: str
    centre: Floats = field(default_factory=lambda: np.zeros(3))
    size: float = 1.0
    bend: Floats = field(default_factory=lambda: np.eye(3))
    favoured: Floats | None = None
    grain: float = 0.0
    noise: float = 0.05
    lags: int = 12
    depth: int = 1

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """Followers hear their head, or the UAV above them in a tree of ``depth`` levels."""
        return roles if self.depth == 1 else Chain(depth=self.depth).arrange(rng, roles)

    def find_delays(self, parameters: Singles) -> Indices:
        """Steps from a motion of the UAV that is heard to the answer, at least 1, for shares of the spread."""
        return 1 + np.clip(np.rint(self.delay + self.spread * parameters), 0, self.lags - 1 - self.back).astype(
            np.int64
        )

    def draw_for(self, rng: np.random.Generator, uavs: int) -> Singles:
        """The share of the spread of each follower."""
        return rng.random(uavs, dtype=np.float32)

    def answer(self, inputs: Floats) -> Floats:
        """The network's output ``(n, 3)`` for inputs ``(n, 18)``."""
        output = _ACTIVATIONS[self.activation](inputs @ self.inner + self.bias) @ self.outer - self.centre
        output = np.rint(output / self.grain) * self.grain if self.grain else output
        return np.asarray(self.size * output)

    def aim(self, inputs: Floats) -> Floats:
        """The direction ``(n, 3)`` without noise."""
        course, output = inputs[:, 6:9], self.answer(inputs)
        goal = _unit(course + output if self.steers else output) @ self.bend
        gain = self.gain if self.favoured is None else self.gain * (0.55 + 0.45 * np.tanh(2.0 * goal @ self.favoured))
        gain = np.broadcast_to(gain, len(course))[:, None]
        return np.asarray((1.0 - gain) * course + gain * goal)

    def fly(self, flight: TrajectoryBatch) -> None:
        """Simulate all followers of all swarms, step by step."""
        position, velocity, start = flight.position, flight.velocity, flight.start
        row, follower = np.nonzero(flight.motion == kernels.FOLLOWS)
        head = flight.source[row, follower]
        number = np.cumsum(flight.source != np.arange(position.shape[2]), axis=1)[row, follower] - 1
        delay = self.find_delays(flight.parameters[row, number]) - 1
        age = np.arange(start - self.back) - delay[:, None]
        weight = np.where(age >= 0, self.forgetting ** np.maximum(age, 0), 0.0) if self.forgetting else (age == 0)
        weight = weight / weight.sum(axis=1, keepdims=True)
        for s in range(flight.steps):
            t = start + s
            if self.forgetting:
                past = t - 1 - np.arange(weight.shape[1])
                heard, heard_before = (
                    np.einsum("na,nac->nc", weight, velocity[row[:, None], past - shift, head[:, None]])
                    for shift in (0, self.back)
                )
            else:
                past = t - 1 - delay
                heard, heard_before = (velocity[row, past - shift, head].astype(float) for shift in (0, self.back))
            course, course_before = (velocity[row, t - 1 - shift, follower].astype(float) for shift in (0, self.back))
            offset = (position[row, t, head] - position[row, t, follower]).astype(float)
            offset /= np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), self.reach)
            goal = self.aim(list_inputs(heard, heard_before, course, course_before, offset))
            velocity[row, t, follower] = _unit(goal + self.noise * flight.noise[row, s, follower])
            position[:, t + 1] = position[:, t] + velocity[:, t]


def _turn_level(angle: float) -> Floats:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _draw_map(rng: np.random.Generator) -> Floats:
    """A map of vectors: none, a turn about the vertical or any axis, opposed, mirrored, or on one axis."""
    kind = str(
        rng.choice(["same", "level", "any", "opposed", "mirrored", "axis"], p=[0.35, 0.25, 0.1, 0.14, 0.1, 0.06])
    )
    if kind == "level":
        return _turn_level(rng.uniform(-np.pi, np.pi) * rng.choice([0.35, 1.0]))
    axis = _unit(rng.standard_normal(3))
    return {
        "same": np.eye(3),
        "opposed": -np.eye(3),
        "mirrored": np.eye(3) - 2.0 * np.outer(axis, axis),
        "axis": 1.5 * np.outer(axis, axis),
        "any": np.linalg.qr(rng.standard_normal((3, 3)))[0],
    }[kind]


def _draw_network(rng: np.random.Generator) -> dict[str, Any]:
    """Weights: in half of the draws a sum of mapped inputs, else a hidden layer."""
    is_used = rng.random(6) < _INPUT_RATES
    if not is_used[list(_HEAD_INPUTS)].any():
        is_used[rng.choice(_HEAD_INPUTS)] = True
    size = is_used * np.exp(rng.uniform(np.log(0.25), np.log(1.5), 6)) * _INPUT_SIZES
    if is_used[4] and rng.random() < 0.6:
        size[[0, 1, 3]] *= rng.choice([0.0, 0.3])  # mostly turns
    if rng.random() < 0.5:
        activation = str(rng.choice(["plain", "plain", "tanh", "sign", "sine", "threshold"]))
        inner = np.concatenate([part * _draw_map(rng) for part in size]) * (3.0 if activation == "sign" else 1.0)
        return {"inner": inner, "bias": np.zeros(3), "outer": np.eye(3), "activation": activation}
    hidden = int(rng.choice([4, 8, 16]))
    inner = 1.5 * rng.standard_normal((18, hidden)) * np.repeat(size, 3)[:, None]
    if rng.random() < 0.3:
        inner *= rng.random(inner.shape) < 0.3
    outer, bias = rng.standard_normal((hidden, 3)) / np.sqrt(hidden), rng.standard_normal(hidden) * rng.choice([0, 0.5])
    return {"inner": inner, "bias": bias, "outer": outer, "activation": str(rng.choice(list(_ACTIVATIONS)))}


def _try_law(rng: np.random.Generator, law: RandomLaw) -> tuple[Floats, float]:
    """Outputs ``(n, 3)`` of a law at random moments, and the share of their variance that is due to the head."""
    heard, course = (_unit(rng.standard_normal((_SAMPLES, 3))) for _ in range(2))
    heard_before, course_before = (_unit(x + 0.25 * rng.standard_normal((_SAMPLES, 3))) for x in (heard, course))
    offset = _unit(rng.standard_normal((_SAMPLES, 3))) * rng.uniform(0.3, 1.0, (_SAMPLES, 1))
    orders = np.arange(_SAMPLES), rng.permutation(_SAMPLES)
    output, other_output = (
        law.answer(list_inputs(heard[k], heard_before[k], course, course_before, offset[k])) for k in orders
    )
    return output, 0.5 * float(((output - other_output) ** 2).sum(1).mean() / max(output.var(0).sum(), 1e-9))


def draw_law(rng: np.random.Generator, steps: int) -> RandomLaw:
    """Draw a law whose answers depend on the head, for windows of so many steps; a third is heard late."""
    while True:
        gain, back = float(rng.uniform(0.3, 0.95)), int(rng.integers(1, 5))
        latest = 6 if rng.random() < 0.67 else max(6, min(steps // 3, MOST_LAGS - 12))
        delay, spread = int(rng.integers(0, latest)), int(rng.integers(0, 4))
        law = RandomLaw(
            delay, spread, back, float(rng.choice([0.0, 0.0, rng.uniform(0.4, 0.9)])), float(rng.uniform(5.0, 60.0)),
            gain, bool(rng.random() < 0.5), **_draw_network(rng),
            noise=float(rng.choice([0.05, 0.1])) * (1.0 - gain) ** 0.5, lags=max(12, delay + spread + back + 4),
        )  # fmt: skip
        output, due_to_head = _try_law(rng, law)
        if due_to_head > 0.15:
            break
    centre, deviation = output.mean(0) * rng.choice([1.0, 1.0, 0.5]), max(float(output.std(0).mean()), 1e-3)
    is_bent = rng.random() < 0.35
    return replace(
        law,
        centre=centre,
        size=float(rng.uniform(0.2, 0.9)) / deviation if law.steers else 1.0,
        bend=np.eye(3) if not is_bent else _turn_level(rng.uniform(-1.2, 1.2)) if law.steers else _draw_map(rng),
        depth=1 if rng.random() < 0.65 else int(rng.integers(2, 5)),
        favoured=_unit(rng.standard_normal(3)) if rng.random() < 0.2 else None,
        grain=float(rng.uniform(0.5, 1.5)) * deviation if rng.random() < 0.12 else 0.0,
    )

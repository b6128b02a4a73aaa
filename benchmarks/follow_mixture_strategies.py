"""Fourteen follow strategies beside f1 to f7, for the benchmarks; importing this module registers all of them.

``follow-mixture`` fits follow strategies of a few *feature classes*. Five of the strategies here lie inside such a
class (:data:`IN_A_CLASS`; ``strategy_classes.py`` measures it): what it leaves unexplained is less than the followers'
noise. The others do not (:data:`OUTSIDE_CLASSES`). Rules and constants of the detector were chosen while first windows
of all fourteen, of other seeds, were looked at; so none of them is new to it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from usnet_env.swarm import FollowInputs, FollowStrategy, register_follow_strategy

__all__ = ["FIRST_EIGHT", "IN_A_CLASS", "OUTSIDE_CLASSES", "STRATEGIES"]

Array = NDArray[np.float32]
Law = Callable[[FollowInputs], Array]

_names = ["own_delays", "turned"]  # of all that are registered


def registered(lags: int) -> Callable[[Law], Law]:
    """Register a function under its name."""

    def register(function: Law) -> Law:
        register_follow_strategy(function.__name__, function, lags=lags)
        _names.append(function.__name__)
        return function

    return register


class OwnDelays(FollowStrategy):
    """Every follower copies its head with its own delay of one to three steps."""

    equation = "v_{i,t+1} = norm(v_{iL,t-d_i} + κ_n n)"
    lags = 3

    def direction(self, inputs: FollowInputs) -> Array:
        # A row is one follower; it keeps its place as long as no UAV is destroyed.
        delay = np.arange(len(inputs.own_position)) % 3
        return inputs.head_velocity[np.arange(len(delay)), delay]


class Turned(FollowStrategy):
    """A rotation about a random axis, drawn for each episode."""

    equation = "v_{i,t+1} = norm(R v_{iL,t} + κ_n n)"
    lags = 1

    def draw(self, rng: np.random.Generator) -> Array:
        q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        return (q * np.sign(np.linalg.det(q))).astype(np.float32).reshape(-1)

    def direction(self, inputs: FollowInputs) -> Array:
        return inputs.head_velocity[:, 0] @ inputs.parameters.reshape(3, 3).T


register_follow_strategy("own_delays", OwnDelays())
register_follow_strategy("turned", Turned())


@registered(lags=2)
def saturated(inputs: FollowInputs) -> Array:
    """tanh(3 v) on every axis, over two lags."""
    return np.tanh(3.0 * (inputs.head_velocity[:, 0] + 0.5 * inputs.head_velocity[:, 1]))


@registered(lags=2)
def products(inputs: FollowInputs) -> Array:
    """The cross product of the head's last two velocities."""
    return 1.5 * np.cross(inputs.head_velocity[:, 0], inputs.head_velocity[:, 1])


@registered(lags=2)
def absolute(inputs: FollowInputs) -> Array:
    """|v| on every axis, minus 0.7 times the velocity before."""
    return np.abs(inputs.head_velocity[:, 0]) - 0.7 * inputs.head_velocity[:, 1]


OFFSET = np.array([20.0, -15.0, 5.0], np.float32)


@registered(lags=1)
def formation_offset(inputs: FollowInputs) -> Array:
    """The head's velocity, plus a pull towards a place at a fixed offset from the head."""
    gap = inputs.head_position[:, 1] + OFFSET - inputs.own_position[:, 1]
    distance = np.sqrt((gap * gap).sum(axis=1, keepdims=True))
    return inputs.head_velocity[:, 0] + 0.5 * gap / np.maximum(distance, 5.0)


@registered(lags=3)
def median(inputs: FollowInputs) -> Array:
    """The axis-wise median of the head's last three velocities."""
    return np.median(inputs.head_velocity[:, :3], axis=1).astype(np.float32)


@registered(lags=2)
def pursuit(inputs: FollowInputs) -> Array:
    """The direction to the head's position two steps ago, plus half the sign of its velocity."""
    gap = inputs.head_position[:, 2] - inputs.own_position[:, 0]
    distance = np.sqrt((gap * gap).sum(axis=1, keepdims=True))
    return gap / np.maximum(distance, 1.0) + 0.5 * np.sign(inputs.head_velocity[:, 0])


@registered(lags=1)
def swerve(inputs: FollowInputs) -> Array:
    """The head's velocity, rotated about the vertical by an angle proportional to the distance."""
    gap = inputs.head_position[:, 1] - inputs.own_position[:, 1]
    angle = np.sqrt((gap * gap).sum(axis=1)) / 300.0
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y, z = inputs.head_velocity[:, 0].T
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)


@registered(lags=3)
def majority(inputs: FollowInputs) -> Array:
    """On every axis the sign of the sum of the head's last three velocities."""
    return np.sign(inputs.head_velocity[:, :3].sum(axis=1))


@registered(lags=2)
def constant_turn(inputs: FollowInputs) -> Array:
    """Constant-turn prediction: the head's next velocity if it repeats the plane and the angle of its last turn."""
    now, before = inputs.head_velocity[:, 0], inputs.head_velocity[:, 1]
    cosine = (now * before).sum(axis=1, keepdims=True)
    return (2.0 * cosine * now - before).astype(np.float32)


@registered(lags=2)
def parallel_navigation(inputs: FollowInputs) -> Array:
    """Parallel navigation: the head's velocity (two lags), its component along the line of sight towards the head."""
    gap = inputs.head_position[:, 1] - inputs.own_position[:, 1]
    distance = np.sqrt((gap * gap).sum(axis=1, keepdims=True))
    sight = gap / np.maximum(distance, 5.0)  # fades when close, where the line of sight has no direction
    velocity = inputs.head_velocity[:, 0] + 0.6 * inputs.head_velocity[:, 1]
    along = (velocity * sight).sum(axis=1, keepdims=True)
    return (velocity + (np.abs(along) - along) * sight).astype(np.float32)


@registered(lags=2)
def track_guidance(inputs: FollowInputs) -> Array:
    """Track guidance: the head's course (two lags), plus a correction of the cross-track error."""
    course = inputs.head_velocity[:, 0] + inputs.head_velocity[:, 1]
    course = course / np.maximum(np.sqrt((course * course).sum(axis=1, keepdims=True)), 1e-3)
    gap = inputs.head_position[:, 1] - inputs.own_position[:, 1]
    error = gap - (gap * course).sum(axis=1, keepdims=True) * course
    return (course + error / np.sqrt((error * error).sum(axis=1, keepdims=True) + 80.0**2)).astype(np.float32)


@registered(lags=2)
def limited_turn_rate(inputs: FollowInputs) -> Array:
    """A limited turn rate: from its last velocity towards the head's (two lags), by at most 0.9 radians a step."""
    own = inputs.own_position[:, 0] - inputs.own_position[:, 1]
    own = own / np.maximum(np.sqrt((own * own).sum(axis=1, keepdims=True)), 1e-3)
    wanted = inputs.head_velocity[:, 0] + 0.7 * inputs.head_velocity[:, 1]
    along = (wanted * own).sum(axis=1, keepdims=True)
    aside = wanted - along * own
    across = np.sqrt((aside * aside).sum(axis=1, keepdims=True))
    angle = np.minimum(np.arctan2(across, along), 0.9)
    return (np.cos(angle) * own + np.sin(angle) * aside / np.maximum(across, 1e-6)).astype(np.float32)


STRATEGIES = tuple(_names)
#: The strategies of the first measurements of ``learned`` and ``follow-mixture``.
FIRST_EIGHT = STRATEGIES[:8]
#: A feature class of ``follow-mixture`` contains the first three exactly and the last two nearly; ``own_delays`` and
#: ``swerve`` with one law for each follower.
IN_A_CLASS = ("own_delays", "turned", "products", "formation_offset", "swerve")
#: The others.
OUTSIDE_CLASSES = tuple(name for name in STRATEGIES if name not in IN_A_CLASS)

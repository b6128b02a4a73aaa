"""Follow strategies that no list of the detector contains; importing this registers them as `own_...`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from usnet_env.swarm import FollowInputs, FollowStrategy, register_follow_strategy

__all__ = ["LOOKED_AT", "OUT_OF_LIST", "UNSEEN"]

Array = NDArray[np.float32]


class OwnDelays(FollowStrategy):
    """Every follower copies its head with a delay of its own, of one to three steps."""

    equation = "v_{i,t+1} = norm(v_{iL,t-d_i} + κ_n n)"
    lags = 3

    def direction(self, inputs: FollowInputs) -> Array:
        # A row is one follower, always at the same place while nobody is destroyed.
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


def saturated(inputs: FollowInputs) -> Array:
    """tanh(3 v) on every axis, over two lags."""
    return np.tanh(3.0 * (inputs.head_velocity[:, 0] + 0.5 * inputs.head_velocity[:, 1]))


def products(inputs: FollowInputs) -> Array:
    """The cross product of the head's last two velocities."""
    return 1.5 * np.cross(inputs.head_velocity[:, 0], inputs.head_velocity[:, 1])


def absolute(inputs: FollowInputs) -> Array:
    """|v| on every axis, less the velocity before."""
    return np.abs(inputs.head_velocity[:, 0]) - 0.7 * inputs.head_velocity[:, 1]


OFFSET = np.array([20.0, -15.0, 5.0], np.float32)


def formation(inputs: FollowInputs) -> Array:
    """The head's velocity, and a pull towards a place beside the head."""
    gap = inputs.head_position[:, 1] + OFFSET - inputs.own_position[:, 1]
    distance = np.sqrt((gap * gap).sum(axis=1, keepdims=True))
    return inputs.head_velocity[:, 0] + 0.5 * gap / np.maximum(distance, 5.0)


def median(inputs: FollowInputs) -> Array:
    """The axis-wise median of the head's last three velocities."""
    return np.median(inputs.head_velocity[:, :3], axis=1).astype(np.float32)


def pursuit(inputs: FollowInputs) -> Array:
    """Towards where the head was two steps ago, and half of its velocity's sign."""
    gap = inputs.head_position[:, 2] - inputs.own_position[:, 0]
    distance = np.sqrt((gap * gap).sum(axis=1, keepdims=True))
    return gap / np.maximum(distance, 1.0) + 0.5 * np.sign(inputs.head_velocity[:, 0])


def swerve(inputs: FollowInputs) -> Array:
    """The head's velocity, turned about the vertical by an angle that grows with the distance."""
    gap = inputs.head_position[:, 1] - inputs.own_position[:, 1]
    angle = np.sqrt((gap * gap).sum(axis=1)) / 300.0
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y, z = inputs.head_velocity[:, 0].T
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)


def majority(inputs: FollowInputs) -> Array:
    """On every axis the sign of the head's last three velocities together."""
    return np.sign(inputs.head_velocity[:, :3].sum(axis=1))


Array = NDArray[np.float32]


def constant_turn(inputs: FollowInputs) -> Array:
    """Where the head flies next if it keeps turning in the plane and by the angle of its last turn."""
    now, before = inputs.head_velocity[:, 0], inputs.head_velocity[:, 1]
    cosine = (now * before).sum(axis=1, keepdims=True)
    return (2.0 * cosine * now - before).astype(np.float32)


def parallel_navigation(inputs: FollowInputs) -> Array:
    """Parallel navigation: across the line of sight as the head (two lags), along it always towards the head."""
    gap = inputs.head_position[:, 1] - inputs.own_position[:, 1]
    distance = np.sqrt((gap * gap).sum(axis=1, keepdims=True))
    sight = gap / np.maximum(distance, 5.0)  # fades when close, where the line of sight has no direction
    velocity = inputs.head_velocity[:, 0] + 0.6 * inputs.head_velocity[:, 1]
    along = (velocity * sight).sum(axis=1, keepdims=True)
    return (velocity + (np.abs(along) - along) * sight).astype(np.float32)


def track_guidance(inputs: FollowInputs) -> Array:
    """Track guidance: along the head's course (two lags), and back onto its track line by the cross-track error."""
    course = inputs.head_velocity[:, 0] + inputs.head_velocity[:, 1]
    course = course / np.maximum(np.sqrt((course * course).sum(axis=1, keepdims=True)), 1e-3)
    gap = inputs.head_position[:, 1] - inputs.own_position[:, 1]
    error = gap - (gap * course).sum(axis=1, keepdims=True) * course
    return (course + error / np.sqrt((error * error).sum(axis=1, keepdims=True) + 80.0**2)).astype(np.float32)


def limited_turn_rate(inputs: FollowInputs) -> Array:
    """A limited turn rate: from its own last velocity towards the head's (two lags), by at most 0.9 radians a step."""
    own = inputs.own_position[:, 0] - inputs.own_position[:, 1]
    own = own / np.maximum(np.sqrt((own * own).sum(axis=1, keepdims=True)), 1e-3)
    wanted = inputs.head_velocity[:, 0] + 0.7 * inputs.head_velocity[:, 1]
    along = (wanted * own).sum(axis=1, keepdims=True)
    aside = wanted - along * own
    across = np.sqrt((aside * aside).sum(axis=1, keepdims=True))
    angle = np.minimum(np.arctan2(across, along), 0.9)
    return (np.cos(angle) * own + np.sin(angle) * aside / np.maximum(across, 1e-6)).astype(np.float32)


def _register() -> tuple[str, ...]:
    register_follow_strategy("own_delays", OwnDelays())
    register_follow_strategy("turned", Turned())
    for name, function, lags in (
        ("saturated", saturated, 2),
        ("products", products, 2),
        ("absolute", absolute, 2),
        ("formation_offset", formation, 1),
        ("median", median, 3),  # this one and the next were written by another hand than the detector
        ("pursuit", pursuit, 2),
        ("swerve", swerve, 1),
        ("majority", majority, 3),
        ("constant_turn", constant_turn, 2),  # this one and the next three were written by another hand as well
        ("parallel_navigation", parallel_navigation, 2),
        ("track_guidance", track_guidance, 2),
        ("limited_turn_rate", limited_turn_rate, 2),
    ):
        register_follow_strategy(name, function, lags=lags)
    return "own_delays", "turned", "saturated", "products", "absolute", "formation_offset", "median", "pursuit"


OUT_OF_LIST = _register()
LOOKED_AT = ("swerve", "majority", "constant_turn", "parallel_navigation")  # unseen by earlier builds, which did badly on two of them
UNSEEN = ("track_guidance", "limited_turn_rate")  # that nothing was built for, nor looked at before the rows that are published

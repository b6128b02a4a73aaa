"""Open laws of a second grammar, which has no part of the one in ``open_follow.py``.

A follower sees the last steps of its head (:data:`SEEN`), answers in one of several ways (:data:`ANSWERS`), and the
strength of its answer changes (:data:`STRENGTH`). ``follow="second-1"`` to ``"second-54"`` are the combinations of
these parts, with constants drawn as those of the first grammar.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from usnet_env.arrays import Floats, Indices, Singles
from usnet_env.swarm.open_follow import NUMBERS, Constants, OpenLaw, blend, to_unit
from usnet_env.swarm.strategy import FollowInputs

STEPS = 7  # of the head that a follower sees, newest first


@dataclass(frozen=True)
class Sight:
    """What n followers see when they answer; step k is seen as it was k steps ago.

    ``own`` ``(n, 3)`` is the follower's velocity, ``course`` and ``bearing`` ``(n, STEPS, 3)`` are the courses of the
    head and the ways to it, both of length 1, ``phase`` ``(n, 1)`` is between 0 and 1, and ``clock`` is in steps.
    """

    own: Floats
    course: Floats
    bearing: Floats
    phase: Floats
    clock: int

    @property
    def turn(self) -> Floats:
        """The angles ``(n, STEPS - 2)`` in radians by which the head turned in two steps."""
        along = (self.course[:, 2:] * self.course[:, :-2]).sum(axis=2)
        return np.asarray(np.arccos(np.clip(along, -1.0, 1.0)))


class SecondLaw(OpenLaw):
    """v_{i,t+1} = norm((1 - s g) v_{i,t} + s g answer(see(past of the head)) + kappa_g n), s the strength."""

    @property
    def equation(self) -> str:  # type: ignore[override]  # follows from the fields
        """The parts of the law."""
        return f"open law of the second grammar: sees its head {self.hears}, {self.answers}, {self.bends}"

    def direction(self, inputs: FollowInputs) -> Singles:
        """The law."""
        constants = Constants(*inputs.parameters[:NUMBERS].tolist())
        phase = inputs.parameters[NUMBERS:][inputs.follower][:, None].astype(np.float64)
        lag, mirror = SEEN[self.hears](constants, phase, inputs.clock)
        row = np.arange(len(lag))[:, None]
        course = inputs.head_velocity[row, lag].astype(np.float64) @ mirror
        to_head = (inputs.head_position[row, lag] - inputs.own_position[:, :STEPS]).astype(np.float64) @ mirror
        velocity = (inputs.own_position[:, 0] - inputs.own_position[:, 1]).astype(np.float64)
        sight = Sight(velocity, to_unit(course), to_unit(to_head), phase, inputs.clock)
        wanted = to_unit(ANSWERS[self.answers](constants, sight))
        return blend(constants, velocity, wanted, STRENGTH[self.bends](constants, sight))


def _see_glimpses(constants: Constants, phase: Floats, clock: int) -> tuple[Indices, Floats]:
    """One look in 2 to 5 steps, kept until the next one, as by birds that scan or by a radar that turns."""
    period, steps = 2 + round(constants.spread), np.arange(STEPS)
    age = (clock - steps + np.floor(phase * period).astype(np.int64)) % period
    return steps + age, np.eye(3)


def _see_drifting(constants: Constants, phase: Floats, clock: int) -> tuple[Indices, Floats]:
    """0 to 5 steps late, more and less in turn, as over a radio link whose load changes."""
    phases = clock / (20.0 + 10.0 * constants.delay) + phase
    delay = np.rint(2.5 + 2.5 * np.sin(2.0 * np.pi * phases)).astype(np.int64)
    return delay + np.arange(STEPS), np.eye(3)


def _see_mirrored(constants: Constants, phase: Floats, clock: int) -> tuple[Indices, Floats]:
    """Reflected by an upright plane, as in a display flown in mirror image."""
    across = np.array([-np.sin(constants.course), np.cos(constants.course), 0.0])
    delay = np.full((len(phase), 1), round(constants.delay))
    return delay + np.arange(STEPS), np.eye(3) - 2.0 * np.outer(across, across)


def _rotate(course: Floats, angle: Floats) -> Floats:
    """Courses ``(n, 3)`` turned to the left by ``(n,)`` radians."""
    cos, sin, (x, y, z) = np.cos(angle), np.sin(angle), course.T
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)


def _answer_jerk(constants: Constants, sight: Sight) -> Floats:
    """A push by the second difference of the head's velocity, as by a load on a tow rope."""
    jerk = sight.course[:, 0] - 2.0 * sight.course[:, 2] + sight.course[:, 4]
    return sight.own + (0.6 + 0.6 * constants.sharpness) * jerk


def _answer_sum_of_turns(constants: Constants, sight: Sight) -> Floats:
    """A turn by a part of the angle that the head turned in all steps, as by an autopilot with an integral part."""
    azimuth = np.unwrap(np.arctan2(sight.course[..., 1], sight.course[..., 0]), axis=1)
    return _rotate(sight.own, (0.4 + 0.4 * constants.sharpness) * (azimuth[:, 0] - azimuth[:, -1]))


def _answer_by_relay(constants: Constants, sight: Sight) -> Floats:
    """The head's course from a sharp turn on until it flies nearly straight, as by a thermostat; else the own one."""
    follows = np.zeros(len(sight.own), bool)
    for turn in sight.turn.T[::-1]:
        follows = np.where(follows, turn > 0.08, turn > 0.15 + 0.1 * constants.sharpness)
    return np.where(follows[:, None], sight.course[:, 0], sight.own)


def _keep_bearing(constants: Constants, sight: Sight) -> Floats:
    """A turn 3 to 6 times that of the way to the head, as by dragonflies: proportional navigation."""
    turned = np.cross(sight.bearing[:, -1], sight.bearing[:, 0])
    return sight.own + (3.0 + 3.0 * constants.sharpness) * np.cross(turned, sight.own)


def _read_climb(constants: Constants, sight: Sight) -> Floats:
    """The head's climb, read as an angle to a fixed course, as by bees that see a dance."""
    climb = np.arcsin(np.clip(sight.course[:, 0, 2], -1.0, 1.0))
    angle = constants.course + (1.5 + 1.5 * constants.sharpness) * climb
    level = np.hypot(sight.own[:, 0], sight.own[:, 1])
    return np.stack([level * np.cos(angle), level * np.sin(angle), sight.own[:, 2]], axis=1)


def _copy_sharpest(constants: Constants, sight: Sight) -> Floats:
    """The head's course after the sharpest turn that is seen, as by animals that attend to what is sudden."""
    return sight.course[np.arange(len(sight.own)), sight.turn.argmax(axis=1)]


def _in_rhythm(constants: Constants, sight: Sight) -> Floats:
    """More and less in turn, with a period of 8 to 16 steps, as fish that burst and coast."""
    return 0.6 + 0.4 * np.sin(2.0 * np.pi * (sight.clock / (6.0 + 2.0 * constants.delay) + sight.phase))


def _in_view(constants: Constants, sight: Sight) -> Floats:
    """All of it with the head in front, little behind, as of animals with a blind angle."""
    cosine = (sight.own * sight.bearing[:, 0]).sum(axis=1, keepdims=True)
    return np.where(cosine > -0.3 - 0.5 * constants.sharpness, 1.0, 0.2)


def _with_fatigue(constants: Constants, sight: Sight) -> Floats:
    """The less, the more the head turned, as of senses that get used to a stimulus."""
    return np.exp(-sight.turn.sum(axis=1, keepdims=True) / (0.5 + constants.sharpness))


SEEN: dict[str, Callable[[Constants, Floats, int], tuple[Indices, Floats]]] = {
    "by glimpses": _see_glimpses, "over a link whose delay drifts": _see_drifting, "in a mirror": _see_mirrored
}  # fmt: skip
ANSWERS: dict[str, Callable[[Constants, Sight], Floats]] = {
    "answers its jerk": _answer_jerk, "answers the sum of its turns": _answer_sum_of_turns,
    "copies like a relay": _answer_by_relay, "keeps its bearing": _keep_bearing,
    "reads its climb": _read_climb, "copies its sharpest turn": _copy_sharpest,
}  # fmt: skip
STRENGTH: dict[str, Callable[[Constants, Sight], Floats]] = {
    "in a rhythm": _in_rhythm, "within its view": _in_view, "with fatigue": _with_fatigue
}  # fmt: skip

#: The laws by name.
SECOND_LAWS = {
    f"second-{number}": SecondLaw(number, *parts) for number, parts in enumerate(product(SEEN, ANSWERS, STRENGTH), 1)
}

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
        law, share = Constants(*inputs.parameters[:NUMBERS].tolist()), inputs.parameters[NUMBERS:][inputs.follower]
        phase = share[:, None].astype(np.float64)
        lag, mirror = SEEN[self.hears](law, phase, inputs.clock)
        row = np.arange(len(lag))[:, None]
        course = inputs.head_velocity[row, lag].astype(np.float64) @ mirror
        way = (inputs.head_position[row, lag] - inputs.own_position[:, :STEPS]).astype(np.float64) @ mirror
        own = (inputs.own_position[:, 0] - inputs.own_position[:, 1]).astype(np.float64)
        sight = Sight(own, to_unit(course), to_unit(way), phase, inputs.clock)
        wanted = to_unit(ANSWERS[self.answers](law, sight))
        return blend(law, own, wanted, STRENGTH[self.bends](law, sight))


def _see_glimpses(law: Constants, phase: Floats, clock: int) -> tuple[Indices, Floats]:
    """One look in 2 to 5 steps, kept until the next one, as by birds that scan or by a radar that turns."""
    period, then = 2 + round(law.spread), np.arange(STEPS)
    age = (clock - then + np.floor(phase * period).astype(np.int64)) % period
    return then + age, np.eye(3)


def _see_drifting(law: Constants, phase: Floats, clock: int) -> tuple[Indices, Floats]:
    """0 to 5 steps late, more and less in turn, as over a radio link whose load changes."""
    turns = clock / (20.0 + 10.0 * law.delay) + phase
    late = np.rint(2.5 + 2.5 * np.sin(2.0 * np.pi * turns)).astype(np.int64)
    return late + np.arange(STEPS), np.eye(3)


def _see_mirrored(law: Constants, phase: Floats, clock: int) -> tuple[Indices, Floats]:
    """Reflected by an upright plane, as in a display flown in mirror image."""
    across = np.array([-np.sin(law.course), np.cos(law.course), 0.0])
    late = np.full((len(phase), 1), round(law.delay))
    return late + np.arange(STEPS), np.eye(3) - 2.0 * np.outer(across, across)


def _rotate(own: Floats, angle: Floats) -> Floats:
    """Courses ``(n, 3)`` turned to the left by ``(n,)`` radians."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([cos * own[:, 0] - sin * own[:, 1], sin * own[:, 0] + cos * own[:, 1], own[:, 2]], axis=1)


def _answer_jerk(law: Constants, now: Sight) -> Floats:
    """A push by the second difference of the head's velocity, as by a load on a tow rope."""
    return now.own + (0.6 + 0.6 * law.sharpness) * (now.course[:, 0] - 2.0 * now.course[:, 2] + now.course[:, 4])


def _answer_sum_of_turns(law: Constants, now: Sight) -> Floats:
    """A turn by a part of the angle that the head turned in all steps, as by an autopilot with an integral part."""
    azimuth = np.unwrap(np.arctan2(now.course[..., 1], now.course[..., 0]), axis=1)
    return _rotate(now.own, (0.4 + 0.4 * law.sharpness) * (azimuth[:, 0] - azimuth[:, -1]))


def _answer_by_relay(law: Constants, now: Sight) -> Floats:
    """The head's course from a sharp turn on until it flies nearly straight, as by a thermostat; else the own one."""
    on = np.zeros(len(now.own), bool)
    for turn in now.turn.T[::-1]:
        on = np.where(on, turn > 0.08, turn > 0.15 + 0.1 * law.sharpness)
    return np.where(on[:, None], now.course[:, 0], now.own)


def _keep_bearing(law: Constants, now: Sight) -> Floats:
    """A turn 3 to 6 times that of the way to the head, as by dragonflies: proportional navigation."""
    turned = np.cross(now.bearing[:, -1], now.bearing[:, 0])
    return now.own + (3.0 + 3.0 * law.sharpness) * np.cross(turned, now.own)


def _read_climb(law: Constants, now: Sight) -> Floats:
    """The head's climb, read as an angle to a fixed course, as by bees that see a dance."""
    climb = np.arcsin(np.clip(now.course[:, 0, 2], -1.0, 1.0))
    angle = law.course + (1.5 + 1.5 * law.sharpness) * climb
    level = np.hypot(now.own[:, 0], now.own[:, 1])
    return np.stack([level * np.cos(angle), level * np.sin(angle), now.own[:, 2]], axis=1)


def _copy_sharpest(law: Constants, now: Sight) -> Floats:
    """The head's course after the sharpest turn that is seen, as by animals that attend to what is sudden."""
    return now.course[np.arange(len(now.own)), now.turn.argmax(axis=1)]


def _in_rhythm(law: Constants, now: Sight) -> Floats:
    """More and less in turn, with a period of 8 to 16 steps, as fish that burst and coast."""
    return 0.6 + 0.4 * np.sin(2.0 * np.pi * (now.clock / (6.0 + 2.0 * law.delay) + now.phase))


def _in_view(law: Constants, now: Sight) -> Floats:
    """All of it with the head in front, little behind, as of animals with a blind angle."""
    ahead = (now.own * now.bearing[:, 0]).sum(axis=1, keepdims=True)
    return np.where(ahead > -0.3 - 0.5 * law.sharpness, 1.0, 0.2)


def _with_fatigue(law: Constants, now: Sight) -> Floats:
    """The less, the more the head turned, as of senses that get used to a stimulus."""
    return np.exp(-now.turn.sum(axis=1, keepdims=True) / (0.5 + law.sharpness))


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

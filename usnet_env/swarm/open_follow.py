"""Open laws: ways to follow that are composed of parts, with constants drawn at random, so that no prior holds them.

A follower hears its head late (:data:`DELAYS`), answers in one of several ways (:data:`RESPONSES`), and its answer is
bent (:data:`DISTORTIONS`). ``follow="open-1"`` to ``"open-83"`` are the combinations of these parts. Each episode draws
new constants; with ``follow_seed`` all episodes have the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from usnet_env.arrays import Floats, Singles
from usnet_env.swarm.strategy import KAPPA_NOISE, FollowInputs, FollowStrategy

MEMORY = 12  # steps of the head's past that a law uses


class Constants(NamedTuple):
    """The numbers of a law in an episode; what a part makes of them is in its function."""

    delay: float  # steps
    spread: float  # steps
    gain: float  # g
    reach: float  # metres
    sharpness: float  # 0 to 1
    course: float  # radians


NUMBERS = len(Constants._fields)


@dataclass(frozen=True)
class Moment:
    """What n followers know when they answer. All arrays but ``distance`` are ``(n, 3)``.

    ``velocity`` is the follower's, ``heard`` the course of the head as heard, ``before`` that of 3 steps earlier,
    ``to_head`` the vector to the head in metres, and ``distance`` ``(n, 1)`` its length.
    """

    velocity: Floats
    heard: Floats
    before: Floats
    to_head: Floats
    distance: Floats


@dataclass(frozen=True)
class OpenLaw(FollowStrategy):
    """v_{i,t+1} = norm((1 - g) v_{i,t} + g bend(answer(hear(past of the head))) + kappa_g n).

    A follower hears its head ``delay`` steps late, and up to ``spread`` steps more; each has a share of its own. A law
    of another ``number`` draws other constants from the same seed.
    """

    number: int
    hears: str
    answers: str
    bends: str
    noise: float = KAPPA_NOISE
    lags = MEMORY

    @property
    def equation(self) -> str:  # type: ignore[override]  # follows from the fields
        """The parts of the law."""
        return f"open law: hears its head {self.hears}, {self.answers}, and bends {self.bends}"

    def draw_for(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the constants, then the share ``(N,)`` of the spread of each follower."""
        rng = np.random.default_rng([self.number, int(rng.integers(2**63))])
        steps = rng.integers((1, 0), (6, 4))
        sizes = rng.uniform((0.4, 20.0, 0.0, -np.pi), (0.9, 60.0, 1.0, np.pi))
        return np.concatenate([steps, sizes, rng.random(uavs)], dtype=np.float32)

    def direction(self, inputs: FollowInputs) -> Singles:
        """The law."""
        numbers, share = inputs.parameters[:NUMBERS], inputs.parameters[NUMBERS:][inputs.follower]
        constants = Constants(*numbers.tolist())
        to_head = (inputs.head_position[:, 0] - inputs.own_position[:, 0]).astype(np.float64)
        distance = np.linalg.norm(to_head, axis=1, keepdims=True)
        velocity = (inputs.own_position[:, 0] - inputs.own_position[:, 1]).astype(np.float64)
        weights_by_step = DELAYS[self.hears](constants, share, distance[:, 0])
        heard, past_heard = (
            np.einsum("nl,nlc->nc", weights, inputs.head_velocity[:, :MEMORY])
            for weights in (weights_by_step, np.roll(weights_by_step, 3, 1))
        )
        moment = Moment(velocity, to_unit(heard), to_unit(past_heard), to_head, distance)
        answer = to_unit(RESPONSES[self.answers](constants, moment))
        return blend(constants, velocity, *DISTORTIONS[self.bends](constants, answer))


def blend(constants: Constants, velocity: Floats, wanted: Floats, share_of_gain: Floats) -> Singles:
    """The direction between the own velocity and what is wanted, all ``(n, 3)``; ``share_of_gain`` is ``(n, 1)``."""
    gain = constants.gain * share_of_gain
    # A smoother follower would stand out the more by its track alone, so kappa_g is 0.1 (1 - g)^0.5.
    scale = KAPPA_NOISE / (0.1 * (1.0 - constants.gain) ** 0.5)
    return (scale * ((1.0 - gain) * velocity + gain * wanted)).astype(np.float32)


def to_unit(vectors: Floats) -> Floats:
    """Vectors ``(..., 3)`` scaled to length 1."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9))


def _weigh_step(delay: Floats | Singles) -> Floats:
    """Weights ``(n, MEMORY)`` of one step, ``delay`` steps ago."""
    return np.asarray(np.arange(MEMORY) == np.clip(np.rint(delay), 0, MEMORY - 4)[:, None], np.float64)


def _hear_late(constants: Constants, share: Singles, distance: Floats) -> Floats:
    return _weigh_step(constants.delay + constants.spread * share)


def _hear_by_distance(constants: Constants, share: Singles, distance: Floats) -> Floats:
    """The farther, the later: one step more each ``reach`` / 4."""
    return _weigh_step(constants.delay / 2 + 4.0 * distance / constants.reach)


def _hear_with_memory(constants: Constants, share: Singles, distance: Floats) -> Floats:
    """An average in which a step weighs less than the next one, from the delay on."""
    age = np.arange(MEMORY) - np.rint(constants.delay + constants.spread * share)[:, None]
    is_heard = (age >= 0) & (np.arange(MEMORY) < MEMORY - 3)
    weight = np.where(is_heard, (0.4 + 0.5 * constants.sharpness) ** np.maximum(age, 0), 0.0)
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))


def _copy(constants: Constants, moment: Moment) -> Floats:
    return moment.heard


def _copy_large_turns(constants: Constants, moment: Moment) -> Floats:
    """The head's course after a large turn, else the own one."""
    turned = 1.0 - (moment.heard * moment.before).sum(axis=1, keepdims=True)
    return np.where(turned > 0.01 + 0.05 * constants.sharpness, moment.heard, moment.velocity)


def _turn(sign: float, constants: Constants, moment: Moment) -> Floats:
    """The own course, turned about the axis about which the head turned, as the head or against its turn."""
    turn = np.cross(np.cross(moment.before, moment.heard), moment.velocity)
    return moment.velocity + sign * (0.5 + constants.sharpness) * turn


def _pursue_ahead(constants: Constants, moment: Moment) -> Floats:
    """The way to a point ahead of the head, and its course near this point."""
    offset = moment.to_head + constants.reach * moment.heard
    return np.asarray(offset / 20.0 + moment.heard)


def _keep_zone(constants: Constants, moment: Moment) -> Floats:
    """Away from a head that is near, towards one that is far, its course between."""
    pull = np.clip((moment.distance - constants.reach) / constants.reach, -1.0, 1.0)
    return moment.heard + 1.5 * pull * to_unit(moment.to_head)


def _answer_changes(constants: Constants, moment: Moment) -> Floats:
    """A step of equal size on each axis, by the sign of the head's change."""
    change = moment.heard - moment.before
    return moment.velocity + (0.1 + 0.3 * constants.sharpness) * np.sign(change) * (np.abs(change) > 0.05)


def _keep(constants: Constants, wanted: Floats) -> tuple[Floats, Floats]:
    return wanted, np.ones((1, 1))


def _round_course(constants: Constants, wanted: Floats) -> tuple[Floats, Floats]:
    """Courses are multiples of 15 to 60 degrees from the course of the law."""
    unit = np.pi / np.rint(12.0 - 9.0 * constants.sharpness)
    azimuth = np.rint((np.arctan2(wanted[:, 1], wanted[:, 0]) - constants.course) / unit) * unit + constants.course
    level = np.hypot(wanted[:, 0], wanted[:, 1])
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), wanted[:, 2]], axis=1), np.ones((1, 1))


def _favour_course(constants: Constants, wanted: Floats) -> tuple[Floats, Floats]:
    """The gain depends on the course: all of it along that of the law, little against it."""
    along = np.cos(np.arctan2(wanted[:, 1], wanted[:, 0]) - constants.course)
    return wanted, (0.55 + 0.45 * along)[:, None]


def _turn_aside(constants: Constants, wanted: Floats) -> tuple[Floats, Floats]:
    """The answer is turned by up to 60 degrees to a side."""
    angle = np.pi / 3 * (2 * constants.sharpness - 1)
    cos, sin = np.cos(angle), np.sin(angle)
    turned = wanted @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return turned, np.ones((1, 1))


DELAYS: dict[str, Callable[[Constants, Singles, Floats], Floats]] = {
    "late": _hear_late, "by distance": _hear_by_distance, "with memory": _hear_with_memory
}  # fmt: skip
RESPONSES: dict[str, Callable[[Constants, Moment], Floats]] = {
    "copies": _copy, "copies large turns": _copy_large_turns, "turns alike": partial(_turn, 1.0),
    "turns against": partial(_turn, -1.0), "pursues ahead": _pursue_ahead, "keeps a zone": _keep_zone,
    "answers changes": _answer_changes,
}  # fmt: skip
DISTORTIONS: dict[str, Callable[[Constants, Floats], tuple[Floats, Floats]]] = {
    "nothing": _keep, "to round courses": _round_course, "by its course": _favour_course, "aside": _turn_aside
}  # fmt: skip


#: The laws by name. That of number 0, a bare late copy, is none of them.
_PARTS = enumerate(product(DELAYS, RESPONSES, DISTORTIONS))
OPEN_LAWS = {f"open-{number}": OpenLaw(number, *parts) for number, parts in _PARTS if number}

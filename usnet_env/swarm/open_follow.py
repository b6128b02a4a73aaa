"""Open laws: ways to follow that are composed at random from a seed, so that no prior can hold them.

A follower hears its head late (:data:`HEARD`), answers in one of several ways (:data:`ANSWERS`), and its answer is bent
(:data:`BENT`). ``follow="open-1"`` to ``"open-10"`` select the laws of the seed in the environment variable
``USNET_OPEN_SEED``, by default those of :data:`PUBLIC_SEED`. The suite ``open`` has the hash of another seed.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from usnet_env.arrays import Floats, Singles
from usnet_env.swarm.strategy import FollowInputs, FollowStrategy

PUBLIC_SEED = 71841
LAWS = 10
MEMORY = 12  # steps of the head's past that a law uses


@dataclass(frozen=True)
class Moment:
    """What n followers know when they answer. All arrays but ``distance`` are ``(n, 3)``.

    ``own`` is the follower's velocity, ``heard`` the course of the head as heard, ``before`` that of 3 steps earlier,
    ``gap`` the way to the head in metres, and ``distance`` ``(n, 1)`` its length.
    """

    own: Floats
    heard: Floats
    before: Floats
    gap: Floats
    distance: Floats


@dataclass(frozen=True)
class OpenLaw(FollowStrategy):
    """v_{i,t+1} = norm((1 - g) v_{i,t} + g bend(answer(hear(past of the head))) + kappa_n n).

    A follower hears its head ``delay`` steps late, and up to ``spread`` steps more; each has a share of its own. What a
    part makes of the other constants is in its function.
    """

    hears: str
    answers: str
    bends: str
    delay: int  # steps
    spread: int  # steps
    gain: float  # g
    reach: float  # metres
    sharpness: float  # 0 to 1
    course: float  # radians
    noise: float  # kappa_n
    lags = MEMORY

    @property
    def equation(self) -> str:  # type: ignore[override]  # follows from the fields
        """The parts of the law."""
        return f"open law: hears its head {self.hears}, {self.answers}, and bends {self.bends}"

    def draw_for(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the share ``(N,)`` of the spread of each follower."""
        return rng.random(uavs, dtype=np.float32)

    def direction(self, inputs: FollowInputs) -> Singles:
        """The law."""
        gap = (inputs.head_position[:, 0] - inputs.own_position[:, 0]).astype(np.float64)
        distance = np.linalg.norm(gap, axis=1, keepdims=True)
        share = inputs.parameters[inputs.follower]
        own = (inputs.own_position[:, 0] - inputs.own_position[:, 1]).astype(np.float64)
        late = HEARD[self.hears](self, share, distance[:, 0])
        heard, before = (
            np.einsum("nl,nlc->nc", weights, inputs.head_velocity[:, :MEMORY])
            for weights in (late, np.roll(late, 3, 1))
        )
        answer = ANSWERS[self.answers](self, Moment(own, _unit(heard), _unit(before), gap, distance))
        bent, share_of_gain = BENT[self.bends](self, _unit(answer))
        gain = self.gain * share_of_gain
        return ((1.0 - gain) * own + gain * bent).astype(np.float32)


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9))


def _at(late: Floats | Singles) -> Floats:
    """Weights ``(n, MEMORY)`` of one step, ``late`` steps ago."""
    return np.asarray(np.arange(MEMORY) == np.clip(np.rint(late), 0, MEMORY - 4)[:, None], np.float64)


def _hear_late(law: OpenLaw, share: Singles, distance: Floats) -> Floats:
    return _at(law.delay + law.spread * share)


def _hear_by_distance(law: OpenLaw, share: Singles, distance: Floats) -> Floats:
    """The farther, the later: one step more each ``reach`` / 4."""
    return _at(law.delay / 2 + 4.0 * distance / law.reach)


def _hear_with_memory(law: OpenLaw, share: Singles, distance: Floats) -> Floats:
    """An average in which a step weighs less than the next one, from the delay on."""
    age = np.arange(MEMORY) - np.rint(law.delay + law.spread * share)[:, None]
    heard = (age >= 0) & (np.arange(MEMORY) < MEMORY - 3)
    weight = np.where(heard, (0.4 + 0.5 * law.sharpness) ** np.maximum(age, 0), 0.0)
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))


def _copy(law: OpenLaw, now: Moment) -> Floats:
    return now.heard


def _copy_large_turns(law: OpenLaw, now: Moment) -> Floats:
    """The head's course after a large turn, else the own one."""
    turned = 1.0 - (now.heard * now.before).sum(axis=1, keepdims=True)
    return np.where(turned > 0.01 + 0.05 * law.sharpness, now.heard, now.own)


def _turn_alike(law: OpenLaw, now: Moment) -> Floats:
    """The own course, turned about the axis about which the head turned."""
    return now.own + (0.5 + law.sharpness) * np.cross(np.cross(now.before, now.heard), now.own)


def _turn_against(law: OpenLaw, now: Moment) -> Floats:
    """The own course, turned against the head's turn."""
    return now.own - (0.5 + law.sharpness) * np.cross(np.cross(now.before, now.heard), now.own)


def _pursue_ahead(law: OpenLaw, now: Moment) -> Floats:
    """The way to a point ahead of the head, and its course near this point."""
    way = now.gap + law.reach * now.heard
    return np.asarray(way / 20.0 + now.heard)


def _keep_zone(law: OpenLaw, now: Moment) -> Floats:
    """Away from a head that is near, towards one that is far, its course between."""
    pull = np.clip((now.distance - law.reach) / law.reach, -1.0, 1.0)
    return now.heard + 1.5 * pull * _unit(now.gap)


def _answer_changes(law: OpenLaw, now: Moment) -> Floats:
    """A step of equal size on each axis, by the sign of the head's change."""
    change = now.heard - now.before
    return now.own + (0.1 + 0.3 * law.sharpness) * np.sign(change) * (np.abs(change) > 0.05)


def _keep(law: OpenLaw, wanted: Floats) -> tuple[Floats, Floats]:
    return wanted, np.ones((1, 1))


def _round_course(law: OpenLaw, wanted: Floats) -> tuple[Floats, Floats]:
    """Courses are multiples of 15 to 60 degrees from the course of the law."""
    unit = np.pi / np.rint(12.0 - 9.0 * law.sharpness)
    azimuth = np.rint((np.arctan2(wanted[:, 1], wanted[:, 0]) - law.course) / unit) * unit + law.course
    level = np.hypot(wanted[:, 0], wanted[:, 1])
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), wanted[:, 2]], axis=1), np.ones((1, 1))


def _favour_course(law: OpenLaw, wanted: Floats) -> tuple[Floats, Floats]:
    """The gain depends on the course: all of it along that of the law, little against it."""
    along = np.cos(np.arctan2(wanted[:, 1], wanted[:, 0]) - law.course)
    return wanted, (0.55 + 0.45 * along)[:, None]


def _turn_aside(law: OpenLaw, wanted: Floats) -> tuple[Floats, Floats]:
    """The answer is turned by up to 60 degrees to a side."""
    angle = np.pi / 3 * (2 * law.sharpness - 1)
    cos, sin = np.cos(angle), np.sin(angle)
    turned = wanted @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return turned, np.ones((1, 1))


HEARD: dict[str, Callable[[OpenLaw, Singles, Floats], Floats]] = {
    "late": _hear_late, "by distance": _hear_by_distance, "with memory": _hear_with_memory
}  # fmt: skip
ANSWERS: dict[str, Callable[[OpenLaw, Moment], Floats]] = {
    "copies": _copy, "copies large turns": _copy_large_turns, "turns alike": _turn_alike,
    "turns against": _turn_against, "pursues ahead": _pursue_ahead, "keeps a zone": _keep_zone,
    "answers changes": _answer_changes,
}  # fmt: skip
BENT: dict[str, Callable[[OpenLaw, Floats], tuple[Floats, Floats]]] = {
    "nothing": _keep, "to round courses": _round_course, "by its course": _favour_course, "aside": _turn_aside
}  # fmt: skip


def draw_laws(seed: int) -> dict[str, OpenLaw]:
    """Draw the laws ``open-1`` to ``open-10`` of a seed; no two have the same parts, and a bare late copy is none."""
    rng = np.random.default_rng(seed)
    parts = [each for each in product(HEARD, ANSWERS, BENT) if each != ("late", "copies", "nothing")]
    chosen = rng.choice(len(parts), LAWS, replace=False)
    return {f"open-{number}": _draw_law(rng, parts[part]) for number, part in enumerate(chosen, 1)}


def _draw_law(rng: np.random.Generator, parts: tuple[str, str, str]) -> OpenLaw:
    delay, spread = (int(number) for number in rng.integers((1, 0), (6, 4)))
    sizes = rng.uniform((0.4, 20.0, 0.0, -np.pi), (0.9, 60.0, 1.0, np.pi))
    gain, reach, sharpness, course = (float(size) for size in sizes)
    noise = 0.1 * (1.0 - gain) ** 0.5  # a smoother follower would stand out the more by its track alone
    return OpenLaw(*parts, delay, spread, gain, reach, sharpness, course, noise)


#: The laws by name.
OPEN_LAWS = draw_laws(int(os.environ.get("USNET_OPEN_SEED", PUBLIC_SEED)))

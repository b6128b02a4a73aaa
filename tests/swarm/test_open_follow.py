"""Open laws: what an episode draws, and how followers fly by them."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from flights import fly, generators, unit

from usnet_env.swarm import SwarmConfig, start
from usnet_env.swarm import second_follow as second
from usnet_env.swarm.open_follow import DELAYS, DISTORTIONS, MEMORY, OPEN_LAWS, RESPONSES, Constants, OpenLaw
from usnet_env.swarm.strategy import FollowInputs

PLAIN = Constants(delay=3, spread=0, gain=0.7, reach=40.0, sharpness=0.5, course=1.0)


@dataclass(frozen=True)
class FixedLaw(OpenLaw):
    """A law whose constants are not drawn."""

    constants: Constants = PLAIN

    def draw_for(self, rng, uavs):
        return np.array([*self.constants, *rng.random(uavs)], np.float32)


def test_the_laws_are_all_combinations_but_a_bare_late_copy():
    parts = [(law.hears, law.answers, law.bends) for law in OPEN_LAWS.values()]
    assert parts == [each for each in product(DELAYS, RESPONSES, DISTORTIONS) if each != ("late", "copies", "nothing")]
    assert list(OPEN_LAWS) == [f"open-{number}" for number in range(1, 84)]
    parts = [(law.hears, law.answers, law.bends) for law in second.SECOND_LAWS.values()]
    assert parts == list(product(second.SEEN, second.ANSWERS, second.STRENGTH))
    assert list(second.SECOND_LAWS) == [f"second-{number}" for number in range(1, 55)]


def test_follow_seed_fixes_the_constants_which_differ_from_law_to_law():
    def draw(follow, seed, uavs=24, **fixed):
        config = SwarmConfig(follow=follow, memory=12, clusters=2, uavs=uavs, **fixed)
        return start(config, generators([seed])).parameters[0]

    first = draw("open-5", 0, follow_seed=4)
    assert len(first) == len(PLAIN) + 24
    assert np.array_equal(first, draw("open-5", 1, follow_seed=4))
    assert np.array_equal(first, draw("open-5", 0, uavs=40, follow_seed=4)[: len(first)])
    for other in (draw("open-6", 0, follow_seed=4), draw("open-5", 0, follow_seed=5), draw("open-5", 0)):
        assert (first[2:] != other[2:]).all()
    drawn = np.array([draw("open-1", seed)[:6] for seed in range(200)])
    for column, low, high in zip(drawn.T, (1, 0, 0.4, 20, 0, -np.pi), (5, 3, 0.9, 60, 1, np.pi), strict=True):
        assert low <= column.min() < low + 0.03 * (high - low)
        assert high >= column.max() > high - 0.03 * (high - low)


def test_the_noise_is_less_with_a_larger_gain():
    """It is 0.1 (1 - g)^0.5, beside a head that flies straight on."""
    for gain in (0.4, 0.9):
        law = FixedLaw(0, "late", "copies", "nothing", constants=PLAIN._replace(gain=gain))
        state, window = fly(law, memory=12, mobility="straight", uavs=60)
        velocity, followers = window.velocity[0].astype(float), np.flatnonzero(~state.head)
        wanted = (1 - gain) * velocity[:-1, followers] + gain * velocity[:-1, state.root[followers]]
        flown = velocity[1:, followers]
        across = flown / (flown * wanted).sum(axis=2, keepdims=True) - wanted
        measured = np.sqrt((across**2).sum(axis=2).mean() / 2)
        assert measured == pytest.approx(0.1 * (1 - gain) ** 0.5, rel=0.06)


@pytest.mark.parametrize("bends", ["nothing", "aside"])
def test_flight_obeys_a_literal_reading(bends):
    law = FixedLaw(0, "late", "copies", bends, noise=0.0, constants=PLAIN._replace(sharpness=1.0))
    state, window = fly(law, memory=12, mobility="gauss_markov")
    velocity = window.velocity[0].astype(float)
    turn = np.pi / 3 if bends == "aside" else 0.0
    turned = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    i = np.flatnonzero(~state.head)
    wanted = 0.3 * velocity[5:-1, i] + 0.7 * velocity[2:-4, state.root[i]] @ turned.T
    np.testing.assert_allclose(velocity[6:, i], unit(wanted), atol=1e-4)


def make_inputs(uavs=30):
    rng = np.random.default_rng(3)
    head = np.cumsum(rng.normal(0, 0.3, (uavs, MEMORY, 3)), axis=1) + rng.normal(size=(uavs, 1, 3))
    head /= np.linalg.norm(head, axis=2, keepdims=True)
    place = rng.uniform(-60, 60, (uavs, 1, 3)) - np.cumsum(
        np.concatenate([np.zeros((uavs, 1, 3)), head], axis=1), axis=1
    )
    own = rng.uniform(-60, 60, (uavs, 1, 3)) + rng.normal(0, 0.6, (uavs, MEMORY + 1, 3))
    constants = PLAIN._replace(delay=2, spread=3, reach=30.0, sharpness=0.3)
    return FollowInputs(own, head, place, np.array([*constants, *rng.random(uavs)], np.float32))


@pytest.mark.parametrize(
    "law", [*OPEN_LAWS.values(), *second.SECOND_LAWS.values()], ids=[*OPEN_LAWS, *second.SECOND_LAWS]
)
def test_a_follower_depends_on_its_own_row_and_on_the_head(law):
    inputs = make_inputs()
    direction, rows = law.direction(inputs), np.arange(30)
    assert np.isfinite(direction).all()
    for names in (["own_position"], ["head_velocity", "head_position"]):
        changed = {name: getattr(inputs, name).copy() for name in names}
        for array in changed.values():
            array[7:12] = array[7:12, ::-1]
        after = (law.direction(replace(inputs, **changed)) != direction).any(axis=1)
        assert after[7:12].any()
        assert not after[(rows < 7) | (rows >= 12)].any()


def test_what_is_heard_is_an_average_of_the_past():
    share, distance = np.linspace(0, 1, 9, dtype=np.float32), np.linspace(0, 300, 9)
    for hear in DELAYS.values():
        weights = hear(PLAIN._replace(delay=5, spread=3), share, distance)
        np.testing.assert_allclose(weights.sum(axis=1), 1.0)
        assert (weights[:, MEMORY - 3 :] == 0).all()  # the velocity 3 steps before is known too
        age = weights @ np.arange(MEMORY)
        assert (np.diff(age) >= 0).all()
        assert age[0] < age[-1]

"""Follow strategies: equations, the slow loop, a user's own; open laws: what an episode draws, and their parts."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from flights import fly, generators, unit
from numpy_laws import slow

from usnet_env import ArgumentError, register_follow_strategy
from usnet_env.swarm import FOLLOW_STRATEGIES, FollowStrategy, SwarmConfig, advance, destroy, start
from usnet_env.swarm import second_follow as second
from usnet_env.swarm.follow import TanhNetworkStrategy
from usnet_env.swarm.open_follow import DELAYS, DISTORTIONS, MEMORY, OPEN_LAWS, RESPONSES, Constants, OpenLaw
from usnet_env.swarm.random_follow import random_follow_strategy
from usnet_env.swarm.second_follow import ANSWERS, STEPS, Sight
from usnet_env.swarm.strategy import FollowInputs

NAMES = ["f1", "f2", "f3", "f4", "f5", "f6", "f7"]


@pytest.mark.parametrize("formation", ["uniform", "around"])
@pytest.mark.parametrize(("name", "seed"), [*((name, 0) for name in NAMES), *(("random", seed) for seed in range(4))])
def test_proposition_1_holds(name, seed, formation):
    """The loss (15) is 0 where the IFSN is the strategy and all attention is on the head, by (16) and (17).

    So compiled loops fly what ``numpy_laws.py`` says; one formation has followers nearer than f6's reach, one farther.
    """
    strategy = FOLLOW_STRATEGIES[name]
    swarm, window = fly(replace(strategy, noise=0.0), seed=seed, formation=formation, memory=4, uavs=9)
    p, v = window.position[0].astype(float), window.velocity[0].astype(float)
    i = np.flatnonzero(~swarm.head)
    network = slow(strategy, swarm.parameters)
    losses = []
    for noticed in (swarm.root[i], np.roll(swarm.root[i], 1)):
        alpha, loss = (noticed[:, None] == np.arange(9)).astype(float), 0.0
        for t in range(3, len(v) - 1):
            pooled = np.einsum("ij,ljk->ilk", alpha, v[t - 3 : t + 1][::-1])  # (16)
            oldest = alpha @ p[t - 3]  # (17)
            # appendix A.1: the later positions follow from the oldest one and the velocities
            place = oldest[:, None] + np.pad(pooled[:, ::-1], ((0, 0), (1, 0), (0, 0))).cumsum(axis=1)
            own = p[t - 3 : t + 2, i][::-1].swapaxes(0, 1)
            predicted = network.direction(FollowInputs(own, pooled, place[:, ::-1], swarm.parameters))
            loss += ((v[t + 1, i] - unit(predicted)) ** 2).sum()
        losses.append(loss)
    assert losses[0] == pytest.approx(0.0, abs=1e-3)
    assert losses[1] > 10.0


def test_a_registered_function_is_used_by_name():
    def mirror(inputs: FollowInputs):
        return -inputs.head_velocity[:, 0]

    register_follow_strategy("test-mirror-0", mirror, lags=1, noise=0.0, equation="v = -v_L", replace=True)
    swarm, window = fly("test-mirror-0")
    i = np.flatnonzero(~swarm.head)[0]
    np.testing.assert_allclose(window.velocity[0, 1:, i], -window.velocity[0, :-1, swarm.root[i]], atol=1e-5)
    assert FOLLOW_STRATEGIES["test-mirror-0"].equation == "v = -v_L"
    with pytest.raises(ArgumentError, match="strategy must"):
        register_follow_strategy("test-x", 3)
    for name, value in (("lags", 0), ("lags", -3), ("noise", -5), ("noise", "0")):
        with pytest.raises(ArgumentError, match=rf"^{name} must"):
            register_follow_strategy("test-x", mirror, **{name: value})


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (np.zeros(3), r"must have shape \(\d+, 3\), got \(3,\)"),
        (None, r"must have shape .* got None"),
        (np.full((1, 3), np.nan), "must hold finite numbers"),
    ],
)
def test_a_strategy_that_returns_no_directions_is_named(answer, words):
    class Wrong(FollowStrategy):
        def direction(self, inputs):
            return answer if np.ndim(answer) < 2 else answer.repeat(len(inputs.follower), axis=0)

    register_follow_strategy("test-bad", lambda inputs: Wrong().direction(inputs), replace=True)
    for follow, name in (("test-bad", "'test-bad'"), (Wrong(), "Wrong")):
        with pytest.raises(ArgumentError, match=f"^directions of follow strategy {name} {words}"):
            fly(follow)


def random_inputs(rng, n=400):
    head_velocity = rng.standard_normal((n, 4, 3)).astype(np.float32)
    head_velocity /= np.linalg.norm(head_velocity, axis=-1, keepdims=True)
    own, head = rng.uniform(0, 500, (2, n, 5, 3)).astype(np.float32)
    return FollowInputs(own, head_velocity, head, np.empty(0, np.float32))


def cosine(a, b):
    return ((a * b).sum(axis=1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1) + 1e-9)).mean()


def test_random_strategies_are_none_of_the_seven():
    rng = np.random.default_rng(0)
    inputs = random_inputs(rng)
    tables = [slow(FOLLOW_STRATEGIES[name], np.empty(0)).direction(inputs) for name in NAMES[:6]]
    for _ in range(400):
        law = random_follow_strategy(rng)
        wanted = slow(law, law.pack()).direction(replace(inputs, parameters=law.pack()))
        assert max(cosine(wanted, table) for table in tables) < 0.995


def test_f7_depends_on_its_head():
    inputs = random_inputs(np.random.default_rng(0))
    still = inputs.own_position[:, :1].repeat(5, axis=1)
    inputs = replace(inputs, own_position=still, parameters=TanhNetworkStrategy().draw(np.random.default_rng(1)))
    turned = replace(inputs, head_velocity=-inputs.head_velocity)
    scales = {}, {"position_scale": 1.0}
    network, saturated = (slow(TanhNetworkStrategy(**scale), inputs.parameters) for scale in scales)
    assert cosine(network.direction(inputs), network.direction(turned)) < 0.2
    assert cosine(saturated.direction(inputs), saturated.direction(turned)) > 0.9


@pytest.mark.parametrize("gone", ["follower", "head"])
def test_a_follower_keeps_its_number_when_others_are_destroyed(gone):
    class OwnDelays(FollowStrategy):
        lags = 3
        noise = 0.0

        def direction(self, inputs):
            return inputs.head_velocity[np.arange(len(inputs.follower)), inputs.follower % 3]

    config = SwarmConfig(follow=OwnDelays(), clusters=2, uavs=14, decoys=1, observation_steps=20)
    rngs = generators([0])
    state = start(config, rngs)
    first = np.flatnonzero(~(state.head | state.decoy)[0])
    candidates = np.zeros((1, 14), bool)
    candidates[0, first[0] if gone == "follower" else np.flatnonzero(state.head[0])[0]] = True
    state = destroy(state, candidates)
    _, window = advance(config, state, rngs)
    velocity = window.velocity[0]
    for number, i in enumerate(first):
        if state.alive[0, i]:
            late = number % 3
            copied = velocity[2 - late : -1 - late, state.root[0, i]]
            np.testing.assert_allclose(velocity[3:, i], copied, atol=1e-5)


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
    assert np.array_equal(*start(SwarmConfig(follow="f7", follow_seed=3), generators([0, 9])).parameters)
    assert not np.array_equal(*start(SwarmConfig(follow="f7"), generators([0, 9])).parameters)
    drawn = np.array([draw("open-1", seed)[:6] for seed in range(200)])
    for column, low, high in zip(drawn.T, (1, 0, 0.4, 20, 0, -np.pi), (5, 3, 0.9, 60, 1, np.pi), strict=True):
        assert low <= column.min() < low + 0.03 * (high - low)
        assert high >= column.max() > high - 0.03 * (high - low)


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
    flown = np.pad(head, ((0, 0), (1, 0), (0, 0))).cumsum(axis=1)
    place = rng.uniform(-60, 60, (uavs, 1, 3)) - flown
    own = rng.uniform(-60, 60, (uavs, 1, 3)) + rng.normal(0, 0.6, (uavs, MEMORY + 1, 3))
    constants = PLAIN._replace(delay=2, spread=3, reach=30.0, sharpness=0.3)
    return FollowInputs(own, head, place, np.array([*constants, *rng.random(uavs)], np.float32))


@pytest.mark.parametrize("law", (laws := OPEN_LAWS | second.SECOND_LAWS).values(), ids=list(laws))
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


LAW = Constants(delay=3, spread=2, gain=0.7, reach=40.0, sharpness=0.5, course=1.0)
PHASE = np.linspace(0, 0.99, 9)[:, None]


def see(azimuth=(0.0,) * STEPS, climb=0.0):
    """What 9 followers that fly along x see of a head ahead that flies these courses, newest first."""
    level = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(STEPS)], axis=1)
    course = np.cos(climb) * level + [0.0, 0.0, np.sin(climb)]
    own = np.tile([1.0, 0.0, 0.0], (9, 1))
    return Sight(own, np.tile(course, (9, 1, 1)), np.tile(own[:, None], (1, STEPS, 1)), PHASE, 0)


@pytest.mark.parametrize(
    ("answer", "seen", "azimuth"),
    [
        ("answers its jerk", see(0.1 * np.arange(STEPS)), 0.0),  # it turns evenly, so the push is along its course
        ("answers the sum of its turns", see(4.0 - np.arange(STEPS)), 0.6 * 6),  # almost a whole turn
        ("copies like a relay", see(np.full(STEPS, 0.7)), 0.0),
        ("copies like a relay", see(np.array([0.7, 0.64, 0.58, 0.52, 0.3, 0.0, 0.0])), 0.7),  # sharp, then less
        ("copies like a relay", see(np.array([0.7, 0.64, 0.58, 0.52, 0.46, 0.4, 0.34])), 0.0),  # never sharp
        ("copies like a relay", see(np.array([0.7, 0.7, 0.7, 0.7, 0.4, 0.0, 0.0])), 0.0),  # sharp, then straight
        ("keeps its bearing", see(np.full(STEPS, 0.7)), 0.0),
        ("reads its climb", see(climb=0.2), 1.0 + 2.25 * 0.2),
        ("copies its sharpest turn", see(np.array([0.9, 0.85, 0.8, 0.75, 0.1, 0.07, 0.0])), 0.8),
    ],
)
def test_an_answer_is_the_course_that_its_words_say(answer, seen, azimuth):
    wanted = ANSWERS[answer](LAW, seen)
    found = np.arctan2(wanted[:, 1], wanted[:, 0])
    np.testing.assert_allclose(np.cos(found - azimuth), 1.0, atol=1e-3)

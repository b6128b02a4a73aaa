"""Follow strategies: against their equations, against the slow loop, and as a user registers them."""

from dataclasses import replace

import numpy as np
import pytest
from flights import fly, generators, unit
from numpy_laws import slow

from usnet_env import ArgumentError, register_follow_strategy
from usnet_env.swarm import FOLLOW_STRATEGIES, FollowStrategy, SwarmConfig, advance, destroy, start
from usnet_env.swarm.follow import TanhNetworkStrategy
from usnet_env.swarm.random_follow import random_follow_strategy
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


def test_followers_noise_has_the_table_s_size():
    """f1 with noise: the part of v_{i,t+1} across v_{iL,t} is kappa_n n before normalisation."""
    swarm, window = fly("f1", observation_steps=3000)
    v = window.velocity[0].astype(float)
    i = np.flatnonzero(~swarm.head)[0]
    led, flown = v[:-1, swarm.root[i]], v[1:, i]
    along = (led * flown).sum(axis=1, keepdims=True)
    across = (flown - along * led) / along  # undo norm(): components in metres of v_{iL}
    assert np.sqrt((across**2).sum(axis=1).mean() / 2) == pytest.approx(0.05, rel=0.05)


def test_f7_draws_a_network_an_episode_unless_seeded():
    free = start(SwarmConfig(follow="f7"), generators([0, 1])).parameters
    fixed = start(SwarmConfig(follow="f7", follow_seed=3), generators([0, 1])).parameters
    assert not np.array_equal(free[0], free[1])
    assert np.array_equal(fixed[0], fixed[1])
    assert np.array_equal(fixed[0], start(SwarmConfig(follow="f7", follow_seed=3), generators([9])).parameters[0])


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
    register_follow_strategy("test-bad", lambda inputs: np.zeros(3), replace=True)
    with pytest.raises(ValueError, match="reshape"):
        fly("test-bad")


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

"""Evasion: how the choices of heads change the flight, their prices, the rewards, and the agents in the game."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from hypothesis import given, settings
from hypothesis import strategies as st
from small_games import assert_single_game, drawn, small

import usnet_env  # noqa: F401  # registers the single-agent environments
from usnet_env import ArgumentError
from usnet_env.multiagent import usnet_evasion_v0
from usnet_env.multiagent.evasion import Manoeuvres, Plan, compute_prices, fly_windows, select_decoys
from usnet_env.swarm import FollowInputs, SwarmConfig, start
from usnet_env.swarm.follow import FollowFunction, LaggedSum, StayInRange

OBSERVER = "observer_0"
TRUTHFUL = [0, 0, 0, 0]


def plan_of(heads, **choices):
    values = {name: np.zeros((1, heads), np.int64) for name in ("mobility", "jitter", "decoys", "delay")}
    for name, value in choices.items():
        values[name][:] = value
    return Plan(**values)


def a_swarm(seed=0, **arguments):
    config = SwarmConfig(**{"clusters": 2, "uavs": 20, "observation_steps": 60, "memory": 8, **arguments})
    rngs = [np.random.default_rng(seed)]
    return config, start(config, rngs), rngs


def flown(config, state, rngs, plan, manoeuvres=None, before=None):
    before = np.zeros((1, config.clusters), np.int64) if before is None else before
    return fly_windows(config, manoeuvres or Manoeuvres(), state, before, plan, select_decoys(state, plan), rngs)


def act(env, named=(), **choices):
    """An action for each agent: the candidates of the observer, and the choices of heads (0 by default)."""
    vote = np.zeros(env.config.uavs, np.int8)
    vote[list(named)] = 1
    heads = {agent: choices.get(agent, TRUTHFUL) for agent in env.agents if agent != OBSERVER}
    return {OBSERVER: vote, **heads}


@pytest.mark.parametrize(("follow", "seed"), [("f1", 0), ("f3", 1), ("f6", 2), ("f7", 12345)])
def test_truthful_heads_fly_as_in_the_single_agent_game(follow, seed):
    arguments = {"clusters": 3, "uavs": 20, "observation_steps": 20, "memory": 8, "follow": follow, "decoys": 1}
    single = gym.make("USNET/MultiCluster-v0", **arguments).unwrapped
    env = usnet_evasion_v0.parallel_env(**arguments)
    expected, _ = single.reset(seed=seed)
    env.reset(seed=seed)
    observations, rewards, *_ = env.step(act(env))
    assert set(rewards.values()) == {0.0}
    assert_single_game(single, env, expected, observations, lambda named: act(env, np.flatnonzero(named)))


def pull_from_afar(inputs):
    gap = inputs.head_position[:, 1] - inputs.own_position[:, 1]
    distance = np.linalg.norm(gap, axis=1, keepdims=True)
    return inputs.head_velocity[:, 0] + (distance > 60) * gap / np.maximum(distance, 1e-6)


@pytest.mark.parametrize(
    ("strategy", "direct"),
    [
        (LaggedSum(3, square=True, noise=0.0), lambda one: (one.head_velocity[:, :3] ** 2).sum(axis=1)),
        (StayInRange(noise=0.0), pull_from_afar),
        (FollowFunction(lambda one: one.head_velocity[:, 1], noise=0.0), lambda one: one.head_velocity[:, 1]),
    ],
)
def test_delayed_followers_see_the_past_of_their_head(strategy, direct):
    """Against equation (1) in NumPy, with the head's track shifted by the delay; f6 depends on the distance."""
    config, state, rngs = a_swarm(follow=strategy, formation="around", seed=3)
    heads = np.flatnonzero(state.head[0])
    _, sighting, _ = flown(config, state, rngs, plan_of(2, delay=[2, 4]))
    place, v = sighting.position[0], sighting.velocity[0]
    for head, late in zip(heads, (2, 4), strict=True):
        followers = np.flatnonzero((state.root[0] == head) & ~state.head[0])
        for t in range(10, 60):
            inputs = FollowInputs(
                own_position=place[t - 8 : t + 1, followers][::-1].swapaxes(0, 1),
                head_velocity=np.repeat(v[t - 4 - late : t - late, head][::-1][None], len(followers), axis=0),
                head_position=np.repeat(place[t - 4 - late : t + 1 - late, head][::-1][None], len(followers), axis=0),
                parameters=state.parameters[0],
            )
            wanted = direct(inputs)
            wanted = wanted / np.linalg.norm(wanted, axis=1, keepdims=True)
            np.testing.assert_allclose(v[t, followers], wanted, atol=2e-3)


def test_decoys_fly_by_themselves_and_leave_their_head_a_follower():
    config, state, rngs = a_swarm(cluster_sizes=(2, 16), follow=LaggedSum(1, noise=0.0))
    uavs, taken = select_decoys(state, plan_of(2, decoys=[5, 5]))
    who, rows = uavs[taken], np.nonzero(taken)[1]
    assert sorted(np.bincount(rows)) == [1, 5]  # the head with 2 followers keeps one
    _, sighting, _ = flown(config, state, rngs, plan_of(2, decoys=[5, 5]))
    v = sighting.velocity[0]
    heads = np.flatnonzero(state.head[0])
    for i in np.flatnonzero(~state.head[0]):
        follows = np.allclose(v[1:, i], v[:-1, state.root[0, i]], atol=1e-5)
        assert follows != (i in who)
    for row, head in enumerate(heads):  # the nearest followers are selected
        mine = np.flatnonzero((state.root[0] == head) & ~state.head[0])
        away = np.linalg.norm(state.position[0, mine] - state.position[0, head], axis=1)
        taken = np.isin(mine, who[rows == row])
        assert away[taken].max() <= away[~taken].min()


def test_each_head_flies_the_mobility_it_chose():
    config, state, rngs = a_swarm(observation_steps=200)
    heads = np.flatnonzero(state.head[0])
    offer = Manoeuvres(mobilities=("iid", "straight"))
    _, sighting, now = flown(config, state, rngs, plan_of(2, mobility=[1, 0]), offer)
    v = sighting.velocity[0]
    np.testing.assert_array_equal(now, [[1, 0]])
    np.testing.assert_allclose(v[:, heads[0]], v[[0], heads[0]].repeat(200, axis=0), atol=1e-6)
    turns = (v[1:, heads[1]] * v[:-1, heads[1]]).sum(axis=1)
    assert abs(turns.mean()) < 0.2
    np.testing.assert_allclose(np.linalg.norm(v, axis=-1), 1.0, atol=1e-4)


def test_the_price_by_its_formula():
    _, state, _ = a_swarm(cluster_sizes=(6, 12))
    heads = np.flatnonzero(state.head[0])
    led = np.array([((state.root[0] == head) & ~state.head[0]).sum() for head in heads])
    offer = Manoeuvres(mobility_price=0.3, jitter_price=0.2, decoy_price=2.0, delay_price=0.1)
    got = compute_prices(offer, state, plan_of(2, mobility=[2, 0], jitter=[1, 0], decoys=[2, 1], delay=[0, 4]))
    expected = [(led[0] + 1) * 0.5 + 2.0 * 2, 2.0 * 1 + 0.1 * 4 * (led[1] - 1)]
    np.testing.assert_allclose(got[0], np.array(expected) / 20)
    assert compute_prices(offer, state, plan_of(2)).tolist() == [[0.0, 0.0]]


@pytest.mark.filterwarnings("ignore:redundancy_price is 0")
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31), share=st.floats(0, 0.5), scale=st.sampled_from([0.0, 0.5, 1.0, 3.0]))
def test_zero_sum_on_j_m_up_to_the_price(seed, share, scale):
    """In every step, for every head: observer + head + price = 0; and the observer's return is -J_m.

    Candidates in the opening, when nothing is seen, do not count.
    """
    env = small("evasion", max_rounds=5, redundancy_price=scale)
    rng = np.random.default_rng(seed)
    observations, infos = env.reset(seed=seed)
    total, swarm, rounds, redundant = 0.0, env.swarm, 0, 0
    while env.agents:
        actions = drawn(env, rng, observations, share)
        alive = swarm.alive
        opening = not observations[OBSERVER]["legal"].any()
        assert opening == (not observations[OBSERVER]["seen"].any())
        observations, rewards, terminations, _, infos = env.step(actions)
        assert env.swarm.alive.all() or not opening
        for agent, reward in rewards.items():
            if agent != OBSERVER:
                assert reward + rewards[OBSERVER] + infos[agent]["price"] == pytest.approx(0.0, abs=1e-12)
                assert not (terminations[agent] and infos[agent]["price"])
        total += rewards[OBSERVER]
        if not opening:
            rounds += 1
            redundant += int((actions[OBSERVER] & ~(swarm.head & alive)).sum())
        swarm = env.swarm
        assert (infos[OBSERVER]["round"], infos[OBSERVER]["J"]) == (rounds, pytest.approx(rounds + redundant / 20))
    assert total == pytest.approx(-(rounds + scale * redundant / 20), abs=1e-9)


def test_destroyed_heads_leave_and_the_rest_plays_on():
    env = small("evasion")
    observations, _ = env.reset(seed=0)
    observations, *_ = env.step(act(env))
    heads = np.flatnonzero(env.swarm.head)
    observations, rewards, terminations, truncations, infos = env.step(act(env, [heads[1]], head_1=[1, 1, 2, 4]))
    assert env.agents == [OBSERVER, "head_0", "head_2"]
    assert env.possible_agents == [OBSERVER, "head_0", "head_1", "head_2"]
    assert terminations == {OBSERVER: False, "head_0": False, "head_1": True, "head_2": False}
    assert not any(truncations.values())
    assert (rewards["head_1"], infos["head_1"]["price"]) == (1.0, 0.0)  # it gets its last reward, and pays nothing
    assert set(observations) == set(env.possible_agents)
    assert not observations["head_1"]["alive"][heads[1]]
    observations, rewards, *_ = env.step(act(env, [heads[0]]))
    assert set(observations) == set(rewards) == {OBSERVER, "head_0", "head_2"}
    observations, rewards, terminations, _, infos = env.step(act(env, [heads[2]]))
    assert terminations == {OBSERVER: True, "head_2": True}
    assert (env.agents, infos[OBSERVER]["success"], infos[OBSERVER]["J"]) == ([], 1, 3.0)
    assert not observations[OBSERVER]["seen"].any()


def test_the_observation_of_a_head():
    env = small("evasion", cluster_sizes=(2, 2, 13))
    observations, _ = env.reset(seed=4)
    env.step(act(env))
    swarm = env.swarm
    heads = np.flatnonzero(swarm.head)
    victim = np.flatnonzero(~swarm.head)[0]
    observations, *_ = env.step(act(env, [victim]))
    swarm = env.swarm
    for j, head in enumerate(heads):
        seen = observations[f"head_{j}"]
        assert np.flatnonzero(seen["self"]).tolist() == [head]
        np.testing.assert_array_equal(seen["heads"], swarm.head)
        followers = (swarm.root == head) & ~swarm.head & swarm.alive
        np.testing.assert_array_equal(seen["followers"], followers)
        np.testing.assert_array_equal(seen["position"], swarm.position)
        np.testing.assert_array_equal(seen["alive"], swarm.alive)
        assert np.flatnonzero(seen["named"]).tolist() == [victim]
        decoys = np.split(seen["legal"], np.cumsum([3, 2, 3]))[2]
        assert decoys.tolist() == [1, *(int(followers.sum() > many) for many in (1, 2))]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        *(({"mobilities": value}, "mobilities must") for value in (("iid", "hover"), (), ("iid", "iid"))),
        ({"most_decoys": -1}, "most_decoys must"),
        ({"most_delay": 2.5}, "most_delay must"),
        ({"decoy_price": np.nan}, "decoy_price must"),
        *(({"follow": name, "memory": 16}, "follow must") for name in ("none", "reference", "shifted")),
        ({"follow": "f3", "memory": 6}, "most_delay must be at most memory - 3"),
        ({"follow": "couzin", "memory": 16}, "most_delay must be .* 0 for a flock"),
        ({"max_cycles": 1}, "max_rounds must"),
        ({"uavs": 5}, "uavs must"),
    ],
)
def test_bad_arguments_are_named(arguments, sentence):
    with pytest.raises(ArgumentError, match=sentence):
        usnet_evasion_v0.parallel_env(**arguments)


@pytest.mark.parametrize("action", [None, [0] * 3, [0, 0, 0, 5], [0, -1, 0, 0], [0.5, 0, 0, 0], [[0], 1]])
def test_a_wrong_choice_is_refused_and_changes_nothing(action):
    env, twin = small("evasion"), small("evasion")
    env.reset(seed=0)
    twin.reset(seed=0)
    with pytest.raises(ArgumentError, match="action of head_1 must"):
        env.step(act(env, head_1=action))
    assert data_equivalence(env.step(act(env)), twin.step(act(twin)), exact=True)


def test_an_action_for_every_agent_is_asked_for():
    env = small("evasion")
    for early in (lambda: env.step({}), env.state, lambda: env.swarm):
        with pytest.raises(ArgumentError, match="reset must be called first"):
            early()
    env.reset(seed=0)
    for wrong in (None, {}, {"observer_0": np.zeros(20)}, {**act(env), "head_9": TRUTHFUL}):
        with pytest.raises(ArgumentError, match="actions must map each of observer_0, head_0"):
            env.step(wrong)
    with pytest.raises(ArgumentError, match="seed must"):
        env.reset(seed=-1)

"""Observers: what each sees, their messages, and how their votes are combined into candidates."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from hypothesis import given, settings
from hypothesis import strategies as st
from small_games import SMALL, assert_single_game, small

import usnet_env  # noqa: F401  # registers the single-agent environments
from usnet_env import ArgumentError, Window
from usnet_env.multiagent import usnet_observers_v0
from usnet_env.multiagent.play import play_game
from usnet_env.multiagent.policies import RandomObserver
from usnet_env.multiagent.sensors import SensorConfig, combine_votes
from usnet_env.replay import EpisodeRecord
from usnet_env.swarm.formation import ARENA


def votes(env, named):
    """A vote for every observer, from the UAVs that each names."""
    actions = {}
    for agent, uavs in zip(env.agents, named, strict=True):
        actions[agent] = np.zeros(env.action_space(agent).shape, env.action_space(agent).dtype)
        actions[agent][list(uavs)] = 1
    return actions


@pytest.mark.parametrize(
    "more", [{}, {"sample_every": 3, "decoys": 1}, {"mobility": "gauss_markov", "head_jitter": True}]
)
def test_one_observer_that_sees_all_plays_the_single_agent_game(more):
    single = gym.make("USNET/MultiCluster-v0", **SMALL, **more).unwrapped
    env = usnet_observers_v0.parallel_env(**SMALL, **more, observers=1, sensing_range=1e5)
    expected, _ = single.reset(seed=0)
    observations, _ = env.reset(seed=0)
    assert_single_game(single, env, expected, observations, lambda named: {"observer_0": named})


def test_an_observer_sees_only_the_uavs_in_range():
    env = usnet_observers_v0.parallel_env(**SMALL, observers=2, sensing_range=(300.0, 500.0), mobility="straight")
    everything = usnet_observers_v0.parallel_env(**SMALL, observers=1, sensing_range=1e5, mobility="straight")
    for seed in range(5):
        observations, _ = env.reset(seed=seed)
        truth = everything.reset(seed=seed)[0]["observer_0"]
        for agent, limit in zip(env.agents, (300.0, 500.0), strict=True):
            seen = observations[agent]
            away = np.linalg.norm(truth["position"] - seen["place"], axis=-1)
            np.testing.assert_array_equal(seen["seen"], away <= limit)
            np.testing.assert_array_equal(seen["position"], truth["position"] * (away <= limit)[..., None])
            both = (away[1:] <= limit) & (away[:-1] <= limit)
            np.testing.assert_array_equal(seen["velocity"], truth["velocity"] * both[..., None])
            np.testing.assert_array_equal(seen["legal"], (away <= limit).any(axis=0))
            Window.from_observation(seen)


@pytest.mark.parametrize("sample_every", [1, 3])
def test_an_observer_flies_in_the_arena_and_sees_what_is_in_range_of_where_it_is_then(sample_every):
    arguments = {**SMALL, "sample_every": sample_every}
    env = usnet_observers_v0.parallel_env(**arguments, observers=2, sensing_range=300.0, observer_speed=20.0)
    everything = usnet_observers_v0.parallel_env(**arguments, observers=1, sensing_range=1e5)
    places = {agent: seen["place"] for agent, seen in env.reset(seed=0)[0].items()}
    everything.reset(seed=0)
    elapsed = 4 + sample_every * np.arange(13)[:, None]  # after the unobserved steps
    for flight in ([0.6, 0.0, 0.1], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]):
        actions = {agent: np.array([*[-1.0] * 20, *flight]) for agent in env.agents}
        observations = env.step(actions)[0]
        truth = everything.step({"observer_0": np.zeros(20)})[0]["observer_0"]
        for agent, seen in observations.items():
            velocity = 20.0 * np.array(flight) / max(np.linalg.norm(flight), 1.0)
            way = np.clip(places[agent] + elapsed * velocity, 0.0, ARENA)
            places[agent] = seen["place"]
            np.testing.assert_allclose(seen["place"], way[-1], rtol=1e-6)
            near = np.linalg.norm(truth["position"] - way[:, None], axis=-1) <= 300.0
            np.testing.assert_array_equal(seen["seen"], near)
            np.testing.assert_array_equal(seen["position"], truth["position"] * near[..., None])
            np.testing.assert_array_equal(seen["legal"], near.any(axis=0))
    assert env.list_observers() is None


@pytest.mark.parametrize(("fusion", "no_vote"), [("union", -1.0), ("majority", 0.0), ("scores", 0.0)])
def test_observers_that_could_fly_and_stand_play_the_game_of_those_that_stand(fusion, no_vote):
    stands, flies = (small("observers", fusion=fusion, observer_speed=speed, max_rounds=4) for speed in (0.0, 5.0))
    seen, rng = stands.reset(seed=3)[0], np.random.default_rng(0)
    assert data_equivalence(seen, flies.reset(seed=3)[0], exact=True)
    while stands.agents:
        votes = {agent: (rng.random(22) < 0.1).astype(np.int8) for agent in stands.agents}
        answers = stands.step(votes)
        same = {
            agent: np.where([*vote, 0, 0, 0], [*vote, 0, 0, 0], [no_vote] * 20 + [0] * 5)
            for agent, vote in votes.items()
        }
        assert data_equivalence(answers, flies.step(same), exact=True)
    assert not flies.agents


@pytest.mark.parametrize("sample_every", [1, 3])
def test_a_record_has_the_velocity_of_a_uav_whose_ends_two_observers_saw(sample_every):
    env = usnet_observers_v0.parallel_env(**SMALL, observers=4, miss_rate=0.2, sample_every=sample_every)
    record = EpisodeRecord(**play_game(env, {"observer": RandomObserver()}, seed=0).record)
    both = record.seen[:, 1:] & record.seen[:, :-1]
    moved = np.diff(record.position, axis=1) / sample_every
    np.testing.assert_allclose(record.velocity[both], moved[both], atol=1e-3)
    assert not record.velocity[~both].any()


# --- votes -----------------------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_rules_by_their_definitions(seed):
    rng = np.random.default_rng(seed)
    seen = rng.random((4, 9)) < 0.7
    named = (rng.random(seen.shape) < 0.5) & seen
    scores = rng.random(seen.shape) * seen
    union, majority = (combine_votes(name, named.astype(float), seen) for name in ("union", "majority"))
    summed = combine_votes("scores", scores, seen)
    for i in range(seen.shape[1]):
        who = np.flatnonzero(seen[:, i])
        assert union[i] == any(named[k, i] for k in who)
        assert majority[i] == (sum(named[k, i] for k in who) > len(who) / 2)
        assert summed[i] == (sum(scores[k, i] for k in who) > len(who) / 2)
    assert (majority <= union).all()


def test_votes_count_only_for_seen_and_living_uavs():
    env = usnet_observers_v0.parallel_env(**SMALL, observers=2, sensing_range=(1.0, 1e5))
    env.reset(seed=0)
    assert not env.step(votes(env, [range(20), ()]))[-1]["observer_0"]["redundant"]  # it sees no UAV
    assert env.swarm.alive.all()
    follower = int(np.flatnonzero(~env.swarm.head)[0])
    _, rewards, *_ = env.step(votes(env, [(), [follower]]))
    assert rewards == {"observer_0": -1.05, "observer_1": -1.05}
    assert not env.swarm.alive[follower]
    assert env.step(votes(env, [(), [follower]]))[-1]["observer_1"]["redundant"] == 0  # destroyed already


def test_all_observers_share_the_reward_and_end_together():
    env = small("observers", sensing_range=1e5, fusion="majority")
    env.reset(seed=0)
    heads = np.flatnonzero(env.swarm.head)
    _, rewards, terminations, *_ = env.step(votes(env, [heads, heads[:1], ()]))
    assert set(rewards.values()) == {-1.0}
    assert np.flatnonzero(~env.swarm.alive).tolist() == [heads[0]]
    assert not any(terminations.values())
    observations, rewards, terminations, truncations, infos = env.step(votes(env, [heads, heads, ()]))
    assert all(terminations.values())
    assert not any(truncations.values())
    assert env.agents == []
    assert infos["observer_2"]["J"] == 2.0
    assert not any(one["seen"].any() or one["legal"].any() for one in observations.values())


def test_messages_arrive_with_the_next_window():
    env = small("observers")
    observations, _ = env.reset(seed=0)
    assert not observations["observer_1"]["messages"].any()
    actions = votes(env, [(), (), ()])
    actions["observer_1"][-2:] = [1, 0]
    actions["observer_2"][-2:] = [1, 1]
    observations, *_ = env.step(actions)
    for seen in observations.values():
        np.testing.assert_array_equal(seen["messages"], [[0, 0], [1, 0], [1, 1]])
    observations, *_ = env.step(votes(env, [(), (), ()]))
    assert not observations["observer_0"]["messages"].any()
    assert "messages" not in small("observers", message_size=0).reset(seed=0)[0]["observer_0"]


# --- positions -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("observers", [1, 2, 3, 4, 7, 8])
@pytest.mark.parametrize("placement", ["grid", "uniform"])
def test_observers_are_in_the_arena(observers, placement):
    places = SensorConfig(observers=observers, placement=placement).draw_positions(np.random.default_rng(0))
    assert places.shape == (observers, 3)
    assert ((places >= 0) & (places <= ARENA)).all()
    assert len(np.unique(places, axis=0)) == observers


# --- the border ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("observers", 0),
        ("sensing_range", -1.0),
        ("sensing_range", (100.0, 200.0)),
        ("position_noise", "much"),
        ("miss_rate", 1.0),
        ("placement", "gird"),
        ("fusion", "vote"),
        ("message_size", -1),
        ("observer_speed", -1.0),
        ("max_cycles", 0),
    ],
)
def test_bad_arguments_are_named(name, value):
    with pytest.raises(ArgumentError, match=f"{name} must"):
        usnet_observers_v0.parallel_env(**{name: value})


@pytest.mark.parametrize("fusion", ["union", "scores"])
@pytest.mark.parametrize("speed", [0.0, 5.0])
@pytest.mark.parametrize("action", [None, np.zeros(19), np.full(20, 2), np.full(20, np.nan), ["a"] * 20])
def test_a_wrong_vote_or_flight_is_refused(fusion, speed, action):
    env = small("observers", fusion=fusion, message_size=0, observer_speed=speed)
    env.reset(seed=0)
    if speed and np.shape(action) == (20,):
        action = [*[0.0] * 20, *action[:3]]
    with pytest.raises(
        ArgumentError, match="action of observer_1 must .* last three" if speed else "action of observer_1 must"
    ):
        env.step({**votes(env, [(), (), ()]), "observer_1": action})

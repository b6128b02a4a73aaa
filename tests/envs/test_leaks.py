"""Only the motion shows the heads: indices, masks, dtypes and info carry nothing about them, nor about their number."""

import gymnasium as gym
import numpy as np
import pytest
from scipy.stats import binomtest
from sklearn.ensemble import RandomForestClassifier
from sklearn.metrics import roc_auc_score

from usnet_env.envs.wrappers import BoxMasks, MultiDiscreteCandidates
from usnet_env.swarm.kinematics import KINEMATICS

CASES = [
    {"follow": "f1"},
    {"follow": "f6", "formation": "around", "miss_rate": 0.2},
    {"follow": "f4", "position_noise": 1.0, "decoys": 2, "sample_every": 2},
]
EPISODES = 240


def blind_features(observation, info):
    """Per UAV, everything in an observation and in info that is not flight: (N, features)."""
    uavs = len(observation["alive"])
    position, seen = observation["position"], observation["seen"].astype(float)
    columns = [
        np.arange(uavs),
        observation["alive"],
        seen.mean(axis=0),
        seen[0],
        seen[-1],
        np.full(uavs, position.dtype.itemsize),
        (position == 0).all(axis=(0, 2)),
        *((np.signbit(flown) & (flown == 0)).any(axis=(0, 2)) for flown in (position, observation["velocity"])),
        np.full(uavs, observation["round"][0]),
        *(np.full(uavs, float(value)) for value in info.values()),
    ]
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["follow"])
def test_a_classifier_of_all_that_is_not_flight_is_at_chance(case):
    env = gym.make("USNET/MultiCluster-v0", clusters=3, uavs=20, observation_steps=10, **case)
    features, labels = [], []
    for seed in range(EPISODES):
        observation, info = env.reset(seed=seed)
        features.append(blind_features(observation, info))
        labels.append(env.unwrapped.swarm.head)
    half = EPISODES // 2
    train, test = np.concatenate(features[:half]), np.concatenate(features[half:])
    truth, held_out = np.concatenate(labels[:half]), np.concatenate(labels[half:])
    forest = RandomForestClassifier(100, min_samples_leaf=5, random_state=0).fit(train, truth)
    chance = 1 / np.sqrt(12 * held_out.sum() * (1 - held_out.mean()))  # standard error of an AUC of 1/2
    assert abs(roc_auc_score(held_out, forest.predict_proba(test)[:, 1]) - 0.5) < 4 * chance


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["follow"])
@pytest.mark.parametrize("rule", ["first", "last", "most seen", "least seen"])
def test_rules_that_look_at_no_flight_hit_as_often_as_a_die(rule, case):
    env = gym.make("USNET/SingleCluster-v0", followers=5, observation_steps=10, **case)
    hits, sides = 0, env.action_space.n
    for seed in range(300):
        observation, _ = env.reset(seed=seed)
        seen = observation["seen"].sum(axis=0)
        named = {"first": 0, "last": sides - 1, "most seen": seen.argmax(), "least seen": seen.argmin()}[rule]
        hits += bool(env.unwrapped.swarm.head[named])
    assert binomtest(hits, 300, 1 / sides).pvalue > 1e-3


@pytest.mark.parametrize("kinematics", KINEMATICS)
@pytest.mark.parametrize("case", [{"follow": "f4", "miss_rate": 0.1}, {"follow": "f4"}, {"follow": "couzin"}])
def test_the_zeros_of_the_destroyed_tell_nothing(kinematics, case):
    """Positions, velocities and their signs are the same for what were heads, decoys and followers."""
    env = gym.make(
        "USNET/MultiCluster-v0",
        clusters=3,
        uavs=20,
        decoys=2,
        mobility="gauss_markov",
        kinematics=kinematics,
        memory=12,
        **case,
    )
    env.reset(seed=0)
    swarm = env.unwrapped.swarm
    action = np.zeros(20, np.int8)
    for role in (swarm.head, swarm.decoy, ~(swarm.head | swarm.decoy)):
        action[np.flatnonzero(role)[0]] = 1
    observation, *_ = env.step(action)
    for name in ("position", "velocity"):
        masked = observation[name][:, action.astype(bool)]
        assert not masked.any()
        assert not np.signbit(masked).any()


# --- the number of heads ---------------------------------------------------------------------------------------------

MULTI = "USNET/MultiCluster-v0"
UAVS = 24


def infos_of_single_envs(clusters, wrap=lambda env: env):
    """``info`` at reset, after a round that names no UAV, and after a round that hits one head."""
    env = wrap(gym.make(MULTI, clusters=clusters, uavs=UAVS, observation_steps=10))
    _, first = env.reset(seed=0)
    *_, empty = env.step(np.zeros(UAVS, np.int8))
    one_head = np.arange(UAVS) == np.flatnonzero(env.unwrapped.swarm.head)[0]
    *_, hit = env.step(one_head.astype(np.int8))
    assert hit["hits"] == 1
    return [first, empty, hit]


def infos_of_vector_envs(clusters):
    envs = gym.make_vec(MULTI, num_envs=2, clusters=clusters, uavs=UAVS, observation_steps=10)
    _, first = envs.reset(seed=0)
    *_, empty = envs.step(np.zeros((2, UAVS), np.int8))
    head = envs.unwrapped.swarm.head
    *_, hit = envs.step((head & (head.cumsum(axis=1) == 1)).astype(np.int8))
    assert hit["hits"].tolist() == [1, 1]
    return [{name: values.tolist() for name, values in info.items()} for info in (first, empty, hit)]


def infos_of_observers(game, clusters):
    """What ``observer_0`` of a PettingZoo game gets, with every other agent passive."""
    module = pytest.importorskip(f"usnet_env.multiagent.{game}")
    env = module.parallel_env(clusters=clusters, uavs=UAVS, observation_steps=10)
    _, infos = env.reset(seed=0)
    kept = [infos["observer_0"]]
    for share in (0, 0, 1):
        actions = {agent: np.zeros_like(env.action_space(agent).sample()) for agent in env.agents}
        first_head = np.flatnonzero(env.swarm.head)[0]
        for agent in env.agents:
            if agent.startswith("observer"):
                actions[agent][first_head] = share
        *_, infos = env.step(actions)
        kept.append(infos["observer_0"])
    assert kept[-1]["hits"] == 1
    return kept


GAMES = {
    "single": infos_of_single_envs,
    "vector": infos_of_vector_envs,
    "multi-discrete": lambda clusters: infos_of_single_envs(clusters, MultiDiscreteCandidates),
    "box masks": lambda clusters: infos_of_single_envs(clusters, BoxMasks),
    "observers": lambda clusters: infos_of_observers("usnet_observers_v0", clusters),
    "evasion": lambda clusters: infos_of_observers("usnet_evasion_v0", clusters),
}


@pytest.mark.parametrize("name", GAMES)
def test_info_does_not_depend_on_the_number_of_heads(name):
    """The same rounds in swarms of 2 and of 6 clusters: as long as heads are left, ``info`` is the same."""
    assert GAMES[name](2) == GAMES[name](6)


@pytest.mark.parametrize("reveal", [False, True])
def test_the_heads_left_are_in_info_only_on_request(reveal):
    env = gym.make(MULTI, clusters=3, uavs=UAVS, observation_steps=10, reveal_truth=reveal)
    envs = gym.make_vec(MULTI, num_envs=2, clusters=3, uavs=UAVS, observation_steps=10, reveal_truth=reveal)
    for info in (env.reset(seed=0)[1], env.step(np.zeros(UAVS))[-1]):
        assert info.get("heads_left") == (3 if reveal else None)
    for info in (envs.reset(seed=0)[1], envs.step(np.zeros((2, UAVS)))[-1]):
        assert ("heads_left" in info) == reveal
        assert not reveal or info["heads_left"].tolist() == [3, 3]

"""Only the motion shows the heads: indices, masks and info carry nothing about them, nor about their number."""

import gymnasium as gym
import numpy as np
import pytest
from sklearn.ensemble import RandomForestClassifier
from sklearn.metrics import roc_auc_score

from usnet_env.swarm.kinematics import KINEMATICS

CASES = [
    {"follow": "f1"},
    {"follow": "f6", "formation": "around", "miss_rate": 0.2},
    {"follow": "f4", "position_noise": 1.0, "decoys": 2, "sample_every": 2},
]
EPISODES = 160


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


@pytest.mark.parametrize("reveal", [False, True])
def test_info_depends_on_the_number_of_heads_only_on_request(reveal):
    """The same rounds in swarms of 2 and of 6 clusters: none is named, then one head is hit."""
    infos = []
    for clusters in (2, 6):
        arguments = {"clusters": clusters, "uavs": 24, "observation_steps": 10, "reveal_truth": reveal}
        env = gym.make("USNET/MultiCluster-v0", **arguments)
        _, first = env.reset(seed=0)
        *_, empty = env.step(np.zeros(24, np.int8))
        one_head = np.arange(24) == np.flatnonzero(env.unwrapped.swarm.head)[0]
        *_, hit = env.step(one_head.astype(np.int8))
        assert hit["hits"] == 1
        infos.append([first, empty, hit])
    if reveal:
        assert [info["heads_left"] for info in infos[0] + infos[1]] == [2, 2, 1, 6, 6, 5]
    else:
        assert infos[0] == infos[1]

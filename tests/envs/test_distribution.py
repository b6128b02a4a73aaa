"""Games that differ: what is drawn, what an argument fixes, and the state of such a game."""

import gymnasium as gym
import numpy as np
import pytest

from usnet_env import ArgumentError
from usnet_env.envs import DISTRIBUTIONS, MultiClusterEnv, SingleClusterEnv
from usnet_env.swarm import KINEMATICS, SwarmConfig
from usnet_env.swarm.follow import FIELD_MODELS, FOLLOW_STRATEGIES

PAPER = ["f1", "f2", "f3", "f4", "f5", "f6", "f7"]
DRAWN = {
    "follow": PAPER,
    "uavs": (12, 24),
    "clusters": (2, 4),
    "position_noise": (0.0, 0.5),
    "kinematics": ["unit", "varied_speed"],
}


def make(**arguments):
    return MultiClusterEnv(**{"distribution": "field-v1", "memory": 12, "observation_steps": 2, **arguments})


def drawn(count=300, **arguments):
    env = make(**arguments)
    for seed in range(count):
        env.reset(seed=seed)
        yield env.config


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_all_that_a_distribution_holds_is_drawn(name):
    rules = DISTRIBUTIONS[name].rules
    assert {model.removesuffix("-led") for model in rules["follow"]} == set(FIELD_MODELS)
    assert set(rules["follow"]) <= set(FOLLOW_STRATEGIES)
    assert set(rules["kinematics"]) <= set(KINEMATICS)
    rngs = map(np.random.default_rng, range(300))
    swarms = [DISTRIBUTIONS[name].draw(rng) for rng in rngs]
    for part in ("follow", "mobility", "kinematics", "formation", "head_jitter"):
        assert {swarm[part] for swarm in swarms} == set(rules[part]), part
    for part in {"clusters", "decoys", "bystanders", "traffic"} & set(rules):
        low, high = rules[part]
        assert {swarm[part] for swarm in swarms} == set(range(low, high + 1)), part
    noise = [swarm["position_noise"] for swarm in swarms]
    assert max(noise) <= rules["position_noise"].high
    assert np.mean(np.array(noise) == 0) == pytest.approx(0.5, abs=0.1)


def test_an_argument_fixes_its_part_and_no_other():
    for config, fixed in zip(drawn(10), drawn(10, follow="f3", kinematics="unit"), strict=True):
        assert (fixed.follow, fixed.kinematics) == ("f3", "unit")
        assert fixed == SwarmConfig(**{**config.model_dump(), "follow": "f3", "kinematics": "unit"})


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"uavs": 20}, "uavs"),
        ({"uavs": 30, "absent": 20}, "uavs - absent"),
        ({"follow": {"f1": -1}}, r"follow\['f1'\]"),
        ({"follow": ["f1", "f8"]}, "follow"),
        ({"kinematics": {}}, "kinematics"),
        ({"clusters": (6, 2)}, "clusters"),
        ({"clusters": (2, 30)}, "uavs"),
        ({"decoys": ["a"]}, "decoys"),
        ({"miss_rate": {"low": 0.1}}, "miss_rate"),
        ({"position_noise": {"low": 0.0, "high": 1.0, "log": True}}, "position_noise"),
        ({"distribution": "field-v9"}, "distribution"),
        ({"distribution": {"memory": [4, 12]}}, "distribution"),
        ({"distribution": {"followers": [4, 12]}}, "distribution"),
    ],
)
def test_what_can_not_be_drawn_is_refused_when_the_environment_is_made(arguments, named):
    with pytest.raises(ArgumentError, match=rf"^{named} "):
        make(**arguments)


def test_lists_and_ranges_survive_the_spec_and_are_told():
    env = gym.make("USNET/MultiCluster-v0", reveal_truth=True, observation_steps=3, **DRAWN)
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert again.observation_space == env.observation_space
    widest = env.unwrapped.widest_config
    assert (widest.kinematics, widest.position_noise) == ("varied_speed", 0.5)
    seen = []
    for seed in range(30):
        window, info = env.reset(seed=seed)
        np.testing.assert_array_equal(again.reset(seed=seed)[0]["position"], window["position"])
        assert env.observation_space.contains(window)
        assert (window["alive"].sum(), info["head"].sum()) == (info["uavs"], info["clusters"])
        np.testing.assert_array_equal(info["root"], env.unwrapped.swarm.root)
        assert env.step(info["head"])[1] == -1.0
        seen.append((info["follow"], info["kinematics"], info["clusters"], info["uavs"]))
    follow, kinematics, clusters, uavs = map(set, zip(*seen, strict=True))
    assert (follow, kinematics, clusters) == (set(PAPER), {"unit", "varied_speed"}, {2, 3, 4})
    assert (min(uavs) >= 12, max(uavs) <= 24, len(uavs) > 5) == (True, True, True)


def test_swarms_of_p1_of_several_sizes():
    env = SingleClusterEnv(followers=(3, 9), decoys=(0, 2), observation_steps=3, reveal_truth=True)
    assert env.action_space.n == 12
    for seed in range(10):
        window, info = env.reset(seed=seed)
        assert window["alive"].sum() == 1 + info["followers"] + info["decoys"]
        assert not window["seen"][:, window["alive"] == 0].any()
        assert not window["position"][:, window["alive"] == 0].any()
        assert env.step(info["head"])[1] == 0.0
        env.reset()
        assert env.step(window["alive"] == 0)[1] < 0  # to name who isn't there is redundant

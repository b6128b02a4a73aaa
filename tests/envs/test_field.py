"""The field environment: what it draws, what an argument fixes, and its state."""

import gymnasium as gym
import numpy as np
import pytest

from usnet_env import ArgumentError
from usnet_env.envs import FieldEnv
from usnet_env.envs.field import DISTRIBUTIONS
from usnet_env.swarm import SwarmConfig
from usnet_env.swarm.follow import FIELD_MODELS
from usnet_env.swarm.kinematics import KINEMATICS

FIELD = "USNET/Field-v1"


def drawn(count=300, **arguments):
    env = FieldEnv(**{"observation_steps": 2, **arguments})
    for seed in range(count):
        env.reset(seed=seed)
        yield env.config


@pytest.mark.parametrize("distribution", list(DISTRIBUTIONS.values()), ids=lambda each: each.version)
def test_every_model_is_in_the_distribution_and_is_drawn(distribution):
    assert set(distribution.follow) == set(FIELD_MODELS)
    assert set(distribution.kinematics) <= set(KINEMATICS)
    configs = list(drawn(distribution=distribution.version))
    for name in ("follow", "mobility", "kinematics", "formation"):
        assert {getattr(config, name) for config in configs} == set(getattr(distribution, name)), name
    for name in ("clusters", "decoys", "bystanders", "traffic"):
        low, high = getattr(distribution, name)
        assert {getattr(config, name) for config in configs} == set(range(low, high + 1)), name
    assert {config.uavs for config in configs} == {82}
    assert np.mean([config.position_noise == 0 for config in configs]) == pytest.approx(0.5, abs=0.1)


def test_the_versions_differ_in_the_formation_alone():
    assert gym.make(FIELD).unwrapped.spec.kwargs == {"distribution": 2}
    for before, after in zip(drawn(20, distribution=1), drawn(20, distribution=2), strict=True):
        assert after.formation == {"around": "gathered", "uniform": "uniform"}[before.formation]
        assert SwarmConfig(**{**after.model_dump(), "formation": before.formation}) == before


def test_an_argument_fixes_its_part_and_no_other():
    for config, fixed in zip(drawn(20), drawn(20, follow="f3", kinematics="unit"), strict=True):
        assert (fixed.follow, fixed.kinematics) == ("f3", "unit")
        assert fixed == SwarmConfig(**{**config.model_dump(), "follow": "f3", "kinematics": "unit"})


def test_the_swarm_fits_the_largest_draw():
    with pytest.raises(ArgumentError, match="uavs must be at least"):
        FieldEnv(uavs=20)
    FieldEnv(uavs=20, bystanders=0, traffic=0)
    for _ in drawn(100, uavs=32):
        pass


def test_observations_stay_in_their_space_at_the_top_speed():
    env = gym.make(FIELD, kinematics="varied_speed", follow="unequal_delays", mobility="straight", max_rounds=2)
    for seed in range(5):
        observation, _ = env.reset(seed=seed)
        assert env.observation_space.contains(observation)


def test_a_state_of_another_swarm_is_restored():
    env = FieldEnv(observation_steps=10)
    env.reset(seed=3)
    state, config = env.get_state(), env.config
    after = env.step(np.eye(82, dtype=np.int8)[0])
    other = FieldEnv(observation_steps=10)
    other.reset(seed=4)
    assert other.config != config
    other.set_state(state)
    assert other.config == config
    np.testing.assert_array_equal(other.step(np.eye(82, dtype=np.int8)[0])[0]["position"], after[0]["position"])
    with pytest.raises(ArgumentError, match="state must come from"):
        FieldEnv(observation_steps=11).set_state(state)

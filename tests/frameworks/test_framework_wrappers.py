"""The wrappers that change a space and nothing else."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

from usnet_env import ArgumentError
from usnet_env.envs.wrappers import BoxMasks

SMALL = {"clusters": 2, "uavs": 10, "observation_steps": 12, "max_rounds": 4}


def test_masks_become_boxes_and_nothing_else_changes():
    plain, wrapped = (gym.make("USNET/MultiCluster-v0", **SMALL) for _ in range(2))
    wrapped = BoxMasks(wrapped)
    assert {name for name, part in wrapped.observation_space.items() if isinstance(part, spaces.MultiBinary)} == set()
    assert wrapped.observation_space["seen"] == spaces.Box(0, 1, (13, 10), np.int8)
    assert wrapped.observation_space["velocity"] == plain.observation_space["velocity"]
    assert wrapped.action_space == plain.action_space
    (one, _), (other, _) = plain.reset(seed=0), wrapped.reset(seed=0)
    np.testing.assert_equal(one, other)
    assert wrapped.observation_space.contains(other)


def test_an_observation_without_masks_is_refused():
    with pytest.raises(ArgumentError, match="env must have a Dict observation space, got Box"):
        BoxMasks(gym.make("CartPole-v1"))


# Games of several agents


@pytest.fixture
def games():
    pytest.importorskip("pettingzoo")
    from usnet_env.multiagent import usnet_evasion_v0, usnet_observers_v0

    return {"observers": usnet_observers_v0.parallel_env, "evasion": usnet_evasion_v0.parallel_env}


@pytest.mark.parametrize("name", ["observers", "evasion"])
@pytest.mark.parametrize("wrapper", ["ParallelBoxMasks", "MultiDiscreteVotes"])
def test_a_wrapped_game_is_the_same_game(games, name, wrapper):
    from usnet_env.multiagent import wrappers

    plain, wrapped = games[name](**SMALL), getattr(wrappers, wrapper)(games[name](**SMALL))
    np.testing.assert_equal(plain.reset(seed=0), wrapped.reset(seed=0))
    rng = np.random.default_rng(0)
    while plain.agents:
        actions = {
            agent: (rng.random(plain.action_space(agent).shape) < 0.1).astype(np.int64) for agent in plain.agents
        }
        assert all(wrapped.action_space(agent).shape == one.shape for agent, one in actions.items())
        step = wrapped.step(actions)
        np.testing.assert_equal(plain.step(actions), step)
        assert all(wrapped.observation_space(agent).contains(seen) for agent, seen in step[0].items())


def test_the_spaces_are_what_the_frameworks_want(games):
    from usnet_env.multiagent.wrappers import DiscreteActions, MultiDiscreteVotes, ParallelBoxMasks

    votes = MultiDiscreteVotes(games["observers"](**SMALL, message_size=2))
    assert votes.action_space("observer_0") == spaces.MultiDiscrete([2] * 12)
    assert votes.action_space("observer_0") is votes.action_space("observer_0")
    evasion = games["evasion"](**SMALL)
    assert MultiDiscreteVotes(evasion).action_space("head_1") == evasion.action_space("head_1")
    masks = ParallelBoxMasks(DiscreteActions(evasion))
    seen = masks.observation_space("observer_0")
    assert seen["action_mask"] == spaces.Box(0, 1, (11,), np.int8)
    assert seen["seen"] == spaces.Box(0, 1, (13, 10), np.int8)
    assert masks.observation_space("observer_0") is seen


def test_what_is_no_game_is_refused(games):
    from usnet_env.multiagent.wrappers import MultiDiscreteVotes, ParallelBoxMasks

    with pytest.raises(ArgumentError, match=r"env must have votes that are candidates, got Box.* for observer_0"):
        MultiDiscreteVotes(games["observers"](**SMALL, fusion="scores"))
    for wrapper in (MultiDiscreteVotes, ParallelBoxMasks):
        with pytest.raises(ArgumentError, match="env must be a parallel_env or a wrapper around it, got 3"):
            wrapper(3)

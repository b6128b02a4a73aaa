"""The vector environments against Gymnasium's own vectorisation of the single ones."""

import gymnasium as gym
import numpy as np
import pytest

from usnet_env import ArgumentError
from usnet_env.envs import ENVIRONMENTS

MULTI = "USNET/MultiCluster-v0"


def same(one, other):
    assert one.keys() == other.keys()
    for key in one:
        np.testing.assert_array_equal(one[key], other[key], err_msg=key)
        assert one[key].dtype == other[key].dtype, key


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        *((name, {}) for name in sorted(ENVIRONMENTS)),
        ("USNET/SingleCluster-v0", {"follow": "f7", "reveal_truth": True}),
        (MULTI, {"follow": "f7", "reveal_truth": True, "max_rounds": 2}),
        ("USNET/Field-v1", {"follow": "f7", "reveal_truth": True, "max_rounds": 2}),
    ],
)
def test_equal_to_single_envs_over_many_episodes(name, arguments):
    arguments = {**arguments, "observation_steps": 10}
    batch = gym.make_vec(f"usnet_env:{name}", num_envs=5, **arguments)
    singles = gym.make_vec(name, num_envs=5, vectorization_mode="sync", **arguments)
    assert batch.unwrapped.__class__.__name__.endswith("VectorEnv")
    one, other = batch.reset(seed=0), singles.reset(seed=0)
    same(one[0], other[0])
    same(one[1], other[1])
    rng = np.random.default_rng(3)
    ends = 0
    for _ in range(15):
        share = rng.choice([0.05, 0.5, 1.0], size=(5, 1))
        actions = (rng.random(batch.action_space.shape) < share).astype(np.int8)
        one, other = batch.step(actions), singles.step(actions)
        same(one[0], other[0])
        for mine, theirs in zip(one[1:4], other[1:4], strict=True):
            np.testing.assert_array_equal(mine, theirs)
            assert mine.dtype == theirs.dtype
        same(one[4], other[4])
        assert batch.observation_space.contains(one[0])
        ends += int((one[2] | one[3]).sum())
    assert ends > 5


def test_seeds_as_a_list_and_generators_that_go_on():
    batch = gym.make_vec(MULTI, num_envs=3, observation_steps=10)
    one = batch.reset(seed=[7, 7, 8])[0]["position"]
    np.testing.assert_array_equal(one[0], one[1])
    assert not np.array_equal(one[0], one[2])
    assert not np.array_equal(batch.reset()[0]["position"][0], one[0])
    single = gym.make(MULTI, observation_steps=10)
    np.testing.assert_array_equal(single.reset(seed=8)[0]["position"], one[2])


def test_bad_input_is_named():
    for arguments in ({"num_envs": 0}, {"follow": "f0"}, {"render_mode": "rgb_array"}):
        with pytest.raises(ArgumentError, match=f"^{next(iter(arguments))} must"):
            gym.make_vec(MULTI, **{"num_envs": 2, **arguments})
    batch = gym.make_vec(MULTI, num_envs=2, observation_steps=10)
    with pytest.raises(ArgumentError, match="reset must be called first"):
        batch.step(np.zeros((2, 82)))
    with pytest.raises(ArgumentError, match=r"^options must"):
        batch.reset(seed=0, options={"follow": "f3"})
    batch.reset(seed=0)
    for wrong in (np.zeros(82), np.full((2, 82), 2), None):
        with pytest.raises(ArgumentError, match=r"^action must"):
            batch.step(wrong)


@pytest.mark.parametrize("seed", [1.5, "12", -1, [1.5, 1], ["a", "b"], [1, 2, 3]], ids=str)
def test_bad_seeds_are_named(seed):
    batch = gym.make_vec(MULTI, num_envs=2, observation_steps=10)
    with pytest.raises(ArgumentError, match=r"^seed must"):
        batch.reset(seed=seed)
    one = batch.reset(seed=[3, None])[0]["position"][0]
    np.testing.assert_array_equal(batch.reset(seed=np.array([3, 4]))[0]["position"][0], one)

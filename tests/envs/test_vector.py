"""The vector environments against Gymnasium's own vectorisation of the single ones."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from usnet_env import ArgumentError
from usnet_env.envs import ENVIRONMENTS

MULTI = "USNET/MultiCluster-v0"
# Swarms with and without references and compiled loops, in one batch.
KINDS = {
    "follow": ["f1", "f7", "none", "second-1", "random", "pigeons", "informed", "reference", "independent", "shifted"],
    "kinematics": ["unit", "varied_speed", "lagged", "limited", "layered"],
    "mobility": ["iid", "alike", "smooth_turn"],
    "head_jitter": [False, True],
    "clusters": (2, 4),
    "decoys": (0, 2),
    "bystanders": (0, 2),
    "memory": 12,
    "uavs": 24,
    "max_rounds": 2,
}


def same(one, other):
    assert one.keys() == other.keys()
    for key in one:
        if isinstance(one[key], dict):
            same(one[key], other[key])
            continue
        if one[key].dtype == object:
            assert [value is None for value in one[key]] == [value is None for value in other[key]]
            for mine, theirs in zip(one[key], other[key], strict=True):
                if isinstance(mine, dict):
                    same(mine, theirs)
                else:  # the name of what was drawn
                    assert mine == theirs
            continue
        np.testing.assert_array_equal(one[key], other[key], err_msg=key)
        assert one[key].dtype == other[key].dtype, key


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        *((name, {}) for name in sorted(ENVIRONMENTS)),
        ("USNET/SingleCluster-v0", {"autoreset_mode": "SameStep", "observe": ("velocity",)}),
        (MULTI, {"autoreset_mode": "SameStep", "reveal_truth": True, "max_rounds": 2, "miss_rate": 0.1}),
        ("USNET/Field-v1", {"autoreset_mode": "SameStep", "max_rounds": 2}),
        ("USNET/SingleCluster-v0", {"follow": "f7", "reveal_truth": True}),
        (MULTI, {"follow": "f7", "reveal_truth": True, "max_rounds": 2}),
        ("USNET/Field-v1", {"follow": "f7", "reveal_truth": True, "max_rounds": 2}),
        (MULTI, {**KINDS, "reveal_truth": True}),
        (MULTI, {"follow": ["none", "independent"], "max_rounds": 2}),
    ],
)
def test_equal_to_single_envs_over_many_episodes(name, arguments):
    arguments = {**arguments, "observation_steps": 10}
    batch = gym.make_vec(f"usnet_env:{name}", num_envs=5, **arguments)
    mode = {"autoreset_mode": AutoresetMode(arguments.pop("autoreset_mode", "NextStep"))}
    singles = gym.make_vec(name, num_envs=5, vectorization_mode="sync", vector_kwargs=mode, **arguments)
    assert batch.metadata["autoreset_mode"] is mode["autoreset_mode"]
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
    for arguments in ({"num_envs": 0}, {"follow": "f0"}, {"autoreset_mode": "never"}, {"observe": ["speed"]}):
        with pytest.raises(ArgumentError, match=f"^{next(iter(arguments))} must"):
            gym.make_vec(MULTI, **{"num_envs": 2, **arguments})
    with pytest.raises(ArgumentError, match=r"^max_episode_steps is not .* 'max_rounds' limits an episode"):
        gym.make_vec(MULTI, num_envs=2, max_episode_steps=5)
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


def make_pair(**arguments):
    """A batch and Gymnasium's vectorisation of single environments, in which the caller resets the games."""
    arguments = {"clusters": 2, "uavs": 12, "observation_steps": 10, "max_rounds": 2, **arguments}
    mode = AutoresetMode.DISABLED
    batch = gym.make_vec(MULTI, num_envs=4, autoreset_mode=mode, **arguments)
    options = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}}
    return batch, gym.make_vec(MULTI, num_envs=4, **options, **arguments)


def test_games_that_the_caller_resets():
    batch, singles = make_pair(reveal_truth=True)
    for envs in (batch, singles):
        envs.reset(seed=3)
    assert batch.np_random_seed == singles.np_random_seed == (3, 4, 5, 6)
    rng = np.random.default_rng(0)
    for k in range(6):
        actions = (rng.random((4, 12)) < 0.5).astype(np.int8)
        one, other = batch.step(actions), singles.step(actions)
        same(one[0], other[0])
        same(one[4], other[4])
        over = one[2] | one[3]
        if over.any():
            with pytest.raises(ArgumentError, match="reset must be called"):
                batch.step(actions)
            one, other = (envs.reset(seed=[k] * 4, options={"reset_mask": over.copy()}) for envs in (batch, singles))
            same(one[0], other[0])
            same(one[1], other[1])
    for wrong in (np.zeros(4, bool), np.ones(3, bool), [1, 0, 0, 0]):
        with pytest.raises(ArgumentError, match=r"^reset_mask must"):
            batch.reset(options={"reset_mask": wrong})


def test_statistics_of_games_that_restart_in_the_step_that_ends_them():
    """Gymnasium 1.2 and 1.3 report a return of 0, the best of P1, in each game but the first."""
    batch = gym.make_vec("USNET/SingleCluster-Tiny-v0", num_envs=2, autoreset_mode="SameStep")
    envs = RecordEpisodeStatistics(batch)
    envs.reset(seed=0)
    for _ in range(3):
        *_, info = envs.step(np.zeros((2, 8), np.int8))
        assert info["episode"]["r"].tolist() == [-1.0, -1.0]
        assert info["episode"]["l"].tolist() == [1, 1]


def test_an_observation_that_is_changed_in_place_changes_no_later_one_and_no_state():
    batch, singles = make_pair()
    for envs in (batch, singles):
        for values in envs.reset(seed=3)[0].values():
            values[:] = 0
    np.testing.assert_equal(batch.get_state(), list(singles.call("get_state")))
    one, other = (envs.reset(options={"reset_mask": np.arange(4) == 0})[0] for envs in (batch, singles))
    same(one, other)


def test_single_games_of_a_batch():
    """Pictures, attributes and states are those of single environments."""
    batch, singles = make_pair(render_mode="rgb_array")
    for envs in (batch, singles):
        envs.reset(seed=3)
    for _ in range(2):
        np.testing.assert_array_equal(batch.render(), singles.render())
        action = np.eye(4, 12, dtype=np.int8)
        batch.step(action), singles.step(action)
        states = batch.get_state()
    np.testing.assert_equal(states, list(singles.call("get_state")))
    np.testing.assert_array_equal(batch.call("action_masks"), batch.action_masks())
    batch.set_attr("note", [1, 2, 3, 4])
    assert batch.get_attr("note") == (1, 2, 3, 4)
    with pytest.raises(ArgumentError, match=r"^name must be no attribute"):
        batch.set_attr("rules", None)
    batch.reset(seed=9)
    window = batch.set_state(states)
    np.testing.assert_equal(batch.get_state(), states)
    np.testing.assert_array_equal(window["velocity"], [state["observation"]["velocity"] for state in states])

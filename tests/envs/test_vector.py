"""The vector environments against Gymnasium's own vectorisation of the single ones."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from usnet_env import ArgumentError
from usnet_env.envs import ENVIRONMENTS

MULTI, SINGLE, PROBING = "USNET/MultiCluster-v0", "USNET/SingleCluster-v0", "USNET/Probing-v1"
SMALL = {"clusters": 2, "uavs": 12, "max_rounds": 2}
# Swarms with and without references and compiled loops, in one batch.
KINDS = {
    "follow": ["f1", "f7", "none", "second-1", "random", "pigeons", "informed", "reference", "independent", "shifted"],
    "kinematics": ["unit", "varied_speed", "lagged", "limited", "layered"],
    "mobility": ["iid", "alike", "smooth_turn"],
    "head_jitter": [False, True],
    "clusters": (2, 4),
    "decoys": (0, 2),
    "bystanders": (0, 2),
    "position_noise": (0.0, 0.5),
    "memory": 12,
    "uavs": (20, 24),
    "max_rounds": 2,
}


def make_pair(name=MULTI, mode="Disabled", count=4, **arguments):
    """A batch, and Gymnasium's vectorisation of single environments."""
    arguments = {"observation_steps": 10, **arguments}
    batch = gym.make_vec(f"usnet_env:{name}", num_envs=count, autoreset_mode=mode, **arguments)
    options = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": AutoresetMode(mode)}}
    return batch, gym.make_vec(name, num_envs=count, **options, **arguments)


def equal(one, other):
    return data_equivalence(one, other, exact=True)


@pytest.mark.parametrize(
    ("name", "mode", "arguments"),
    [
        *((name, "NextStep", {}) for name in sorted(ENVIRONMENTS)),
        (SINGLE, "SameStep", {"observe": ("velocity",)}),
        (MULTI, "SameStep", {"reveal_truth": True, "max_rounds": 2, "miss_rate": 0.1}),
        ("USNET/Field-v1", "SameStep", {"max_rounds": 2}),
        (MULTI, "Disabled", {**SMALL, "reveal_truth": True}),
        *((MULTI, mode.value, {**KINDS, "reveal_truth": True}) for mode in AutoresetMode),
        *((PROBING, mode.value, {"followers": 2, "miss_rate": 0.1, "reveal_truth": True}) for mode in AutoresetMode),
        *((name, "NextStep", {"follow": "f7", "reveal_truth": True}) for name in (SINGLE, MULTI, "USNET/Field-v1")),
        (MULTI, "NextStep", {"follow": ["none", "independent"], "max_rounds": 2}),
    ],
)
def test_equal_to_single_envs_over_many_episodes(name, mode, arguments):
    """What they return, their states, and what goes on from a state."""
    batch, singles = make_pair(name, mode, 5, **arguments)
    assert batch.metadata["autoreset_mode"] is AutoresetMode(mode)
    assert batch.unwrapped.__class__.__name__.endswith("VectorEnv")
    assert equal(batch.reset(seed=0), singles.reset(seed=0))
    assert batch.np_random_seed == singles.np_random_seed == (0, 1, 2, 3, 4)
    rng, ends = np.random.default_rng(3), 0
    for k in range(10):
        if name == PROBING:
            actions = {"steer": rng.uniform(-1, 1, (5, 1, 3)), "name": rng.integers(4, size=5)}
        else:
            share = rng.choice([0.05, 0.5, 1.0], size=(5, 1))
            actions = (rng.random(batch.action_space.shape) < share).astype(np.int8)
        one, other = batch.step(actions), singles.step(actions)
        assert equal(one, other)
        assert batch.observation_space.contains(one[0])
        over = one[2] | one[3]
        ends += int(over.sum())
        if mode == "Disabled" and over.any():
            with pytest.raises(ArgumentError, match="reset must be called"):
                batch.step(actions)
            for array in (*one[0].values(), *other[0].values()):
                array[:] = 0  # changes no later observation
            again = [envs.reset(seed=[k, k, 8, 3, 9], options={"reset_mask": over.copy()}) for envs in (batch, singles)]
            assert equal(*again)
            one = again[0]
    assert ends > 5
    seen = {name: array.copy() for name, array in one[0].items()}
    for array in one[0].values():
        array[:] = 0  # changes no state
    states = batch.get_state()
    np.testing.assert_equal(states, list(singles.call("get_state")))  # a goal that isn't drawn yet is NaN
    batch.reset(seed=9)
    assert equal(batch.set_state(states), seen)
    np.testing.assert_equal(batch.get_state(), states)
    assert equal(batch.step(actions), singles.step(actions))


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
    for seed in (1.5, "12", -1, [1.5, 1], ["a", "b"], [1, 2, 3]):
        with pytest.raises(ArgumentError, match=r"^seed must"):
            batch.reset(seed=seed)
    for mask in (np.zeros(2, bool), np.ones(3, bool), [1, 0]):
        with pytest.raises(ArgumentError, match=r"^reset_mask must"):
            batch.reset(options={"reset_mask": mask})
    one = batch.reset(seed=[3, None])[0]["position"][0]
    np.testing.assert_array_equal(batch.reset(seed=np.array([3, 4]))[0]["position"][0], one)
    assert not np.array_equal(batch.reset()[0]["position"][0], one)  # the generators go on
    for wrong in (np.zeros(82), np.full((2, 82), 2), None):
        with pytest.raises(ArgumentError, match=r"^action must"):
            batch.step(wrong)


def test_statistics_of_games_that_restart_in_the_step_that_ends_them():
    """Gymnasium 1.2 and 1.3 report a return of 0, the best of P1, in each game but the first."""
    batch = gym.make_vec("USNET/SingleCluster-Tiny-v0", num_envs=2, autoreset_mode="SameStep")
    envs = RecordEpisodeStatistics(batch)
    envs.reset(seed=0)
    for _ in range(3):
        *_, info = envs.step(np.zeros((2, 8), np.int8))
        assert info["episode"]["r"].tolist() == [-1.0, -1.0]
        assert info["episode"]["l"].tolist() == [1, 1]


def test_single_games_of_a_batch():
    """Pictures, attributes and steps are those of single environments."""
    batch, singles = make_pair(**SMALL, render_mode="rgb_array", count=2)
    for envs in (batch, singles):
        envs.reset(seed=3)
    for _ in range(2):
        assert equal(batch.render(), singles.render())
        batch.step(np.eye(2, 12, dtype=np.int8)), singles.step(np.eye(2, 12, dtype=np.int8))
    np.testing.assert_array_equal(batch.call("action_masks"), batch.action_masks())
    batch.set_attr("note", [1, 2])
    assert batch.get_attr("note") == (1, 2)
    with pytest.raises(ArgumentError, match=r"^name must be no attribute"):
        batch.set_attr("rules", None)
    fresh, _ = make_pair(**SMALL, count=2)
    fresh.set_state(batch.get_state())  # before it was reset
    assert equal(fresh.get_state(), batch.get_state())
    for envs in (batch, singles):
        envs.reset(seed=5)
    alone, before = [envs.unwrapped.envs[1] for envs in (batch, singles)], batch.get_state()
    assert equal(*(env.unwrapped.step(np.eye(12, dtype=np.int8)[0]) for env in alone))
    assert equal(batch.render(), singles.render())
    after = batch.get_state()
    assert equal(after, list(singles.call("get_state")))
    assert equal(after[0], before[0])

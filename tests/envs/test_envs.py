"""The single environments, found through the registry and driven as Gymnasium code drives them."""

import inspect
import json
import pickle
import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from hypothesis import given, settings
from hypothesis import strategies as st

from usnet_env import ArgumentError
from usnet_env.envs import (
    ENVIRONMENTS,
    MultiClusterEnv,
    MultiDiscreteCandidates,
    SingleClusterEnv,
    register_environments,
)
from usnet_env.envs.wrappers import BoxMasks
from usnet_env.registration import OTHERS, PROBING

IDS = sorted(ENVIRONMENTS)
MULTI = "USNET/MultiCluster-v0"
SINGLE = "USNET/SingleCluster-v0"
SMALL = {"clusters": 3, "uavs": 20, "observation_steps": 12}


def test_the_registry_holds_every_id():
    assert sorted(name for name in gym.registry if name.startswith("USNET/")) == sorted([*IDS, *OTHERS])
    register_environments()  # a second time changes nothing, and warns of nothing


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_s_checker_has_nothing_to_say(name):
    """Warnings are errors in this test suite. Pictures take long, and are the same for all."""
    check_env(gym.make(name, render_mode="rgb_array").unwrapped, skip_render_check=name != MULTI)


@pytest.mark.parametrize("name", IDS)
def test_an_id_says_it_all(name):
    spec = gym.make(f"usnet_env:{name}", follow="f3").spec
    again = gym.make(gym.envs.registration.EnvSpec.from_json(spec.to_json()))
    assert again.unwrapped.config == gym.make(name, follow="f3").unwrapped.config
    assert json.loads(spec.to_json())["kwargs"]["follow"] == "f3"


def play(env, seed, choose):
    """(truth at the start, candidates of each round, rewards, last info) of an episode."""
    _, first = env.reset(seed=seed)
    swarm = env.unwrapped.swarm
    rounds, rewards, done = [], [], False
    while not done:
        rounds.append(choose(env.unwrapped.swarm, len(rounds)))
        _, reward, terminated, truncated, info = env.step(rounds[-1])
        assert info.keys() == first.keys()
        assert sum(value for name, value in info.items() if name.startswith("reward_")) == pytest.approx(reward)
        rewards.append(reward)
        done = terminated or truncated
    return swarm.head, rounds, rewards, info, terminated


@pytest.mark.filterwarnings("ignore:redundancy_price is 0")
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), share=st.floats(0, 1), price=st.sampled_from([0.0, 0.5, 1.0, 3.0]))
def test_the_return_of_p2_is_minus_j_m(seed, share, price):
    """J_m written out from the paper: R + (1/N) sum_r |C_r without H_{r-1}|."""
    rng = np.random.default_rng(seed)
    env = gym.make(MULTI, **SMALL, decoys=2, max_rounds=6, redundancy_price=price)
    head, rounds, rewards, info, terminated = play(env, seed, lambda swarm, r: (rng.random(20) < share).astype(np.int8))
    remaining, redundant = set(np.flatnonzero(head)), 0
    for candidates in rounds:
        named = set(np.flatnonzero(candidates))
        redundant += len(named - remaining)
        remaining -= named
    assert sum(rewards) == pytest.approx(-(len(rounds) + price * redundant / 20), abs=1e-12)
    assert info["J"] == pytest.approx(len(rounds) + redundant / 20, abs=1e-12)  # always at price 1
    assert env.unwrapped.swarm.heads_left == len(remaining)
    assert terminated == (not remaining) == bool(info["success"])
    assert terminated or len(rounds) == 6


@pytest.mark.filterwarnings("ignore:redundancy_price is 0")
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31), share=st.floats(0, 1), price=st.sampled_from([0.0, 0.5, 1.0, 3.0]))
def test_the_reward_of_p1_is_j_s_and_its_price_leaves_a_miss_at_one(seed, share, price):
    rng = np.random.default_rng(seed)
    env = gym.make(SINGLE, followers=5, observation_steps=12, redundancy_price=price)
    head, rounds, rewards, info, terminated = play(env, seed, lambda swarm, r: (rng.random(6) < share).astype(np.int8))
    named, hit = rounds[0].sum(), (rounds[0] & head).sum()
    assert info["J"] == (hit - named if named else -1)
    assert rewards == [-price * (named - hit) if hit else -1 - price * max(named - 1, 0)]
    assert terminated


@pytest.mark.parametrize(("follow", "some"), [("informed", -1.0), ("shepherd", -1.5)])
def test_the_price_of_p1_is_of_redundant_candidates_also_with_several_heads_or_none(follow, some):
    env = gym.make(SINGLE, follow=follow, memory=12, observation_steps=12, redundancy_price=0.5)

    def heads_and_two_others(swarm, r):
        return (swarm.head | (np.cumsum(~swarm.head) <= 2) & ~swarm.head).astype(np.int8)

    head, rounds, rewards, info, _ = play(env, 0, heads_and_two_others)
    assert head.sum() != 1
    assert (rounds[0].sum(), rewards, info["J"]) == (head.sum() + 2, [some], -2.0)
    _, _, rewards, info, _ = play(env, 0, lambda swarm, r: swarm.head.astype(np.int8))
    assert rewards == [0.0] == [info["J"]]
    assert info["success"] == 1


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
@pytest.mark.parametrize("name", [MULTI, SINGLE])
def test_free_candidates_are_warned_of_unless_a_budget_limits_them(make, name):
    make(name, redundancy_price=0, shot_budget=1)
    with pytest.warns(UserWarning, match="redundancy_price is 0, so to name all UAVs is the best answer"):
        make(name, redundancy_price=0)


@pytest.mark.parametrize(("name", "reward"), [(MULTI, -1.0), (SINGLE, -1.0)])
def test_a_salvo_over_the_budget_destroys_nobody(name, reward):
    env = gym.make(name, shot_budget=3)
    env.reset(seed=0)
    action = np.zeros(env.action_space.n, np.int8)
    action[:4] = 1
    observation, got, _, _, info = env.step(action)
    assert (got, info["over_budget"]) == (reward, 1)
    assert info["hits"] == info["redundant"] == 0
    assert observation["alive"].all()
    assert env.unwrapped.swarm.alive.all()


def test_rounds_orphans_and_masks():
    env = gym.make(MULTI, **SMALL)
    observation, info = env.reset(seed=0)
    assert (info["round"], observation["round"][0]) == (0, 1)
    swarm = env.unwrapped.swarm
    first = np.flatnonzero(swarm.head)[0]
    action = np.zeros(20, np.int8)
    action[first] = 1
    observation, _, _, _, info = env.step(action)
    after = env.unwrapped.swarm
    assert (info["round"], observation["round"][0], after.heads_left) == (1, 2, 2)
    assert observation["alive"][first] == 0
    assert not observation["seen"][:, first].any()
    orphans = (swarm.root == first) & ~swarm.head
    assert after.head[after.root[orphans]].all()
    assert (after.root[orphans] != first).all()
    masks = env.unwrapped.action_masks().reshape(20, 2)
    assert masks[:, 0].all()
    np.testing.assert_array_equal(masks[:, 1], observation["alive"])


def test_a_terminated_game_shows_an_empty_window_and_a_truncated_one_the_next():
    env = gym.make(MULTI, **SMALL, max_rounds=1)
    env.reset(seed=0)
    observation, *_ = env.step(env.unwrapped.swarm.head.astype(np.int8))
    assert not observation["seen"].any()
    env.reset(seed=0)
    observation, _, terminated, truncated, _ = env.step(np.zeros(20, np.int8))
    assert (terminated, truncated) == (False, True)
    assert observation["seen"].all()


@pytest.mark.parametrize(
    "action",
    [np.zeros(19, np.int8), 0, None, "all", [[0] * 10] * 2, [2] * 20, [np.nan] * 20, [0.5] * 20, [-1] * 20, [[0], 1]],
    ids=repr,
)
def test_a_wrong_action_is_named_and_changes_nothing(action):
    env = gym.make(MULTI, **SMALL).unwrapped
    env.reset(seed=0)
    before = env.get_state()
    with pytest.raises(ArgumentError, match=r"^action must .*got .*\.$"):
        env.step(action)
    assert pickle.dumps(env.get_state()) == pickle.dumps(before)


def test_what_comes_too_early_or_too_late_is_refused():
    env = gym.make(SINGLE).unwrapped
    for early in (env.action_masks, env.get_state, lambda: env.step(np.zeros(16)), lambda: env.swarm):
        with pytest.raises(ArgumentError, match="reset must be called first"):
            early()
    env.reset(seed=0)
    env.step(np.zeros(16, np.int8))
    with pytest.raises(ArgumentError, match="reset must be called first"):
        env.step(np.zeros(16, np.int8))
    with pytest.warns(UserWarning, match="render_mode='rgb_array'"):
        assert env.render() is None


def shots(count):
    rng = np.random.default_rng(11)
    return [(rng.random(20) < 0.1).astype(np.int8) for _ in range(count)]


@pytest.mark.parametrize(
    ("name", "case", "actions"),
    [
        (MULTI, SMALL, shots(6)),
        (MULTI, SMALL | {"follow": "f7", "mobility": "smooth_turn", "position_noise": 1.0}, shots(6)),
        (PROBING, {"followers": 5, "actions": "flat"}, [np.full(10, 0.3, np.float32)] * 6),
    ],
)
def test_an_episode_goes_on_where_it_was_saved(name, case, actions):
    env, elsewhere = (gym.make(name, **case).unwrapped for _ in range(2))
    env.reset(seed=4)
    env.step(actions[0])
    state = pickle.loads(pickle.dumps(env.get_state()))
    twin = pickle.loads(pickle.dumps(env))
    expected = [env.step(action) for action in actions]
    env.set_state(state)  # back from where it flew
    shown = elsewhere.set_state(state)
    assert data_equivalence({part: shown[part] for part in state["observation"]}, state["observation"], exact=True)
    for other in (twin, env, elsewhere):
        assert data_equivalence([other.step(action) for action in actions], expected, exact=True)
    for wrong in (state, None):
        with pytest.raises(ArgumentError, match="state must come from get_state"):
            gym.make(name).unwrapped.set_state(wrong)


@pytest.mark.parametrize(("name", "kind"), [(SINGLE, SingleClusterEnv), (MULTI, MultiClusterEnv)])
def test_the_docstring_lists_the_keys_of_info(name, kind):
    table = inspect.getdoc(kind).partition("`info` holds")[2].partition("##")[0]
    listed = re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)
    _, info = gym.make(name).reset(seed=0)
    assert listed == list(info)
    assert set(info.values()) == {0}
    revealed = re.search(r"\| `reveal_truth` .* `info` also holds (.*) \|", inspect.getdoc(kind))[1]
    _, truth = gym.make(name, reveal_truth=True).reset(seed=0)
    assert {*info, *re.findall(r"`(\w+)`", revealed)} == set(truth)


@pytest.mark.parametrize("wrapper", [BoxMasks, MultiDiscreteCandidates])
def test_a_wrapped_environment_plays_the_same_game_and_can_be_made_again_from_its_spec(wrapper):
    plain, wrapped = gym.make(MULTI, **SMALL), wrapper(gym.make(MULTI, **SMALL))
    again = gym.make(wrapped.spec)
    assert (again.action_space, again.observation_space) == (wrapped.action_space, wrapped.observation_space)
    assert data_equivalence(plain.reset(seed=0), wrapped.reset(seed=0), exact=True)
    action = np.array(shots(1)[0], np.int64)
    assert wrapped.action_space.contains(action.astype(wrapped.action_space.dtype))
    observation = wrapped.step(action)[0]
    assert data_equivalence(plain.step(action)[0], observation, exact=True)
    assert wrapped.observation_space.contains(observation)
    np.testing.assert_array_equal(wrapped.get_wrapper_attr("action_masks")(), plain.unwrapped.action_masks())
    with pytest.warns(UserWarning, match="is different from the unwrapped version"):
        check_env(wrapped)


@pytest.mark.parametrize(
    ("name", "value"),
    [("options", {"follow": "f3"}), ("options", "f3"), *(("seed", each) for each in (1.5, -1, "1", [1], np.nan))],
)
def test_a_bad_argument_of_reset_is_named(name, value):
    env = gym.make(MULTI, **SMALL).unwrapped
    with pytest.raises(ArgumentError, match=rf"^{name} must"):
        env.reset(**{"seed": 0, name: value})
    assert data_equivalence(env.reset(seed=np.array(7), options={}), env.reset(seed=7), exact=True)

"""The games of several agents in TorchRL: those of the batch, with one number as an agent's action."""

import importlib

import numpy as np
import pytest

from usnet_env import ArgumentError

pytestmark = pytest.mark.slow  # TorchRL takes seconds to import

SMALL = {"clusters": 2, "uavs": 10, "observation_steps": 12, "max_rounds": 3}
GAMES = [
    ("usnet_observers_v0", {}),
    ("usnet_observers_v0", {"message_size": 2, "fusion": "scores"}),
    ("usnet_evasion_v0", {}),
]


@pytest.fixture
def make():
    pytest.importorskip("torchrl")
    pytest.importorskip("pettingzoo")
    return importlib.import_module("usnet_env.frameworks.torchrl").GamesEnv


@pytest.mark.parametrize(("game", "more"), GAMES)
def test_torchrl_plays_the_games_of_the_batch(make, game, more):
    batch_env = importlib.import_module(f"usnet_env.multiagent.{game}").batch_env
    env, games = make(game, 4, **SMALL, **more), batch_env(4, **SMALL, **more)
    importlib.import_module("torchrl.envs").check_env_specs(env, seed=0)
    env.set_seed(5)
    played = env.rollout(6, break_when_any_done=False)
    seen, _ = games.reset(seed=5)
    for t in range(6):
        now, after = played[:, t], played["next"][:, t]
        np.testing.assert_array_equal(now["state"], games.state())
        for role, flat in games.flatten(seen).items():
            np.testing.assert_array_equal(now[role, "observation"], flat)
            np.testing.assert_array_equal(now[role, "active"][..., 0], games.active[role])
        chosen = now["observer", "action"].numpy()
        space = games.action_spaces["observer"]
        actions = {"observer": np.arange(space.shape[0]) == np.where(chosen < 10, chosen, -1)[..., None]}
        if "head" in games.roles:
            choices = np.unravel_index(now["head", "action"].numpy(), games.action_spaces["head"].nvec)
            actions["head"] = np.stack(choices, axis=-1)
        seen, rewards, terminated, truncated, _ = games.step(actions)
        for role, reward in rewards.items():
            np.testing.assert_allclose(after[role, "reward"][..., 0], reward, rtol=1e-6)
        over = (terminated["observer"] | truncated["observer"]).any(axis=1)
        np.testing.assert_array_equal(after["done"][:, 0], over)
        if over.any():
            seen, _ = games.reset(games=over)
    assert played["next", "done"].any()


def test_masks_allow_living_uavs_nobody_and_the_decoys_that_a_head_can_have(make):
    env = make("usnet_evasion_v0", 2, clusters=2, uavs=6, observation_steps=12)
    first = env.reset(seed=0)
    nobody = first["observer", "action_mask"]
    assert nobody[..., 6].all()  # nobody; in the opening no UAV has been seen
    assert not nobody[..., :6].any()
    mask = first["head", "action_mask"].numpy().reshape(2, 2, *env.games.action_spaces["head"].nvec)
    assert mask[..., :2, :].all()  # no decoy or one
    assert not mask[..., 2, :].any()  # of two followers one remains
    first["observer", "action"] = np.full((2, 1), 6)
    first["head", "action"] = np.zeros((2, 2), int)
    first["head", "active"].zero_()  # the caller's, not the game's
    assert env.games.active["head"].all()
    assert env.step(first)["next", "observer", "action_mask"].all()


def test_observe_keeps_some_arrays_of_each_role(make):
    env = make("usnet_evasion_v0", 2, **SMALL, observe=("velocity", "heads"))
    importlib.import_module("torchrl.envs").check_env_specs(env, seed=0)
    env.set_seed(3)
    flat, seen = env.reset(), env.games.reset(seed=3)[0]
    assert flat["observer", "observation"].shape == (2, 1, 12 * 10 * 3)
    parts = [seen["head"]["heads"], seen["head"]["velocity"].reshape(2, 2, -1)]
    np.testing.assert_array_equal(flat["head", "observation"], np.concatenate(parts, axis=2))
    with pytest.raises(ArgumentError, match=r"^observe must be one of alive, .* got 'speed'"):
        make("usnet_evasion_v0", 2, **SMALL, observe=("velocity", "speed"))

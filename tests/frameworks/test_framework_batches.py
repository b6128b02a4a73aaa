"""The batches of games in Stable-Baselines3 and TorchRL, and the policies that learn from raw windows."""

import importlib

import gymnasium as gym
import numpy as np
import pytest

from usnet_env import ArgumentError

SMALL = {"clusters": 2, "uavs": 10, "observation_steps": 12, "max_rounds": 2}
SEEN = {"observe": ("velocity", "alive")}


def test_stable_baselines_plays_the_games_of_the_batch():
    pytest.importorskip("stable_baselines3")
    from usnet_env.frameworks.sb3 import SwarmVecEnv

    envs = SwarmVecEnv("USNET/MultiCluster-v0", 3, render_mode="rgb_array", **SMALL)
    batch = gym.make_vec("USNET/MultiCluster-v0", num_envs=3, autoreset_mode="SameStep", **SMALL)
    envs.seed(5)
    np.testing.assert_equal(envs.reset(), batch.reset(seed=5)[0])
    rng, total, ends = np.random.default_rng(0), np.zeros(3), []
    for _ in range(4):
        action = (rng.random((3, 10)) < 0.3).astype(np.int8)
        observation, reward, done, infos = envs.step(action)
        expected, expected_reward, terminated, truncated, info = batch.step(action)
        np.testing.assert_equal(observation, expected)
        np.testing.assert_array_equal(done, terminated | truncated)
        np.testing.assert_allclose(reward, expected_reward, rtol=1e-6)
        total += expected_reward
        for b in np.flatnonzero(done):
            assert infos[b]["episode"]["r"] == total[b] == pytest.approx(-infos[b]["J"])
            assert infos[b]["TimeLimit.truncated"] == truncated[b]
            np.testing.assert_equal(infos[b]["terminal_observation"], info["final_obs"][b])
            ends.append(infos[b]["episode"]["l"])
        total[done] = 0.0
    assert set(ends) == {1, 2}
    masks = envs.env_method("action_masks", indices=[2])
    np.testing.assert_array_equal(masks, envs.env_method("action_masks")[2:])
    assert (envs.get_attr("problem", indices=0), len(envs.get_images())) == (["P2"], 3)
    assert [set(state) >= {"swarm"} for state in envs.env_method("get_state")] == [True] * 3
    envs.set_attr("note", [5, 6], indices=[0, 2])
    assert envs.get_attr("note", indices=2) == [[5, 6]]
    envs.set_attr("note", 1, indices=1)
    assert envs.get_attr("note") == [[5, 6], 1, [5, 6]]
    before = [rng.bit_generator.state for rng in envs.envs.np_random]
    envs.env_method("reset", indices=[0])  # draws from the generator of game 0 only
    same = [rng.bit_generator.state == old for rng, old in zip(envs.envs.np_random, before, strict=True)]
    assert same == [False, True, True]
    with pytest.raises(ArgumentError, match="that the games of a batch share"):
        envs.set_attr("rules", None, indices=[0])


def test_the_pair_policy_learns_raw_windows_in_stable_baselines():
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO

    from detectors.policy_detector import PolicyDetector
    from detectors.rl.sb3 import PairPolicy
    from usnet_env import evaluate
    from usnet_env.frameworks.sb3 import SwarmVecEnv

    arguments = {"followers": 4, "observation_steps": 16}
    envs = SwarmVecEnv("USNET/SingleCluster-v0", 64, **arguments, **SEEN)
    settings = {"n_steps": 8, "batch_size": 128, "n_epochs": 4, "learning_rate": 1e-2}
    model = PPO(PairPolicy, envs, seed=0, device="cpu", **settings).learn(4096)
    detector = PolicyDetector(model.policy)
    result = evaluate("USNET/SingleCluster-v0", detector, episodes=20, seed=1, env_kwargs=arguments)
    assert result.summary[0]["metrics"]["J"]["mean"] > -0.5  # a guess has -0.8


def test_stable_baselines_steers_and_names_in_one_action():
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO

    from usnet_env.frameworks.sb3 import SwarmVecEnv

    envs = SwarmVecEnv("USNET/Probing-v1", 8, followers=4, observation_steps=12, actions="flat", intruders=2)
    model = PPO("MultiInputPolicy", envs, n_steps=8, batch_size=32, n_epochs=1, seed=0, device="cpu").learn(64)
    assert {game["l"] for game in model.ep_info_buffer} >= {4}  # waits until the window is full


@pytest.mark.parametrize("name", ["PairNetwork", "AttentionNetwork"])
def test_a_network_sees_no_order_and_no_destroyed_uav_and_the_pair_network_no_direction(name):
    torch = pytest.importorskip("torch")
    from detectors.rl import AttentionNetwork, PairNetwork

    torch.manual_seed(0)
    network = PairNetwork() if name == "PairNetwork" else AttentionNetwork(steps=12)
    velocity, alive = torch.randn(2, 12, 7, 3), torch.ones(2, 7)
    alive[1, 3] = 0
    with torch.no_grad():
        logits, value = network(velocity, alive)
        order = torch.randperm(7)
        turn = torch.linalg.qr(torch.randn(3, 3))[0] if name == "PairNetwork" else torch.eye(3)
        permuted, same = network(velocity[:, :, order] @ turn, alive[:, order])
        velocity[1, :, 3] = 9.0
        unseen, _ = network(velocity, alive)
    torch.testing.assert_close(permuted, logits[:, order], atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(same, value, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(unseen, logits, atol=1e-4, rtol=1e-4)
    assert logits[1, 3] == -1e3
    assert network(velocity, torch.zeros(2, 7))[1].isfinite().all()  # as when all UAVs were destroyed


@pytest.mark.parametrize("named", [1, 3])
def test_a_new_pair_network_names_so_many_uavs_of_any_swarm(named):
    torch = pytest.importorskip("torch")
    from detectors.rl import PairNetwork

    for uavs in (8, 30):
        logits, _ = PairNetwork(named=named)(torch.randn(2, 12, uavs, 3), torch.ones(2, uavs))
        torch.testing.assert_close(logits.sigmoid().sum(dim=1), torch.full((2,), float(named)))


def test_the_attention_policy_trains_and_is_loaded_again(tmp_path):
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO

    from detectors.rl.sb3 import AttentionPolicy
    from usnet_env.frameworks.sb3 import SwarmVecEnv

    envs = SwarmVecEnv("USNET/SingleCluster-v0", 4, followers=4, observation_steps=16, **SEEN)
    settings = {"n_steps": 4, "batch_size": 8, "n_epochs": 1, "policy_kwargs": {"network": {"width": 16}}}
    model = PPO(AttentionPolicy, envs, seed=0, device="cpu", **settings).learn(16)
    model.save(tmp_path / "model")
    seen = envs.reset()
    action, _ = model.predict(seen, deterministic=True)
    assert action.shape == (4, 5)
    np.testing.assert_array_equal(PPO.load(tmp_path / "model").predict(seen, deterministic=True)[0], action)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning")
@pytest.mark.parametrize("name", ["SingleCluster-v0", "MultiCluster-v0", "Probing-v1"])
def test_torchrl_plays_the_games_of_the_batch(name):
    torch = pytest.importorskip("torch")
    envs = pytest.importorskip("torchrl.envs")
    from usnet_env.frameworks.torchrl import SwarmEnv

    arguments = SMALL if name == "MultiCluster-v0" else {"followers": 9, "observation_steps": 12}
    if name == "Probing-v1":
        envs.check_env_specs(SwarmEnv(f"USNET/{name}", 4, **arguments), seed=0)
        arguments["actions"] = "flat"
    env = SwarmEnv(f"USNET/{name}", 4, **arguments)
    envs.check_env_specs(env, seed=0)
    batch = gym.make_vec(f"USNET/{name}", num_envs=4, autoreset_mode="SameStep", **arguments)
    env.set_seed(7)
    played = env.rollout(5, break_when_any_done=False)
    observation, _ = batch.reset(seed=7)
    for t in range(5):
        np.testing.assert_array_equal(played["velocity"][:, t], observation["velocity"])
        observation, reward, terminated, truncated, _ = batch.step(played["action"][:, t].numpy())
        torch.testing.assert_close(played["next", "reward"][:, t, 0], torch.from_numpy(reward).float())
        np.testing.assert_array_equal(played["next", "done"][:, t, 0], terminated | truncated)


FEW = {"clusters": 2, "uavs": 10, "observation_steps": 12, "max_rounds": 3}
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


@pytest.mark.slow  # TorchRL takes seconds to import
@pytest.mark.parametrize(("game", "more"), GAMES)
def test_torchrl_plays_the_games_of_several_agents(make, game, more):
    batch_env = importlib.import_module(f"usnet_env.multiagent.{game}").batch_env
    env, games = make(game, 4, **FEW, **more), batch_env(4, **FEW, **more)
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


@pytest.mark.slow
def test_masks_allow_living_uavs_none_and_the_decoys_that_a_head_can_have(make):
    env = make("usnet_evasion_v0", 2, clusters=2, uavs=6, observation_steps=12)
    first = env.reset(seed=0)
    mask = first["observer", "action_mask"]
    assert mask[..., 6].all()  # no UAV; in the opening none has been seen
    assert not mask[..., :6].any()
    mask = first["head", "action_mask"].numpy().reshape(2, 2, *env.games.action_spaces["head"].nvec)
    assert mask[..., :2, :].all()  # no decoy or one
    assert not mask[..., 2, :].any()  # of two followers one remains
    first["observer", "action"] = np.full((2, 1), 6)
    first["head", "action"] = np.zeros((2, 2), int)
    first["head", "active"].zero_()  # the caller's, not the game's
    assert env.games.active["head"].all()
    assert env.step(first)["next", "observer", "action_mask"].all()


@pytest.mark.slow
def test_observe_keeps_some_arrays_of_each_role(make):
    env = make("usnet_evasion_v0", 2, **FEW, observe=("velocity", "heads"))
    importlib.import_module("torchrl.envs").check_env_specs(env, seed=0)
    env.set_seed(3)
    flat, seen = env.reset(), env.games.reset(seed=3)[0]
    assert flat["observer", "observation"].shape == (2, 1, 12 * 10 * 3)
    parts = [seen["head"]["heads"], seen["head"]["velocity"].reshape(2, 2, -1)]
    np.testing.assert_array_equal(flat["head", "observation"], np.concatenate(parts, axis=2))
    with pytest.raises(ArgumentError, match=r"^observe must be one of alive, .* got 'speed'"):
        make("usnet_evasion_v0", 2, **FEW, observe=("velocity", "speed"))

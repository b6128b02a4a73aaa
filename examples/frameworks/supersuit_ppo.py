"""SuperSuit and Stable-Baselines3: PPO trains one policy for all observers of usnet_observers_v0.

pip install -e '.[supersuit]'
python examples/frameworks/supersuit_ppo.py
"""

import argparse
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import supersuit
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv
from wrappers import MultiDiscreteVotes

from detectors.policy_detector import PolicyDetector
from usnet_env import Window
from usnet_env.evaluation import evaluate_games
from usnet_env.multiagent import usnet_observers_v0
from usnet_env.multiagent.policies import DetectorObserver

UAVS = 12
ARGUMENTS = {"observers": 3, "sensing_range": 700.0, "clusters": 2, "uavs": UAVS}
ARGUMENTS |= {"observation_steps": 20, "max_rounds": 5}
PRICE = 3.0  # of a redundant candidate; at the paper's 1, naming all UAVs is too good to learn anything better
SETTINGS = {"learning_rate": 1e-2, "n_steps": 64, "batch_size": 128, "policy_kwargs": {"net_arch": [32]}}


def how_copied(window: Window) -> np.ndarray:
    """``(N,)`` float32: the share of the observed UAVs that copy this UAV best, one step later."""
    here = window.alive & window.seen.any(axis=0)
    velocity = np.where(window.velocity_seen[..., None], window.velocity, 0.0)
    agreement = np.einsum("tic,tjc->ij", velocity[1:], velocity[:-1])  # row i: how well i copies each j
    np.fill_diagonal(agreement, -np.inf)
    agreement[:, ~here] = -np.inf
    votes = np.bincount(agreement[here].argmax(axis=1), minlength=window.uavs)
    return (votes / max(1, here.sum())).astype(np.float32)


def observe_copied(observation: dict[str, Any], *_: Any) -> np.ndarray:
    """For each UAV, the share of the UAVs that this observer sees and that copy it."""
    return how_copied(Window.from_observation(observation))


def make_envs(games: int, seed: int) -> VecEnv:
    """Several games; each observer of each game is one environment of Stable-Baselines3."""
    game = MultiDiscreteVotes(usnet_observers_v0.parallel_env(**ARGUMENTS, redundancy_price=PRICE))
    game = supersuit.observation_lambda_v0(
        game, observe_copied, lambda *_: gym.spaces.Box(0.0, 1.0, (UAVS,), np.float32)
    )
    envs = supersuit.concat_vec_envs_v1(
        supersuit.pettingzoo_env_to_vec_env_v1(game), games, base_class="stable_baselines3"
    )
    envs.venv.reset(seed=seed)  # SuperSuit's environments have no seed(): seed them here, not through PPO
    return envs


def train(steps: int, games: int = 4, seed: int = 0) -> PPO:
    """Train one policy for all observers; a step of a game counts once for each observer."""
    set_random_seed(seed)
    model = PPO("MlpPolicy", make_envs(games, seed), gamma=1.0, device="cpu", **SETTINGS)
    model.learn(steps)
    model.predict(model.observation_space.sample())  # without gradients: a policy with gradients cannot be copied
    return model


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, then let every observer use the policy, and compare with detectors."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=24_576, help="steps to train for, counted for each observer")
    parser.add_argument("--games", type=int, default=20, help="games to score")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    model = train(asked.steps, seed=asked.seed)
    observers = {"PPO": DetectorObserver(PolicyDetector(model.policy, observe=how_copied))}
    observers |= {"regression": "lagged-regression", "random": "random(count=2)"}
    teams = {name: {"observer": observer} for name, observer in observers.items()}
    result = evaluate_games("usnet_observers_v0", teams, game_kwargs=ARGUMENTS, episodes=asked.games, seed=2022)
    print(result.to_markdown(["success", "J"]))


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads make small networks slower
    main()

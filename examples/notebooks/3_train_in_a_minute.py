"""
Train in a minute
=================

PPO learns from raw windows which UAV leads, without hints or rules. It needs ``pip install '.[rl]'``.
"""

# %%
import gymnasium as gym
import matplotlib.pyplot as plt
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from detectors.policy_detector import PolicyDetector
from detectors.rl.sb3 import PairPolicy
from usnet_env import evaluate
from usnet_env.frameworks.sb3 import SwarmVecEnv
from usnet_env.replay import draw_episode, record_episode

torch.set_num_threads(1)
GAME = {"followers": 7, "observation_steps": 20}  # P1 with eight UAVs

# %% [markdown]
# 64 games fly in one batch. The reward is 0 for the head alone, and less for every other answer. The network compares
# the velocities of each pair of UAVs; its 676 parameters know nothing at first.


# %%
class Rewards(BaseCallback):
    """Keeps the number of games and the mean reward of each rollout."""

    def _on_training_start(self):
        self.curve = []

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        self.curve.append((self.num_timesteps, self.model.rollout_buffer.rewards.mean()))


envs = SwarmVecEnv("USNET/SingleCluster-v0", 64, observe=("velocity", "alive"), **GAME)
settings = {"n_steps": 16, "batch_size": 256, "n_epochs": 4, "learning_rate": 5e-3, "device": "cpu"}
rewards = Rewards()
model = PPO(PairPolicy, envs, seed=0, **settings).learn(16_384, callback=rewards)

plt.figure(figsize=(6, 3), layout="constrained")
plt.plot(*zip(*rewards.curve, strict=True), marker=".")
plt.xlabel("games")
_ = plt.ylabel("mean reward; 0 is best")

# %% [markdown]
# Its policy is a detector like any other. On swarms that it has not seen:

# %%
detectors = {"PPO": PolicyDetector(model.policy), "random": "random"}
result = evaluate("USNET/SingleCluster-v0", detectors, episodes=200, seed=1, env_kwargs=GAME)
assert result["PPO"]["exact"]["mean"] > 0.95
result

# %% [markdown]
# One of these swarms, in ``learned.png`` too: what the agent sees and names, and the truth.

# %%
env = gym.make("USNET/SingleCluster-v0", **GAME)
figure = draw_episode(record_episode(env, detectors["PPO"], seed=2, detector_seed=1, label="PPO"))
figure.savefig("learned.png")
figure

# %% [markdown]
# It knows only f1. Train with ``follow="random"``, another law in every game, then test on f1 to f7.

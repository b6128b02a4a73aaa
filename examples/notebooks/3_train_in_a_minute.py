"""
Train in a minute
=================

PPO learns from raw windows which UAV leads, without hints or rules. It needs ``pip install '.[rl]'``.
"""

# %%
import gymnasium as gym
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from detectors.policy_detector import PolicyDetector
from detectors.rl.sb3 import PairPolicy
from usnet_env import Window, evaluate, plot_detection
from usnet_env.frameworks.sb3 import SwarmVecEnv

torch.set_num_threads(1)
GAME = {"followers": 7, "observation_steps": 20}  # P1 with eight UAVs

# %% [markdown]
# 64 games fly in one batch. The reward is 0 for the head alone, and less for every other answer. The network compares
# the velocities of each pair of UAVs; its 675 parameters know nothing at first.


# %%
class Rewards(BaseCallback):
    """Prints the mean reward of each rollout."""

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        print(self.num_timesteps, "games:", f"{self.model.rollout_buffer.rewards.mean():.2f}")


envs = SwarmVecEnv("USNET/SingleCluster-v0", 64, observe=("velocity", "alive"), **GAME)
settings = {"n_steps": 16, "batch_size": 256, "n_epochs": 4, "learning_rate": 5e-3, "device": "cpu"}
model = PPO(PairPolicy, envs, seed=0, **settings).learn(16_384, callback=Rewards())

# %% [markdown]
# Its policy is a detector like any other. On swarms that it has not seen:

# %%
detectors = {"PPO": PolicyDetector(model.policy), "random": "random"}
result = evaluate("USNET/SingleCluster-v0", detectors, episodes=200, seed=1, env_kwargs=GAME)
print(result.to_markdown(["exact", "J"]))
assert result["PPO"]["exact"]["mean"] > 0.95

# %% [markdown]
# One of these swarms, in ``learned.png`` too. The star is the UAV that the agent names:

# %%
env = gym.make("USNET/SingleCluster-v0", **GAME)
window = Window.from_observation(env.reset(seed=2)[0])
figure = plot_detection(detectors["PPO"].detect(window), window)
figure.savefig("learned.png")
figure

# %% [markdown]
# It knows only f1. Train with ``follow="random"``, another law in every game, then test on f1 to f7.

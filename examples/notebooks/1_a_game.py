"""
A game
======

Who leads this swarm? An environment, a detector, the loop between them, and pictures. It needs
``pip install '.[render]'``.
"""

# %%
import gymnasium as gym

from usnet_env import Window, evaluate, make_detector
from usnet_env.replay import animate, draw_episode, record_episode

game = {"clusters": 3, "uavs": 30, "follow": "f3", "mobility": "gauss_markov", "head_jitter": True}
game |= {"formation": "gathered", "observation_steps": 60}
env = gym.make("usnet_env:USNET/MultiCluster-v0", **game)

# %% [markdown]
# What a detector sees in the first round, and what it answers:

# %%
observation, info = env.reset(seed=3)
window = Window.from_observation(observation)
detector = make_detector("reader")
detector.reset(seed=1)
detection = detector.detect(window)
print(window.position.shape, "positions;", detection.candidates.nonzero()[0], "named")

# %% [markdown]
# The whole game as a picture, and as an animation. In a notebook, the last line of a cell is shown.

# %%
record = record_episode(env, detector, seed=3, detector_seed=1)
animate(record, "game.gif")
draw_episode(record)

# %% [markdown]
# One game proves little. Several games, next to policies that don't look:

# %%
result = evaluate("USNET/MultiCluster-v0", ["reader", "lagged-network"], episodes=5, env_kwargs=game, trivial=True)
result

"""
Plug in a detector
==================

A short detector that needs no number of heads and beats the trivial policies. docs/plugging_in.md goes on to a
package. It needs ``pip install '.[render]'``.
"""

# %%
import gymnasium as gym
import numpy as np

from detectors import Detector
from detectors.checks import check_detector
from usnet_env import Detection, Window, evaluate, plot_detection, register_detector
from usnet_env.evaluation import evaluate_suite

# %% [markdown]
# A follower copies its head one step later. So each UAV votes for the one that it copies most, and a UAV with three or
# more votes is named.


# %%
class MostCopied(Detector):
    """Names the UAVs whose velocity several others copy one step later."""

    votes: int = 3

    def detect(self, window: Window) -> Detection:
        velocity = np.where(window.velocity_seen[..., None], window.velocity, 0.0)
        copied = np.einsum("tic,tjc->ij", velocity[1:], velocity[:-1])  # row i: how much i copies each j
        lead = copied - copied.T
        np.fill_diagonal(lead, -np.inf)
        lead[:, ~window.alive] = -np.inf
        order = self.rng.permutation(window.uavs)  # ties are broken at random
        leader = order[lead[:, order].argmax(axis=1)]
        votes = np.bincount(leader[window.alive], minlength=window.uavs)
        return Detection(candidates=(votes >= self.votes) & window.alive, scores=votes)


# %% [markdown]
# Ranked, with a detector that ships and the trivial policies:

# %%
register_detector("most-copied", MostCopied, replace=True)
game = {"clusters": 3, "uavs": 40, "follow": "f3", "observation_steps": 30}
names = ["most-copied", "lagged-regression"]
result = evaluate("USNET/MultiCluster-v0", names, episodes=10, env_kwargs=game, trivial=True)
assert result["most-copied"]["J"]["mean"] < result["destroy-all"]["J"]["mean"]
result

# %% [markdown]
# What it names in one window:

# %%
env = gym.make("USNET/MultiCluster-v0", **game, formation="gathered")
window = Window.from_observation(env.reset(seed=2)[0])
detector = MostCopied()
detector.reset(seed=1)
plot_detection(detector.detect(window), window)

# %% [markdown]
# Does it keep the rules?

# %%
for check in check_detector(MostCopied()):
    print(check.check, check.status)

# %% [markdown]
# In a suite, here two episodes of one cell; docs/suites.md compares a whole run with the published rows.

# %%
evaluate_suite("paper", "most-copied", cells=["f3"], episodes=2)

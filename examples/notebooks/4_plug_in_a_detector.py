"""
Plug in a detector
==================

A short detector that needs no number of heads and beats the trivial policies. docs/plugging_in.md explains it.
"""

# %%
import sys
from pathlib import Path

import gymnasium as gym

from detectors.checks import check_detector
from usnet_env import Window, evaluate, plot_detection, register_detector

folder = Path(__file__).parent if "__file__" in globals() else Path.cwd()
sys.path.append(str(folder.parent / "custom_detector"))
from most_copied import MostCopied  # noqa: E402  # the file is shown on the page

# %%
register_detector("most-copied", MostCopied, replace=True)
game = {"clusters": 3, "uavs": 40, "follow": "f3", "observation_steps": 30}
names = ["most-copied", "lagged-regression"]
result = evaluate("USNET/MultiCluster-v0", names, episodes=10, env_kwargs=game, trivial=True)
print(result.to_markdown(["J", "exact"]))
assert result["most-copied"]["J"]["mean"] < result["destroy-all"]["J"]["mean"]

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
from usnet_env.evaluation import evaluate_suite  # noqa: E402

mine = evaluate_suite("paper", "most-copied", cells=["f3"], episodes=2)
print(mine.to_markdown(["J", "exact"]))

"""The core plays and scores without touching any extra, whatever is installed beside it."""

PROGRAM = """
import sys

import gymnasium as gym
import usnet_env
from usnet_env.envs.wrappers import BoxMasks
from usnet_env.plugins import detector_names

arguments = {"clusters": 2, "uavs": 12, "observation_steps": 40}
BoxMasks(gym.make("USNET/MultiCluster-v0", **arguments)).reset(seed=0)
result = usnet_env.evaluate("USNET/MultiCluster-v0", ["lagged-regression(clusters=2)", "random"], episodes=3,
                            env_kwargs=arguments)
assert result.summary[0]["metrics"]["f1_first"]["mean"] == 1.0
assert {"gassl", "mc-gassl", "lagged-regression"} <= set(detector_names())

extras = {
    "matplotlib", "minari", "pettingzoo", "rerun", "sb3_contrib", "stable_baselines3", "supersuit", "tensordict",
    "tianshou", "torch", "torchrl",
}
assert not extras & set(sys.modules), extras & set(sys.modules)
"""


def test_the_core_imports_no_extra(fresh_process, tmp_path):
    fresh_process.run(PROGRAM, tmp_path)

"""Every change of the ablation of follow-mixture still finds the part that it changes."""

import numpy as np
import pytest
import threshold_ablation

from usnet_env import Window
from usnet_env.envs import MultiClusterEnv


@pytest.fixture(scope="module")
def game():
    env = MultiClusterEnv(clusters=3, uavs=25, observation_steps=50, follow="f6", decoys=2)
    observation, _ = env.reset(seed=4)
    return threshold_ablation.Game("P2", Window.from_observation(observation), np.asarray(env.swarm.head), 0)


@pytest.mark.parametrize("key", threshold_ablation.CHANGES)
def test_a_changed_detector_answers_the_window(key, game):
    row = threshold_ablation.play(game, key, "cost")
    assert row["heads"] == 3
    assert row["J"] >= 1.0  # one round at least, and more for wrong and missed UAVs
    assert row["exact"] == (row["J"] == 1.0)

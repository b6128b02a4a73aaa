"""The wrapper of the games of several agents, which frameworks need, plays the same games."""

import numpy as np
import pytest

pytest.importorskip("pettingzoo")

from gymnasium import spaces
from wrappers import ParallelBoxMasks

from usnet_env.multiagent import usnet_evasion_v0, usnet_observers_v0

SMALL = {"clusters": 2, "uavs": 10, "observation_steps": 12, "max_rounds": 4}
GAMES = [usnet_observers_v0, usnet_evasion_v0]


@pytest.mark.parametrize("game", GAMES)
def test_a_wrapped_game_is_the_same_game(game):
    plain, wrapped = game.parallel_env(**SMALL), ParallelBoxMasks(game.parallel_env(**SMALL))
    for agent in plain.possible_agents:
        parts = wrapped.observation_space(agent).values()
        assert not any(isinstance(part, spaces.MultiBinary) for part in parts)
    np.testing.assert_equal(plain.reset(seed=0), wrapped.reset(seed=0))
    rng = np.random.default_rng(0)
    while plain.agents:
        actions = {
            agent: (rng.random(plain.action_space(agent).shape) < 0.1).astype(np.int64) for agent in plain.agents
        }
        step = wrapped.step(actions)
        np.testing.assert_equal(plain.step(actions), step)
        assert all(wrapped.observation_space(agent).contains(seen) for agent, seen in step[0].items())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version:UserWarning")
@pytest.mark.parametrize("game", GAMES)
def test_torchrl_reads_the_games(game):
    torchrl = pytest.importorskip("torchrl.envs")
    torchrl.check_env_specs(
        torchrl.PettingZooWrapper(ParallelBoxMasks(game.parallel_env(**SMALL)), use_mask=True), seed=0
    )

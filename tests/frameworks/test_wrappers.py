"""The wrappers of the games of several agents, which frameworks need, play the same games."""

import numpy as np
import pytest

pytest.importorskip("pettingzoo")

from gymnasium import spaces
from wrappers import DiscreteActions, FlatObservations, MultiDiscreteVotes, ParallelBoxMasks

from usnet_env.multiagent import usnet_evasion_v0, usnet_observers_v0

SMALL = {"clusters": 2, "uavs": 10, "observation_steps": 12, "max_rounds": 4}
GAMES = [usnet_observers_v0, usnet_evasion_v0]


@pytest.mark.parametrize("game", GAMES)
@pytest.mark.parametrize("wrapper", [ParallelBoxMasks, MultiDiscreteVotes])
def test_a_wrapped_game_is_the_same_game(game, wrapper):
    plain, wrapped = game.parallel_env(**SMALL), wrapper(game.parallel_env(**SMALL))
    for agent in plain.possible_agents:
        assert wrapped.action_space(agent) is wrapped.action_space(agent)
        masks = [part for part in wrapped.observation_space(agent).values() if isinstance(part, spaces.MultiBinary)]
        assert (masks == []) == (wrapper is ParallelBoxMasks)
        assert not (wrapper is MultiDiscreteVotes and isinstance(wrapped.action_space(agent), spaces.MultiBinary))
    np.testing.assert_equal(plain.reset(seed=0), wrapped.reset(seed=0))
    rng = np.random.default_rng(0)
    while plain.agents:
        actions = {
            agent: (rng.random(plain.action_space(agent).shape) < 0.1).astype(np.int64) for agent in plain.agents
        }
        step = wrapped.step(actions)
        np.testing.assert_equal(plain.step(actions), step)
        assert all(wrapped.observation_space(agent).contains(seen) for agent, seen in step[0].items())


@pytest.mark.parametrize("game", GAMES)
def test_flat_observations_are_boxes_with_the_mask_of_the_actions(game):
    numbered = DiscreteActions(game.parallel_env(**SMALL))
    flat = FlatObservations(DiscreteActions(game.parallel_env(**SMALL)))
    seen, boxes = numbered.reset(seed=0)[0], flat.reset(seed=0)[0]
    for k, agent in enumerate(flat.agents):
        flat.action_space(agent).seed(k)  # actions that don't end the game
    for _ in range(2):
        for agent, box in boxes.items():
            assert isinstance(flat.observation_space(agent), spaces.Box)
            assert flat.observation_space(agent).contains(box)
            np.testing.assert_equal(spaces.unflatten(numbered.observation_space(agent), box), seen[agent])
        actions = {
            agent: int(flat.action_space(agent).sample(mask=seen[agent]["action_mask"])) for agent in flat.agents
        }
        seen, boxes = numbered.step(actions)[0], flat.step(actions)[0]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version:UserWarning")
@pytest.mark.parametrize("game", GAMES)
def test_torchrl_reads_the_games(game):
    torchrl = pytest.importorskip("torchrl.envs")
    for wrap in (lambda env: env, DiscreteActions):
        env = torchrl.PettingZooWrapper(ParallelBoxMasks(wrap(game.parallel_env(**SMALL))), use_mask=True)
        torchrl.check_env_specs(env, seed=0)

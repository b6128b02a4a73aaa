"""Small games for the tests, and how to play them with drawn actions."""

import numpy as np
from gymnasium.utils.env_checker import data_equivalence

from usnet_env.multiagent import usnet_evasion_v0, usnet_observers_v0

GAMES = {"observers": usnet_observers_v0, "evasion": usnet_evasion_v0}
SMALL = {"clusters": 3, "uavs": 20, "observation_steps": 12}
SMALL_OF = {
    "observers": {**SMALL, "observers": 3, "sensing_range": 600.0, "position_noise": 0.5, "message_size": 2},
    "evasion": SMALL,
}


def small(game, form="parallel_env", **more):
    return getattr(GAMES[game], form)(**{**SMALL_OF[game], **more})


def drawn(env, rng, observations, share=0.1):
    """An action for every living agent: few candidates, so that games last."""
    actions = {}
    for agent in env.agents:
        space = env.action_space(agent)
        if hasattr(space, "nvec"):
            actions[agent] = rng.integers(0, space.nvec)
        else:
            actions[agent] = (rng.random(space.shape) < share).astype(np.int8)
    return actions


def assert_single_game(single, env, expected, observations, act):
    """What observer_0 sees and gets, with drawn candidates, is what the game with one agent says.

    Both begin with their observations; ``act`` makes the actions of the games from the candidates ``(N,)``.
    """
    rng, over, agent = np.random.default_rng(0), False, "observer_0"
    while not over:
        got = observations[agent]
        assert data_equivalence(expected, {key: got[key] for key in expected}, exact=True)
        candidates = (rng.random(len(got["alive"])) < 0.2) & expected["alive"].astype(bool)
        expected, reward, *ends, info = single.step(candidates)
        observations, *answers, infos = env.step(act(candidates))
        assert [answer[agent] for answer in answers] == [reward, *ends]
        assert {key: infos[agent][key] for key in info} == info
        over = any(ends)


def episode(env, seed, actions_seed=0, share=0.1):
    """Everything that a game returns, from reset to its end."""
    rng = np.random.default_rng(actions_seed)
    observations, infos = env.reset(seed=seed)
    steps = [(observations, {}, {}, {}, infos, env.state(), list(env.agents))]
    while env.agents:
        step = env.step(drawn(env, rng, observations, share))
        observations = step[0]
        steps.append((*step, env.state(), list(env.agents)))
    return steps

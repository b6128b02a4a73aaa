"""Batches of games: they equal the games in Parallel form, and their arrays have rows for all agents."""

import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import data_equivalence
from small_games import GAMES, SMALL_OF, drawn, small

from usnet_env import ArgumentError

MORE = [
    ("observers", {"fusion": "scores", "placement": "uniform", "miss_rate": 0.1, "max_rounds": 3}),
    ("observers", {"fusion": "majority", "observer_speed": 20.0, "sample_every": 2, "max_rounds": 3}),
    ("evasion", {"max_rounds": 3}),
    ("evasion", {"follow": "f6", "decoys": 1, "mobilities": ("gauss_markov", "straight", "alike"), "max_rounds": 3}),
]


def batch_of(game, count, **more):
    return GAMES[game].batch_env(count, **{**SMALL_OF[game], **more})


def draw_all(games, rng):
    """Actions of all agents, also of those that have left; they have no effect."""
    return {
        role: rng.integers(0, 2, (games.num_envs, count, *games.action_spaces[role].shape))
        for role, count in games.roles.items()
    }


def assert_equal(batched, single, b):
    """What a batch says of game b, by role, is what the game says, by agent."""
    for agent, expected in single.items():
        role, _, j = agent.rpartition("_")
        for name, value in expected.items() if isinstance(expected, dict) else [(None, expected)]:
            got = (batched[role] if name is None else batched[role][name])[b, int(j)]
            assert data_equivalence(got if isinstance(value, np.ndarray) else got.item(), value, exact=True)


@pytest.mark.parametrize(("game", "more"), MORE)
def test_a_batch_plays_the_games_of_the_parallel_form(game, more):
    """Their flat observations are those of Gymnasium, and what a caller does to observations changes no later one."""
    games, singles = batch_of(game, 3, **more), [small(game, **more) for _ in range(3)]
    answers = [env.reset(seed=7 + b) for b, env in enumerate(singles)]
    seen, infos = games.reset(seed=7)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(8):
        for b, env in enumerate(singles):
            assert_equal(seen, answers[b][0], b)
            assert_equal(infos, answers[b][-1], b)
            np.testing.assert_array_equal(games.state()[b], env.state())
        for role, flat in games.flatten(seen).items():
            last = {name: array[1, -1] for name, array in seen[role].items()}
            np.testing.assert_array_equal(flat[1, -1], spaces.flatten(games.observation_spaces[role], last))
        actions = [drawn(env, rng, None, share=0.1) for env in singles]
        stacked = draw_all(games, rng)
        for b, (agent, action) in ((b, pair) for b, each in enumerate(actions) for pair in each.items()):
            role, _, j = agent.rpartition("_")
            stacked[role][b, int(j)] = action
        left = {role: ~active for role, active in games.active.items()}
        step = games.step(stacked)
        assert not any(part[role][rows].any() for part in step[1:4] for role, rows in left.items())
        seen, infos = step[0], step[-1]
        answers = [env.step(action) for env, action in zip(singles, actions, strict=True)]
        for b, answer in enumerate(answers):
            for by_role, expected in zip(step, answer, strict=True):
                assert_equal(by_role, expected, b)
        over = ~games.active["observer"].any(axis=1)
        assert over.tolist() == [not env.agents for env in singles]
        if over.any():
            arrays = [array for parts in seen.values() for array in parts.values()]
            for array in arrays:
                array[...] = 1
            seen, infos = games.reset(games=over)
            assert all((array == 1).all() for array in arrays)
            for b in range(3):
                answers[b] = singles[b].reset() if over[b] else (answers[b][0], {})
        ends += over.sum()
    assert ends > 2


def test_a_batch_draws_each_of_its_games():
    """With the axes of the first window, and crosses where UAVs were destroyed in it."""
    games, env = batch_of("observers", 2, render_mode="rgb_array"), small("observers", render_mode="rgb_array")
    games.reset(seed=[5, 3])
    env.reset(seed=3)
    for candidates in np.eye(22, dtype=np.int8)[:2]:
        games.step({"observer": np.tile(candidates, (2, 3, 1))})
        env.step(dict.fromkeys(env.agents, candidates))
    np.testing.assert_array_equal(games.draw(1), env.render())


def test_bad_arguments_of_a_batch_are_named():
    games = batch_of("evasion", 2)
    with pytest.raises(ArgumentError, match="num_envs must"):
        batch_of("evasion", 0)
    with pytest.raises(ArgumentError, match="games must"):
        games.reset(games=[True, False])
    games.reset(seed=[1, 2])
    with pytest.raises(ArgumentError, match="games must"):
        games.reset(games=np.zeros(2, bool))
    with pytest.raises(ArgumentError, match="actions must map each of observer, head"):
        games.step({"observer": np.zeros((2, 1, 20))})
    with pytest.raises(ArgumentError, match="actions of head must"):
        games.step({"observer": np.zeros((2, 1, 20)), "head": np.full((2, 3, 4), 9)})

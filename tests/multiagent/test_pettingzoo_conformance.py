"""Both games in both forms under PettingZoo's own tests, and a whole-episode twin rollout that those lack."""

import copy
import pickle
import warnings
from types import SimpleNamespace

import numpy as np
import pettingzoo
import pytest
from gymnasium.spaces.utils import flatten
from gymnasium.utils.env_checker import data_equivalence
from small_games import GAMES, SMALL, drawn, episode, small

from usnet_env.multiagent import register_games
from usnet_env.multiagent.flat import FlatGame

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of PettingZoo's own old modules
    from pettingzoo import test as suites
    from pettingzoo.test.state_test import state_test

# Advice of the test suites that does not fit games of windows and masks.
ADVICE = [
    "ignore:Observation space for each agent probably should be",
    "ignore:Action space for each agent probably should be",
    "ignore:Agents have different observation space sizes",
    "ignore:Observation is not a NumPy array",
]
pytestmark = [pytest.mark.filterwarnings(line) for line in ADVICE]

both_games = pytest.mark.parametrize("game", list(GAMES))


@pytest.mark.parametrize(
    ("game", "arguments"), [*((game, {}) for game in GAMES), ("observers", {"observer_speed": 5.0})]
)
def test_parallel_api_seeds_and_state(game, arguments):
    suites.parallel_api_test(small(game, **arguments), num_cycles=20)
    suites.seed_test(lambda: small(game, "env"), num_cycles=10)
    suites.parallel_seed_test(lambda: small(game), num_cycles=10)
    state_test(small(game, "env"), small(game), num_cycles=4)


@both_games
def test_a_flat_game_passes_the_api_test_and_plays_the_same_game(game):
    flat, env, rng = FlatGame(small(game)), small(game), np.random.default_rng(0)
    suites.parallel_api_test(flat, num_cycles=20)
    (seen, infos), (expected, _) = flat.reset(seed=3), env.reset(seed=3)
    while env.agents:
        masks = {agent: infos[agent]["action_mask"] for agent in env.agents}
        numbers = {agent: rng.choice(mask.nonzero()[0]) for agent, mask in masks.items()}
        for agent in numbers:
            np.testing.assert_array_equal(seen[agent], flatten(env.observation_space(agent), expected[agent]))
            assert flat.observation_space(agent).contains(seen[agent])
            assert masks[agent].sum() > 1 or not expected[agent]["legal"].any()
        actions = {agent: find_action(env.action_space(agent), number) for agent, number in numbers.items()}
        seen, *answers, infos = flat.step(numbers)
        expected, *same, _ = env.step(actions)
        assert answers == same


def find_action(space, number):
    """The choices of a head, or the vote for one UAV or, by the last number, none."""
    if hasattr(space, "nvec"):
        return np.array(np.unravel_index(number, space.nvec))
    uavs = SMALL["uavs"]
    return (np.arange(space.n) == (number if number < uavs else -1)).astype(np.int8)


@both_games
@pytest.mark.parametrize("form", ["env", "raw_env"])
def test_aec_api(game, form):
    suites.api_test(small(game, form), num_cycles=20)


@both_games
def test_render(game):
    pytest.importorskip("matplotlib")

    def make(render_mode):  # PettingZoo's test makes a "human" env and doesn't use it
        return small(game, "env", render_mode=None if render_mode == "human" else render_mode)

    suites.render_test(make)
    with pytest.warns(UserWarning, match="render_mode='rgb_array'"):
        assert small(game).render() is None


@both_games
def test_max_cycles(game):
    """With one shot a round at most, drawn actions destroy no UAV, and only ``max_cycles`` ends the game."""
    module = SimpleNamespace(
        parallel_env=lambda max_cycles: small(game, shot_budget=1, max_cycles=max_cycles),
        env=lambda max_cycles: small(game, "env", shot_budget=1, max_cycles=max_cycles),
    )
    suites.max_cycles_test(module)


@pytest.mark.parametrize(
    ("game", "more"),
    [
        ("observers", {"decoys": 1}),
        ("observers", {"kinematics": "varied_speed", "observer_speed": 20.0}),
        ("evasion", {"decoys": 1}),
    ],
)
def test_observations_and_states_stay_in_their_spaces_and_are_described(game, more):
    env = small(game, **more)
    for seed in range(3):
        for observations, *_, state, _ in episode(env, seed):
            assert all(env.observation_space(agent).contains(seen) for agent, seen in observations.items())
            assert env.state_space.contains(state)
    for agent in env.possible_agents:
        assert [key for key in env.observation_space(agent) if f"`{key}`" not in type(env).__doc__] == []


@both_games
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_in_mid_game_goes_on_alike(game, copied):
    env = small(game, max_rounds=6)
    env.reset(seed=5)
    rng = np.random.default_rng(0)
    env.step(drawn(env, rng, None, share=0.02))
    twin = copied(env)
    while env.agents:
        actions = drawn(env, rng, None, share=0.05)
        assert data_equivalence(env.step(actions), twin.step(actions), exact=True)
    assert not twin.agents


@both_games
def test_registered_in_both_forms(game):
    name = f"usnet_{game}_v0"
    register_games()  # a second time: no warning about an id that is taken
    parallel = pettingzoo.make("parallel", name, clusters=2, uavs=12)
    aec = pettingzoo.make("aec", name, clusters=2, uavs=12)
    assert parallel.config.uavs == 12
    assert str(parallel) == str(aec.unwrapped) == name
    assert pettingzoo.make("parallel", name, max_cycles=3).rules.max_rounds == {"observers": 3, "evasion": 2}[game]

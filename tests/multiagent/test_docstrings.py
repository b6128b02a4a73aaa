"""The docstrings of the games, compared with the code."""

import inspect
import re

import pytest
from small_games import GAMES

import usnet_env.envs


@pytest.mark.parametrize("game", list(GAMES))
def test_a_docstring_lists_the_arguments_with_their_defaults(game):
    kind = GAMES[game].parallel_env
    docstring = inspect.getdoc(kind)
    section = docstring.partition("## Arguments")[2].partition("## ")[0]
    table, _, shared = section.partition("and of `USNET/MultiCluster-v0`:")
    rows = dict(re.findall(r"^\| `(\w+)` \| `?(.+?)`? \|", table, re.MULTILINE))
    defaults = {name: parameter.default for name, parameter in inspect.signature(kind).parameters.items()}
    common = set(re.findall(r"`(\w+)`", shared))
    assert set(rows) | common == set(defaults)
    for name, value in rows.items():
        default = defaults[name]
        assert value.replace('"', "'") == (f"{default:g}" if type(default) is float else repr(default))
    single = inspect.signature(usnet_env.envs.MultiClusterEnv).parameters
    assert [name for name in common if defaults[name] != single[name].default] == []


@pytest.mark.parametrize("game", list(GAMES))
def test_a_docstring_lists_what_agents_observe(game):
    docstring = inspect.getdoc(GAMES[game].parallel_env)
    env = GAMES[game].parallel_env(**({"message_size": 1} if game == "observers" else {}))
    for agent in env.possible_agents:
        assert [key for key in env.observation_space(agent) if f"`{key}`" not in docstring] == []

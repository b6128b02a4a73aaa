"""The base class of both games: a batch of one game, in PettingZoo's form, and its pictures."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import Field

from usnet_env.arrays import Floats, Observation, Singles
from usnet_env.config import ArgumentError, MissingExtraError, how_to_install, optional_seed, quote
from usnet_env.envs import game
from usnet_env.envs.game import Rules
from usnet_env.multiagent.batch import GameBatch
from usnet_env.swarm import SwarmState
from usnet_env.swarm.config import Count, SizeArguments, SwarmArguments

try:
    from pettingzoo import AECEnv, ParallelEnv
    from pettingzoo.utils.conversions import parallel_to_aec_wrapper
    from pettingzoo.utils.wrappers import BaseParallelWrapper as BaseParallelWrapper  # for flat.py
    from pettingzoo.utils.wrappers import OrderEnforcingWrapper
except ImportError:
    raise MissingExtraError(f"Games with several agents need PettingZoo; {how_to_install('multiagent')}.") from None

Infos = dict[str, dict[str, int | float]]
#: Observations, rewards, terminations, truncations and infos by agent.
Step = tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], Infos]


class GameArguments(game.RenderArguments, game.RoundArguments, SizeArguments, SwarmArguments):
    """The arguments that both games take."""

    max_cycles: Count | None = Field(None, description="most steps; `usnet_evasion_v0` has one more than rounds")

    def make_rules(self, opening: int = 0) -> Rules:
        """The rules of P2; ``opening`` is the number of steps before the first round."""
        limit = self.max_rounds if self.max_cycles is None else min(self.max_rounds, self.max_cycles - opening)
        return self.part(Rules, max_rounds=limit)


class UsnetParallelEnv(ParallelEnv[str, Observation, Any]):  # type: ignore[misc]  # PettingZoo ships no types
    """Base class of the games, in PettingZoo's Parallel form: a batch of one game.

    Attributes:
        config: the configuration of the swarm.
        rules: the rules of the game.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 1, "is_parallelizable": True}

    def __init__(self, games: GameBatch) -> None:
        self.games, self.config, self.rules, self.render_mode = games, games.config, games.rules, games.render_mode
        #: The role of each agent, and its number in the role.
        self._rows = {f"{role}_{j}": (role, j) for role, count in games.roles.items() for j in range(count)}
        self.possible_agents = list(self._rows)
        self.agents: list[str] = []
        self._spaces = {
            agent: copy.deepcopy((games.observation_spaces[role], games.action_spaces[role]))
            for agent, (role, _) in self._rows.items()
        }

    def observation_space(self, agent: str) -> spaces.Dict:
        """The observation space of an agent."""
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The action space of an agent."""
        return self._spaces[agent][1]

    @cached_property
    def state_space(self) -> spaces.Box:
        """The space of :meth:`state`: all finite numbers."""
        twin, most = copy.deepcopy(self.games), np.finfo(np.float32).max
        twin.reset(seed=0)
        return spaces.Box(-most, most, twin.state()[0].shape, np.float32)

    @property
    def swarm(self) -> SwarmState:
        """A copy of the true swarm, for evaluation and pictures; observers never receive it."""
        return self.games.game.swarm.episode()

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], Infos]:
        """Start a game with a seed of its generator (``None`` keeps the present one); ``options`` have no effect.

        Raises:
            ArgumentError: the seed is not a whole number from 0.
        """
        observations, infos = self.games.reset(seed=optional_seed("seed", seed))
        self.agents = list(self.possible_agents)
        return self._split(observations, self.agents), self._split(infos, self.agents)

    def step(self, actions: Any) -> Step:
        """Play a round with an action of each living agent, and fly the next window.

        Raises:
            ArgumentError: an action is missing, or has a wrong shape or wrong values, or the game has ended.
        """
        answers, playing = self.games.play(self._gather(actions)), self.agents
        active = self._split(self.games.active, playing)
        self.agents = [agent for agent in playing if active[agent]]
        seen, rewards, terminated, truncated, infos = (self._split(part, playing) for part in answers)
        return seen, rewards, terminated, truncated, infos

    def _gather(self, actions: Any) -> dict[str, NDArray[Any]]:
        """The checked actions by role, zeros for agents that have left."""
        game.require_game(self.games.game if self.agents else None)
        if not isinstance(actions, Mapping) or set(actions) != set(self.agents):
            names = ", ".join(self.agents)
            raise ArgumentError(f"actions must map each of {names} to its action, got {quote(actions)}.")
        parsed: dict[str, list[NDArray[Any]]] = {role: [] for role in self.games.roles}
        for agent, (role, _) in self._rows.items():
            action = actions.get(agent, np.zeros(self.action_space(agent).shape or (), np.int64))
            parsed[role].append(self.games.parse(role, action, (), f"action of {agent}"))
        return {role: np.stack(rows)[None] for role, rows in parsed.items()}

    def _split(self, by_role: Mapping[str, Any], agents: Iterable[str]) -> dict[str, Any]:
        """What a batch of one game says about some agents: copies of arrays, and plain numbers."""

        def pick(values: Any, j: int) -> Any:
            if isinstance(values, dict):
                return {name: pick(part, j) for name, part in values.items()}
            return values[0, j].copy() if values.ndim > 2 else values[0, j].item()

        return {agent: pick(by_role[role], j) for agent in agents for role, j in [self._rows[agent]]}

    @property
    def last_round(self) -> dict[str, Any] | None:
        """The round of the last step by name; ``None`` before the first round.

        The window of all observers together, the ``root`` of each UAV before the candidates were destroyed, the
        ``candidates``, the ``scores`` by which they were chosen, and the metrics of ``info``.
        """
        games = self.games
        if not games.answered[0]:  # neither is the opening of evasion a round
            return None
        played = {"root": games.before.reveal().root, "candidates": games.candidates, "scores": games.scores}
        played |= games.metrics
        return vars(games.before.merge_windows()) | {name: array[0] for name, array in played.items()}

    def state(self) -> Singles:
        """The true state for a centralised critic, ``(S,)`` float32; see :meth:`GameBatch.state`."""
        return self.games.state()[0]

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the last round, or the current window before the first round, ``(H, W, 3)`` uint8."""
        return self.games.draw() if game.has_mode(self.render_mode) else None

    def describe_action(self, agent: str, action: Any) -> str:
        """Describe what an agent chose, for replays; empty for an action that candidates and scores show."""
        return ""

    def list_observers(self) -> Floats | None:
        """``(K, 4)``, position and sensing range of each observer in metres; ``None`` if it has none, or flies."""
        return None


def make_aec_forms(form: type[UsnetParallelEnv]) -> tuple[Callable[..., AECEnv], Callable[..., AECEnv]]:
    """Make the functions ``raw_env`` and ``env`` of a game, which create its AEC form and take its arguments."""

    def raw_env(**arguments: Any) -> AECEnv:
        """Create the AEC form without the wrapper that enforces the order of calls."""
        return parallel_to_aec_wrapper(form(**arguments))

    def env(**arguments: Any) -> AECEnv:
        """Create the AEC form."""
        return OrderEnforcingWrapper(raw_env(**arguments))

    return raw_env, env

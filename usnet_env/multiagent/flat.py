"""Games whose observations are vectors and whose actions are numbers, as many frameworks take them."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.spaces.utils import flatdim, flatten, flatten_space

from usnet_env.envs.wrappers import number_actions
from usnet_env.multiagent.base import BaseParallelWrapper, UsnetParallelEnv


class FlatGame(BaseParallelWrapper):  # type: ignore[misc]  # PettingZoo ships no types
    """A game in Parallel form with a ``Box`` ``(F,)`` as observation and a ``Discrete`` action of each agent.

    An observer names one UAV by its index, or none by N, and doesn't fly. The choices of a head are numbered together,
    the last one varying fastest. ``info`` holds the ``action_mask`` ``(A,)`` of the legal actions.

    Args:
        env: ``parallel_env`` of a game.

    Example:
        >>> from usnet_env.multiagent import usnet_observers_v0
        >>> FlatGame(usnet_observers_v0.parallel_env(clusters=2, uavs=8)).action_space("observer_0")
        Discrete(9)
    """

    def __init__(self, env: UsnetParallelEnv) -> None:
        super().__init__(env)
        seen = {agent: env.observation_space(agent) for agent in env.possible_agents}
        self._numbered = {
            agent: number_actions(env.action_space(agent), flatdim(seen[agent]["legal"])) for agent in seen
        }
        self._boxes = {agent: flatten_space(space) for agent, space in seen.items()}
        self._numbers = {agent: spaces.Discrete(len(table)) for agent, (table, _) in self._numbered.items()}

    def observation_space(self, agent: str) -> Any:
        """A ``Box``."""
        return self._boxes[agent]

    def action_space(self, agent: str) -> spaces.Discrete:
        """The numbers of the actions."""
        return self._numbers[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Start a game."""
        return self._flatten(*self.env.reset(seed, options))

    def step(self, actions: dict[str, int]) -> Any:
        """Play a round."""
        seen, *ends, infos = self.env.step({agent: self._numbered[agent][0][each] for agent, each in actions.items()})
        seen, infos = self._flatten(seen, infos)
        return seen, *ends, infos

    def _flatten(self, seen: dict[str, Any], infos: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        for agent, info in infos.items():
            legal = np.append(seen[agent]["legal"], 1).astype(bool)
            info["action_mask"] = legal[self._numbered[agent][1]].all(axis=1)
        flat = {agent: flatten(self.env.observation_space(agent), each) for agent, each in seen.items()}
        return flat, infos

"""Wrappers of the games of several agents for frameworks that need other spaces; copy what you need.

``env`` is the ``parallel_env`` of a game, or a wrapper around it.
"""

from functools import reduce
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.spaces import flatten, flatten_space
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from usnet_env.envs.wrappers import box_masks


class ParallelBoxMasks(BaseParallelWrapper):
    """Describe the masks in the observations as ``Box``, as :class:`usnet_env.envs.wrappers.BoxMasks` does."""

    def __init__(self, env: ParallelEnv) -> None:
        super().__init__(env)
        self._observations = {agent: box_masks(env.observation_space(agent)) for agent in env.possible_agents}

    def observation_space(self, agent: str) -> spaces.Dict:
        """The observation space of an agent; the same object every time."""
        return self._observations[agent]


class FlatObservations(BaseParallelWrapper):
    """Flatten the observation of each agent to one ``Box``, as Gymnasium's ``FlattenObservation`` does."""

    def __init__(self, env: ParallelEnv) -> None:
        super().__init__(env)
        self._observations = {agent: flatten_space(env.observation_space(agent)) for agent in env.possible_agents}

    def observation_space(self, agent: str) -> spaces.Box:
        """The observation space of an agent; the same object every time."""
        return self._observations[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Any], Any]:
        """Start a game."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return self._flatten(observations), infos

    def step(self, actions: dict[str, Any]) -> tuple[Any, ...]:
        """Make a step."""
        observations, *rest = self.env.step(actions)
        return self._flatten(observations), *rest

    def _flatten(self, observations: dict[str, Any]) -> dict[str, np.ndarray]:
        return {agent: flatten(self.env.observation_space(agent), seen) for agent, seen in observations.items()}


class MultiDiscreteVotes(BaseParallelWrapper):
    """Describe votes for candidates as ``MultiDiscrete([2] * N)``, which SuperSuit and RLlib need."""

    def __init__(self, env: ParallelEnv) -> None:
        super().__init__(env)
        actions = {agent: env.action_space(agent) for agent in env.possible_agents}
        self._actions = {
            agent: spaces.MultiDiscrete(np.full(space.shape, 2)) if isinstance(space, spaces.MultiBinary) else space
            for agent, space in actions.items()
        }

    def action_space(self, agent: str) -> spaces.MultiDiscrete:
        """The action space of an agent; the same object every time."""
        return self._actions[agent]


class DiscreteActions(BaseParallelWrapper):
    """Convert every agent's actions to ``Discrete(n)``, and add an ``action_mask`` ``(n,)`` to its observations.

    An observer names one UAV by its index, or no UAV by N: ``Discrete(N + 1)``; its message, if the game has messages,
    is 0. The choices of a head are numbered together, the last choice varying fastest. Votes must be candidates.
    """

    def __init__(self, env: ParallelEnv) -> None:
        super().__init__(env)
        self._actions, self._observations = {}, {}
        for agent in env.possible_agents:
            inner, seen = env.action_space(agent), env.observation_space(agent)
            heads = isinstance(inner, spaces.MultiDiscrete)
            count = int(np.prod(inner.nvec)) if heads else seen["legal"].shape[0] + 1
            self._actions[agent] = spaces.Discrete(count)
            self._observations[agent] = spaces.Dict({**seen.spaces, "action_mask": spaces.MultiBinary(count)})

    def action_space(self, agent: str) -> spaces.Discrete:
        """The action space of an agent; the same object every time."""
        return self._actions[agent]

    def observation_space(self, agent: str) -> spaces.Dict:
        """The observation space of an agent; the same object every time."""
        return self._observations[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Any], Any]:
        """Start a game."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return self._add_masks(observations), infos

    def step(self, actions: dict[str, int]) -> tuple[Any, ...]:
        """Make a step with one number for each agent."""
        observations, *rest = self.env.step({agent: self._decode(agent, actions[agent]) for agent in actions})
        return self._add_masks(observations), *rest

    def _decode(self, agent: str, number: int) -> np.ndarray:
        space = self.env.action_space(agent)
        if isinstance(space, spaces.MultiDiscrete):
            return np.array(np.unravel_index(number, space.nvec))
        vote = np.zeros(space.shape, np.int8)
        if number < self._actions[agent].n - 1:  # the last number names no UAV
            vote[number] = 1
        return vote

    def _add_masks(self, observations: dict[str, Any]) -> dict[str, Any]:
        masked = {}
        for agent, observation in observations.items():
            space, legal = self.env.action_space(agent), observation["legal"]
            if isinstance(space, spaces.MultiDiscrete):
                mask = reduce(np.kron, np.split(legal, np.cumsum(space.nvec)[:-1]))
            else:
                mask = np.append(legal, np.int8(1))
            masked[agent] = {**observation, "action_mask": mask.astype(np.int8)}
        return masked

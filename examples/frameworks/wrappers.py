"""Wrappers for frameworks that need a different form of the actions or observations."""

from __future__ import annotations

from functools import reduce
from typing import Any

import numpy as np
from gymnasium import spaces

from usnet_env.arrays import Observation
from usnet_env.config import ArgumentError, quote
from usnet_env.envs.wrappers import box_masks
from usnet_env.multiagent.base import BaseParallelWrapper, Step, UsnetParallelEnv

_MOST_ACTIONS = 100_000


class DiscreteActions(BaseParallelWrapper):  # type: ignore[misc]  # PettingZoo ships no types
    """Convert every agent's actions to ``Discrete(n)``, and add an ``action_mask`` to its observations.

    An observer names one UAV by its index, or no UAV by N: ``Discrete(N + 1)``; its message, if the game has messages,
    is 0. The choices of a head are numbered together, the last choice varying fastest: ``Discrete`` of the product of
    their sizes. ``action_mask`` ``(n,)`` int8 is 1 for legal actions, as ``action_space(agent).sample(mask)`` takes it.

    Args:
        env: the ``parallel_env`` of one of the games.

    Raises:
        ArgumentError: ``env`` is not one of the games, its votes are scores, or an agent has more than 100,000 actions.
    """

    def __init__(self, env: UsnetParallelEnv) -> None:
        if not isinstance(env, UsnetParallelEnv):
            raise ArgumentError(f"env must be the parallel_env of a usnet_env game, got {quote(env)}.")
        super().__init__(env)
        self._actions: dict[str, spaces.Discrete] = {}
        self._observations: dict[str, spaces.Dict] = {}
        for agent in env.possible_agents:
            inner, seen = env.action_space(agent), env.observation_space(agent)
            if isinstance(inner, spaces.MultiBinary):
                count = seen["legal"].shape[0] + 1  # type: ignore[index]  # MultiBinary has a shape
            elif isinstance(inner, spaces.MultiDiscrete):
                count = int(np.prod(inner.nvec))
            else:
                raise ArgumentError(f"env must have votes that are candidates, got {quote(inner)} for {agent}.")
            if count > _MOST_ACTIONS:
                raise ArgumentError(f"env must have at most {_MOST_ACTIONS} actions for each agent, got {count}.")
            self._actions[agent] = spaces.Discrete(count)
            self._observations[agent] = spaces.Dict({**seen.spaces, "action_mask": spaces.MultiBinary(count)})

    def action_space(self, agent: str) -> spaces.Discrete:
        """Return the action space of an agent; the same object every time."""
        return self._actions[agent]

    def observation_space(self, agent: str) -> spaces.Dict:
        """Return the observation space of an agent; the same object every time."""
        return self._observations[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, Any]]:
        """Start a game; see the wrapped environment."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return {agent: self._add_mask(agent, value) for agent, value in observations.items()}, infos

    def step(self, actions: Any) -> Step:
        """Make a step with one number for each agent.

        Raises:
            ArgumentError: a number is out of range, or the wrapped game refuses the actions.
        """
        if not isinstance(actions, dict):
            raise ArgumentError(f"actions must map agents to actions, got {quote(actions)}.")
        inner = {agent: self._decode_action(agent, action) for agent, action in actions.items()}
        observations, *rest = self.env.step(inner)
        return ({agent: self._add_mask(agent, value) for agent, value in observations.items()}, *rest)

    def _decode_action(self, agent: str, action: Any) -> Any:
        """Convert a number to the action of the wrapped game."""
        if agent not in self._actions:
            return action
        count = int(self._actions[agent].n)
        value = np.asarray(action)
        if value.shape not in ((), (1,)) or value.dtype.kind not in "iu" or not 0 <= value.item() < count:
            raise ArgumentError(f"action of {agent} must be a whole number from 0 to {count - 1}, got {quote(action)}.")
        space = self.env.action_space(agent)
        if isinstance(space, spaces.MultiDiscrete):
            return np.array(np.unravel_index(value.item(), space.nvec))
        vote = np.zeros(space.shape, np.int8)
        if value.item() < count - 1:
            vote[value.item()] = 1
        return vote

    def _add_mask(self, agent: str, observation: Observation) -> Observation:
        space, legal = self.env.action_space(agent), observation["legal"]
        if isinstance(space, spaces.MultiDiscrete):
            mask = reduce(np.kron, np.split(legal, np.cumsum(space.nvec)[:-1]))
        else:
            mask = np.append(legal, np.int8(1))
        return {**observation, "action_mask": mask.astype(np.int8)}


class MultiDiscreteVotes(BaseParallelWrapper):  # type: ignore[misc]  # PettingZoo ships no types
    """Convert votes from ``MultiBinary(N)`` to ``MultiDiscrete([2] * N)``, which SuperSuit and RLlib need.

    The values of the actions do not change, and neither do the action spaces of heads.

    Args:
        env: the ``parallel_env`` of one of the games, or a wrapper around it.

    Raises:
        ArgumentError: ``env`` is not one of the games, or its votes are scores.
    """

    def __init__(self, env: UsnetParallelEnv | BaseParallelWrapper) -> None:
        super().__init__(_check_game(env))
        self._actions = {agent: _convert_space(agent, env.action_space(agent)) for agent in env.possible_agents}

    def action_space(self, agent: str) -> spaces.MultiDiscrete:
        """Return the action space of an agent; the same object every time."""
        return self._actions[agent]


class ParallelBoxMasks(BaseParallelWrapper):  # type: ignore[misc]  # PettingZoo ships no types
    """Describe the masks in the observation spaces as ``Box``; see ``usnet_env.envs.wrappers.BoxMasks``.

    The observations themselves do not change.

    Args:
        env: the ``parallel_env`` of one of the games, or a wrapper around it such as :class:`DiscreteActions`.

    Raises:
        ArgumentError: ``env`` is not one of the games.
    """

    def __init__(self, env: UsnetParallelEnv | BaseParallelWrapper) -> None:
        super().__init__(_check_game(env))
        self._observations = {agent: box_masks(env.observation_space(agent)) for agent in env.possible_agents}

    def observation_space(self, agent: str) -> spaces.Dict:
        """Return the observation space of an agent; the same object every time."""
        return self._observations[agent]


def _check_game(env: Any) -> Any:
    """Return ``env`` if it is a game in Parallel form."""
    if not isinstance(env, UsnetParallelEnv | BaseParallelWrapper):
        raise ArgumentError(f"env must be a parallel_env or a wrapper around it, got {quote(env)}.")
    return env


def _convert_space(agent: str, space: Any) -> spaces.MultiDiscrete:
    if isinstance(space, spaces.MultiBinary):
        return spaces.MultiDiscrete(np.full(space.shape, 2))
    if not isinstance(space, spaces.MultiDiscrete):
        raise ArgumentError(f"env must have votes that are candidates, got {quote(space)} for {agent}.")
    return space

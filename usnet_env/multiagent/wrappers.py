"""Wrappers for frameworks that need another form of the same actions and observations."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, quote
from usnet_env.envs.wrappers import box_masks
from usnet_env.multiagent.base import BaseParallelWrapper, Observation, Step, UsnetParallelEnv

__all__ = ["DiscreteActions", "MultiDiscreteVotes", "ParallelBoxMasks"]

_MOST_ACTIONS = 100_000


class DiscreteActions(BaseParallelWrapper):  # type: ignore[misc]  # PettingZoo ships no types
    """A game whose agents each choose one of n actions; the observation gets the key ``action_mask`` beside ``legal``.

    Who names UAVs chooses one of them, or N for nobody: ``Discrete(N + 1)`` (a message, where there is one, stays
    empty). A head's choices are numbered together, the last one varying fastest: ``Discrete`` of their product. The
    mask ``(n,)`` int8 is 1 for what is legal; ``action_space(agent).sample(mask)`` takes it.

    Args:
        env: one of the games' ``parallel_env``.

    Raises:
        ArgumentError: an env of another kind, one whose votes are scores, or one with too many actions.
    """

    def __init__(self, env: UsnetParallelEnv) -> None:
        if not isinstance(env, UsnetParallelEnv):
            raise ArgumentError(f"env must be the parallel_env of a game of this project, got {quote(env)}.")
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
        """The actions of an agent; the same object every time."""
        return self._actions[agent]

    def observation_space(self, agent: str) -> spaces.Dict:
        """The observations of an agent; the same object every time."""
        return self._observations[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, Any]]:
        """Start a game; see the wrapped one."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return {agent: self._masked(agent, one) for agent, one in observations.items()}, infos

    def step(self, actions: Any) -> Step:
        """A step with one number for each agent.

        Raises:
            ArgumentError: a number out of range, or what the wrapped game refuses.
        """
        if not isinstance(actions, dict):
            raise ArgumentError(f"actions must map agents to actions, got {quote(actions)}.")
        inner = {agent: self._inner(agent, action) for agent, action in actions.items()}
        observations, *rest = self.env.step(inner)
        return ({agent: self._masked(agent, one) for agent, one in observations.items()}, *rest)

    def _inner(self, agent: str, action: Any) -> Any:
        """The wrapped game's action."""
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

    def _masked(self, agent: str, observation: Observation) -> Observation:
        space, legal = self.env.action_space(agent), observation["legal"]
        if isinstance(space, spaces.MultiDiscrete):
            mask: NDArray[np.int8] = np.ones(1, np.int8)
            for part in np.split(legal, np.cumsum(space.nvec)[:-1]):
                mask = np.outer(mask, part).reshape(-1)
        else:
            mask = np.append(legal, np.int8(1))
        return {**observation, "action_mask": mask.astype(np.int8)}


class MultiDiscreteVotes(BaseParallelWrapper):  # type: ignore[misc]  # PettingZoo ships no types
    """Votes as ``MultiDiscrete([2] * N)``, which SuperSuit and RLlib want for ``MultiBinary(N)``; the same bits.

    Args:
        env: one of the games' ``parallel_env``, or a wrapper round it. Heads' actions stay as they are.

    Raises:
        ArgumentError: an env of another kind, or one whose votes are scores.
    """

    def __init__(self, env: UsnetParallelEnv | BaseParallelWrapper) -> None:
        super().__init__(_game(env))
        self._actions = {agent: _multi_discrete(agent, env.action_space(agent)) for agent in env.possible_agents}

    def action_space(self, agent: str) -> spaces.MultiDiscrete:
        """The actions of an agent; the same object every time."""
        return self._actions[agent]


class ParallelBoxMasks(BaseParallelWrapper):  # type: ignore[misc]  # PettingZoo ships no types
    """The masks in the observations as ``Box``, the observations unchanged; see ``usnet_env.envs.wrappers.BoxMasks``.

    Args:
        env: one of the games' ``parallel_env``, or a wrapper round it such as :class:`DiscreteActions`.

    Raises:
        ArgumentError: an env of another kind.
    """

    def __init__(self, env: UsnetParallelEnv | BaseParallelWrapper) -> None:
        super().__init__(_game(env))
        self._observations = {agent: box_masks(env.observation_space(agent)) for agent in env.possible_agents}

    def observation_space(self, agent: str) -> spaces.Dict:
        """The observations of an agent; the same object every time."""
        return self._observations[agent]


def _game(env: Any) -> Any:
    """``env``, if it is a game in Parallel form."""
    if not isinstance(env, UsnetParallelEnv | BaseParallelWrapper):
        raise ArgumentError(f"env must be a parallel_env or a wrapper round it, got {quote(env)}.")
    return env


def _multi_discrete(agent: str, space: Any) -> spaces.MultiDiscrete:
    if isinstance(space, spaces.MultiBinary):
        return spaces.MultiDiscrete(np.full(space.shape, 2))
    if not isinstance(space, spaces.MultiDiscrete):
        raise ArgumentError(f"env must have votes that are candidates, got {quote(space)} for {agent}.")
    return space

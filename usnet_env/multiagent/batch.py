"""Several games in one batch, as arrays: what both games of several agents are made of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask, Observation, Singles
from usnet_env.config import ArgumentError, quote
from usnet_env.envs import game
from usnet_env.envs.batch import SwarmGames
from usnet_env.envs.game import Rules
from usnet_env.multiagent.sensors import merge_windows
from usnet_env.swarm import ObservationBatch, SwarmConfig

ByRole = dict[str, NDArray[Any]]  # an array (B, n) of each role with n agents
Observations = dict[str, Observation]  # by role and name, arrays (B, n, ...)
Step = tuple[Observations, ByRole, ByRole, ByRole, Observations]

OBSERVER = "observer"  # the role whose reward is that of P2


class GameBatch(SwarmGames, ABC):
    """``num_envs`` games of several agents, each of which equals the game in Parallel form with its seed.

    Arrays have the axes B, games, and n, agents of a role. All agents keep their rows until their game is over; what
    agents do that have left has no effect. A game that is over plays on after :meth:`reset`.

    Attributes:
        roles: n of each role.
        observation_spaces: for each role, the space of one agent; its ``legal`` masks the actions.
        action_spaces: for each role, the space of one agent.
        active: for each role, the agents that play, ``(B, n)`` bool.
        scores: ``(B, N)``, the candidates are chosen by them.
        has_window: ``(B,)`` bool, the games whose observers have seen a window.
    """

    def __init__(
        self,
        num_envs: int,
        config: SwarmConfig,
        rules: Rules,
        roles: Mapping[str, tuple[int, spaces.Dict, spaces.Space[Any]]],
        render_mode: str | None,
    ) -> None:
        super().__init__(num_envs, config, rules, observers=(roles[OBSERVER][0],), pictures=render_mode is not None)
        self.render_mode = render_mode
        self.roles = {role: count for role, (count, _, _) in roles.items()}
        self.observation_spaces = {role: seen for role, (_, seen, _) in roles.items()}
        self.action_spaces = {role: acts for role, (_, _, acts) in roles.items()}
        self.active = {role: np.zeros((num_envs, count), bool) for role, count in self.roles.items()}
        self.scores = np.zeros((num_envs, config.uavs))
        self.has_window = np.ones(num_envs, bool)
        self._prices: ByRole = {}  # that agents pay, of roles that do

    def reset(self, seed: Any = None, games: Any = None) -> tuple[Observations, Observations]:
        """Start games: observations and infos of all.

        Args:
            seed: game b is seeded with ``seed + b``, or with element b of a sequence; ``None`` keeps the generators.
            games: which games to start, ``(B,)`` bool, such as those that are over; by default all.

        Raises:
            ArgumentError: another number of seeds or games than B, or a seed that is not a whole number from 0.
        """
        chosen = self.begin(seed, games, "games")
        begun = np.isin(self.all_games, chosen)[:, None]
        self.metrics = {name: np.zeros_like(array) for name, array in self.metrics.items()}
        self.scores = np.where(begun, 0.0, self.scores)
        self.active = {role: active | begun for role, active in self.active.items()}
        self._prices = {role: np.zeros_like(price) for role, price in self._prices.items()}
        self._begin(chosen)
        return self._observe(), self._infos()

    def step(self, actions: Mapping[str, Any]) -> Step:
        """Play a round of each game, and fly the next windows.

        Args:
            actions: for each role, ``(B, n, ...)``.

        Returns:
            Observations, rewards, terminations, truncations and infos, by role. The game of an observer that terminated
            or was truncated is over.

        Raises:
            ArgumentError: actions of a role are missing or have a wrong shape or values, or a game is over.
        """
        if not isinstance(actions, Mapping) or set(actions) != set(self.roles):
            raise ArgumentError(f"actions must map each of {', '.join(self.roles)} to arrays, got {quote(actions)}.")
        lead = {role: (self.num_envs, count) for role, count in self.roles.items()}
        parsed = {role: self.parse(role, actions[role], lead[role], f"actions of {role}") for role in lead}
        return self.play(parsed)

    def play(self, actions: ByRole) -> Step:
        """:meth:`step` with actions from :meth:`parse`."""
        self.require_running()
        active = self.active
        candidates, self.scores = self._combine(actions)
        reward = self.play_round(candidates, self.has_window.copy())[:, None]
        self._prices = self._respond(actions)
        state = self.game
        self.fly(self.all_games)
        over = {OBSERVER: state.terminated[:, None], **self._find_leaving()}
        terminations = {role: active[role] & over[role] for role in active}
        truncations = {role: active[role] & state.truncated[:, None] & ~over[role] for role in active}
        paid = {role: np.zeros(each.shape) for role, each in active.items()} | self._prices
        rewards = {role: reward if role == OBSERVER else -reward - paid[role] for role in active}
        rewards = {role: np.where(active[role], each, 0.0) for role, each in rewards.items()}
        self.active = {role: active[role] & ~terminations[role] & ~truncations[role] for role in active}
        return self._observe(), rewards, terminations, truncations, self._infos()

    @abstractmethod
    def parse(self, role: str, action: Any, lead: tuple[int, ...], name: str) -> NDArray[Any]:
        """Check actions of agents, ``(*lead, ...)``, which errors call ``name``."""

    @abstractmethod
    def _begin(self, games: Indices) -> None:
        """Start what some games have besides the swarm."""

    @abstractmethod
    def _combine(self, actions: ByRole) -> tuple[Mask, Floats]:
        """The candidates and their scores, both ``(B, N)``."""

    @abstractmethod
    def _observe(self) -> Observations:
        """What all agents observe."""

    def _respond(self, actions: ByRole) -> ByRole:
        """Do what the actions say about the next window; the prices that agents pay, of roles that do."""
        return {}

    def _find_leaving(self) -> ByRole:
        """For each other role than the observers', the agents that are destroyed."""
        return {}

    def _show(self, legal: Mask) -> Observation:
        """The observations of the observers, ``legal`` ``(B, n, N)``."""
        shown = self.observe(game.PARTS)
        shared = {name: np.repeat(shown[name][:, None], legal.shape[1], axis=1) for name in ("alive", "round")}
        return {**shown, **shared, "legal": legal.astype(np.int8)}

    def _infos(self) -> Observations:
        infos = {
            role: {name: array[:, None].repeat(count, axis=1) for name, array in self.metrics.items()}
            for role, count in self.roles.items()
        }
        for role, price in self._prices.items():
            infos[role]["price"] = price.copy()
        return infos

    def merge_windows(self, b: int = 0) -> ObservationBatch:
        """What all observers of a game saw together in the present window, for pictures and records."""
        window = {name: array[b] for name, array in self.window.items()}
        return merge_windows(window, self.game.swarm.alive[b], self.config.sample_every)

    def state(self) -> Singles:
        """The true states for a centralised critic, ``(B, S)`` float32.

        They are Markov: all arrays of :class:`~usnet_env.swarm.SwarmState` in their order, of the past positions only
        the present ones (the velocities have the others); then the rounds played, and what the game adds.
        """
        swarm = self.game.swarm
        arrays = {**vars(swarm), "past_position": swarm.position}
        parts = [*arrays.values(), self.game.rounds, *self._more_state()]
        flat = np.concatenate([array.reshape(self.num_envs, -1) for array in parts], axis=1, dtype=np.float32)
        return np.nan_to_num(flat, copy=False)  # a goal that has not been drawn yet is NaN

    def _more_state(self) -> list[NDArray[Any]]:
        """Arrays of the state besides those of the swarm."""
        return []

    def flatten(self, observations: Observations) -> dict[str, Singles]:
        """Observations with one array ``(B, n, F)`` float32 for each role, in the order of Gymnasium's ``flatten``."""
        return {
            role: np.concatenate([array[name].reshape(self.num_envs, self.roles[role], -1) for name in space], axis=2)
            for role, space in self.observation_spaces.items()
            for array in [observations[role]]
        }

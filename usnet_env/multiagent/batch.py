"""Several games in one batch, as arrays: what both games of several agents are made of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask, Observation, Singles
from usnet_env.config import ArgumentError, quote, whole_number
from usnet_env.envs import game
from usnet_env.envs.game import GameState, Rules
from usnet_env.envs.vector import parse_seeds, renew_generators
from usnet_env.multiagent.sensors import merge_sightings
from usnet_env.swarm import ObservationBatch, SwarmConfig, SwarmState

ByRole = dict[str, NDArray[Any]]  # an array (B, n) of each role with n agents
Observations = dict[str, Observation]  # by role and name, arrays (B, n, ...)
Step = tuple[Observations, ByRole, ByRole, ByRole, Observations]

WINDOW = ("position", "velocity", "seen")
OBSERVER = "observer"  # the role whose reward is that of P2


class GameBatch(ABC):
    """``num_envs`` games of several agents, each of which equals the game in Parallel form with its seed.

    Arrays have the axes B, games, and n, agents of a role. All agents keep their rows until their game is over; what
    agents do that have left has no effect. A game that is over plays on after :meth:`reset`.

    Attributes:
        config: the configuration of the swarms.
        rules: the rules of the games.
        roles: n of each role.
        observation_spaces: for each role, the space of one agent; its ``legal`` masks the actions.
        action_spaces: for each role, the space of one agent.
        active: for each role, the agents that play, ``(B, n)`` bool.
        candidates: ``(B, N)`` bool, those of the last round; nobody before the first one.
        scores: ``(B, N)``, the candidates are chosen by them.
        metrics: those of ``info``, each ``(B,)``.
    """

    def __init__(
        self,
        num_envs: int,
        config: SwarmConfig,
        rules: Rules,
        roles: Mapping[str, tuple[int, spaces.Dict, spaces.Space[Any]]],
    ) -> None:
        self.num_envs = whole_number("num_envs", num_envs, 1, 1_000_000)
        self.config, self.rules = config, rules
        self.roles = {role: count for role, (count, _, _) in roles.items()}
        self.observation_spaces = {role: seen for role, (_, seen, _) in roles.items()}
        self.action_spaces = {role: acts for role, (_, _, acts) in roles.items()}
        self.active = {role: np.zeros((num_envs, count), bool) for role, count in self.roles.items()}
        self.candidates = np.zeros((num_envs, config.uavs), bool)
        self.scores = np.zeros((num_envs, config.uavs))
        self.metrics: dict[str, NDArray[Any]] = {}
        self._rngs: list[np.random.Generator] = []
        self._game: GameState | None = None
        self._prices: ByRole = {}  # that agents pay, of roles that do
        count, seen, _ = roles[OBSERVER]
        types = (np.float32, np.float32, bool)
        #: What the n observers see, each array (B, n, ...).
        self._window: Observation = {
            name: np.zeros((num_envs, count, *(seen[name].shape or ())), kind)
            for name, kind in zip(WINDOW, types, strict=True)
        }

    @property
    def game(self) -> GameState:
        """The state of the games.

        Raises:
            ArgumentError: they have not begun.
        """
        return game.require_game(self._game)

    def reset(self, seed: Any = None, games: Any = None) -> tuple[Observations, Observations]:
        """Start games: observations and infos of all.

        Args:
            seed: game b is seeded with ``seed + b``, or with element b of a sequence; ``None`` keeps the generators.
            games: which games to start, ``(B,)`` bool, such as those that are over; by default all.

        Raises:
            ArgumentError: another number of seeds or games than B, or a seed that is not a whole number from 0.
        """
        mask = np.ones(self.num_envs, bool) if games is None else np.asarray(games)
        enough = mask.any() if self._game else mask.all()
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not enough:
            raise ArgumentError(f"games must be {self.num_envs} booleans, some true, at first all, got {quote(games)}.")
        chosen = np.flatnonzero(mask)
        renew_generators(self._rngs, [], parse_seeds(seed, self.num_envs), chosen)
        state = game.start_games([self.config] * len(chosen), [self._rngs[b] for b in chosen])
        self._game = state if mask.all() else self.game.with_rows(chosen, state)
        self.candidates, self.scores = self.candidates & ~mask[:, None], np.where(mask[:, None], 0.0, self.scores)
        self.active = {role: active | mask[:, None] for role, active in self.active.items()}
        self._prices = {role: np.zeros_like(price) for role, price in self._prices.items()}
        self._clear(chosen)
        self._begin({int(b): self._rngs[b] for b in chosen})
        self.metrics = game.initial_info(self.rules, self.game)
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
        return self.play({role: self.parse(role, actions[role], lead[role], f"actions of {role}") for role in lead})

    def play(self, actions: ByRole) -> Step:
        """:meth:`step` with actions from :meth:`parse`."""
        before, active = self.game, self.active
        game.require_game(before if active[OBSERVER].any(axis=1).all() else None)
        named, self.scores = self._combine(actions)
        opened = self._has_window()
        self.candidates = named & opened[:, None]
        state, reward, metrics = game.play_round(self.rules, before, self.candidates)
        if not opened.all():  # before its first window a game has no round
            rounds, truncated = np.where(opened, state.rounds, before.rounds), state.truncated & opened
            state = replace(state, rounds=rounds, truncated=truncated)
            reward = np.where(opened, reward, 0.0)
            metrics = {name: np.where(opened, part, np.zeros_like(part)) for name, part in metrics.items()}
        self._game, self.metrics = state, metrics
        self._prices = self._respond(actions)
        self._clear(np.flatnonzero(state.terminated))
        self._fly(np.flatnonzero(~state.terminated))
        over = {OBSERVER: state.terminated[:, None], **self._find_leaving()}
        terminations = {role: active[role] & over[role] for role in active}
        truncations = {role: active[role] & state.truncated[:, None] & ~over[role] for role in active}
        paid = {role: np.zeros(one.shape) for role, one in active.items()} | self._prices
        rewards = {role: reward[:, None] if role == OBSERVER else -reward[:, None] - paid[role] for role in active}
        rewards = {role: np.where(active[role], one, 0.0) for role, one in rewards.items()}
        self.active = {role: active[role] & ~terminations[role] & ~truncations[role] for role in active}
        return self._observe(), rewards, terminations, truncations, self._infos()

    @abstractmethod
    def parse(self, role: str, action: Any, lead: tuple[int, ...], name: str) -> NDArray[Any]:
        """Check actions of agents, ``(*lead, ...)``, which errors call ``name``."""

    @abstractmethod
    def _begin(self, rngs: Mapping[int, np.random.Generator]) -> None:
        """Start what games have besides the swarm; of each game its number and generator."""

    @abstractmethod
    def _combine(self, actions: ByRole) -> tuple[Mask, Floats]:
        """The candidates and their scores, both ``(B, N)``."""

    @abstractmethod
    def _fly_rows(self, swarm: SwarmState, rows: Indices) -> tuple[SwarmState, Observation]:
        """Fly the next windows of some games: their swarms, and what the observers see."""

    @abstractmethod
    def _observe(self) -> Observations:
        """What all agents observe."""

    def _has_window(self) -> Mask:
        """The games whose observers have seen a window, ``(B,)``."""
        return np.ones(self.num_envs, bool)

    def _respond(self, actions: ByRole) -> ByRole:
        """Do what the actions say about the next window; the prices that agents pay, of roles that do."""
        return {}

    def _find_leaving(self) -> ByRole:
        """For each other role than the observers', the agents that are destroyed."""
        return {}

    def _clear(self, games: Indices) -> None:
        """Show empty windows of some games."""
        if len(games):
            self._window = {name: part.copy() for name, part in self._window.items()}
            for part in self._window.values():
                part[games] = 0

    def _fly(self, rows: Indices) -> None:
        """Fly the next windows of some games; :meth:`_clear` was called for the others, or for these."""
        swarm, every = self.game.swarm, len(rows) == self.num_envs
        if not len(rows):
            return
        after, window = self._fly_rows(swarm if every else swarm.rows(rows), rows)
        self._game = replace(self.game, swarm=after if every else swarm.with_rows(rows, after))
        if every:
            self._window = window
            return
        for name, part in window.items():
            self._window[name][rows] = part

    def _show(self, legal: Mask) -> Observation:
        """The observations of the observers, ``legal`` ``(B, n, N)``."""
        state, count = self.game, legal.shape[1]
        alive = np.repeat(state.swarm.alive[:, None], count, axis=1)
        window = {name: part.copy() for name, part in self._window.items()}
        shown = game.show_window(ObservationBatch(**window, alive=alive), state.rounds)
        shown["round"] = np.tile(shown["round"][:, None, None], (1, count, 1))
        return {**shown, "legal": legal.astype(np.int8)}

    def _infos(self) -> Observations:
        infos = {
            role: {name: part[:, None].repeat(count, axis=1) for name, part in self.metrics.items()}
            for role, count in self.roles.items()
        }
        for role, price in self._prices.items():
            infos[role]["price"] = price.copy()
        return infos

    def merge_windows(self, b: int = 0) -> ObservationBatch:
        """What all observers of a game saw together in the present window, for pictures and records."""
        alive = self.game.swarm.alive[b]
        each = [{name: part[b, k] for name, part in self._window.items()} for k in range(self.roles[OBSERVER])]
        return merge_sightings([ObservationBatch(**one, alive=alive) for one in each], self.config.sample_every)

    def reveal(self) -> SwarmState:
        """A copy of the true swarms, as they were in the present windows."""
        return SwarmState(**self.game.swarm.arrays())

    def state(self) -> Singles:
        """The true states for a centralised critic, ``(B, S)`` float32.

        They are Markov: all arrays of :class:`~usnet_env.swarm.SwarmState` in their order, of the past positions only
        the present ones (the velocities have the others); then the rounds played, and what the game adds.
        """
        swarm = self.game.swarm
        arrays = [swarm.position if one.name == "past_position" else getattr(swarm, one.name) for one in fields(swarm)]
        parts = [*arrays, self.game.rounds, *self._more_state()]
        flat = np.concatenate([part.reshape(self.num_envs, -1) for part in parts], axis=1, dtype=np.float32)
        return np.nan_to_num(flat, copy=False)  # a goal that has not been drawn yet is NaN

    def _more_state(self) -> list[NDArray[Any]]:
        """Arrays of the state besides those of the swarm."""
        return []

    def flatten(self, observations: Observations) -> dict[str, Singles]:
        """Observations with one array ``(B, n, F)`` float32 for each role, in the order of Gymnasium's ``flatten``."""
        return {
            role: np.concatenate([part[name].reshape(self.num_envs, self.roles[role], -1) for name in space], axis=2)
            for role, space in self.observation_spaces.items()
            for part in [observations[role]]
        }

"""Games in one batch: the core of all environments and games. A single game is a batch of one."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask, Observation
from usnet_env.config import ArgumentError, optional_seed, quote, whole_number
from usnet_env.drawing import EpisodeFrames
from usnet_env.envs import game
from usnet_env.envs.game import GameState, Rules
from usnet_env.swarm import ObservationBatch, SwarmConfig, SwarmState, start
from usnet_env.swarm.flight import group_by_config
from usnet_env.swarm.simulator import advance_each

WINDOW = ("position", "velocity", "seen")
Generator = np.random.Generator


class SwarmGames:
    """``num_envs`` games as arrays with a leading axis B, each with its own configuration and generator.

    A step is :meth:`play_round`, which may end games, :meth:`start` of those that begin anew, and :meth:`fly`, which
    shows the next windows.

    Args:
        num_envs: B, number of games.
        config: a swarm whose bounds hold in all episodes.
        rules: the rules of the games.
        draw: draws the swarm of an episode from the generator of its game; ``None``: all have ``config``.
        observers: the axes ``(n,)`` of several observers in a window.
        pictures: whether :meth:`draw` is going to be called, for which each window must be looked at.

    Attributes:
        all_games: the indices of all games.
        configs: the swarm of the present episode of each game.
        rngs: the generator of each game; ``None`` before it is needed.
        seeds: their seeds.
        window: the present ``position``, ``velocity`` and ``seen``, each ``(B, ...)``.
        candidates: ``(B, N)`` bool, those of the last round; none before the first one.
        metrics: those of ``info``, each ``(B,)``.
        answered: ``(B,)`` bool, the games whose last step was a round.
        before: the games before their last step; its arrays for games that were not ``answered`` mean nothing.
    """

    def __init__(
        self,
        num_envs: int,
        config: SwarmConfig,
        rules: Rules,
        draw: Callable[[Generator], SwarmConfig] | None = None,
        observers: tuple[int, ...] = (),
        pictures: bool = False,
    ) -> None:
        self.num_envs = whole_number("num_envs", num_envs, 1, 1_000_000)
        self.all_games = np.arange(self.num_envs)
        self.config, self.rules, self._draw_config, self.pictures = config, rules, draw, pictures
        self.configs = [config] * self.num_envs
        self.rngs: list[Any] = [None] * self.num_envs
        self.seeds: list[Any] = [None] * self.num_envs
        games, steps, uavs = (self.num_envs, *observers), config.observation_steps, config.uavs
        self.window: Observation = {
            "position": np.zeros((*games, steps + 1, uavs, 3), np.float32),
            "velocity": np.zeros((*games, steps, uavs, 3), np.float32),
            "seen": np.zeros((*games, steps + 1, uavs), bool),
        }
        self.candidates = np.zeros((self.num_envs, config.uavs), bool)
        self.metrics: dict[str, NDArray[Any]] = {}
        self.answered = np.zeros(self.num_envs, bool)
        self.before: Any = None
        self._frames = [EpisodeFrames()] * self.num_envs
        self._game: GameState | None = None

    @property
    def game(self) -> GameState:
        """The state of the games.

        Raises:
            ArgumentError: they have not begun.
        """
        return game.require_game(self._game)

    def require_running(self, games: Any = slice(None)) -> None:
        """Refuse a step if some games, or one, have not begun or are over."""
        over = self.game.terminated | self.game.truncated
        game.require_game(None if over[games].any() else self._game)

    def begin(self, seed: Any, mask: Any, name: str) -> Indices:
        """Seed and start the games of a mask ``(B,)``, or of ``None`` all, and return their indices.

        Args:
            seed: game b is seeded with ``seed + b``, or with element b of a sequence; ``None`` keeps the generators.
            mask: the games, at first all.
            name: what errors call the mask.
        """
        chosen = np.ones(self.num_envs, bool) if mask is None else np.asarray(mask)
        is_enough = chosen.any() if self.metrics else chosen.all()
        if chosen.shape != (self.num_envs,) or chosen.dtype != bool or not is_enough:
            raise ArgumentError(f"{name} must be {self.num_envs} booleans, some true, at first all, got {quote(mask)}.")
        if np.ndim(seed) == 0:
            first_seed = optional_seed("seed", seed)
            seed = [None if first_seed is None else first_seed + b for b in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ArgumentError(f"seed must hold one seed for each of {self.num_envs} envs, got {len(seed)}.")
        seeds, games = [optional_seed("seed", value) for value in seed], np.flatnonzero(chosen)
        for b in games.tolist():
            if seeds[b] is not None or self.rngs[b] is None:
                self.rngs[b], self.seeds[b] = seeding.np_random(seeds[b])
        self.start(games)
        return games

    def start(self, games: Indices) -> None:
        """Start some games; their first windows have not been flown."""
        chosen = games.tolist()
        if self._draw_config is not None:
            for b in chosen:
                self.configs[b] = self._draw_config(self.rngs[b])
        groups = group_by_config([self.configs[b] for b in chosen])
        swarm = SwarmState.join([start(config, [self.rngs[chosen[k]] for k in rows]) for config, rows in groups])
        if len(groups) > 1:
            swarm = swarm.rows(np.argsort(np.concatenate([rows for _, rows in groups])))
        (rounds, redundant), (terminated, truncated) = np.zeros((2, len(chosen)), int), np.zeros((2, len(chosen)), bool)
        started = GameState(swarm, swarm.alive.sum(axis=1), rounds, redundant, terminated, truncated)
        self._game = started if len(chosen) == self.num_envs else self.game.with_rows(games, started)
        self.metrics = self.metrics or game.play_round(self.rules, started, np.zeros_like(swarm.alive))[2]
        is_other = ~np.isin(self.all_games, games)
        self.metrics = {name: np.where(is_other, array, np.zeros_like(array)) for name, array in self.metrics.items()}
        self.candidates, self.answered = self.candidates & is_other[:, None], self.answered & is_other
        for b in chosen if self.pictures else ():
            self._frames[b] = EpisodeFrames()

    def parse_action(self, action: Any, lead: tuple[int, ...] = ()) -> Any:
        """Check the action of one game, or with ``lead`` ``(B,)`` of all games: the candidates ``(*lead, N)``."""
        return game.parse_candidates(action, (*lead, self.config.uavs))

    def play_round(self, action: Any, playing: Mask) -> Floats:
        """Do what :meth:`parse_action` returned in the games that are ``playing``, ``(B,)``; the rewards, ``(B,)``."""
        self.before = None
        self.before, old_state = copy.copy(self), self.game
        self.candidates, self.answered = action & playing[:, None], playing
        state, rewards, metrics = game.play_round(self.rules, old_state, self.candidates)
        if not playing.all():
            counters = {key: np.where(playing, getattr(state, key), getattr(old_state, key)) for key in game.COUNTERS}
            state, rewards = replace(state, **counters), np.where(playing, rewards, 0.0)
            metrics = {name: np.where(playing, array, np.zeros_like(array)) for name, array in metrics.items()}
        self._game, self.metrics = state, metrics
        return rewards

    def fly(self, games: Indices) -> None:
        """Fly and observe the next windows of some games; a game that has terminated gets an empty window."""
        state = self.game
        running = games[~state.terminated[games]]
        if len(running) == self.num_envs:
            swarm, self.window = self._fly_rows(state.swarm, running)
            self._game = replace(state, swarm=swarm)
        else:
            self.window = {name: array.copy() for name, array in self.window.items()}  # `before` keeps its windows
            for array in self.window.values():
                array[games] = 0
            if len(running):
                swarm, window = self._fly_rows(state.swarm.rows(running), running)
                self._game = replace(state, swarm=state.swarm.with_rows(running, swarm))
                for name, array in window.items():
                    self.window[name][running] = array
        self.watch(games)

    def _fly_rows(self, swarm: SwarmState, games: Indices) -> tuple[SwarmState, Observation]:
        """Fly the next windows of some games from their swarms."""
        chosen = games.tolist()
        flown, observations = advance_each([self.configs[b] for b in chosen], swarm, [self.rngs[b] for b in chosen])
        return flown, {name: getattr(observations, name) for name in WINDOW}

    def load_game(self, b: int, config: SwarmConfig, state: GameState, window: Observation) -> None:
        """Go on with game b from a state, a batch of one, and its window, as if it began there."""
        self.configs[b], self.answered[b], self._frames[b] = config, False, EpisodeFrames()
        self._game = state if self.num_envs == 1 else self.game.with_rows(np.array([b]), state)
        for name, array in self.window.items():
            array[b] = window[name]
        self.watch(np.array([b]))

    def observe(self, names: Sequence[str], games: Any = slice(None)) -> Observation:
        """Parts of the present observation of some games, or of one without the leading axis, as copies."""
        state, parts = self.game, {name: array[games] for name, array in self.window.items()}
        parts |= {"alive": state.swarm.alive[games], "round": (state.rounds[games, None] + 1).astype(np.float32)}
        is_view = not isinstance(games, np.ndarray)  # indices have copied
        return {name: parts[name].astype(game.TYPES[name], copy=is_view) for name in names}

    def merge_windows(self, b: int = 0) -> ObservationBatch:
        """What was seen in the present window of a game, for pictures and records."""
        return ObservationBatch(
            **{name: array[b] for name, array in self.window.items()}, alive=self.game.swarm.alive[b]
        )

    def reveal(self) -> SwarmState:
        """A copy of the true swarms, as they were in the present windows."""
        return SwarmState(**self.game.swarm.arrays())

    def action_masks(self, games: Any = slice(None)) -> Mask:
        """``(B, 2 N)`` bool, or ``(2 N,)`` of one game: for each UAV whether 0 and whether 1 is allowed."""
        alive = self.game.swarm.alive[games]
        return np.stack([np.ones_like(alive), alive], axis=-1).reshape(*alive.shape[:-1], -1)

    def watch(self, games: Indices) -> None:
        """Take note of the present windows of some games, if there are pictures."""
        for b in games.tolist() if self.pictures else ():
            sighting = self.merge_windows(b)
            self._frames[b].watch(sighting.position, sighting.seen)

    def draw(self, b: int = 0, **scene: Any) -> NDArray[np.uint8]:
        """Draw the last round of a game, or before the first one the present window, ``(H, W, 3)``."""
        games, candidates, title = self, None, game.UNANSWERED
        if self.answered[b]:
            games, candidates = self.before, self.candidates[b]
            title = game.title_round({name: array[b].item() for name, array in self.metrics.items()})
        sighting, truth = games.merge_windows(b), games.reveal().episode(b)
        scene |= {"position": sighting.position, "seen": sighting.seen, **truth.roles()}
        return self._frames[b].render(candidates=candidates, title=title, **scene)

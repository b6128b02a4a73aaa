"""The vector environments: B games in one batch, equal to B single environments with the same seeds."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask, Observation
from usnet_env.config import ArgumentError, optional_seed, quote, whole_number
from usnet_env.envs import game
from usnet_env.envs.usnet import MultiClusterEnv, SingleClusterEnv, UsnetEnv
from usnet_env.swarm import SwarmState


def check_batch(num_envs: Any, autoreset_mode: Any) -> tuple[int, AutoresetMode]:
    """The number of games and when a game restarts, for the constructors of the vector environments."""
    try:
        mode = AutoresetMode(autoreset_mode)
    except ValueError:
        names = ", ".join(mode.value for mode in AutoresetMode)
        raise ArgumentError(f"autoreset_mode must be one of {names}, got {quote(autoreset_mode)}.") from None
    return whole_number("num_envs", num_envs, 1, 1_000_000), mode


def parse_seeds(seed: Any, num_envs: int) -> list[int | None]:
    """One seed for each game, of one number, of one for each, or of ``None``."""
    if np.ndim(seed) == 0:
        first = optional_seed("seed", seed)
        return [None if first is None else first + b for b in range(num_envs)]
    if len(seed) != num_envs:
        raise ArgumentError(f"seed must hold one seed for each of {num_envs} envs, got {len(seed)}.")
    return [optional_seed("seed", one) for one in seed]


def renew_generators(
    rngs: list[np.random.Generator], used: list[int], seeds: Sequence[int | None], chosen: Indices
) -> None:
    """Make new generators of the chosen games that have a seed, and of all games if there are none yet."""
    fresh = not rngs
    for b in range(len(seeds)) if fresh else chosen:
        if fresh or seeds[b] is not None:
            rng, number = seeding.np_random(seeds[b])
            rngs[b : b + 1], used[b : b + 1] = [rng], [number]


class UsnetVectorEnv(VectorEnv[Observation, NDArray[np.int8], NDArray[Any]]):
    """``num_envs`` games in one batch, with the arguments of the single environment.

    ``autoreset_mode`` is Gymnasium's, or its value as text. ``NextStep``: the step after the end of a game resets it
    and ignores its action. ``SameStep``: the step that ends a game resets it, and ``info`` has ``final_obs`` and
    ``final_info``. ``Disabled``: ``reset(options={"reset_mask": mask})`` resets games, ``(B,)`` bool.

    Raises:
        ArgumentError: an argument has the wrong type or is out of range.
    """

    single_env: ClassVar[type[UsnetEnv]]

    def __init__(self, num_envs: int = 1, *, autoreset_mode: Any = AutoresetMode.NEXT_STEP, **arguments: Any) -> None:
        self.num_envs, self.autoreset_mode = check_batch(num_envs, autoreset_mode)
        single = self.single_env(**arguments)
        self.metadata = {**single.metadata, "autoreset_mode": self.autoreset_mode}
        self.config, self.rules, self.reveal_truth = single.config, single.rules, single.reveal_truth
        self.observe, self.render_mode = single.observe, single.render_mode
        self.single_observation_space = single.observation_space
        self.single_action_space = single.action_space
        self.observation_space = batch_space(single.observation_space, self.num_envs)
        self.action_space = batch_space(single.action_space, self.num_envs)
        self._draws, self._configs = single._draws, [single.config] * self.num_envs
        self._singles = [copy.copy(single) for _ in range(self.num_envs)]
        self._rngs: list[np.random.Generator] = []
        self._seeds: list[int] = []
        self._game: game.GameState | None = None
        self._window: Observation = {}

    @property
    def swarm(self) -> SwarmState:
        """A copy of the true state of the B swarms, for evaluation; a detector must not use it."""
        return SwarmState(**game.require_game(self._game).swarm.arrays())

    @property  # type: ignore[misc]  # Gymnasium's can be set
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]  # as in SyncVectorEnv
        """The generator of each game."""
        renew_generators(self._rngs, self._seeds, [None] * self.num_envs, np.arange(0))
        return tuple(self._rngs)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]  # as in SyncVectorEnv
        """The seed of the generator of each game."""
        renew_generators(self._rngs, self._seeds, [None] * self.num_envs, np.arange(0))
        return tuple(self._seeds)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start B games and observe their first windows.

        Args:
            seed: game b is seeded with ``seed + b``, or with element b of a sequence; ``None`` keeps the present
                generators.
            options: ``reset_mask``, the games to start, ``(B,)`` bool; a game is changed by the arguments.

        Raises:
            ArgumentError: another number of seeds than B, a seed that is not a whole number from 0, or other options.
        """
        rest = dict(options or {})
        mask = np.asarray(rest.pop("reset_mask", np.ones(self.num_envs, bool)))
        game.check_options(rest)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise ArgumentError(f"reset_mask must be {self.num_envs} booleans, at least one true, got {quote(mask)}.")
        chosen = np.flatnonzero(mask)
        renew_generators(self._rngs, self._seeds, parse_seeds(seed, self.num_envs), chosen)
        rngs = [self._rngs[b] for b in chosen]
        begun = self._start(chosen)
        metrics = game.initial_info(self.rules, begun)
        begun, window = game.observe_windows([self._configs[b] for b in chosen], begun, rngs)
        if len(chosen) < self.num_envs:
            infos = self._infos(metrics, begun.swarm, chosen)
            begun = game.require_game(self._game).with_rows(chosen, begun)
            for name, values in window.items():
                self._window[name][chosen] = values
            window = self._window
        else:
            infos = self._infos(metrics, begun.swarm)
        self._game = begun
        return self._show(window, chosen), infos

    def _start(self, chosen: Indices) -> game.GameState:
        """Draw and start some games."""
        for b in chosen:
            self._configs[b] = self._draws.draw(self._rngs[b])
        return game.start_games([self._configs[b] for b in chosen], [self._rngs[b] for b in chosen])

    def step(self, actions: Any) -> tuple[Observation, Floats, Mask, Mask, dict[str, Any]]:
        """Play one round of every running game, with candidates ``(B, N)`` of 0 and 1; see the class on resets.

        Raises:
            ArgumentError: actions of another shape or with other values, no call of :meth:`reset` before, or a game
                that is over while ``autoreset_mode`` is ``Disabled``.
        """
        before = game.require_game(self._game)
        candidates = game.parse_candidates(actions, (self.num_envs, self.config.uavs))
        over = before.terminated | before.truncated
        if self.autoreset_mode is AutoresetMode.DISABLED:
            game.require_game(None if over.any() else before)
        state, reward, metrics = game.play_round(self.rules, before, candidates & ~over[:, None])
        played, final = (before, candidates, dict(metrics)), {}
        terminated, truncated = state.terminated & ~over, state.truncated & ~over
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            over = terminated | truncated
            final = self._finish(state, metrics, np.flatnonzero(over))
        else:
            reward[over] = 0.0
        ended = np.flatnonzero(over)
        if len(ended):
            begun = self._start(ended)
            state = begun if len(ended) == self.num_envs else state.with_rows(ended, begun)
            metrics = {name: np.where(over, np.zeros_like(values), values) for name, values in metrics.items()}
        self._game, window = game.observe_windows(self._configs, state, self._rngs)
        shown = self._show(window, ended, played)
        return shown, reward, terminated, truncated, self._infos(metrics, self._game.swarm) | final

    def _finish(self, state: game.GameState, metrics: dict[str, NDArray[Any]], ended: Indices) -> dict[str, Any]:
        """``final_obs`` and ``final_info`` of the games that ended in this step."""
        if not len(ended):
            return {}
        configs, rngs = ([each[b] for b in ended] for each in (self._configs, self._rngs))
        last, window = game.observe_windows(configs, state if len(ended) == self.num_envs else state.rows(ended), rngs)
        mask, observations = np.zeros(self.num_envs, bool), np.full(self.num_envs, None)
        mask[ended] = True
        for b, *parts in zip(ended, *(window[name] for name in self.observe), strict=True):
            observations[b] = dict(zip(self.observe, parts, strict=True))
        infos = self._infos({name: values[ended] for name, values in metrics.items()}, last.swarm, ended)
        return {"final_obs": observations, "_final_obs": mask, "final_info": infos, "_final_info": mask.copy()}

    def _infos(
        self, metrics: dict[str, NDArray[Any]], swarm: SwarmState, games: Indices | None = None
    ) -> dict[str, Any]:
        """One array per key, and the mask ``_key`` of the games that have it: all, or those given."""
        values = metrics | (game.truth_info(swarm) if self.reveal_truth else {})
        if self.reveal_truth and self._draws.names:
            drawn = [self._draws.reveal(self._configs[b]) for b in (range(self.num_envs) if games is None else games)]
            values |= {name: _make_array([each[name] for each in drawn]) for name in self._draws.names}
        mask = np.full(self.num_envs, games is None)
        if games is not None:
            mask[games] = True
            spread = {name: np.zeros((self.num_envs, *part.shape[1:]), part.dtype) for name, part in values.items()}
            for name, part in values.items():
                if part.dtype == object:
                    spread[name][:] = None
                spread[name][games] = part
            values = spread
        return {name: part.copy() for name, part in values.items()} | {f"_{name}": mask.copy() for name in values}

    def _show(
        self, window: Observation, begun: Indices, played: tuple[game.GameState, Mask, dict[str, Any]] | None = None
    ) -> Observation:
        """Keep the present windows and, for pictures, the last round; return copies of what is observed."""
        earlier, self._window = self._window, window
        for b, env in enumerate(self._singles if self.render_mode is not None else ()):
            last = None
            if played is not None and b not in begun:
                before, candidates, metrics = played
                title = game.title_round({name: value[b].item() for name, value in metrics.items()})
                last = (
                    {name: values[b] for name, values in earlier.items()},
                    before.swarm.rows(slice(b, b + 1)),
                    candidates[b],
                    title,
                )
            if played is not None or b in begun:
                env.show_round({name: values[b] for name, values in window.items()}, last)
        return {name: window[name].copy() for name in self.observe}

    @property
    def games(self) -> list[UsnetEnv]:
        """The games as they stand, as single environments that share the generators; to look at, not to play."""
        for b, env in enumerate(self._singles):
            if self._game is not None:
                window = {name: values[b].copy() for name, values in self._window.items()}
                env.place(self._configs[b], self._game.rows(np.array([b])), window, self._rngs[b], self._seeds[b])
        return self._singles

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """The attribute of each game, or what the method of each game returns, as of single environments."""
        found = [getattr(env, name) for env in self.games]
        return tuple(one(*args, **kwargs) if callable(one) else one for one in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """The attribute of each game."""
        return tuple(getattr(env, name) for env in self.games)

    def set_attr(self, name: str, values: Any, games: Iterable[int] | None = None) -> None:
        """Set an attribute of each game, or of some, from a list or tuple of B values or from one value.

        Raises:
            ArgumentError: all games of a batch share the attribute.
        """
        if hasattr(self, name):
            raise ArgumentError(f"name must be no attribute that the games of a batch share, got {quote(name)}.")
        for b in range(self.num_envs) if games is None else games:
            setattr(self._singles[b], name, values[b] if isinstance(values, list | tuple) else values)

    def get_state(self) -> list[dict[str, Any]]:
        """The state of each game, as of a single environment."""
        return [env.get_state() for env in self.games]

    def set_state(self, states: Sequence[dict[str, Any]]) -> Observation:
        """Restore states from :meth:`get_state`, or of single environments with these arguments.

        Raises:
            ArgumentError: a state is of an environment with other arguments.
        """
        for env, state in zip(self.games, states, strict=True):
            env.set_state(state)
        self._configs = [env.config for env in self._singles]
        self._game = game.GameState.join([game.require_game(env._game) for env in self._singles])
        windows = [env._window for env in self._singles]
        self._window = {name: np.stack([window[name] for window in windows]) for name in windows[0]}
        return {name: self._window[name].copy() for name in self.observe}

    def render(self) -> tuple[Any, ...] | None:
        """The picture of each game; see :meth:`UsnetEnv.render`."""
        return self.call("render") if self.render_mode is not None else None

    def action_masks(self) -> Mask:
        """``(B, 2 N)`` bool, the masks of :meth:`UsnetEnv.action_masks` of each game."""
        alive = game.require_game(self._game).swarm.alive
        return np.stack([np.ones_like(alive), alive], axis=2).reshape(self.num_envs, -1)


def _make_array(values: list[Any]) -> NDArray[Any]:
    """One value of each game, names as objects."""
    return np.array(values, object if isinstance(values[0], str) else None)


class SingleClusterVectorEnv(UsnetVectorEnv):
    """B games of :class:`SingleClusterEnv`; see ``gym.make_vec("usnet_env:USNET/SingleCluster-v0", num_envs=B)``."""

    single_env = SingleClusterEnv


class MultiClusterVectorEnv(UsnetVectorEnv):
    """B games of :class:`MultiClusterEnv`; see ``gym.make_vec("usnet_env:USNET/MultiCluster-v0", num_envs=B)``."""

    single_env = MultiClusterEnv

"""The vector environments: B games in one batch, equal to B single environments with the same seeds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from usnet_env.arrays import Floats, Indices, Mask, Observation
from usnet_env.config import ArgumentError, quote, unknown_name
from usnet_env.envs import game
from usnet_env.envs.usnet import MultiClusterEnv, SingleClusterEnv, UsnetEnv
from usnet_env.swarm import SwarmState


class UsnetVectorEnv(SyncVectorEnv):
    """``num_envs`` games that are simulated in one batch, with the arguments of the single environment.

    ``autoreset_mode`` is Gymnasium's, or its value as text. ``NextStep``: the step after the end of a game resets it
    and ignores its action. ``SameStep``: the step that ends a game resets it, and ``info`` has ``final_obs`` and
    ``final_info``. ``Disabled``: ``reset(options={"reset_mask": mask})`` resets games, ``(B,)`` bool.

    Raises:
        ArgumentError: an argument has the wrong type or is out of range.
    """

    single_env: ClassVar[type[UsnetEnv]]

    def __init__(self, num_envs: int = 1, *, autoreset_mode: Any = AutoresetMode.NEXT_STEP, **arguments: Any) -> None:
        modes = {mode.value: mode for mode in AutoresetMode}
        if (mode := getattr(autoreset_mode, "value", autoreset_mode)) not in modes:
            raise unknown_name("autoreset_mode", mode, modes)
        single = self.single_env(**arguments)
        self.config, self.rules, self.reveal_truth = single.widest_config, single.rules, single.reveal_truth
        self.observe, self._sampler, self._games = single.observe, single._sampler, single._make_games(num_envs)
        views = [partial(single._view_game, self._games, b) for b in range(num_envs)]
        super().__init__(views, autoreset_mode=modes[mode])

    @property
    def games(self) -> Sequence[UsnetEnv]:
        """The games as single environments."""
        return self.envs  # type: ignore[return-value]  # the views

    @property
    def swarm(self) -> SwarmState:
        """A copy of the true state of the B swarms, for evaluation; a detector must not use it."""
        return self._games.reveal()

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
        remaining_options = dict(options or {})
        mask = remaining_options.pop("reset_mask", None)
        game.check_options(remaining_options)
        chosen = self._games.begin(seed, mask, "reset_mask")
        self._games.fly(chosen)
        return self._games.observe(self.observe), self._infos(chosen)

    def step(self, actions: Any) -> tuple[Observation, Floats, Mask, Mask, dict[str, Any]]:
        """Play one round of every running game, with actions of :attr:`action_space`; see the class on resets.

        Raises:
            ArgumentError: actions of another shape or with other values, no call of :meth:`reset` before, or a game
                that is over while ``autoreset_mode`` is ``Disabled``.
        """
        games, old_state, mode = self._games, self._games.game, self.autoreset_mode
        parsed = games.parse_action(actions, (self.num_envs,))
        if mode is AutoresetMode.DISABLED:
            games.require_running()
        is_over = old_state.terminated | old_state.truncated
        reward = np.zeros(self.num_envs) if is_over.all() else games.play_round(parsed, ~is_over)
        final: dict[str, Any] = {}
        terminated, truncated = games.game.terminated & ~is_over, games.game.truncated & ~is_over
        if mode is AutoresetMode.SAME_STEP:
            is_over = terminated | truncated
        if len(ended := np.flatnonzero(is_over)):
            if mode is AutoresetMode.SAME_STEP:
                final = self._finish(ended)
            games.start(ended)
        games.fly(games.all_games)
        return games.observe(self.observe), reward, terminated, truncated, self._infos(games.all_games) | final

    def _finish(self, ended: Indices) -> dict[str, Any]:
        """``final_obs`` and ``final_info`` of the games that ended in this step."""
        self._games.fly(ended)
        mask, observations = np.isin(self._games.all_games, ended), np.full(self.num_envs, None)
        for b, *parts in zip(ended, *self._games.observe(self.observe, ended).values(), strict=True):
            observations[b] = dict(zip(self.observe, parts, strict=True))
        infos = self._infos(ended)
        return {"final_obs": observations, "_final_obs": mask, "final_info": infos, "_final_info": mask.copy()}

    def _infos(self, games: Indices) -> dict[str, Any]:
        """One array per key, and the mask ``_key`` of the games that have it; the others have 0 or ``None``."""
        values = dict(self._games.metrics)
        if self.reveal_truth:
            values |= game.truth_info(self._games.game.swarm)
            drawn = [self._sampler.drawn_values(config) for config in self._games.configs]
            for name in self._sampler.names:
                dtype = object if isinstance(drawn[0][name], str) else None
                values[name] = np.array([game_values[name] for game_values in drawn], dtype)
        is_other = ~np.isin(self._games.all_games, games)
        infos = {name: array.copy() for name, array in values.items()}
        for array in infos.values() if is_other.any() else ():
            array[is_other] = None if array.dtype == object else 0
        return infos | {f"_{name}": ~is_other for name in values}

    def set_attr(self, name: str, values: Any, games: Iterable[int] | None = None) -> None:
        """Set an attribute of each game, or of some, from a list or tuple of B values or from one value.

        Raises:
            ArgumentError: all games of a batch share the attribute.
        """
        if hasattr(self, name):
            raise ArgumentError(f"name must be no attribute that the games of a batch share, got {quote(name)}.")
        for b in range(self.num_envs) if games is None else games:
            setattr(self.envs[b], name, values[b] if isinstance(values, list | tuple) else values)

    def get_state(self) -> list[dict[str, Any]]:
        """The state of each game, as of a single environment."""
        return list(self.call("get_state"))

    def set_state(self, states: Sequence[dict[str, Any]]) -> Observation:
        """Restore states from :meth:`get_state`, or of single environments with these arguments.

        Raises:
            ArgumentError: a state is of an environment with other arguments.
        """
        if not self._games.metrics:  # a game of a batch can't be replaced before it has begun
            self.reset()
        for env, state in zip(self.games, states, strict=True):
            env.set_state(state)
        return self._games.observe(self.observe)

    def render(self) -> tuple[Any, ...] | None:  # type: ignore[override]  # as in VectorEnv
        """The picture of each game; see :meth:`UsnetEnv.render`."""
        return self.call("render") if self.render_mode is not None else None

    def action_masks(self) -> Mask:
        """``(B, 2 N)`` bool, the masks of :meth:`UsnetEnv.action_masks` of each game."""
        return self._games.action_masks()


class SingleClusterVectorEnv(UsnetVectorEnv):
    """B games of :class:`SingleClusterEnv`; see ``gym.make_vec("usnet_env:USNET/SingleCluster-v0", num_envs=B)``."""

    single_env = SingleClusterEnv


class MultiClusterVectorEnv(UsnetVectorEnv):
    """B games of :class:`MultiClusterEnv`; see ``gym.make_vec("usnet_env:USNET/MultiCluster-v0", num_envs=B)``."""

    single_env = MultiClusterEnv

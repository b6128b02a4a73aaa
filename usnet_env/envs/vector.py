"""The vector environments: B games in one batch, equal to B single environments with the same seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Mask, Observation
from usnet_env.config import ArgumentError, optional_seed, whole_number
from usnet_env.envs import game
from usnet_env.envs.usnet import MultiClusterEnv, SingleClusterEnv, UsnetEnv
from usnet_env.swarm import SwarmState


def check_batch(num_envs: Any, arguments: Mapping[str, Any]) -> int:
    """The number of games, if the arguments are those of a vector environment."""
    if arguments.get("render_mode") is not None:
        raise ArgumentError("render_mode must be None for a vector environment; use a single environment to render.")
    return whole_number("num_envs", num_envs, 1, 1_000_000)


class UsnetVectorEnv(VectorEnv[Observation, NDArray[np.int8], NDArray[Any]]):
    """``num_envs`` games in one batch, with the arguments of the single environment except ``render_mode``.

    The step after the end of a game resets this game and ignores its action (``AutoresetMode.NEXT_STEP``, Gymnasium's
    default).

    Raises:
        ArgumentError: an argument has the wrong type or is out of range.
    """

    metadata: ClassVar[dict[str, Any]] = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # type: ignore[misc]  # Gymnasium's is no ClassVar
    single_env: ClassVar[type[UsnetEnv]]

    def __init__(self, num_envs: int = 1, **arguments: Any) -> None:
        self.num_envs = check_batch(num_envs, arguments)
        single = self.single_env(**arguments)
        self.config, self.rules, self.reveal_truth = single.config, single.rules, single.reveal_truth
        self.single_observation_space = single.observation_space
        self.single_action_space = single.action_space
        self.observation_space = batch_space(single.observation_space, self.num_envs)
        self.action_space = batch_space(single.action_space, self.num_envs)
        self._rngs: list[np.random.Generator] = []
        self._game: game.GameState | None = None

    @property
    def swarm(self) -> SwarmState:
        """A copy of the true state of the B swarms, for evaluation; a detector must not use it."""
        return SwarmState(**game.require_game(self._game).swarm.arrays())

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start B games and observe their first windows.

        Args:
            seed: game b is seeded with ``seed + b``, or with element b of a sequence; ``None`` keeps the present
                generators.
            options: none; a game is changed by the arguments of the environment.

        Raises:
            ArgumentError: another number of seeds than B, a seed that is not a whole number from 0, or options.
        """
        game.check_options(options)
        seeds = self._seeds(seed)
        fresh = not self._rngs
        self._rngs = [
            seeding.np_random(one)[0] if fresh or one is not None else self._rngs[b] for b, one in enumerate(seeds)
        ]
        state = game.start_games(self.config, self._rngs)
        metrics = game.initial_info(self.rules, state)
        self._game, observation = game.observe_windows(self.config, state, self._rngs)
        return observation, self._infos(metrics)

    def _seeds(self, seed: Any) -> list[int | None]:
        """One seed for each game."""
        if np.ndim(seed) == 0:
            first = optional_seed("seed", seed)
            return [None if first is None else first + b for b in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ArgumentError(f"seed must hold one seed for each of {self.num_envs} envs, got {len(seed)}.")
        return [optional_seed("seed", one) for one in seed]

    def step(self, actions: Any) -> tuple[Observation, Floats, Mask, Mask, dict[str, Any]]:
        """Play one round of every running game, with candidates ``(B, N)`` of 0 and 1; a game that had ended is reset.

        Raises:
            ArgumentError: actions of another shape or with other values, or no call of :meth:`reset` before.
        """
        before = game.require_game(self._game)
        candidates = game.parse_candidates(actions, (self.num_envs, self.config.uavs))
        over = before.terminated | before.truncated
        state, reward, metrics = game.play_round(self.rules, before, candidates & ~over[:, None])
        if over.any():
            ended = np.flatnonzero(over)
            begun = game.start_games(self.config, [self._rngs[b] for b in ended])
            state = state.with_rows(ended, begun)
            reward[ended] = 0.0
            for name, values in game.initial_info(self.rules, begun).items():
                metrics[name][ended] = values
        self._game, observation = game.observe_windows(self.config, state, self._rngs)
        return observation, reward, state.terminated.copy(), state.truncated.copy(), self._infos(metrics)

    def _infos(self, metrics: dict[str, NDArray[Any]]) -> dict[str, Any]:
        """One array per key, and the mask ``_key`` of the games that have it."""
        values = metrics | (game.truth_info(self.swarm) if self.reveal_truth else {})
        return values | {f"_{name}": np.ones(self.num_envs, bool) for name in values}

    def action_masks(self) -> Mask:
        """``(B, 2 N)`` bool, the masks of :meth:`UsnetEnv.action_masks` of each game."""
        alive = game.require_game(self._game).swarm.alive
        return np.stack([np.ones_like(alive), alive], axis=2).reshape(self.num_envs, -1)


class SingleClusterVectorEnv(UsnetVectorEnv):
    """B games of :class:`SingleClusterEnv`; see ``gym.make_vec("usnet_env:USNET/SingleCluster-v0", num_envs=B)``."""

    single_env = SingleClusterEnv


class MultiClusterVectorEnv(UsnetVectorEnv):
    """B games of :class:`MultiClusterEnv`; see ``gym.make_vec("usnet_env:USNET/MultiCluster-v0", num_envs=B)``."""

    single_env = MultiClusterEnv

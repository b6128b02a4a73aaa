"""The batch of games as a ``VecEnv`` of Stable-Baselines3 (extra ``rl``)."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any, cast

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from usnet_env.arrays import Floats, Mask, Observation


class SwarmVecEnv(VecEnv):
    """``num_envs`` games of one environment, simulated in one batch.

    The ``info`` of a game that ended holds its metrics, ``episode``, ``terminal_observation`` and
    ``TimeLimit.truncated``; that of another game is empty. MaskablePPO finds ``action_masks``.

    Args:
        id: id of the environment, ``USNET/SingleCluster-v0`` or another one; of probing with ``actions="flat"``.
        num_envs: B, number of games.
        arguments: the arguments of the environment; ``observe=("velocity", "alive")`` keeps buffers small.
    """

    def __init__(self, id: str, num_envs: int, **arguments: Any) -> None:
        self.envs = cast(Any, gym.make_vec(id, num_envs, autoreset_mode="SameStep", **arguments).unwrapped)
        self._began, self._return, self._length = time.time(), np.zeros(num_envs), np.zeros(num_envs, np.int64)
        super().__init__(num_envs, self.envs.single_observation_space, self.envs.single_action_space)

    def reset(self) -> Observation:
        """Start all games, with the seeds of :meth:`seed` if it was called since the last reset."""
        observation, _ = self.envs.reset(seed=self._seeds)
        self._reset_seeds()
        self._return[:] = self._length[:] = 0
        return observation

    def step_async(self, actions: Any) -> None:
        """Keep the actions of all games for :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Observation, Floats, Mask, list[dict[str, Any]]]:
        """Step all B games; one that ends begins again. Rewards and whether games ended are ``(B,)``."""
        observation, reward, terminated, truncated, info = self.envs.step(self._actions)
        self._return += reward
        self._length += 1
        done, infos = terminated | truncated, [dict[str, Any]() for _ in range(self.num_envs)]
        elapsed, ended = time.time() - self._began, np.flatnonzero(done)
        for b in ended:
            metrics = {name: values[b] for name, values in info["final_info"].items() if name[0] != "_"}
            episode = {"r": self._return[b], "l": self._length[b], "t": elapsed}
            ending = {"terminal_observation": info["final_obs"][b], "TimeLimit.truncated": bool(truncated[b])}
            infos[b] = {**metrics, **ending, "episode": episode}
        self._return[ended] = self._length[ended] = 0
        return observation, reward.astype(np.float32), done, infos

    def close(self) -> None:
        """Close the games."""
        self.envs.close()

    def get_images(self) -> list[Any]:
        """The picture of each game."""
        return list(self.envs.render() or [None] * self.num_envs)

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute of some games."""
        if indices is None:  # any batch of Gymnasium can tell
            return list(self.envs.get_attr(attr_name))
        games = self.envs.games
        return [getattr(games[b], attr_name) for b in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of some games; the batch refuses one that all games share."""
        self.envs.set_attr(attr_name, [value] * self.num_envs, self._get_indices(indices))

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """What a method of some games returns."""
        if method_name == "action_masks":  # in every step of MaskablePPO
            masks = self.envs.action_masks()
            return [masks[b] for b in self._get_indices(indices)]
        return [method(*args, **kwargs) for method in self.get_attr(method_name, self._get_indices(indices))]

    def env_is_wrapped(self, wrapper_class: Any, indices: int | Iterable[int] | None = None) -> list[bool]:
        """No game is wrapped."""
        return [False for _ in self._get_indices(indices)]

"""The batches of games as ``EnvBase`` of TorchRL (extra ``torchrl``)."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any, cast

import gymnasium as gym
import numpy as np
import torch
from gymnasium.spaces.utils import flatdim
from numpy.typing import NDArray
from tensordict import TensorDict
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from usnet_env.arrays import Indices, Mask
from usnet_env.config import unknown_name
from usnet_env.envs.wrappers import number_actions


class _Batch(EnvBase):  # type: ignore[misc]  # TorchRL is an extra
    """``num_envs`` games that are seeded together and restarted one by one."""

    def __init__(self, num_envs: int) -> None:
        super().__init__(batch_size=torch.Size([num_envs]), device="cpu")
        flags = {name: Binary(1, shape=(num_envs, 1), dtype=torch.bool) for name in ("done", "terminated", "truncated")}
        self.done_spec = Composite(flags, shape=self.batch_size)
        self._next_seed: int | None = None  # the seed of the next reset

    def _reset(self, tensordict: TensorDict | None = None, **_: Any) -> TensorDict:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        observation = self._begin(self._next_seed, None if mask is None else mask.reshape(-1).numpy())
        self._next_seed = None
        return self._pack(observation, np.zeros(self.batch_size, bool), np.zeros(self.batch_size, bool))

    def _begin(self, seed: int | None, games: Mask | None) -> dict[str, Any]:
        """Start games, and return the observations of all."""
        raise NotImplementedError

    def _pack(self, parts: dict[str, Any], terminated: Mask, truncated: Mask) -> TensorDict:
        flags = {"terminated": terminated, "truncated": truncated, "done": terminated | truncated}
        packed = TensorDict({name: torch.from_numpy(array)[:, None] for name, array in flags.items()}, self.batch_size)
        for name, part in parts.items():
            if isinstance(part, dict):  # a group of agents
                shape = self.observation_spec[name].shape
                packed[name] = TensorDict({key: torch.from_numpy(array) for key, array in part.items()}, shape)
            else:
                packed[name] = torch.from_numpy(part)
        return packed

    def _set_seed(self, seed: int | None) -> None:
        self._next_seed = seed


class SwarmEnv(_Batch):
    """``num_envs`` games of one environment, simulated in one batch; ``batch_size`` is ``(B,)``.

    The entry ``action`` holds candidates ``(B, N)``; of probing it is flat, or there are ``steer`` and ``name``.
    All arrays of an observation are entries of the same name.

    Args:
        id: id of the environment, ``USNET/SingleCluster-v0`` or another one.
        num_envs: B, number of games.
        arguments: the arguments of the environment; ``observe=("velocity", "alive")`` keeps buffers small.
    """

    def __init__(self, id: str, num_envs: int, **arguments: Any) -> None:
        super().__init__(num_envs)
        self.envs = cast(Any, gym.make_vec(id, num_envs, autoreset_mode="Disabled", **arguments).unwrapped)
        parts = {name: _make_spec(space) for name, space in self.envs.observation_space.items()}
        self.observation_spec = Composite(parts, shape=self.batch_size)
        self.action_spec = _make_action_spec(self.envs.single_action_space, num_envs)
        self.reward_spec = Unbounded((num_envs, 1), dtype=torch.float32)

    def _begin(self, seed: int | None, games: Mask | None) -> dict[str, Any]:
        return self.envs.reset(seed=seed, options=None if games is None else {"reset_mask": games})[0]

    def _step(self, tensordict: TensorDict) -> TensorDict:
        actions = {name: tensordict[name].numpy() for name in self.action_keys}
        observation, reward, terminated, truncated, _ = self.envs.step(actions.get("action", actions))
        return self._pack(observation | {"reward": reward.astype(np.float32)[:, None]}, terminated, truncated)


class GamesEnv(_Batch):
    """``num_envs`` games of several agents in one batch, with flat observations and a number as action of an agent.

    Each role is a group of n agents, which keep their rows until their game is over. Its entries are ``observation``
    ``(B, n, F)``, ``action`` ``(B, n)``, ``action_mask`` ``(B, n, A)``, ``active`` ``(B, n, 1)``, which agents play,
    and ``reward`` ``(B, n, 1)``. An observer names one UAV by its index, or none by N, and doesn't fly. The choices of
    a head are numbered together, the last one varying fastest. ``state`` ``(B, S)`` is Markov, for critics.

    Args:
        game: ``usnet_observers_v0`` or ``usnet_evasion_v0``.
        num_envs: B, number of games.
        observe: the arrays in the flat observations, such as ``("velocity", "alive")``; ``None``: all.
        arguments: the arguments of the game.

    Raises:
        ArgumentError: no role has an array of this name.
    """

    def __init__(self, game: str, num_envs: int, observe: Sequence[str] | None = None, **arguments: Any) -> None:
        super().__init__(num_envs)
        make = importlib.import_module(f"usnet_env.multiagent.{game}").batch_env
        self.games, single = make(num_envs, **arguments), make(1, **arguments)
        single.reset(seed=0)
        names = {name for space in self.games.observation_spaces.values() for name in space}
        if unknown := set(observe or ()) - names:
            raise unknown_name("observe", unknown.pop(), names)
        observation = Composite(state=Unbounded((num_envs, single.state().shape[1])), shape=self.batch_size)
        action, reward = Composite(shape=self.batch_size), Composite(shape=self.batch_size)
        self._numbered: dict[str, tuple[NDArray[Any], Indices]] = {}
        self._observed: dict[str, Indices] = {}  # the numbers of a flat observation that are observed
        for role, count in self.games.roles.items():
            space, seen = self.games.action_spaces[role], self.games.observation_spaces[role]
            self._numbered[role] = number_actions(space, flatdim(seen["legal"]))
            is_observed = [np.full(flatdim(part), observe is None or name in observe) for name, part in seen.items()]
            self._observed[role] = np.flatnonzero(np.concatenate(is_observed))
            number, shape = len(self._numbered[role][0]), (num_envs, count)
            parts = {
                "observation": Unbounded((*shape, len(self._observed[role]))),
                "action_mask": Binary(number, shape=(*shape, number), dtype=torch.bool),
                "active": Binary(1, shape=(*shape, 1), dtype=torch.bool),
            }
            observation[role] = Composite(parts, shape=shape)
            action[role] = Composite(action=Categorical(number, shape=shape), shape=shape)
            reward[role] = Composite(reward=Unbounded((*shape, 1)), shape=shape)
        self.observation_spec, self.action_spec, self.reward_spec = observation, action, reward

    def _begin(self, seed: int | None, games: Mask | None) -> dict[str, Any]:
        return self._describe(self.games.reset(seed=seed, games=games)[0])

    def _step(self, tensordict: TensorDict) -> TensorDict:
        actions = {role: table[tensordict[role, "action"].numpy()] for role, (table, _) in self._numbered.items()}
        seen, rewards, *ends, _ = self.games.step(actions)
        parts = self._describe(seen)
        for role, reward in rewards.items():
            parts[role]["reward"] = reward.astype(np.float32)[..., None]
        return self._pack(parts, *(end["observer"].any(axis=1) for end in ends))

    def _describe(self, seen: dict[str, Any]) -> dict[str, Any]:
        parts: dict[str, Any] = {"state": self.games.state()}
        for role, flat in self.games.flatten(seen).items():
            legal = np.pad(seen[role]["legal"].astype(bool), ((0, 0), (0, 0), (0, 1)), constant_values=True)
            mask, active = legal[..., self._numbered[role][1]].all(axis=-1), self.games.active[role]
            flat, active = flat[..., self._observed[role]], active[..., None].copy()
            parts[role] = {"observation": flat, "action_mask": mask, "active": active}
        return parts


def _make_spec(space: Any) -> Unbounded:
    return Unbounded(space.shape, dtype=torch.from_numpy(np.zeros(0, space.dtype)).dtype)


def _make_action_spec(space: Any, num_envs: int) -> Any:
    if isinstance(space, gym.spaces.Dict):
        parts = {name: _make_action_spec(part, num_envs) for name, part in space.items()}
        return Composite(parts, shape=torch.Size([num_envs]))
    shape = (num_envs, *space.shape)
    if isinstance(space, gym.spaces.MultiBinary):
        return Binary(shape[1], shape=shape, dtype=torch.int8)
    return Categorical(space.n, shape=shape) if isinstance(space, gym.spaces.Discrete) else Bounded(-1, 1, shape)

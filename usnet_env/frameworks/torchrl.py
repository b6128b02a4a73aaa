"""The batch of games as an ``EnvBase`` of TorchRL (extra ``torchrl``)."""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase


class SwarmEnv(EnvBase):  # type: ignore[misc]  # TorchRL is an extra
    """``num_envs`` games of one environment, simulated in one batch; ``batch_size`` is ``(B,)``.

    The actions are candidates ``(B, N)``. All arrays of an observation are entries of the same name.

    Args:
        id: id of the environment, ``USNET/SingleCluster-v0`` or another one.
        num_envs: B, number of games.
        arguments: the arguments of the environment; ``observe=("velocity", "alive")`` keeps buffers small.
    """

    def __init__(self, id: str, num_envs: int, **arguments: Any) -> None:
        super().__init__(batch_size=torch.Size([num_envs]), device="cpu")
        self.envs = cast(Any, gym.make_vec(id, num_envs, autoreset_mode="Disabled", **arguments).unwrapped)
        parts = {name: _make_spec(space) for name, space in self.envs.observation_space.items()}
        self.observation_spec = Composite(parts, shape=self.batch_size)
        shape = self.envs.action_space.shape
        self.action_spec = Binary(shape[1], shape=shape, dtype=torch.int8)
        self.reward_spec = Unbounded((num_envs, 1), dtype=torch.float32)
        flags = {name: Binary(1, shape=(num_envs, 1), dtype=torch.bool) for name in ("done", "terminated", "truncated")}
        self.done_spec = Composite(flags, shape=self.batch_size)
        self._first: int | None = None  # the seed of the next reset

    def _reset(self, tensordict: TensorDict | None = None, **_: Any) -> TensorDict:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        options = None if mask is None else {"reset_mask": mask.reshape(-1).numpy()}
        observation, _ = self.envs.reset(seed=self._first, options=options)
        self._first = None
        return self._pack(observation, np.zeros(self.batch_size, bool), np.zeros(self.batch_size, bool))

    def _step(self, tensordict: TensorDict) -> TensorDict:
        observation, reward, terminated, truncated, _ = self.envs.step(tensordict["action"].numpy())
        packed = self._pack(observation, terminated, truncated)
        return packed.set("reward", torch.from_numpy(reward).float()[:, None])

    def _pack(self, observation: dict[str, Any], terminated: Any, truncated: Any) -> TensorDict:
        flags = {"terminated": terminated, "truncated": truncated, "done": terminated | truncated}
        parts = {name: torch.from_numpy(values) for name, values in observation.items()}
        parts |= {name: torch.from_numpy(values)[:, None] for name, values in flags.items()}
        return TensorDict(parts, batch_size=self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self._first = seed


def _make_spec(space: Any) -> Unbounded:
    return Unbounded(space.shape, dtype=torch.from_numpy(np.zeros(0, space.dtype)).dtype)

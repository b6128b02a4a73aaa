"""The networks as policies of Stable-Baselines3 (extra ``rl``)."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from detectors.rl.attention import AttentionNetwork
from detectors.rl.pair import PairNetwork


class _Answers(BaseFeaturesExtractor):
    """``(B, N + 1)``: the logits of the UAVs and the value."""

    def __init__(self, observation_space: spaces.Dict, kind: type[nn.Module], **sizes: int) -> None:
        uavs = spaces.utils.flatdim(observation_space["alive"])
        super().__init__(observation_space, features_dim=uavs + 1)
        self.network = kind(**sizes)

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        logits, value = self.network(observations["velocity"], observations["alive"])
        return torch.cat([logits, value[:, None]], dim=1)


class _Split(nn.Module):
    """Gives the actor the logits and the critic the value."""

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: Tensor) -> Tensor:
        return features[:, :-1]

    def forward_critic(self, features: Tensor) -> Tensor:
        return features[:, -1:]


class PairPolicy(ActorCriticPolicy):
    """:class:`PairNetwork` for PPO and A2C, with ``MultiBinary(N)`` actions and an observation with velocity and alive.

    Args:
        network: the arguments of the network, in ``policy_kwargs={"network": {...}}``.
    """

    kind: ClassVar[type[nn.Module]] = PairNetwork

    def __init__(self, *args: Any, network: dict[str, int] | None = None, **kwargs: Any) -> None:
        sizes = {"kind": self.kind, **(network or {})}
        kwargs |= {"features_extractor_class": _Answers, "features_extractor_kwargs": sizes}
        super().__init__(*args, **kwargs)

    def _build(self, lr_schedule: Any) -> None:
        parts: dict[str, Any] = {"mlp_extractor": _Split(), "action_net": nn.Identity(), "value_net": nn.Identity()}
        for name, part in parts.items():
            setattr(self, name, part)
        make_optimizer: Any = self.optimizer_class
        self.optimizer = make_optimizer(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


class AttentionPolicy(PairPolicy):
    """:class:`AttentionNetwork` in the place of :class:`PairNetwork`."""

    kind = AttentionNetwork

    def __init__(
        self, observation_space: spaces.Dict, *args: Any, network: dict[str, int] | None = None, **kwargs: Any
    ) -> None:
        steps = observation_space["velocity"].shape[0]  # type: ignore[index]  # it has a shape
        super().__init__(observation_space, *args, network={"steps": steps, **(network or {})}, **kwargs)

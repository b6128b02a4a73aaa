"""The field environment: in every episode another swarm, drawn from a documented distribution."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from pydantic import Field

from usnet_env.arrays import Mask
from usnet_env.config import Config, list_arguments, takes_arguments
from usnet_env.envs import game
from usnet_env.envs.usnet import INFO_P2, OBSERVATION, OutputArguments, UsnetEnv
from usnet_env.envs.vector import check_batch
from usnet_env.swarm import FollowStrategy, Kinematics, Mobility, SwarmConfig
from usnet_env.swarm.config import Burst, Count, Few, Metres, Rate, Ratio, Share, Steps

Weights = Mapping[str, float]
_FOLLOW = {
    **dict.fromkeys(("unequal_delays", "mixed", "switching", "chain", "pigeons", "cucker_smale", "vicsek"), 1.0),
    **dict.fromkeys(("couzin", "frontness", "part_time", "partial_turns", "predator", "informed"), 1.0),
    **dict.fromkeys(("shepherd", "reference"), 0.5),  # swarms that no UAV leads
}
_MOBILITY = {"gauss_markov": 3.0, "smooth_turn": 2.0, "waypoint": 2.0, "local_waypoint": 2.0, "iid": 1.0}
_FORMATION = {"around": 3.0, "uniform": 1.0}


class FieldDistribution(Config):
    """The distribution of the swarms of ``USNET/Field-v0`` and ``USNET/Field-v1``. All draws are independent.

    ``follow``, ``mobility``, ``kinematics`` and ``formation`` have a weight for each name. The numbers are equally
    likely from the smallest to the largest. ``jitter`` is the probability of the head jitter. With the probability
    ``clean`` the sensor lacks a fault, each by itself; otherwise its size is uniform, or log-uniform for
    ``position_noise``. ``version`` increases when a draw changes.
    """

    version: int = 1
    follow: Weights = _FOLLOW
    mobility: Weights = _MOBILITY
    kinematics: Weights = dict.fromkeys(("unit", "varied_speed", "lagged", "limited", "layered"), 1.0)
    formation: Weights = _FORMATION
    clusters: tuple[int, int] = (2, 6)
    decoys: tuple[int, int] = (0, 2)
    bystanders: tuple[int, int] = (0, 6)
    traffic: tuple[int, int] = (0, 6)
    jitter: float = 0.5
    clean: float = 0.5
    position_noise: tuple[float, float] = (0.01, 0.1)
    miss_rate: tuple[float, float] = (0.01, 0.1)
    noise_memory: tuple[float, float] = (0.3, 0.9)
    miss_burst: tuple[float, float] = (2.0, 6.0)
    partial_tracks: tuple[float, float] = (0.05, 0.2)
    swap_rate: tuple[float, float] = (0.0002, 0.001)

    def draw(self, rng: np.random.Generator) -> dict[str, Any]:
        """Draw the arguments of one swarm. The order of the draws is part of the version."""
        drawn: dict[str, Any] = {}
        for name in ("follow", "mobility", "kinematics", "formation"):
            weights: Weights = getattr(self, name)
            share = np.array(list(weights.values()))
            drawn[name] = list(weights)[int(rng.choice(len(share), p=share / share.sum()))]
        for name in ("clusters", "decoys", "bystanders", "traffic"):
            drawn[name] = int(rng.integers(getattr(self, name)[0], getattr(self, name)[1] + 1))
        drawn["head_jitter"] = bool(rng.random() < self.jitter)
        for name in ("position_noise", "miss_rate", "noise_memory", "miss_burst", "partial_tracks", "swap_rate"):
            low, high = getattr(self, name)
            log = name == "position_noise"
            value = float(np.exp(rng.uniform(np.log(low), np.log(high)))) if log else float(rng.uniform(low, high))
            drawn[name] = value if rng.random() >= self.clean else 0.0
        return drawn

    @property
    def largest(self) -> dict[str, Any]:
        """The arguments of a swarm with the largest bounds, and the most UAVs beside followers."""
        return {
            **{name: getattr(self, name)[1] for name in ("clusters", "decoys", "bystanders", "traffic")},
            "follow": "unequal_delays",
            "kinematics": "varied_speed",
            "position_noise": self.position_noise[1],
            "swap_rate": self.swap_rate[1],
            "miss_burst": self.miss_burst[0],
        }


#: The distributions by version.
DISTRIBUTIONS = {1: FieldDistribution(), 2: FieldDistribution(version=2, formation={"gathered": 3.0, "uniform": 1.0})}


def _drawn(text: str) -> Any:
    return Field(None, description=f"{text}; ``None``: drawn")


class FieldArguments(OutputArguments, game.RoundArguments):
    """The arguments of :class:`FieldEnv`; what is ``None`` is drawn for each episode."""

    distribution: Literal[1, 2] = Field(1, description="version of the distribution")
    uavs: Count = Field(82, description="N, number of UAVs")
    observation_steps: Count = Field(100, description="T_ob, number of velocity samples in a window")
    sample_every: Steps = Field(1, description="the observer samples every k-th step")
    memory: Steps = Field(12, description="T_0, past steps that UAVs may use, and unobserved steps in a round")
    follow: str | FollowStrategy | None = _drawn("follow strategy")
    mobility: str | Mobility | None = _drawn("how heads and decoys move")
    kinematics: str | Kinematics | None = _drawn("how UAVs fly")
    formation: str | None = _drawn("initial positions")
    clusters: Count | None = _drawn("M, number of clusters")
    decoys: Few | None = _drawn("number of decoys")
    bystanders: Few | None = _drawn("number of UAVs that fly on their own")
    traffic: Few | None = _drawn("number of UAVs of civil traffic")
    head_jitter: bool | None = _drawn("noise of heads and decoys")
    position_noise: Metres | None = _drawn("standard deviation of the observed positions, m")
    miss_rate: Rate | None = _drawn("probability of a missed detection")
    noise_memory: Rate | None = _drawn("correlation of the noise from one instant to the next")
    miss_burst: Burst | None = _drawn("mean length of a burst of missed detections")
    partial_tracks: Share | None = _drawn("probability of a partial track")
    swap_rate: Share | None = _drawn("probability of an identity switch")
    clutter: Few = Field(0, description="number of false tracks, which begin and end in each window and are of no UAV")
    course_noise: Ratio = Field(1.0, description="position noise along the course of a UAV, in units of that across it")

    def make_config(self, drawn: dict[str, Any]) -> SwarmConfig:
        """The swarm with the given values where this config has ``None``."""
        return self.part(SwarmConfig, **{name: value for name, value in drawn.items() if getattr(self, name) is None})


@list_arguments(observation=OBSERVATION, info=INFO_P2)
class FieldEnv(UsnetEnv):
    """P2 in the field: find all heads; each episode has a different kind of swarm.

    ## Description
    The game is that of `USNET/MultiCluster-v0`. What flies is drawn for each episode: the follow strategy (one of the
    [field models](../field.md)), the mobility of the heads, the kinematics of all UAVs, the initial positions, the
    number of clusters, the decoys, bystanders and civil traffic, and the faults of the sensor.
    N and T_ob are fixed. The agent doesn't know what was drawn. In some episodes no UAV leads: H_0 is empty, the right
    answer is the empty set, and the game ends after one round.

    `usnet_env.envs.field.DISTRIBUTIONS` has the distributions by version; any part of it can be fixed by an argument.

    ## Action Space
    That of `USNET/MultiCluster-v0`.

    ## Observation Space
    {observation}

    The bounds are those of the fastest UAVs and the largest noise of the distribution.

    ## Rewards
    Those of `USNET/MultiCluster-v0`.

    {info}

    ## Starting State
    Drawn from the distribution. `config` is the swarm of the present episode, for evaluation only.

    ## Episode End
    The episode terminates when no head is left, and after the first round if no UAV leads. It is truncated after
    `max_rounds` rounds.

    ## Arguments
    {arguments}

    ## Version History
    * v1: distribution 2, in which the formation `gathered` takes the place of `around`
    * v0: first version, distribution 1
    """

    # With `rules`, these two identify a run; `config` doesn't, because it is drawn.
    widest_config: SwarmConfig  # the bounds of the observation are those of this swarm
    drawn_arguments: dict[str, Any]  # what can be drawn: None where it is, else the value that was given

    @takes_arguments(FieldArguments)
    def __init__(self, arguments: FieldArguments) -> None:
        self._arguments = arguments
        self._distribution = DISTRIBUTIONS[arguments.distribution]
        drawn = self._distribution.draw(np.random.default_rng(0))
        self.widest_config = arguments.make_config({**drawn, **self._distribution.largest})
        self.drawn_arguments = {name: getattr(arguments, name) for name in drawn}
        super().__init__(self.widest_config, arguments.part(game.Rules, problem="P2"), arguments)

    def _draw_config(self) -> SwarmConfig:
        """Draw the swarm of the next episode. All parts are drawn, so a fixed one doesn't change the others."""
        self.config = self._arguments.make_config(self._distribution.draw(self.np_random))
        return self.config

    def _settings(self) -> dict[str, Any]:
        return {"arguments": self._arguments.model_dump()}


class FieldVectorEnv(SyncVectorEnv):
    """B games of :class:`FieldEnv`, one after another; see ``gym.make_vec("usnet_env:USNET/Field-v1", num_envs=B)``."""

    def __init__(self, num_envs: int = 1, *, autoreset_mode: Any = AutoresetMode.NEXT_STEP, **arguments: Any) -> None:
        games, mode = check_batch(num_envs, autoreset_mode)
        super().__init__([lambda: FieldEnv(**arguments)] * games, autoreset_mode=mode)

    def action_masks(self) -> Mask:
        """``(B, 2 N)`` bool, the masks of :meth:`UsnetEnv.action_masks` of each game."""
        return np.stack(self.call("action_masks"))

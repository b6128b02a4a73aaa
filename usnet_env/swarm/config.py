"""The configuration of a simulated swarm and its observer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Self

from pydantic import Field, model_validator

from usnet_env.config import ArgumentError, Config, quote
from usnet_env.config import Count as Count  # for the other configurations
from usnet_env.swarm.follow import FOLLOW_STRATEGIES
from usnet_env.swarm.formation import FARTHEST, FORMATIONS
from usnet_env.swarm.kinematics import KINEMATICS, Kinematics
from usnet_env.swarm.mobility import MOBILITIES, Mobility
from usnet_env.swarm.strategy import FollowStrategy

SWAP_RANGE = 20.0  # metres, the largest distance of two UAVs that exchange their identities
NOISE_BOUND = 8.0  # observation noise is clipped at 8 standard deviations (one in 10^15 draws), so bounds are finite

# The bounds of arguments that several configurations have.
Few = Annotated[int, Field(ge=0, le=100_000)]
Sizes = Sequence[Annotated[int, Field(ge=2, le=100_000)]]
Steps = Annotated[int, Field(ge=1, le=1000)]
Metres = Annotated[float, Field(ge=0, le=1000)]
Ratio = Annotated[float, Field(ge=0, le=100)]
Burst = Annotated[float, Field(ge=0, le=10_000)]
Rate = Annotated[float, Field(ge=0, lt=1)]
Share = Annotated[float, Field(ge=0, le=1)]
Unseen = Annotated[int, Field(ge=0, le=8)]
Level = Annotated[int, Field(ge=1, le=8)]
Price = Annotated[float, Field(ge=0, le=1e6)]


class SwarmArguments(Config):
    """The arguments of the swarm that all environments and games take."""

    follow: str | FollowStrategy = Field(
        "f1", description='follow strategy: ``"f1"`` to ``"f7"``, a registered name, or ``"none"`` (no UAV follows)'
    )
    formation: str = Field(
        "uniform", description="initial positions: ``uniform`` in the arena, ``around`` heads, or ``gathered``"
    )
    memory: Steps = Field(
        4, description="T_0, past steps that a follow strategy may use, and unobserved ones in a round"
    )
    decoys: Few = Field(0, description="number of UAVs that move like heads but have no followers")
    follow_seed: Annotated[int, Field(ge=0, lt=2**63)] | None = Field(
        None, description="seed of what f7 and others draw for an episode; ``None``: each episode has its own"
    )
    observation_steps: Count = Field(100, description="T_ob, number of velocity samples in a window")
    sample_every: Steps = Field(1, description="the observer samples every k-th step")


class MobilityArguments(Config):
    """How heads and decoys move."""

    mobility: str | Mobility = Field("iid", description="how heads and decoys move: ``iid``, ``gauss_markov``, …")
    head_jitter: bool = Field(False, description="add the followers' noise κ_n n to heads and decoys")
    kinematics: str | Kinematics = Field("unit", description="how UAVs fly: ``unit`` (1 m per step), ``lagged``, …")
    led_by: Unseen | tuple[Level, Level] = Field(
        0,
        description="number of unseen UAVs above each head and decoy: a chain in which each follows the one before by "
        "the follow strategy, and the head or decoy the last one; ``(1, 4)``: drawn for each head and decoy",
    )


class BystanderArguments(Config):
    """UAVs that have nothing to do with the clusters."""

    bystanders: Few = Field(0, description="number of UAVs that fly on their own, with smooth turns")
    traffic: Few = Field(0, description="number of UAVs of civil traffic, in straight and level corridors")
    clutter: Few = Field(0, description="number of false tracks, which begin and end in each window and are of no UAV")


class SizeArguments(Config):
    """The size of a swarm with several clusters."""

    clusters: Count = Field(5, description="M, number of clusters")
    uavs: Count = Field(82, description="N, number of UAVs; decoys, bystanders, traffic and false tracks count")
    cluster_sizes: Sizes | None = Field(
        None, description="followers of each cluster, at least 2; ``None``: drawn for each episode"
    )


class SensorArguments(Config):
    """The sensor of a single observer."""

    position_noise: Metres = Field(0.0, description="standard deviation of the observed positions on each axis, m")
    miss_rate: Rate = Field(0.0, description="probability that a UAV is not detected at a sampling instant")
    noise_memory: Rate = Field(0.0, description="correlation of the position noise from one instant to the next")
    course_noise: Ratio = Field(1.0, description="position noise along the course of a UAV, in units of that across it")
    miss_burst: Burst = Field(0.0, description="mean number of missed detections in a row; 0: each by itself")
    partial_tracks: Share = Field(0.0, description="probability that a track begins late or ends early in a window")
    swap_rate: Share = Field(
        0.0, description="probability at an instant that a UAV exchanges its identity with the nearest within 20 m"
    )


class SwarmConfig(SensorArguments, SizeArguments, BystanderArguments, MobilityArguments, SwarmArguments):
    """A swarm of M clusters with N UAVs, and its observer. Lengths in metres, times in steps.

    Raises:
        ArgumentError: an argument has the wrong type or is out of range.

    >>> config = SwarmConfig(follow="pigeons", memory=12, clusters=2, uavs=12)
    >>> config.followers, config.follow_strategy.noise, config.kinematics_model.top_speed
    (10, 0.05, 1.0)
    """

    absent: Few = Field(0, description="how many of the N indices have no UAV, as in the smaller swarms of a batch")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        strategy, sizes, followers = self.follow_strategy, self.cluster_sizes, self.followers
        _ = self.head_mobility, self.kinematics_model, FORMATIONS.find(self.formation)  # an unknown name is refused
        if strategy is not None and strategy.lags > self.memory:
            raise ArgumentError(
                f"memory must be at least {strategy.lags} for follow={quote(self.follow)}, got {self.memory}."
            )
        if sizes is not None and (len(sizes) != self.clusters or sum(sizes) != followers):
            raise ArgumentError(
                f"cluster_sizes must hold {self.clusters} numbers with the sum uavs - clusters - decoys - bystanders "
                f"- traffic - clutter - absent = {followers}, got {quote(list(sizes))}."
            )
        if isinstance(self.led_by, tuple) and self.led_by[0] > self.led_by[1]:
            raise ArgumentError(f"led_by must go from a number to a larger one, got {list(self.led_by)}.")
        if followers < 2 * self.clusters:
            raise ArgumentError(
                f"uavs{' - absent' * bool(self.absent)} must be at least 3 * clusters + decoys + bystanders + traffic "
                f"+ clutter = {self.uavs - self.absent - followers + 2 * self.clusters} (every head has at least 2 "
                f"followers), got {self.uavs - self.absent}."
            )
        if 0 < self.miss_burst < max(1.0, odds := self.miss_rate / (1.0 - self.miss_rate)):
            raise ArgumentError(
                f"miss_burst must be 0, or at least 1 and miss_rate / (1 - miss_rate) = {odds:.3g}, "
                f"got {self.miss_burst:g}."
            )
        return self

    @property
    def steps(self) -> int:
        """Number of simulated steps in a round: ``memory`` unobserved steps, then the window."""
        return self.memory + self.observation_steps * self.sample_every

    @property
    def followers(self) -> int:
        """Number of followers of all clusters at the start."""
        unled = self.decoys + self.bystanders + self.traffic + self.clutter + self.absent
        return self.uavs - self.clusters - unled

    @property
    def unseen_levels(self) -> tuple[int, int]:
        """The fewest and the most unseen UAVs above a head or decoy; 0 and 0 where these follow no UAV."""
        strategy, led_by = self.follow_strategy, self.led_by
        if strategy is None or not strategy.has_followers or strategy.has_references or strategy.shifts_tracks:
            return 0, 0
        return (led_by, led_by) if isinstance(led_by, int) else led_by

    @property
    def follow_strategy(self) -> FollowStrategy | None:
        """The follow strategy as an object; ``None`` for the control ``follow="none"``."""
        if isinstance(self.follow, FollowStrategy):
            return self.follow
        return None if self.follow == "none" else FOLLOW_STRATEGIES.find(self.follow)

    @property
    def head_mobility(self) -> Mobility:
        """The mobility as an object."""
        return self.mobility if isinstance(self.mobility, Mobility) else MOBILITIES.find(self.mobility)

    @property
    def kinematics_model(self) -> Kinematics:
        """The kinematics as an object."""
        return self.kinematics if isinstance(self.kinematics, Kinematics) else KINEMATICS.find(self.kinematics)

    def noise_bound(self) -> float:
        """An upper bound in metres of the position noise on each axis."""
        return NOISE_BOUND * max(1.0, self.course_noise) * self.position_noise

    def position_bound(self, rounds: int) -> float:
        """An upper bound in metres of all observed coordinates within ``rounds`` rounds."""
        travelled = self.memory + rounds * self.steps
        return FARTHEST + max(1.0, self.kinematics_model.top_speed) * travelled + self.noise_bound()

    def speed_bound(self) -> float:
        """An upper bound in metres per step of all true velocity coordinates."""
        return 1.001 * max(1.0, self.kinematics_model.top_speed)  # before the first window all UAVs fly 1 m per step

    def velocity_bound(self) -> float:
        """An upper bound in metres per step of all observed velocity coordinates."""
        jump = (2.0 * self.noise_bound() + SWAP_RANGE * (self.swap_rate > 0)) / self.sample_every
        return self.speed_bound() + jump

"""What a simulated swarm and its observer are made of, checked in one place."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from usnet_env.config import ArgumentError, Config, quote
from usnet_env.swarm.follow import FollowStrategy, follow_strategy
from usnet_env.swarm.formation import ARENA, AROUND_RADIUS, formation
from usnet_env.swarm.mobility import Mobility, mobility

__all__ = ["SwarmConfig"]

_MOST_SAMPLES = 100_000_000  # (T_ob * sample_every + memory) * N of one window: 2.4 GB of positions and velocities

Count = Annotated[int, Field(ge=1, le=100_000)]


class SwarmConfig(Config):
    """A swarm of M clusters and N UAVs, and how it is observed. Lengths in metres, times in steps.

    Args:
        follow: follow strategy of all followers: a registered name, a :class:`FollowStrategy`, or ``"none"`` (the
            followers fly like independent heads: a control).
        mobility: how heads and decoys move: a registered name or a :class:`Mobility`.
        formation: where the swarm starts: ``"uniform"`` or ``"around"``.
        clusters: M.
        uavs: N, decoys included.
        cluster_sizes: m_j, followers of each cluster, at least 2; ``None`` draws them for each episode.
        observation_steps: T_ob, velocity samples in a window.
        memory: T_0, steps of the past that a follow strategy may look at, and steps flown between a re-merge and the
            next window.
        sample_every: the observer samples every k-th step.
        position_noise: standard deviation of the observed positions, per axis.
        miss_rate: probability that a UAV is not detected at a sampling instant.
        decoys: UAVs that fly like heads, follow nobody and lead nobody.
        head_jitter: heads and decoys get the followers' noise kappa_n n on top of their mobility.
        follow_seed: seed of the follow strategy's own draws (f7's network); ``None`` draws them for each episode.

    Raises:
        ArgumentError: a value of another type or out of its range, with the name of the argument.
    """

    follow: str | FollowStrategy = "f1"
    mobility: str | Mobility = "iid"
    formation: str = "uniform"
    clusters: Count = 5
    uavs: Count = 82
    cluster_sizes: tuple[Annotated[int, Field(ge=2, le=100_000)], ...] | None = None
    observation_steps: Count = 100
    memory: Annotated[int, Field(ge=1, le=1000)] = 4
    sample_every: Annotated[int, Field(ge=1, le=1000)] = 1
    position_noise: Annotated[float, Field(ge=0, le=1000)] = 0.0
    miss_rate: Annotated[float, Field(ge=0, lt=1)] = 0.0
    decoys: Annotated[int, Field(ge=0, le=100_000)] = 0
    head_jitter: bool = False
    follow_seed: Annotated[int, Field(ge=0, lt=2**63)] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        strategy = self.follow_strategy
        if not isinstance(self.mobility, Mobility):
            mobility(self.mobility)
        formation(self.formation)
        if strategy is not None and strategy.lags > self.memory:
            raise ArgumentError(
                f"memory must be at least {strategy.lags} for follow={quote(self.follow)}, got {self.memory}."
            )
        followers = self.uavs - self.clusters - self.decoys
        if self.cluster_sizes is not None:
            if len(self.cluster_sizes) != self.clusters:
                raise ArgumentError(
                    f"cluster_sizes must list the followers of each of the {self.clusters} clusters, "
                    f"got {quote(list(self.cluster_sizes))}."
                )
            if sum(self.cluster_sizes) != followers:
                raise ArgumentError(
                    f"cluster_sizes must add up to uavs - clusters - decoys = {followers}, "
                    f"got {quote(list(self.cluster_sizes))} with the sum {sum(self.cluster_sizes)}."
                )
        if followers < 2 * self.clusters:
            raise ArgumentError(
                f"uavs must be at least 3 * clusters + decoys = {3 * self.clusters + self.decoys} "
                f"(every head has 2 followers or more), got {self.uavs}."
            )
        if (self.steps + self.memory) * self.uavs > _MOST_SAMPLES:
            raise ArgumentError(
                f"observation_steps must keep (memory + observation_steps * sample_every) * uavs within "
                f"{_MOST_SAMPLES}, got {self.observation_steps} with {self.uavs} UAVs, one step in {self.sample_every}."
            )
        return self

    @property
    def steps(self) -> int:
        """Steps flown in one round: ``memory`` unobserved ones, then the window."""
        return self.memory + self.observation_steps * self.sample_every

    @property
    def follow_strategy(self) -> FollowStrategy | None:
        """The strategy itself; ``None`` for the control ``follow="none"``."""
        if isinstance(self.follow, FollowStrategy):
            return self.follow
        return None if self.follow == "none" else follow_strategy(self.follow)

    @property
    def head_mobility(self) -> Mobility:
        """The mobility itself."""
        return self.mobility if isinstance(self.mobility, Mobility) else mobility(self.mobility)

    def position_bound(self, rounds: int) -> float:
        """A length in metres that no observed coordinate exceeds within ``rounds`` rounds."""
        travelled = self.memory + rounds * self.steps
        return max(ARENA) + AROUND_RADIUS + travelled + NOISE_BOUND * self.position_noise

    def velocity_bound(self) -> float:
        """A speed in metres per step that no observed coordinate exceeds."""
        return 1.001 + 2.0 * NOISE_BOUND * self.position_noise / self.sample_every


NOISE_BOUND = 8.0  # observed noise is cut at this many standard deviations (once in 10^15 draws), so bounds are finite

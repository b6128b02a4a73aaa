"""Controls: swarms that look like those of the other follow strategies, in which no UAV leads or follows another."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from usnet_env.swarm import kernels
from usnet_env.swarm.field_follow import FieldStrategy
from usnet_env.swarm.formation import Roles
from usnet_env.swarm.strategy import KAPPA
from usnet_env.swarm.trajectory import TrajectoryBatch

__all__ = ["Independent", "Shifted"]


@dataclass(frozen=True)
class Independent(FieldStrategy):
    """Every UAV flies on its own by the swarm's mobility; H_0 is empty."""

    equation = "v_{i,t+1}: the mobility, for all i"
    citation = "null model of independent tracks"
    breaks = "some UAVs lead"
    parameters = ()
    has_heads = False
    has_followers = False

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """No UAV of a cluster has a head, and each is its own source."""
        own = np.arange(len(roles.root))
        return replace(_behead(roles), source=own)

    def fly(self, flight: TrajectoryBatch) -> None:
        """All velocities are given."""
        kernels.integrate(flight.start, flight.position, flight.velocity)


@dataclass(frozen=True)
class Shifted(FieldStrategy):
    """Followers fly by f2, and the observer sees the steps of each UAV's track from another time on; H_0 is empty.

    The velocities of UAV i in a window of T steps are rolled by s_i, and its track begins at its true place. The shifts
    of the m UAVs of a cluster are T / m steps apart, in random order. So every track keeps its statistics, and no UAV
    of a cluster repeats another at a lag below T / m.
    """

    equation = "v_{i,t+1} = norm(v_{iL,t} + v_{iL,t−1} + κ_n n), observed as v_{i,(t−s_i) mod T}"
    citation = "circularly shifted surrogates (Quian Quiroga et al. 2002)"
    breaks = "some UAVs lead"
    parameters = ("noise",)
    has_heads = False
    shifts_tracks = True

    @property
    def lags(self) -> int:  # type: ignore[override]  # that of f2
        """The lags of f2."""
        return 2

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """No UAV of a cluster has a head for the observer; the sources stay."""
        return _behead(roles)

    def fly(self, flight: TrajectoryBatch) -> None:
        """Compiled loop of f2."""
        kappa = np.full(self.lags, KAPPA, np.float32)
        kernels.fly_lags(kappa, False, np.float32(self.noise), flight.source, *flight.flown)


def _behead(roles: Roles) -> Roles:
    """The roles without heads: the UAVs of the clusters have the root -1."""
    members = ~(roles.decoy | roles.bystander)
    return replace(roles, head=np.zeros_like(roles.head), root=np.where(members, -1, roles.root))

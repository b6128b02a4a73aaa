"""Field models in which the UAVs of a cluster fly as a flock: by the neighbours within ranges, not by their head."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from usnet_env.swarm import flock_kernels
from usnet_env.swarm.field_follow import FieldStrategy
from usnet_env.swarm.state import Roles
from usnet_env.swarm.strategy import TrajectoryBatch


@dataclass(frozen=True)
class Flock(FieldStrategy):
    """Repulsion, alignment and attraction among the UAVs of a cluster; a head ignores the others.

    A UAV without a neighbour in any range flies to the middle of its cluster.
    """

    repulsion: float = 0.0  # range, metres; a UAV with a neighbour within it only flies away from it
    alignment: float = 40.0  # range, metres
    attraction: float = 0.0  # range, metres
    align: float = 1.0  # weight of alignment, the mean velocity in its range, the UAV's own included
    attract: float = 0.0  # weight of attraction, the mean direction to the neighbours in its range
    flight: float = 0.0  # distance at which a UAV flees a predator or driver, metres
    flee: float = 0.0  # weight of the flight
    standoff: float = 0.0  # distance of a driver from the middle of its flock, metres
    link: float = 0.0  # weight of the course of the UAV or reference that a UAV with a head, or a head, copies
    chaser: ClassVar[int] = flock_kernels.NO_CHASER

    def fly(self, flight: TrajectoryBatch) -> None:
        """Compiled loop."""
        ranges = np.array([self.repulsion, self.alignment, self.attraction], np.float32)
        weights = np.array([self.align, self.attract], np.float32)
        scalars = map(np.float32, (self.flight, self.flee, self.standoff, self.link))
        swarm = self.table(flight), flight.root, flight.source, flight.not_led
        flock_kernels.fly_flock(ranges, weights, self.chaser, *scalars, *swarm, *flight.loop_arguments)


@dataclass(frozen=True)
class Couzin(Flock):
    """A Couzin flock with an informed head, which ignores the others: repulsion, or else alignment and attraction."""

    repulsion: float = 5.0
    alignment: float = 40.0
    attraction: float = 100.0
    attract: float = 0.6


@dataclass(frozen=True)
class Informed(Couzin):
    """A Couzin flock with an informed minority: its heads fly in the flock, and also prefer a course that they know.

    The course is that of a reference, which flies by the swarm's mobility. ``share`` of the UAVs are informed, at least
    one; the others have no head of their own: their ``root`` is -1.
    """

    share: float = 0.2
    link: float = 0.5
    has_references = True

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """Draw the informed UAVs of each cluster, the drawn head first."""
        head, source, root = roles.head.copy(), roles.source.copy(), roles.root.copy()
        for cluster, drawn_head in enumerate(roles.initial_heads):
            members = np.append(drawn_head, rng.permutation(roles.members(cluster)))
            informed = members[: max(1, round(self.share * len(members)))]
            source[members], root[members] = len(source) + cluster, -1
            head[informed], root[informed] = True, informed
        return roles._replace(head=head, source=source, root=root)


@dataclass(frozen=True)
class Linked(Informed):
    """Informed UAVs of a flock that are all heads: they copy unseen UAVs, and every other one copies one of them."""

    has_references = False

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """Draw the informed UAVs of each cluster, and the one that each of the others copies."""
        roles = super().arrange(rng, roles)
        source, root = roles.source.copy(), roles.root.copy()
        for cluster, top in enumerate(roles.initial_heads):
            members = np.flatnonzero(roles.source == len(source) + cluster)
            informed = members[roles.head[members]]
            source[informed] = top
            uninformed = members[~roles.head[members]]
            source[uninformed] = root[uninformed] = rng.choice(informed, len(uninformed))
        return roles._replace(source=source, root=root)


@dataclass(frozen=True)
class Predator(Couzin):
    """A Couzin flock with a head and a predator, which chases the nearest UAV of the flock; the flock flees it.

    One follower of each cluster is its predator. It is no head and has none.
    """

    flight: float = 60.0
    flee: float = 1.0
    chaser = flock_kernels.PREDATOR

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """Draw the predator of each cluster."""
        not_led, root = roles.not_led.copy(), roles.root.copy()
        for cluster in range(len(roles.initial_heads)):
            predator = rng.choice(roles.members(cluster))
            not_led[predator], root[predator] = True, predator
        return roles._replace(not_led=not_led, root=root)


@dataclass(frozen=True)
class Shepherd(Couzin):
    """A driver behind each flock pushes it where the swarm's mobility wants it; H_0 is empty: a driver is no leader."""

    flight: float = 80.0
    flee: float = 1.5
    standoff: float = 40.0
    has_references = True
    chaser = flock_kernels.DRIVER

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """The drawn head of each cluster becomes its driver."""
        source, not_led, drivers = roles.source.copy(), roles.not_led.copy(), roles.initial_heads
        source[drivers], not_led[drivers] = len(source) + np.arange(len(drivers)), True
        root = np.where(roles.head | roles.decoy | roles.not_led, roles.root, -1)
        return roles.without_heads(root=root, source=source, not_led=not_led)

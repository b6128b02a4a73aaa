"""Field models: follow strategies in which leadership is late, weak, indirect, changing, or absent.

They are follow strategies like f1 to f7: ``follow="pigeons"`` selects one, and ``FIELD_MODELS`` in ``follow.py`` has
them all. A UAV copies its :attr:`SwarmState.source`, which may be another follower or a reference. Every follower has
its own delay, gain and noise, drawn for each episode. The last two are controls: swarms that look like the others, in
which no UAV leads or follows another.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from usnet_env.arrays import Singles
from usnet_env.swarm import field_kernels, follow_kernels
from usnet_env.swarm.field_kernels import ALWAYS
from usnet_env.swarm.state import Roles
from usnet_env.swarm.strategy import KAPPA, KAPPA_NOISE, KAPPA_RANGE, FollowStrategy, TrajectoryBatch

Pair = tuple[float, float]


@dataclass(frozen=True)
class FieldStrategy(FollowStrategy):
    """A field model. Its pairs are the smallest and largest value of a follower."""

    compiled = True
    version: ClassVar[int] = 1  # increases when the model's behaviour changes
    equation: str = ""
    citation: str = ""  # where the model comes from
    breaks: str = ""  # the assumption of detectors that it breaks
    parameters: tuple[str, ...] = ()  # the names of the arguments that matter to it
    noise: float = KAPPA_NOISE
    delays: tuple[int, int] = (1, 1)  # steps
    gains: Pair = (1.0, 1.0)  # the weight of what a follower copies against its own velocity
    noises: Pair = (1.0, 1.0)  # relative to ``noise``

    @property
    def lags(self) -> int:  # type: ignore[override]  # follows from the fields
        """Number of past steps that the model uses."""
        return max(self.delays)

    def draw_for(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the table ``(COLUMNS, N)`` of every UAV, flattened."""
        table = np.empty((field_kernels.COLUMNS, uavs), np.float32)
        table[field_kernels.DELAY] = rng.integers(self.delays[0], self.delays[1] + 1, uavs)
        table[field_kernels.GAIN] = rng.uniform(*self.gains, uavs)
        low, high = np.log(self.noises)
        table[field_kernels.NOISE] = self.noise * np.exp(rng.uniform(low, high, uavs))
        table[field_kernels.SALT] = rng.integers(2**24, size=uavs)
        table[field_kernels.OFFSET :] = self.draw_slots(rng, uavs)
        return table.ravel()

    def draw_slots(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the slots ``(3, N)`` of a formation, metres along, across and above the course; here none."""
        return np.zeros((3, uavs), np.float32)

    def table(self, flight: TrajectoryBatch) -> Singles:
        """The tables ``(B, COLUMNS, N)``."""
        return flight.parameters.reshape(len(flight.noise), field_kernels.COLUMNS, -1)


@dataclass(frozen=True)
class CopyingStrategy(FieldStrategy):
    """Followers copy UAVs above them in a hierarchy, each link with its delay: base of the models of copying.

    v_{i,t+1} = norm((1 - g_i) v_{i,t} + g_i mean_k v_{a_k,t+1-d_k} + kappa_i n), where a_k is k links above i.
    """

    links: int = 1  # number of UAVs above it that a follower copies, at most 8
    strength: float = 0.0  # for Cucker-Smale flocks, the weight of a link at distance 0; 0 for copies
    scale: float = 100.0  # for Cucker-Smale flocks, the distance at which a link weakens, metres
    block_steps: int = 10  # length of a block of steps in which a follower answers or doesn't
    response_probability: float = 1.0  # probability of an answer in a block
    idle_noise: float = 0.1  # of a follower that doesn't answer and flies on
    response_unit: int = ALWAYS  # or EACH_CLUSTER, EACH_FOLLOWER: it draws for each block whether followers answer

    @property
    def lags(self) -> int:  # type: ignore[override]  # follows from the other fields
        """The longest delay along all links; the links of a Cucker-Smale flock have none."""
        return 1 if self.strength else self.links * max(self.delays)

    def fly(self, flight: TrajectoryBatch) -> None:
        """Compiled loop."""
        flock = self.links, np.float32(self.strength), np.float32(self.scale)
        idle = map(np.float32, (self.response_probability, self.idle_noise))
        swarm = self.table(flight), flight.root, flight.source, flight.clock
        field_kernels.fly_links(*flock, self.response_unit, self.block_steps, *idle, *swarm, *flight.loop_arguments)


@dataclass(frozen=True)
class Chain(CopyingStrategy):
    """A chain of command: a tree of ``depth`` links in which each UAV copies the one above it."""

    depth: int = 3

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """A tree with as many branches at each UAV as the depth needs, filled level by level."""
        source = roles.source.copy()
        for cluster, head in enumerate(roles.initial_heads):
            members = rng.permutation(roles.members(cluster))
            branches = next(
                b for b in range(1, len(members) + 1) if sum(b**d for d in range(1, self.depth + 1)) >= len(members)
            )
            above = np.arange(len(members)) // branches - 1
            source[members] = np.where(above < 0, head, members[above])
        return roles._replace(source=source)


@dataclass(frozen=True)
class Hierarchy(CopyingStrategy):
    """A random hierarchy in each cluster."""

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """Order each cluster at random; each follower copies a UAV drawn from those before it, the head included."""
        source = roles.source.copy()
        for cluster, head in enumerate(roles.initial_heads):
            order = np.append(head, rng.permutation(roles.members(cluster)))
            source[order[1:]] = order[rng.integers(np.arange(1, len(order)))]
        return roles._replace(source=source)


@dataclass(frozen=True)
class MixedStrategies(FieldStrategy):
    """f1 to f6 in one swarm: a strategy of each follower, or with ``EACH_CLUSTER`` one of each cluster and block."""

    block_steps: int = 30
    reach: float = KAPPA_RANGE
    response_unit: int = ALWAYS
    lags = 3  # those of f3 and f5

    def fly(self, flight: TrajectoryBatch) -> None:
        """Compiled loop."""
        response = self.response_unit, self.block_steps, np.float32(self.reach)
        field_kernels.fly_mixed(*response, self.table(flight), flight.source, flight.clock, *flight.loop_arguments)


@dataclass(frozen=True)
class FormationSlots(FieldStrategy):
    """Followers keep slots in the frame of a UAV or reference: base of :class:`Frontness` and :class:`Reference`."""

    pull: float = 1.0  # weight of the way to the slot
    near: float = 10.0  # distance from the slot below which the pull weakens, metres
    spread: float = 20.0  # standard deviation of the slots on each axis, metres
    smoothing: int = 12  # number of velocities whose mean gives the course

    @property
    def lags(self) -> int:  # type: ignore[override]  # follows from the other fields
        """The steps of the course and of the delays."""
        return max(self.smoothing, *self.delays)

    def draw_slots(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the slots."""
        return rng.normal(0.0, self.spread, (3, uavs)).astype(np.float32)

    def fly(self, flight: TrajectoryBatch) -> None:
        """Compiled loop."""
        pull, near = np.float32(self.pull), np.float32(self.near)
        field_kernels.fly_slots(self.smoothing, pull, near, self.table(flight), flight.source, *flight.loop_arguments)


@dataclass(frozen=True)
class Frontness(FormationSlots):
    """A formation whose head is in front, in the middle or behind.

    At equal speeds followers overtake a head only where it turns.
    """

    place: int | None = None  # 1 for a head in front, 0 in the middle, -1 behind; ``None``: drawn for each episode
    offset: float = 40.0  # distance of the head from the middle of the formation in front or behind, metres

    def draw_slots(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the place of the head and the slots about it."""
        slots = super().draw_slots(rng, uavs)
        position = int(rng.integers(-1, 2)) if self.place is None else self.place
        slots[0] -= np.float32(position * self.offset)
        return slots


@dataclass(frozen=True)
class Reference(FormationSlots):
    """A formation about a moving reference that no UAV flies: H_0 is empty, and the right answer is the empty set.

    The references fly by the swarm's mobility.
    """

    has_references = True

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """Every UAV of a cluster keeps a slot about the cluster's reference."""
        source = roles.source.copy()
        for cluster, head in enumerate(roles.initial_heads):
            source[np.append(roles.members(cluster), head)] = len(source) + cluster
        return roles.without_heads(source=source)


@dataclass(frozen=True)
class Independent(FieldStrategy):
    """Every UAV flies on its own by the swarm's mobility; H_0 is empty."""

    has_followers = False

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """No UAV of a cluster has a head, and each is its own source."""
        return roles.without_heads(source=np.arange(len(roles.root)))


@dataclass(frozen=True)
class Shifted(FieldStrategy):
    """Followers fly by f2, and the observer sees the steps of each UAV's track from another time on; H_0 is empty.

    The velocities of UAV i in a window of T steps are rolled by s_i, and its track begins where it does. The shifts
    of the m UAVs of a cluster are T / m steps apart, in random order. So every track keeps its statistics, and no UAV
    of a cluster repeats another at a lag below T / m.
    """

    shifts_tracks = True
    lags = 2  # those of f2

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """No UAV of a cluster has a head for the observer; the sources stay."""
        return roles.without_heads()

    def fly(self, flight: TrajectoryBatch) -> None:
        """Compiled loop of f2."""
        kappa = np.full(self.lags, KAPPA, np.float32)
        follow_kernels.fly_lags(kappa, False, np.float32(self.noise), flight.source, *flight.loop_arguments)

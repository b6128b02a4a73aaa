"""Field models: follow strategies in which leadership is late, weak, indirect, changing, or absent.

Each has its equation, its citation and its parameters, and a compiled loop; ``docs/field.md`` lists them. They are
follow strategies like f1 to f7: ``follow="pigeons"`` selects one. A UAV copies its :attr:`SwarmState.source`, which
may be another follower or a reference. Every follower has its own delay, gain and noise, drawn for each episode.
The last two are controls: swarms that look like the others, in which no UAV leads or follows another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from usnet_env.arrays import Singles
from usnet_env.swarm import field_kernels, kernels
from usnet_env.swarm.field_kernels import ALWAYS, EACH_CLUSTER, EACH_FOLLOWER
from usnet_env.swarm.state import Roles
from usnet_env.swarm.strategy import KAPPA, KAPPA_NOISE, KAPPA_RANGE, FollowInputs, FollowStrategy, TrajectoryBatch

Pair = tuple[float, float]


@dataclass(frozen=True)
class FieldStrategy(FollowStrategy):
    """A field model.

    Args:
        noise: kappa_n.
        delays: the smallest and largest delay of a follower, steps.
        gains: the smallest and largest gain of a follower: the weight of what it copies against its own velocity.
        noises: the smallest and largest noise of a follower, relative to ``noise``.

    Attributes:
        citation: where the model comes from.
        breaks: the assumption of detectors that it breaks.
        parameters: the names of the arguments that matter to it.
        version: increases when the model's behaviour changes.
    """

    citation: ClassVar[str] = ""
    breaks: ClassVar[str] = ""
    parameters: ClassVar[tuple[str, ...]] = ()
    version: ClassVar[int] = 1
    noise: float = KAPPA_NOISE
    delays: tuple[int, int] = (1, 1)
    gains: Pair = (1.0, 1.0)
    noises: Pair = (1.0, 1.0)

    @property
    def lags(self) -> int:  # type: ignore[override]  # follows from the fields
        """Number of past steps that the model uses."""
        return max(self.delays)

    def draw_for(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the table ``(COLUMNS, N)`` of every UAV's delay, gain, noise, salt and slot, flattened."""
        table = np.empty((field_kernels.COLUMNS, uavs), np.float32)
        table[field_kernels.DELAY] = rng.integers(self.delays[0], self.delays[1] + 1, uavs)
        table[field_kernels.GAIN] = rng.uniform(*self.gains, uavs)
        table[field_kernels.NOISE] = self.noise * np.exp(
            rng.uniform(np.log(self.noises[0]), np.log(self.noises[1]), uavs)
        )
        table[field_kernels.SALT] = rng.integers(2**24, size=uavs)
        table[field_kernels.OFFSET :] = self.draw_slots(rng, uavs)
        return table.ravel()

    def draw_slots(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the slots ``(3, N)`` of a formation, metres along, across and above the course; here none."""
        return np.zeros((3, uavs), np.float32)

    def direction(self, inputs: FollowInputs) -> Singles:
        """Not defined: a field model depends on more than a follower and its head."""
        raise NotImplementedError(f"the field model {type(self).__name__} has no direction")

    def table(self, flight: TrajectoryBatch) -> Singles:
        """The table ``(B, COLUMNS, N)`` of each episode."""
        return flight.parameters.reshape(flight.episodes, field_kernels.COLUMNS, -1)


@dataclass(frozen=True)
class Links(FieldStrategy):
    """Followers copy UAVs above them in a hierarchy, each link with its delay: base of the models of copying.

    v_{i,t+1} = norm((1 - g_i) v_{i,t} + g_i mean_k v_{a_k,t+1-d_k} + kappa_i n), where a_k is k links above i.

    Args:
        links: number of UAVs above it that a follower copies, at most 8.
        strength: for Cucker-Smale flocks, the weight of a link at distance 0; 0 for copies.
        scale: for Cucker-Smale flocks, the distance at which a link weakens, metres.
        block: length of a block of steps in which a follower answers or doesn't.
        share: probability of an answer in a block.
        idle_noise: noise of a follower that doesn't answer and flies on.
    """

    links: int = 1
    strength: float = 0.0
    scale: float = 100.0
    block: int = 10
    share: float = 1.0
    idle_noise: float = 0.1
    answers: ClassVar[int] = ALWAYS

    @property
    def lags(self) -> int:  # type: ignore[override]  # follows from the other fields
        """The longest delay along all links."""
        return self.links * max(self.delays)

    def fly(self, flight: TrajectoryBatch) -> None:
        """Compiled loop."""
        flock = self.links, np.float32(self.strength), np.float32(self.scale)
        answer = self.answers, self.block, np.float32(self.share), np.float32(self.idle_noise)
        field_kernels.fly_links(*flock, *answer, self.table(flight), flight.source, flight.clock, *flight.flown)


@dataclass(frozen=True)
class UnequalDelays(Links):
    """Every follower copies its head with its own delay, gain and noise."""

    equation = "v_{i,t+1} = norm((1 − g_i) v_{i,t} + g_i v_{iL,t+1−d_i} + κ_i n)"
    citation = "reaction times as in Nagy et al. 2010"
    breaks = "one delay, gain and noise for all followers"
    parameters = ("delays", "gains", "noises", "noise")
    delays: tuple[int, int] = (1, 12)
    gains: Pair = (0.5, 1.0)
    noises: Pair = (0.5, 4.0)


@dataclass(frozen=True)
class Chain(Links):
    """A chain of command: head, sub-heads and followers form a tree in which each copies the one above it.

    Args:
        depth: number of links from the head to the last followers.
    """

    equation = "v_{i,t+1} = norm(v_{a(i),t} + κ_n n), a(i) above i in a tree of depth D"
    citation = "hierarchical leadership (Shen 2007)"
    breaks = "every follower copies a head directly"
    parameters = ("depth", "noise")
    depth: int = 3

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """A tree with as many branches at each UAV as the depth needs, filled level by level."""
        source = roles.source.copy()
        for cluster in range(len(roles.drawn)):
            members = rng.permutation(roles.members(cluster))
            branches = next(
                b for b in range(1, len(members) + 1) if sum(b**d for d in range(1, self.depth + 1)) >= len(members)
            )
            above = np.arange(len(members)) // branches - 1
            source[members] = np.where(above < 0, roles.drawn[cluster], members[above])
        return replace(roles, source=source)


@dataclass(frozen=True)
class Hierarchy(Links):
    """A random hierarchy in each cluster: base of :class:`Pigeons` and :class:`CuckerSmale`."""

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """Order each cluster at random; each follower copies a UAV drawn from those before it, the head included."""
        source = roles.source.copy()
        for cluster in range(len(roles.drawn)):
            order = np.concatenate([roles.drawn[cluster : cluster + 1], rng.permutation(roles.members(cluster))])
            source[order[1:]] = order[rng.integers(np.arange(1, len(order)))]
        return replace(roles, source=source)


@dataclass(frozen=True)
class Pigeons(Hierarchy):
    """A flock in a hierarchy, in which each pair has its delay; delays add up along the hierarchy."""

    equation = (
        "v_{i,t+1} = norm((1 − g_i) v_{i,t} + g_i mean_{k≤3} v_{a_k,t+1−d_ik} + κ_n n), d_ik = d_i + … + d_{a_{k−1}}"
    )
    citation = "Nagy et al. 2010, Nature 464:890"
    breaks = "followers lead no UAV, and one delay for all"
    parameters = ("links", "delays", "gains", "noise")
    links: int = 3
    delays: tuple[int, int] = (1, 3)
    gains: Pair = (0.6, 0.9)


@dataclass(frozen=True)
class CuckerSmale(Hierarchy):
    """A Cucker-Smale flock with hierarchical leadership: links weaken with the distance."""

    equation = (
        "v_{i,t+1} = norm(v_{i,t} + mean_{k≤8} K (1 + ‖p_{a_k} − p_i‖² / σ²)^{−0.4} (v_{a_k,t} − v_{i,t}) + κ_n n)"
    )
    citation = "Cucker & Smale 2007; Shen 2007, SIAM J. Appl. Math. 68:694"
    breaks = "every follower copies a head directly, whatever the distance"
    parameters = ("links", "strength", "scale", "noise")
    links: int = 8
    strength: float = 0.8
    lags = 1  # the delays are not added up: every link has the delay 1


@dataclass(frozen=True)
class PartTime(Links):
    """A head leads a share of the time; in the other blocks its followers fly on."""

    equation = "v_{i,t+1} = norm(v_{iL,t} + κ_n n) if h(L, ⌊t / T⌋) < q, else norm(v_{i,t} + κ_o n)"
    citation = "changing leadership as in Amornbunchornvej et al. 2018 (FLICA)"
    breaks = "a head leads all the time"
    parameters = ("share", "block", "idle_noise", "noise")
    share: float = 0.4
    answers = EACH_CLUSTER


@dataclass(frozen=True)
class PartialTurns(Links):
    """Only some followers answer the turns of a head: each draws in every block whether it does."""

    equation = "v_{i,t+1} = norm(v_{iL,t} + κ_n n) if h(i, ⌊t / T⌋) < q, else norm(v_{i,t} + κ_o n)"
    citation = "partial responses to turns (Attanasi et al. 2014)"
    breaks = "every follower follows in every step"
    parameters = ("share", "block", "idle_noise", "noise")
    block: int = 8
    share: float = 0.5
    answers = EACH_FOLLOWER


@dataclass(frozen=True)
class Kinds(FieldStrategy):
    """f1 to f6 in one swarm: base of :class:`Mixed` and :class:`Switching`.

    Args:
        block: number of steps in which a cluster keeps its strategy.
        reach: kappa_r of f6, metres.
    """

    block: int = 30
    reach: float = KAPPA_RANGE
    lags = 3  # those of f3 and f5
    answers: ClassVar[int] = ALWAYS

    def fly(self, flight: TrajectoryBatch) -> None:
        """Compiled loop."""
        answer = self.answers, self.block, np.float32(self.reach)
        field_kernels.fly_kinds(*answer, self.table(flight), flight.source, flight.clock, *flight.flown)


@dataclass(frozen=True)
class Mixed(Kinds):
    """Every follower flies by one of f1 to f6, drawn for each episode."""

    equation = "v_{i,t+1} = norm(f_{k(i)}(V_{iL,t}) + κ_n n), k(i) ∈ {1, …, 6}"
    citation = "paper, Table II"
    breaks = "one follow strategy in a swarm"
    parameters = ("reach", "noise")


@dataclass(frozen=True)
class Switching(Kinds):
    """Every cluster changes between f1 to f6, also within a window."""

    equation = "v_{i,t+1} = norm(f_{k(L,⌊t / T⌋)}(V_{iL,t}) + κ_n n), k ∈ {1, …, 6}"
    citation = "paper, Table II; switching regimes (Hamilton 1989)"
    breaks = "one follow strategy in a window"
    parameters = ("block", "reach", "noise")
    answers = EACH_CLUSTER


@dataclass(frozen=True)
class Slots(FieldStrategy):
    """Followers keep slots in the frame of a UAV or reference: base of :class:`Frontness` and :class:`Reference`.

    Args:
        pull: weight of the way to the slot.
        near: distance from the slot below which the pull weakens, metres.
        spread: standard deviation of the slots on each axis, metres.
        smoothing: number of velocities whose mean gives the course.
    """

    pull: float = 1.0
    near: float = 10.0
    spread: float = 20.0
    smoothing: int = 12

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
        field_kernels.fly_slots(self.smoothing, pull, near, self.table(flight), flight.source, *flight.flown)


@dataclass(frozen=True)
class Frontness(Slots):
    """A formation whose head is in front, in the middle or behind.

    At equal speeds followers overtake a head only where it turns.

    Args:
        place: 1 for a head in front, 0 in the middle, -1 behind; ``None``: drawn for each episode.
        offset: distance of the head from the middle of the formation in front or behind, metres.
    """

    equation = "v_{i,t+1} = norm(v_{iL,t} + κ_p g / max(‖g‖, 10) + κ_n n), g = p_{iL} + R_L (o_i − f a e_x) − p_i"
    citation = "frontness as in Amornbunchornvej et al. 2018; Reynolds 1987"
    breaks = "heads fly in front"
    parameters = ("place", "offset", "pull", "near", "spread", "smoothing", "noise")
    place: int | None = None
    offset: float = 40.0

    def draw_slots(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the place of the head and the slots about it."""
        slots = super().draw_slots(rng, uavs)
        place = int(rng.integers(-1, 2)) if self.place is None else self.place
        slots[0] -= np.float32(place * self.offset)
        return slots


@dataclass(frozen=True)
class Reference(Slots):
    """A formation about a moving reference that no UAV flies: H_0 is empty, and the right answer is the empty set.

    The references fly by the swarm's mobility.
    """

    equation = "v_{i,t+1} = norm(v_{r,t} + κ_p g / max(‖g‖, 10) + κ_n n), g = p_r + R_r o_i − p_i, r a reference"
    citation = "virtual structures (Lewis & Tan 1997; Ren & Beard 2004)"
    breaks = "every cluster has a head"
    parameters = ("pull", "near", "spread", "smoothing", "noise")
    has_heads = False
    has_references = True

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """Every UAV of a cluster keeps a slot about the cluster's reference."""
        source = roles.source.copy()
        for cluster, head in enumerate(roles.drawn):
            source[np.append(roles.members(cluster), head)] = len(source) + cluster
        return roles.without_heads(source=source, references=len(roles.drawn))


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
        return roles.without_heads(source=np.arange(len(roles.root)))

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
    lags = 2  # those of f2

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """No UAV of a cluster has a head for the observer; the sources stay."""
        return roles.without_heads()

    def fly(self, flight: TrajectoryBatch) -> None:
        """Compiled loop of f2."""
        kappa = np.full(self.lags, KAPPA, np.float32)
        kernels.fly_lags(kappa, False, np.float32(self.noise), flight.source, *flight.flown)

"""What a follow strategy is: the base class, the inputs of equation (1) of the paper, and the flights that it fills."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Indices, Mask, Singles
from usnet_env.parts import REGISTRIES
from usnet_env.swarm import kernels
from usnet_env.swarm.state import Roles
from usnet_env.window import frozen_array

KAPPA = 1.0  # kappa_0, ..., kappa_3 and kappa_p of Table II
KAPPA_NOISE = 0.05  # kappa_n
KAPPA_RANGE = 60.0  # kappa_r, metres


@dataclass(frozen=True)
class FollowInputs:
    """The arguments of equation (1), from which n followers compute v_{i,t+1}. Axis 1 is time, newest first.

    Args:
        own_position: ``(n, T_0 + 1, 3)`` metres, P_{i,t+1}: p_{i,t+1}, ..., p_{i,t-T_0+1}.
        head_velocity: ``(n, T_0, 3)`` metres per step, V_{iL,t}: v_{iL,t}, ..., v_{iL,t-T_0+1}.
        head_position: ``(n, T_0 + 1, 3)`` metres: p_{iL,t+1}, ..., p_{iL,t-T_0+1}. Equation (1) has the last of them
            only; the others follow from it and the velocities.
        parameters: ``(P,)``, the parameters of this episode from :meth:`FollowStrategy.draw`.
        follower: ``(n,)`` int64, which follower a row is: its number among all followers of the swarm, in the order of
            their indices. It stays the same when other UAVs are destroyed. By default 0, ..., n - 1.
        clock: t, the number of steps since the start of the episode.
    """

    own_position: Singles
    head_velocity: Singles
    head_position: Singles
    parameters: Singles
    follower: Indices = field(default_factory=lambda: np.empty(0, np.int64))
    clock: int = 0

    def __post_init__(self) -> None:
        if not len(self.follower):
            object.__setattr__(self, "follower", np.arange(len(self.own_position)))


@dataclass(frozen=True)
class TrajectoryBatch:
    """B swarms with a past of L steps and S steps to simulate; ``position`` and ``velocity`` are filled in place.

    ``root``, ``source``, ``not_led``, ``parameters`` and ``clock`` are those of :class:`SwarmState`; ``source``
    ``(B, N + R)`` ends with that of the references.

    Args:
        position: ``(B, L + S + 1, N + R, 3)`` float32, metres; the first L + 1 instants are given.
        velocity: ``(B, L + S, N + R, 3)`` float32, metres per step; the first L steps are given, and all
            steps of the free UAVs.
        noise: ``(B, S, N + R, 3)`` float32, the followers' n ~ N(0, I), before the scaling by kappa_n.
        motion: ``(B, N + R)`` int8, how each UAV moves: ``kernels.DESTROYED``, ``FREE`` or ``FOLLOWS``.
        plan: how the compiled loops fly the free UAVs, and the kinematics; by default all swarms fly with ``unit``,
            and their free UAVs have flown.
    """

    position: Singles
    velocity: Singles
    noise: Singles
    motion: NDArray[np.int8]
    root: Indices
    parameters: Singles
    source: Indices
    not_led: Mask
    clock: Indices
    plan: kernels.FlightPlan = kernels.FLOWN

    @property
    def loop_arguments(self) -> tuple[NDArray[np.int8], int, Singles, Singles, Singles, kernels.FlightPlan]:
        """The last arguments of the compiled loops: how each UAV moves, from which step on, …, and the plan."""
        return self.motion, self.start, self.noise, self.position, self.velocity, self.plan

    @property
    def steps(self) -> int:
        """S, the number of steps to simulate."""
        return self.noise.shape[1]

    @property
    def start(self) -> int:
        """L, the index in ``velocity`` of the first step to simulate."""
        return self.velocity.shape[1] - self.steps


class FollowStrategy:
    """A follow strategy f. A follower's next velocity is norm(direction + kappa_n n), n ~ N(0, I).

    To add one, define :meth:`direction` in a subclass, or pass a function to :func:`register_follow_strategy`. The
    strategies of this package have compiled loops, :meth:`fly`, in its place.

    >>> from usnet_env.swarm import SwarmConfig
    >>> class Opposite(FollowStrategy):
    ...     def direction(self, inputs):
    ...         return -inputs.head_velocity[:, 0]
    >>> config = SwarmConfig(follow=Opposite())

    Attributes:
        equation: the equation as text, for lists and documentation pages.
        lags: number of past head velocities that the strategy uses; ``memory`` T_0 must be at least this.
        noise: kappa_n, the scale of the noise.
        has_references: whether each cluster has a reference, which flies by the swarm's mobility in place of its heads.
        has_followers: whether UAVs follow; otherwise all UAVs fly by the swarm's mobility.
        compiled: whether :meth:`fly` is a compiled loop that obeys the plan of the flight.
        shifts_tracks: whether the observer sees the steps of each track rolled in time by a shift of its own.
    """

    equation: str = ""
    lags: int = 1
    noise: float = KAPPA_NOISE
    has_references: bool = False
    has_followers: bool = True
    compiled: bool = False
    shifts_tracks: bool = False

    def draw(self, rng: np.random.Generator) -> Singles:
        """Draw the parameters ``(P,)`` float32 of one episode; P is fixed, and 0 for most strategies."""
        return np.empty(0, np.float32)

    def draw_for(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the parameters ``(P,)`` float32 of one episode with N UAVs; by default those of :meth:`draw`."""
        return self.draw(rng)

    def arrange(self, rng: np.random.Generator, roles: Roles) -> Roles:
        """Give each UAV the UAV that it copies, and mark UAVs without a head; by default followers copy their head."""
        return roles

    def direction(self, inputs: FollowInputs) -> Singles:
        """Direction of flight ``(n, 3)`` before noise and normalisation; row i depends only on row i of the inputs."""
        raise NotImplementedError(f"{type(self).__name__} must define direction(inputs).")

    def fly(self, flight: TrajectoryBatch) -> None:
        """Simulate all followers: the general loop, which calls :meth:`direction` step by step."""
        lags, name = flight.start, f"directions of follow strategy {REGISTRIES['follow strategy'].name_of(self)}"
        for b in range(len(flight.noise)):
            position, velocity = flight.position[b], flight.velocity[b]
            followers = np.flatnonzero(flight.motion[b] == kernels.FOLLOWS)
            heads = flight.source[b, followers]
            numbers = np.cumsum(flight.source[b] != np.arange(position.shape[1]))[followers] - 1
            for s in range(flight.steps):
                t = lags + s
                past = slice(t - 1, t - 1 - lags if t > lags else None, -1)
                past_and_now = slice(t, t - lags - 1 if t > lags else None, -1)
                inputs = FollowInputs(
                    own_position=position[past_and_now, followers].swapaxes(0, 1),
                    head_velocity=velocity[past, heads].swapaxes(0, 1),
                    head_position=position[past_and_now, heads].swapaxes(0, 1),
                    parameters=flight.parameters[b],
                    follower=numbers,
                    clock=int(flight.clock[b]) + s,
                )
                noise = np.float32(self.noise) * flight.noise[b, s, followers]
                total = frozen_array(name, self.direction(inputs), np.float32, (len(followers), 3)) + noise
                length = np.sqrt((total * total).sum(axis=-1, keepdims=True, dtype=np.float32))
                velocity[t, followers] = total / np.maximum(length, np.float32(1e-6))
                position[t + 1] = position[t] + velocity[t]

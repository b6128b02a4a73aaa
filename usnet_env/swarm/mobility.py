"""Mobilities: how heads and decoys move (decision (a) on docs/game.md).

All UAVs move 1 m per step, followers included, so speed carries no information about the role.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from usnet_env.arrays import Floats, Singles
from usnet_env.parts import Registry, accept_objects
from usnet_env.swarm import kernels
from usnet_env.swarm.formation import ARENA
from usnet_env.window import frozen_array


class Mobility(ABC):
    """How heads and decoys move. Subclass it, or pass a function to :func:`register_mobility`.

    Attributes:
        description: one line for lists and documentation pages.
        normals: standard normal numbers that a UAV needs per step of a compiled mobility.
    """

    description: str = ""
    normals: int = 0

    @abstractmethod
    def start(self, rng: np.random.Generator, uavs: int) -> Floats:
        """Draw the initial state ``(uavs, MOBILITY_STATE)`` float64 from the mobility's stationary distribution."""

    @abstractmethod
    def fly(self, state: Floats, position: Singles, steps: int, rng: np.random.Generator) -> Singles:
        """Directions of flight ``(steps, uavs, 3)``, which the simulator normalises; updates ``state`` in place.

        Args:
            state: ``(uavs, MOBILITY_STATE)`` float64.
            position: ``(uavs, 3)`` float32, metres, the present positions.
            steps: number of steps to simulate.
            rng: the episode's generator.
        """

    def fly_batch(self, state: Floats, position: Singles, steps: int, rngs: Sequence[np.random.Generator]) -> Singles:
        """Directions of flight ``(B, steps, n, 3)`` of n UAVs in each of B swarms; by default those of :meth:`fly`.

        Args:
            state: ``(B, n, MOBILITY_STATE)`` float64, updated in place.
            position: ``(B, n, 3)`` float32, metres, the present positions.
            steps: number of steps to simulate.
            rngs: the generators of the swarms.
        """
        swarms = zip(state, position, rngs, strict=True)
        flown = [self.fly(values, present, steps, rng) for values, present, rng in swarms]
        name, shape = f"directions of mobility {MOBILITIES.name_of(self)}", (steps, position.shape[1], 3)
        return np.array([frozen_array(name, directions, np.float32, shape) for directions in flown])


@dataclass(frozen=True)
class CompiledMobility(Mobility):
    """A mobility with a compiled step: its code in ``kernels``, normal numbers per step, and up to 6 constants."""

    code: int
    normals: int
    numbers: tuple[float, ...] = ()
    description: str = ""

    @cached_property
    def constants(self) -> Floats:
        """``(6,)`` float64, the constants for the kernel, padded with zeros."""
        return np.array([*self.numbers, *[0.0] * (6 - len(self.numbers))])

    def start(self, rng: np.random.Generator, uavs: int) -> Floats:
        """Draw directions, waypoints and turns."""
        state = np.zeros((uavs, kernels.MOBILITY_STATE))
        if self.code == kernels.IID:
            return state
        direction = rng.standard_normal((uavs, 3))  # uniform on the sphere, once it has length 1
        if self.code == kernels.GAUSS_MARKOV:
            state[:, 2] = rng.uniform(-np.pi, np.pi, uavs)  # mean azimuth; the mean pitch is level
            state[:, 0:2] = state[:, 2:4] + np.sqrt(self.constants[1:3]) * rng.standard_normal((uavs, 2))
            return state
        state[:, 0:3] = direction / np.sqrt((direction * direction).sum(axis=1, keepdims=True))
        if self.code == kernels.WAYPOINT:
            state[:, 3:6] = rng.random((uavs, 3)) * ARENA
        elif self.code == kernels.LOCAL_WAYPOINT:
            state[:, 3:6] = np.nan  # no waypoint yet: `fly` draws one relative to the UAV's position
        return state

    def fly(self, state: Floats, position: Singles, steps: int, rng: np.random.Generator) -> Singles:
        """The compiled loop, for a swarm of free UAVs."""
        uavs, velocity = np.arange(len(state)), np.empty((1, steps, *position.shape), np.float32)
        noise = rng.standard_normal((1, steps, len(state), self.normals), dtype=np.float32)
        codes, constants = np.full_like(uavs, self.code), np.tile(self.constants, (len(state), 1))
        jitter, motion = np.zeros(len(state), np.float32), np.full((1, len(state)), kernels.FREE, np.int8)
        plan = kernels.FlightPlan(uavs[None], codes, constants, noise, state[None], jitter)
        kernels.fly_free(0, 0, plan, motion, velocity, position[None, None], velocity)
        return velocity[0]


@dataclass(frozen=True)
class MobilityFunction(Mobility):
    """A mobility that calls a function; made by :func:`register_mobility`."""

    function: Callable[[np.random.Generator, Singles, int, Floats], Singles]

    @property
    def description(self) -> str:  # type: ignore[override]  # follows from the function
        """The first line of the function's docstring."""
        return (self.function.__doc__ or "").partition("\n")[0]

    def start(self, rng: np.random.Generator, uavs: int) -> Floats:
        """Zeros: the function sets its own state in its first call."""
        return np.zeros((uavs, kernels.MOBILITY_STATE))

    def fly(self, state: Floats, position: Singles, steps: int, rng: np.random.Generator) -> Singles:
        """Call the function."""
        return self.function(rng, position, steps, state)


@dataclass(frozen=True)
class SharedMobility(Mobility):
    """All UAVs fly alike by a mobility: as its first UAV, from positions of their own."""

    mobility: Mobility
    description: str = ""

    def start(self, rng: np.random.Generator, uavs: int) -> Floats:
        """Draw one state for all."""
        return np.tile(self.mobility.start(rng, 1), (uavs, 1))

    def fly(self, state: Floats, position: Singles, steps: int, rng: np.random.Generator) -> Singles:
        """Draw the directions of the first UAV for all."""
        directions = self.mobility.fly(state[:1], position[:1], steps, rng)
        state[:] = state[0]
        return directions.repeat(len(state), axis=1)


_BUILT_IN: dict[str, Mobility] = {
    "iid": CompiledMobility(kernels.IID, 3, description="a new random direction at each step (the paper's setting)"),
    "gauss_markov": CompiledMobility(
        kernels.GAUSS_MARKOV, 2, (0.85, 0.2, 0.02),
        "Gauss-Markov azimuth and pitch around a mean heading; autocorrelation 0.85, variances 0.2 and 0.02 rad^2",
    ),
    "smooth_turn": CompiledMobility(
        kernels.SMOOTH_TURN, 5, (10.0, 0.6),
        "turns about random axes with exponential durations (mean 10 steps) and truncated exponential curvature",
    ),
    "waypoint": CompiledMobility(
        kernels.WAYPOINT, 3, (0.2, 5.0, *ARENA), "random waypoints in the whole arena, turns up to 0.2 rad per step"
    ),
    "local_waypoint": CompiledMobility(
        kernels.LOCAL_WAYPOINT, 3, (0.5, 2.0, 10.0), "random waypoints about 10 m away, turns up to 0.5 rad per step"
    ),
    "straight": CompiledMobility(kernels.STRAIGHT, 1, description="a straight line in a random direction"),
}  # fmt: skip
_ALIKE = "all heads and decoys fly alike: one new random direction for all at each step"
_BUILT_IN["alike"] = SharedMobility(_BUILT_IN["iid"], _ALIKE)

#: All mobilities by name.
MOBILITIES = Registry[Mobility](
    "mobility", "mobility", "usnet.mobilities", __name__, accept_objects(Mobility, MobilityFunction), _BUILT_IN
)

#: Register a mobility, so that ``mobility=name`` selects it; see :meth:`usnet_env.parts.Registry.register`. It is a
#: :class:`Mobility`, or a function ``(rng, position (n, 3), steps, state (n, 8)) -> (steps, n, 3)`` of directions of
#: flight. ``state`` starts as zeros, and the function may change it in place to keep values between rounds.
register_mobility = MOBILITIES.register

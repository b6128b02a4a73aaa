"""Kinematics: what a UAV can fly, apart from what it wants.

A mobility or a follow strategy says in which direction a UAV wants to fly; its kinematics turns this direction into its
velocity, step by step. The models here have a compiled step; one of a user defines :meth:`Kinematics.steer` in NumPy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Singles
from usnet_env.parts import Registry, accept_objects
from usnet_env.swarm import kernels


class Kinematics:
    """How a UAV flies towards the direction that it wants. Subclass it and define :meth:`steer`.

    Attributes:
        equation: the equation as text, for lists and documentation pages.
        source: where the model comes from.
        breaks: the assumption of a detector that it breaks.
        version: increases when the model's behaviour changes.
        top_speed: an upper bound of the speed, metres per step.
        values: number of values in the state of one UAV.
        normals: standard normal numbers that a UAV needs per step.
    """

    equation: ClassVar[str] = ""
    source: ClassVar[str] = ""
    breaks: ClassVar[str] = ""
    version: ClassVar[int] = 1
    values: int = 0
    normals: int = 0
    top_speed: float = 1.0

    def start(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the initial state ``(uavs, values)``."""
        return np.zeros((uavs, self.values), np.float32)

    def steer(self, wanted: Singles, before: Singles, position: Singles, state: Singles, normals: Singles) -> Singles:
        """The velocities ``(n, 3)`` of one step, metres per step; row i depends only on row i of the inputs.

        Args:
            wanted: ``(n, 3)``, the directions that the UAVs want, of length 1.
            before: ``(n, 3)``, their velocities one step earlier, metres per step.
            position: ``(n, 3)``, their present positions, metres.
            state: ``(n, values)``, their states, updated in place.
            normals: ``(n, normals)``, standard normal numbers.
        """
        raise NotImplementedError(f"{type(self).__name__} must define steer.")

    def fly(
        self, t: int, motion: NDArray[np.int8], normals: Singles, state: Singles, position: Singles, velocity: Singles
    ) -> None:
        """Fly step ``t`` of B swarms: replace the wanted directions ``velocity[:, t]``, of length 1, by velocities.

        Args:
            t: the index of the step in ``velocity``, and of the present instant in ``position``.
            motion: ``(B, N + R)`` int8, how each UAV and reference moves; those with ``kernels.DESTROYED`` get 0.
            normals: ``(B, N + R, normals)``, standard normal numbers.
            state: ``(B, N + R, values)``, updated in place.
            position: ``(B, T + 1, N + R, 3)`` metres; instant ``t + 1`` is written.
            velocity: ``(B, T, N + R, 3)``, metres per step; step ``t`` is changed.
        """
        living = motion != kernels.DESTROYED
        living_state = state[living]
        wanted, last_velocity, present = velocity[:, t][living], velocity[:, t - 1][living], position[:, t][living]
        steered = self.steer(wanted, last_velocity, present, living_state, normals[living])
        state[living] = living_state
        velocity[:, t] = 0.0
        velocity[:, t][living] = steered
        position[:, t + 1] = position[:, t] + velocity[:, t]


class CompiledKinematics(Kinematics):
    """A model with a compiled step; ``code`` is its number and ``_fields`` the fields that are its constants."""

    code: ClassVar[int]
    _fields: ClassVar[tuple[str, ...]] = ()

    @cached_property
    def constants(self) -> Singles:
        """``(4,)``, the constants for the kernel, padded with zeros."""
        return np.array([*(getattr(self, name) for name in self._fields), 0, 0, 0, 0][:4], np.float32)

    def fly(
        self, t: int, motion: NDArray[np.int8], normals: Singles, state: Singles, position: Singles, velocity: Singles
    ) -> None:
        """Compiled step, of a flight of one step in which all UAVs have their directions."""
        noise = np.empty((len(motion), 1, 0, 3), np.float32)
        plan = kernels.FLOWN._replace(kinematics=self.code, kinematic_constants=self.constants)
        plan = plan._replace(kinematic_noise=np.ascontiguousarray(normals[:, None]), kinematic_state=state)
        kernels.fly_without_followers(motion, t, noise, position, velocity, plan)


@dataclass(frozen=True)
class Unit(CompiledKinematics):
    """Every UAV flies 1 m per step in the direction that it wants (the paper's setting)."""

    equation = "v_{t+1} = u_{t+1}"
    source = "paper, §II-A"
    breaks = "–"
    code = kernels.UNIT


@dataclass(frozen=True)
class VariedSpeed(CompiledKinematics):
    """Speeds that differ between UAVs and vary over time, by an autoregressive process of order 1."""

    equation = "v_{t+1} = s_{t+1} u_{t+1}, s = clip(s̄_i (1 + a)), a_{t+1} = φ a_t + σ √(1 − φ²) n"
    source = "AR(1), as in Gauss-Markov mobility (Liang & Haas 1999)"
    breaks = "all UAVs fly at one constant speed"
    values = 2  # mean speed, relative deviation
    normals = 1
    code = kernels.VARIED_SPEED
    slowest: float = 0.5  # metres per step
    fastest: float = 1.5
    spread: float = 0.2  # the UAVs' mean speeds are uniform in 1 ± spread, metres per step
    phi: float = 0.95  # φ, the correlation of the relative deviation from one step to the next
    sigma: float = 0.15  # σ, the standard deviation of the relative deviation

    @property
    def top_speed(self) -> float:  # type: ignore[override]  # follows from the other fields
        """The largest speed."""
        return self.fastest

    @cached_property
    def constants(self) -> Singles:
        """φ, σ √(1 − φ²), and the speeds."""
        scale = self.sigma * math.sqrt(1.0 - self.phi**2)
        return np.array([self.phi, scale, self.slowest, self.fastest], np.float32)

    def start(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the mean speeds, and the deviations from their stationary distribution."""
        mean = rng.uniform(1.0 - self.spread, 1.0 + self.spread, uavs)
        return np.stack([mean, self.sigma * rng.standard_normal(uavs)], axis=1).astype(np.float32)


@dataclass(frozen=True)
class Lagged(CompiledKinematics):
    """A first-order lag: the velocity approaches the wanted one with a time constant of each UAV, in steps."""

    equation = "v_{t+1} = v_t + (u_{t+1} − v_t) / τ_i"
    source = "first-order velocity response (Beard & McLain 2012, §9)"
    breaks = "a UAV flies the wanted velocity at once"
    values = 1  # 1 / time constant
    code = kernels.LAGGED
    shortest: float = 1.5
    longest: float = 4.0

    def start(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the time constants."""
        return (1.0 / rng.uniform(self.shortest, self.longest, (uavs, 1))).astype(np.float32)


@dataclass(frozen=True)
class Limited(CompiledKinematics):
    """A limited turn rate and acceleration; a UAV that wants to turn more slows down."""

    equation = "∠(v_{t+1}, v_t) ≤ ω_i, |s_{t+1} − s_t| ≤ a, s aims at s_0 + (1 − s_0) (1 + cos ∠(u, v)) / 2"
    source = "bounded turn rate and acceleration (Dubins 1957; Beard & McLain 2012)"
    breaks = "a UAV can turn at any rate"
    values = 1  # turn rate
    code = kernels.LIMITED
    _fields = ("slowest", "acceleration")
    least_turn: float = 0.15  # the UAVs' turn rates are uniform from here, radians per step
    most_turn: float = 0.35
    slowest: float = 0.5  # the speed that a UAV aims at when it wants to reverse, metres per step
    acceleration: float = 0.05  # the largest change of the speed, metres per step and step

    def start(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the turn rates."""
        return rng.uniform(self.least_turn, self.most_turn, (uavs, 1)).astype(np.float32)


@dataclass(frozen=True)
class Layered(CompiledKinematics):
    """Altitude layers: a UAV keeps the altitude of its layer and flies the wanted course in the plane.

    ``layers`` layers are ``height`` metres apart, the lowest at half of it; ``climb`` is the largest vertical speed.
    """

    equation = "v_z = clip((h_i − z) / 10, ±c), v_xy = √(1 − v_z²) u_xy / ‖u_xy‖"
    source = "altitude layers of urban airspace (Sunil et al. 2015, Metropolis)"
    breaks = "the three axes are alike"
    values = 1  # altitude
    code = kernels.LAYERED
    _fields = ("climb",)
    layers: int = 5
    height: float = 20.0
    climb: float = 0.3

    def start(self, rng: np.random.Generator, uavs: int) -> Singles:
        """Draw the layers."""
        return ((rng.integers(self.layers, size=(uavs, 1)) + 0.5) * self.height).astype(np.float32)


@dataclass(eq=False)
class Avoidance(Kinematics):
    """The kinematics of UAVs that avoid K intruders, on top of another model.

    In place of the direction u a UAV flies norm(u + push Σ_k max(0, 1 − d_k / reach) e_k), where d_k is its distance to
    intruder k and e_k the direction from there (the repulsion zone of Couzin et al. 2002, made soft).

    Args:
        model: how the UAVs fly what they want.
        position: ``(B, K, 3)`` metres, where the intruders are; every step moves them.
        velocity: ``(B, K, 3)``, metres per step.
        reach: metres, the distance from which a UAV avoids an intruder.
        push: weight of the avoidance beside the wanted direction, which has length 1.
        uavs: N; the references of a swarm, which have higher indices, avoid nothing.
    """

    model: Kinematics
    position: Singles
    velocity: Singles
    reach: float
    push: float
    uavs: int

    def __post_init__(self) -> None:
        self.values, self.normals, self.top_speed = self.model.values, self.model.normals, self.model.top_speed

    def fly(
        self, t: int, motion: NDArray[np.int8], normals: Singles, state: Singles, position: Singles, velocity: Singles
    ) -> None:
        """Turn the wanted directions of step ``t``, fly them by the model, and move the intruders."""
        wanted = velocity[:, t, : self.uavs]
        push = find_push(position[:, t, : self.uavs], self.position, self.reach)
        turned = wanted + np.float32(self.push) * push
        turned /= np.maximum(np.linalg.norm(turned, axis=-1, keepdims=True), np.float32(1e-6))
        is_near = push.any(axis=-1) & (motion[:, : self.uavs] != kernels.DESTROYED)
        wanted[is_near] = turned[is_near]
        self.position = self.position + self.velocity
        self.model.fly(t, motion, normals, state, position, velocity)


def find_push(position: Singles, intruders: Singles, reach: float) -> Singles:
    """Σ_k max(0, 1 − d_k / reach) e_k at positions ``(…, N, 3)`` near intruders ``(…, K, 3)``: ``(…, N, 3)``."""
    offset = position[..., :, None, :] - intruders[..., None, :, :]
    distance = np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), np.float32(1e-6))
    return np.asarray((np.maximum(1 - distance / np.float32(reach), 0) * offset / distance).sum(axis=-2))


_BUILT_IN = {"unit": Unit(), "varied_speed": VariedSpeed(), "lagged": Lagged()}
_BUILT_IN |= {"limited": Limited(), "layered": Layered()}

#: All kinematics models by name.
KINEMATICS = Registry[Kinematics](
    "kinematics model", "kinematics", "usnet.kinematics", __name__, accept_objects(Kinematics), _BUILT_IN
)

#: Register a model, so that ``kinematics=name`` selects it; see :meth:`usnet_env.parts.Registry.register`.
register_kinematics = KINEMATICS.register

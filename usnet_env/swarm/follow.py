"""Follow strategies: how a follower's next velocity depends on its head, equation (1) of the paper.

f1 to f7 are the strategies of the paper's Table II. Each is defined in NumPy by :meth:`FollowStrategy.direction`; a new
strategy needs only this method. f1 to f7 also have a compiled loop over the whole window, which is tested against the
NumPy definition.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from usnet_env.arrays import Indices, Singles
from usnet_env.config import ArgumentError, plain_text, quote, real_number, whole_number
from usnet_env.registry import Registry
from usnet_env.swarm import kernels
from usnet_env.swarm.trajectory import TrajectoryBatch

__all__ = [
    "FOLLOW_STRATEGIES",
    "FollowInputs",
    "FollowStrategy",
    "Lags",
    "Network",
    "StayInRange",
    "follow_strategies",
    "follow_strategy",
    "register_follow_strategy",
]


KAPPA = 1.0  # kappa_0, ..., kappa_3 and kappa_p of Table II
KAPPA_NOISE = 0.05  # kappa_n
KAPPA_RANGE = 60.0  # kappa_r, metres

MOST_LAGS = 1000  # the largest ``memory``
MOST_NOISE = 1e6  # a follower's direction is then noise alone; in float32 its square is still finite


@dataclass(frozen=True)
class FollowInputs:
    """The arguments of equation (1), from which n followers compute v_{i,t+1}. Axis 1 is time, newest first.

    Args:
        own_position: ``(n, T_0 + 1, 3)`` metres, P_{i,t+1}: p_{i,t+1}, ..., p_{i,t-T_0+1}.
        head_velocity: ``(n, T_0, 3)`` metres per step, V_{iL,t}: v_{iL,t}, ..., v_{iL,t-T_0+1}.
        head_position: ``(n, T_0 + 1, 3)`` metres: p_{iL,t+1}, ..., p_{iL,t-T_0+1}. Equation (1) has the last of them
            only; the others follow from it and the velocities.
        parameters: ``(P,)``, the parameters of this episode from :meth:`FollowStrategy.draw`.
        follower: ``(n,)`` int64, which follower a row is: its number among all followers of the swarm, from 0 in the
            order of their indices. It stays the same when other UAVs are destroyed. By default 0, ..., n - 1.
    """

    own_position: Singles
    head_velocity: Singles
    head_position: Singles
    parameters: Singles
    follower: Indices = field(default_factory=lambda: np.empty(0, np.int64))

    def __post_init__(self) -> None:
        if not len(self.follower):
            object.__setattr__(self, "follower", np.arange(len(self.own_position)))


class FollowStrategy(ABC):
    """A follow strategy f. A follower's next velocity is norm(direction + kappa_n n), n ~ N(0, I).

    To add a strategy, subclass this and define :meth:`direction`, or pass a function to
    :func:`register_follow_strategy`.

    Attributes:
        equation: the equation as text, for lists and documentation pages.
        lags: number of past head velocities that the strategy uses; ``memory`` T_0 must be at least this.
        noise: kappa_n, the scale of the noise.
    """

    equation: str = ""
    lags: int = 1
    noise: float = KAPPA_NOISE

    def draw(self, rng: np.random.Generator) -> Singles:
        """Draw the parameters ``(P,)`` float32 of one episode; P is fixed, and 0 for most strategies."""
        return np.empty(0, np.float32)

    @abstractmethod
    def direction(self, inputs: FollowInputs) -> Singles:
        """Direction of flight ``(n, 3)`` before noise and normalisation; row i depends only on row i of the inputs."""

    def fly(self, trajectories: TrajectoryBatch) -> None:
        """Simulate all followers: fill ``velocity`` and ``position`` from step ``trajectories.start`` on.

        This is the general loop over episodes and steps; f1 to f7 override it with compiled loops.
        """
        lags = trajectories.start
        for b in range(trajectories.episodes):
            position, velocity = trajectories.position[b], trajectories.velocity[b]
            followers = np.flatnonzero(trajectories.motion[b] == kernels.FOLLOWS)
            heads = trajectories.leader[b, followers]
            numbers = np.cumsum(trajectories.leader[b] != np.arange(len(trajectories.leader[b])))[followers] - 1
            for s in range(trajectories.steps):
                t = lags + s
                past = slice(t - 1, t - 1 - lags if t > lags else None, -1)
                past_and_now = slice(t, t - lags - 1 if t > lags else None, -1)
                inputs = FollowInputs(
                    own_position=position[past_and_now, followers].swapaxes(0, 1),
                    head_velocity=velocity[past, heads].swapaxes(0, 1),
                    head_position=position[past_and_now, heads].swapaxes(0, 1),
                    parameters=trajectories.parameters[b],
                    follower=numbers,
                )
                try:
                    direction = self.direction(inputs)
                except IndexError as error:
                    raise ArgumentError(
                        f"memory must cover the past that the follow strategy {quote(_registered_name(self))} reads, "
                        f"got {lags}: {error}; register the strategy with the lags that it needs."
                    ) from error
                velocity[t, followers] = _norm(direction, np.float32(self.noise) * trajectories.noise[b, s, followers])
                position[t + 1] = position[t] + velocity[t]


def _norm(direction: Singles, noise: Singles) -> Singles:
    """norm(direction + noise) of Table II for rows of 3 components."""
    total = np.asarray(direction, np.float32) + noise
    length = np.sqrt((total * total).sum(axis=-1, keepdims=True, dtype=np.float32))
    return total / np.maximum(length, np.float32(1e-6))


@dataclass(frozen=True)
class Lags(FollowStrategy):
    """f1 to f5: sum of the head's last velocities or of their squares (Table II, types 1 to 5).

    v_{i,t+1} = norm(sum_{tau=0}^{lags-1} kappa_tau v_{iL,t-tau} + kappa_n n), where v * v
    (axis-wise) replaces v if ``square``.
    """

    lags: int = 1
    square: bool = False
    kappa: float = KAPPA
    noise: float = KAPPA_NOISE

    @property
    def equation(self) -> str:  # type: ignore[override]  # follows from the other fields
        """The equation as in Table II."""
        term = "v_{iL,t-τ} ⊙ v_{iL,t-τ}" if self.square else "v_{iL,t-τ}"
        combination = f"Σ_{{τ=0}}^{{{self.lags - 1}}} κ_τ {term}" if self.lags > 1 else f"κ_0 {term.replace('-τ', '')}"
        return f"v_{{i,t+1}} = norm({combination} + κ_n n)"

    def direction(self, inputs: FollowInputs) -> Singles:
        """The sum over the lags."""
        past = inputs.head_velocity[:, : self.lags]
        return np.float32(self.kappa) * (past * past if self.square else past).sum(axis=1, dtype=np.float32)

    def fly(self, trajectories: TrajectoryBatch) -> None:
        """Compiled loop; positions are integrated afterwards, because no velocity depends on them."""
        kernels.fly_lags(
            np.full(self.lags, self.kappa, np.float32),
            self.square,
            np.float32(self.noise),
            *trajectories.flight,
            trajectories.velocity,
        )
        kernels.integrate(trajectories.start, trajectories.position, trajectories.velocity)


@dataclass(frozen=True)
class StayInRange(FollowStrategy):
    """f6: the head's velocity, plus a pull towards the head beyond the distance kappa_r (Table II, type 6)."""

    equation: str = (
        "v_{i,t+1} = norm(κ_0 v_{iL,t} + κ_n n + 1{‖p_{iL,t} − p_{i,t}‖ > κ_r} κ_p (p_{iL,t} − p_{i,t}) / ‖·‖)"
    )
    lags: int = 1
    kappa: float = KAPPA
    pull: float = KAPPA
    reach: float = KAPPA_RANGE
    noise: float = KAPPA_NOISE

    def direction(self, inputs: FollowInputs) -> Singles:
        """Head velocity, plus ``pull`` times the unit vector towards the head if it is farther than ``reach``."""
        gap = inputs.head_position[:, 1] - inputs.own_position[:, 1]
        distance = np.sqrt((gap * gap).sum(axis=-1, keepdims=True, dtype=np.float32))
        pull = np.where(distance > np.float32(self.reach), np.float32(self.pull), np.float32(0.0))
        towards = gap * (pull / np.maximum(distance, np.float32(1e-6)))
        return np.float32(self.kappa) * inputs.head_velocity[:, 0] + towards

    def fly(self, trajectories: TrajectoryBatch) -> None:
        """Compiled loop, which also integrates the positions."""
        kernels.fly_range(
            np.float32(self.kappa),
            np.float32(self.pull),
            np.float32(self.reach),
            np.float32(self.noise),
            *trajectories.flight,
            trajectories.position,
            trajectories.velocity,
        )


@dataclass(frozen=True)
class Network(FollowStrategy):
    """f7: a random tanh network of the inputs of equation (1) (Table II, type 7; decision (c) on docs/game.md).

    v_{i,t+1} = norm(MLP(P_{i,t+1}, V_{iL,t}, p_{iL,t-3}) + kappa_n n). It has one hidden layer of 16 units;
    the weights are drawn for each episode. The positions enter as (p_{i,t+1} - p_{iL,t-3}) / ``position_scale`` and as
    differences of consecutive own positions. Both are linear maps of the paper's inputs. Raw metres would saturate
    every unit, and the output would not depend on the head. The gains give the head's velocities the largest weight
    among the inputs of a hidden unit.
    """

    equation: str = "v_{i,t+1} = norm(MLP(P_{i,t+1}, V_{iL,t}, p_{iL,t-3}) + κ_n n)"
    lags: int = kernels.MLP_LAGS
    noise: float = KAPPA_NOISE
    position_scale: float = 300.0
    head_gain: float = 0.6
    own_gain: float = 0.1
    position_gain: float = 0.15

    def draw(self, rng: np.random.Generator) -> Singles:
        """Draw the weights, biases and output weights of one network."""
        own, head = 3 * kernels.MLP_LAGS, 3 * kernels.MLP_LAGS
        gains = np.repeat([self.position_gain, self.own_gain, self.head_gain], [3, own, head])
        weights = gains[:, None] * rng.standard_normal((kernels.MLP_INPUTS, kernels.MLP_HIDDEN))
        bias = 0.1 * rng.standard_normal(kernels.MLP_HIDDEN)
        readout = rng.standard_normal((kernels.MLP_HIDDEN, 3)) / np.sqrt(kernels.MLP_HIDDEN)
        return np.concatenate([weights.ravel(), bias, readout.ravel()]).astype(np.float32)

    def direction(self, inputs: FollowInputs) -> Singles:
        """The output of the network."""
        n, lags, units = len(inputs.own_position), kernels.MLP_LAGS, kernels.MLP_HIDDEN
        inner = kernels.MLP_INPUTS * units
        weights = inputs.parameters[:inner].reshape(kernels.MLP_INPUTS, units)
        bias = inputs.parameters[inner : inner + units]
        readout = inputs.parameters[inner + units :].reshape(units, 3)
        offset = (inputs.own_position[:, 0] - inputs.head_position[:, lags]) / np.float32(self.position_scale)
        own_velocity = inputs.own_position[:, :lags] - inputs.own_position[:, 1 : lags + 1]
        features = np.concatenate(
            [offset, own_velocity.reshape(n, -1), inputs.head_velocity[:, :lags].reshape(n, -1)], axis=1
        )
        output: Singles = np.tanh(features @ weights + bias) @ readout
        return output

    def fly(self, trajectories: TrajectoryBatch) -> None:
        """Compiled loop, which also integrates the positions."""
        kernels.fly_mlp(
            trajectories.parameters,
            np.float32(self.position_scale),
            np.float32(self.noise),
            *trajectories.flight,
            trajectories.position,
            trajectories.velocity,
        )


@dataclass(frozen=True)
class FollowFunction(FollowStrategy):
    """A follow strategy that calls a function; made by :func:`register_follow_strategy`."""

    function: Callable[[FollowInputs], Singles]
    lags: int = 4
    noise: float = KAPPA_NOISE
    equation: str = ""

    def direction(self, inputs: FollowInputs) -> Singles:
        """Call the function and check its result."""
        direction = np.asarray(self.function(inputs), np.float32)
        shape = (len(inputs.own_position), 3)
        if direction.shape != shape:
            raise ArgumentError(f"follow function must return an array of shape {shape}, got {direction.shape}.")
        if not np.isfinite(direction).all():
            raise ArgumentError("follow function must return finite numbers, got NaN or infinity.")
        return direction


def check_strategy(strategy: Any, subject: str = "strategy") -> FollowStrategy:
    """Return a strategy, made of a function if it is one.

    Raises:
        ArgumentError: it is neither, or its ``lags`` or ``noise`` is out of range.
    """
    if not isinstance(strategy, FollowStrategy):
        if not callable(strategy) or isinstance(strategy, type):
            raise ArgumentError(f"{subject} must be a FollowStrategy or a function, got {quote(strategy)}.")
        strategy = FollowFunction(strategy)
    whole_number("lags", strategy.lags, 1, MOST_LAGS)
    real_number("noise", strategy.noise, 0, MOST_NOISE)
    return strategy


#: All follow strategies by name; ``"none"`` selects the control without followers.
FOLLOW_STRATEGIES = Registry(
    "follow strategy",
    "follow",
    "usnet.follow_strategies",
    __name__,
    check_strategy,
    {
        "f1": Lags(1),
        "f2": Lags(2),
        "f3": Lags(3),
        "f4": Lags(2, square=True),
        "f5": Lags(3, square=True),
        "f6": StayInRange(),
        "f7": Network(),
    },
    reserved=("none",),
)


def _registered_name(strategy: FollowStrategy) -> str:
    """The name under which a strategy is registered, or else the name of its class."""
    return next((name for name in FOLLOW_STRATEGIES if FOLLOW_STRATEGIES[name] is strategy), type(strategy).__name__)


def follow_strategies() -> Mapping[str, FollowStrategy]:
    """All follow strategies by name (a read-only view)."""
    return FOLLOW_STRATEGIES


#: The follow strategy of a name; see :meth:`usnet_env.registry.Registry.find`.
follow_strategy = FOLLOW_STRATEGIES.find


def register_follow_strategy(
    name: str,
    strategy: FollowStrategy | Callable[[FollowInputs], Singles],
    *,
    lags: int = 4,
    noise: float = KAPPA_NOISE,
    equation: str = "",
    replace: bool = False,
) -> None:
    """Register a follow strategy, so that ``follow=name`` selects it.

    Args:
        name: a new name.
        strategy: a :class:`FollowStrategy`, or a function from :class:`FollowInputs` of n followers to their directions
            ``(n, 3)``; the simulator adds noise and normalises.
        lags: for a function, the number of past head velocities that it uses, from 1 to 1000.
        noise: for a function, kappa_n, from 0 to 10^6.
        equation: for a function, its equation as text for lists.
        replace: replace another strategy of this name, for example to run a notebook cell again. An environment in the
            middle of an episode uses the new strategy from its next window on. The names f1 to f7 can't be replaced.

    Raises:
        ArgumentError: ``name`` is empty or already registered for another strategy, or another argument has the wrong
            type or is out of range.
    """
    if callable(strategy) and not isinstance(strategy, FollowStrategy | type):
        strategy = FollowFunction(
            strategy,
            whole_number("lags", lags, 1, MOST_LAGS),
            real_number("noise", noise, 0, MOST_NOISE),
            plain_text("equation", equation),
        )
    FOLLOW_STRATEGIES.register(name, strategy, replace=replace)

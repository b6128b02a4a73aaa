"""Follow strategies: how a follower's next velocity depends on its head, equation (1) of the paper.

f1 to f7 are the strategies of the paper's Table II. Each is defined in NumPy by :meth:`FollowStrategy.direction`; a new
strategy needs only this method. f1 to f7 also have a compiled loop over the whole window, which is tested against the
NumPy definition. The field models and controls of ``field_follow.py`` and ``flock_follow.py`` are registered here too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from usnet_env.arrays import Singles
from usnet_env.config import real_number, whole_number
from usnet_env.parts import Registry
from usnet_env.swarm import field_follow, flock_follow, kernels
from usnet_env.swarm.checks import check_part, check_returned
from usnet_env.swarm.field_follow import FieldStrategy
from usnet_env.swarm.strategy import KAPPA, KAPPA_NOISE, KAPPA_RANGE, FollowInputs, FollowStrategy, TrajectoryBatch

MOST_LAGS = 1000  # the largest ``memory``
MOST_NOISE = 1e6  # a follower's direction is then noise alone; in float32 its square is still finite


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
        """Compiled loop."""
        kappa, noise = np.full(self.lags, self.kappa, np.float32), np.float32(self.noise)
        kernels.fly_lags(kappa, self.square, noise, trajectories.root, *trajectories.flown)


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
        """Compiled loop."""
        constants = map(np.float32, (self.kappa, self.pull, self.reach, self.noise))
        kernels.fly_range(*constants, trajectories.root, *trajectories.flown)


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
        gains = np.repeat([self.position_gain, self.own_gain, self.head_gain], [3, past := 3 * kernels.MLP_LAGS, past])
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
        """Compiled loop."""
        scale, noise = np.float32(self.position_scale), np.float32(self.noise)
        kernels.fly_mlp(trajectories.parameters, scale, noise, trajectories.root, *trajectories.flown)


@dataclass(frozen=True)
class FollowFunction(FollowStrategy):
    """A follow strategy that calls a function; made by :func:`register_follow_strategy`."""

    function: Callable[[FollowInputs], Singles]
    lags: int = 4
    noise: float = KAPPA_NOISE
    equation: str = ""

    def direction(self, inputs: FollowInputs) -> Singles:
        """Call the function and check its result."""
        return check_returned("follow", self.function(inputs), (len(inputs.own_position), 3)).astype(np.float32)


def check_strategy(strategy: Any, subject: str = "strategy") -> FollowStrategy:
    """Return a strategy, made of a function if it is one.

    Raises:
        ArgumentError: it is neither, or its ``lags`` or ``noise`` is out of range.
    """
    strategy = check_part(subject, strategy, FollowStrategy, FollowFunction)
    whole_number("lags", strategy.lags, 1, MOST_LAGS)
    real_number("noise", strategy.noise, 0, MOST_NOISE)
    return strategy


#: The field models by name.
FIELD_MODELS: dict[str, FieldStrategy] = {
    "unequal_delays": field_follow.UnequalDelays(),
    "mixed": field_follow.Mixed(),
    "switching": field_follow.Switching(),
    "chain": field_follow.Chain(),
    "pigeons": field_follow.Pigeons(),
    "cucker_smale": field_follow.CuckerSmale(),
    "vicsek": flock_follow.Vicsek(),
    "couzin": flock_follow.Couzin(),
    "informed": flock_follow.Informed(),
    "frontness": field_follow.Frontness(),
    "part_time": field_follow.PartTime(),
    "partial_turns": field_follow.PartialTurns(),
    "predator": flock_follow.Predator(),
    "shepherd": flock_follow.Shepherd(),
    "reference": field_follow.Reference(),
}

#: The swarms without a head and without followers by name.
CONTROLS: dict[str, FieldStrategy] = {"independent": field_follow.Independent(), "shifted": field_follow.Shifted()}

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
        **FIELD_MODELS,
        **CONTROLS,
    },
    reserved=("none",),
)


#: The follow strategy of a name; see :meth:`usnet_env.parts.Registry.find`.
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
        replace: replace another strategy of this name, for example to run a notebook cell again.

    Raises:
        ArgumentError: another strategy has the name, or an argument has the wrong type or is out of range.
    """
    if callable(strategy) and not isinstance(strategy, FollowStrategy | type):
        strategy = FollowFunction(strategy, lags, noise, equation)
    FOLLOW_STRATEGIES.register(name, strategy, replace=replace)

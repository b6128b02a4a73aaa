"""Follow strategies: how a follower's next velocity depends on its head, equation (1) of the paper.

f1 to f7 are the strategies of the paper's Table II; each has a compiled loop over the whole window. A new one needs
only :meth:`FollowStrategy.direction`, or a function. The field models and controls of ``field_follow.py`` and
``flock_follow.py`` are registered here too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from usnet_env.arrays import Singles
from usnet_env.config import real_number, whole_number
from usnet_env.parts import Registry, accept_objects
from usnet_env.swarm import field_follow, flock_follow, follow_kernels
from usnet_env.swarm.field_follow import FieldStrategy
from usnet_env.swarm.field_kernels import EACH_CLUSTER, EACH_FOLLOWER
from usnet_env.swarm.open_follow import OPEN_LAWS
from usnet_env.swarm.random_follow import EpisodeRandomStrategy
from usnet_env.swarm.second_follow import SECOND_LAWS
from usnet_env.swarm.strategy import KAPPA, KAPPA_NOISE, KAPPA_RANGE, FollowInputs, FollowStrategy, TrajectoryBatch


@dataclass(frozen=True)
class LaggedSum(FollowStrategy):
    """f1 to f5: sum of the head's last velocities or of their squares (Table II, types 1 to 5).

    v * v (axis-wise) replaces v if ``square``.
    """

    compiled = True
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

    def fly(self, flight: TrajectoryBatch) -> None:
        """Compiled loop."""
        kappa, noise = np.full(self.lags, self.kappa, np.float32), np.float32(self.noise)
        follow_kernels.fly_lags(kappa, self.square, noise, flight.source, *flight.loop_arguments)


@dataclass(frozen=True)
class StayInRange(FollowStrategy):
    """f6: the head's velocity, plus a pull towards the head beyond the distance kappa_r (Table II, type 6)."""

    equation: str = "v_{i,t+1} = norm(κ_0 v_{iL,t} + κ_n n + 1{‖d‖ > κ_r} κ_p d / ‖d‖), d = p_{iL,t} − p_{i,t}"
    compiled = True
    lags: int = 1
    kappa: float = KAPPA
    pull: float = KAPPA
    reach: float = KAPPA_RANGE
    noise: float = KAPPA_NOISE

    def fly(self, flight: TrajectoryBatch) -> None:
        """Compiled loop."""
        constants = map(np.float32, (self.kappa, self.pull, self.reach, self.noise))
        follow_kernels.fly_range(*constants, flight.source, *flight.loop_arguments)


@dataclass(frozen=True)
class TanhNetworkStrategy(FollowStrategy):
    """f7: a random tanh network of the inputs of equation (1) (Table II, type 7; decision (c) on docs/game.md).

    It has one hidden layer of 16 units; the weights are drawn for each episode. The positions enter as
    (p_{i,t+1} - p_{iL,t-3}) / ``position_scale`` and as differences of consecutive own positions. Raw metres would
    saturate every unit, and the output would not depend on the head. The gains give the head's velocities the largest
    weight among the inputs of a hidden unit.
    """

    equation: str = "v_{i,t+1} = norm(MLP(P_{i,t+1}, V_{iL,t}, p_{iL,t-3}) + κ_n n)"
    compiled = True
    lags: int = follow_kernels.MLP_LAGS
    noise: float = KAPPA_NOISE
    position_scale: float = 300.0
    head_gain: float = 0.6
    own_gain: float = 0.1
    position_gain: float = 0.15

    def draw(self, rng: np.random.Generator) -> Singles:
        """Draw the weights, biases and output weights of one network."""
        past, inputs, units = 3 * follow_kernels.MLP_LAGS, follow_kernels.MLP_INPUTS, follow_kernels.MLP_HIDDEN
        gains = np.repeat([self.position_gain, self.own_gain, self.head_gain], [3, past, past])
        weights = gains[:, None] * rng.standard_normal((inputs, units))
        bias = 0.1 * rng.standard_normal(units)
        readout = rng.standard_normal((units, 3)) / np.sqrt(units)
        return np.concatenate([weights.ravel(), bias, readout.ravel()]).astype(np.float32)

    def fly(self, flight: TrajectoryBatch) -> None:
        """Compiled loop."""
        scale, noise = np.float32(self.position_scale), np.float32(self.noise)
        follow_kernels.fly_mlp(flight.parameters, scale, noise, flight.source, *flight.loop_arguments)


@dataclass(frozen=True)
class FollowFunction(FollowStrategy):
    """A follow strategy that calls a function; made by :func:`register_follow_strategy`."""

    function: Callable[[FollowInputs], Singles]
    lags: int = 4
    noise: float = KAPPA_NOISE
    equation: str = ""

    def direction(self, inputs: FollowInputs) -> Singles:
        """Call the function."""
        return self.function(inputs)


#: The field models by name: the equation, the citation, the broken assumption, the parameters, and their values.
FIELD_MODELS: dict[str, FieldStrategy] = {
    "unequal_delays": field_follow.CopyingStrategy(
        "v_{i,t+1} = norm((1 − g_i) v_{i,t} + g_i v_{iL,t+1−d_i} + κ_i n)",
        "reaction times as in Nagy et al. 2010",
        "one delay, gain and noise for all followers",
        ("delays", "gains", "noises", "noise"),
        delays=(1, 12), gains=(0.5, 1.0), noises=(0.5, 4.0),
    ),
    "mixed": field_follow.MixedStrategies(
        "v_{i,t+1} = norm(f_{k(i)}(V_{iL,t}) + κ_n n), k(i) ∈ {1, …, 6}",
        "paper, Table II",
        "one follow strategy in a swarm",
        ("reach", "noise"),
    ),
    "switching": field_follow.MixedStrategies(
        "v_{i,t+1} = norm(f_{k(L,⌊t / T⌋)}(V_{iL,t}) + κ_n n), k ∈ {1, …, 6}",
        "paper, Table II; switching regimes (Hamilton 1989)",
        "one follow strategy in a window",
        ("block_steps", "reach", "noise"),
        response_unit=EACH_CLUSTER,
    ),
    "chain": field_follow.Chain(
        "v_{i,t+1} = norm(v_{a(i),t} + κ_n n), a(i) above i in a tree of depth D",
        "hierarchical leadership (Shen 2007)",
        "every follower copies a head directly",
        ("depth", "noise"),
    ),
    "pigeons": field_follow.Hierarchy(
        "v_{i,t+1} = norm((1 − g_i) v_{i,t} + g_i mean_{k≤3} v_{a_k,t+1−d_ik} + κ_n n), d_ik = d_i + … + d_{a_{k−1}}",
        "Nagy et al. 2010, Nature 464:890",
        "followers lead no UAV, and one delay for all",
        ("links", "delays", "gains", "noise"),
        links=3, delays=(1, 3), gains=(0.6, 0.9),
    ),
    "cucker_smale": field_follow.Hierarchy(
        "v_{i,t+1} = norm(v_{i,t} + mean_{k≤8} K (1 + ‖p_{a_k} − p_i‖² / σ²)^{−0.4} (v_{a_k,t} − v_{i,t}) + κ_n n)",
        "Cucker & Smale 2007; Shen 2007, SIAM J. Appl. Math. 68:694",
        "every follower copies a head directly, whatever the distance",
        ("links", "strength", "scale", "noise"),
        links=8, strength=0.8,
    ),
    "vicsek": flock_follow.Flock(
        "v_{i,t+1} = norm(mean_{‖p_j − p_i‖ < r} v_{j,t} + κ_n n)",
        "Vicsek et al. 1995; one leader: Mwaffo et al. 2017",
        "followers copy a head and no other UAV",
        ("alignment", "noise"),
        noise=0.1,
    ),
    "couzin": flock_follow.Couzin(
        "v_{i,t+1} = norm(−Σ_{d<r_r} d_ij / ‖d_ij‖ + κ_n n), or else "
        "norm(mean_{d<r_o} v_{j,t} + w mean_{d<r_a} d_ij / ‖d_ij‖ + κ_n n)",
        "Couzin et al. 2002, 2005, Nature 433:513",
        "followers copy a head and no other UAV",
        ("repulsion", "alignment", "attraction", "attract", "noise"),
    ),
    "informed": flock_follow.Informed(
        "informed i: v_{i,t+1} = norm(d_i / ‖d_i‖ + ω v_{r,t} + κ_n n), d_i as in couzin, r a reference",
        "Couzin et al. 2005, Nature 433:513",
        "a head ignores the UAVs that it leads",
        ("share", "link", "repulsion", "alignment", "attraction", "attract", "noise"),
    ),
    "frontness": field_follow.Frontness(
        "v_{i,t+1} = norm(v_{iL,t} + κ_p g / max(‖g‖, 10) + κ_n n), g = p_{iL} + R_L (o_i − f a e_x) − p_i",
        "frontness as in Amornbunchornvej et al. 2018; Reynolds 1987",
        "heads fly in front",
        ("place", "offset", "pull", "near", "spread", "smoothing", "noise"),
    ),
    "part_time": field_follow.CopyingStrategy(
        "v_{i,t+1} = norm(v_{iL,t} + κ_n n) if h(L, ⌊t / T⌋) < q, else norm(v_{i,t} + κ_o n)",
        "changing leadership as in Amornbunchornvej et al. 2018 (FLICA)",
        "a head leads all the time",
        ("response_probability", "block_steps", "idle_noise", "noise"),
        response_unit=EACH_CLUSTER, response_probability=0.4,
    ),
    "partial_turns": field_follow.CopyingStrategy(
        "v_{i,t+1} = norm(v_{iL,t} + κ_n n) if h(i, ⌊t / T⌋) < q, else norm(v_{i,t} + κ_o n)",
        "partial responses to turns (Attanasi et al. 2014)",
        "every follower follows in every step",
        ("response_probability", "block_steps", "idle_noise", "noise"),
        response_unit=EACH_FOLLOWER, response_probability=0.5, block_steps=8,
    ),
    "predator": flock_follow.Predator(
        "prey: couzin + w_f (p_i − p_q) / ‖·‖ within r_f; predator q: v_{q,t+1} = norm(p_nearest − p_q + κ_n n)",
        "Couzin et al. 2002; Lee et al. 2006 (predator and prey flocks)",
        "the UAV that causes a turn leads, and a UAV that copies motion follows",
        ("flight", "flee", "noise"),
    ),
    "shepherd": flock_follow.Shepherd(
        "flock: couzin + w_f (p_i − p_s) / ‖·‖ within r_f; driver s: v_{s,t+1} = norm(p̄ − b u − p_s + κ_n n)",
        "Strömbom et al. 2014, J. R. Soc. Interface 11:20140719",
        "the UAV that causes a turn leads",
        ("flight", "flee", "standoff", "noise"),
    ),
    "reference": field_follow.Reference(
        "v_{i,t+1} = norm(v_{r,t} + κ_p g / max(‖g‖, 10) + κ_n n), g = p_r + R_r o_i − p_i, r a reference",
        "virtual structures (Lewis & Tan 1997; Ren & Beard 2004)",
        "every cluster has a head",
        ("pull", "near", "spread", "smoothing", "noise"),
    ),
}  # fmt: skip

#: The swarms without a head and without followers by name.
CONTROLS: dict[str, FieldStrategy] = {
    "independent": field_follow.Independent(
        "v_{i,t+1}: the mobility, for all i", "null model of independent tracks", "some UAVs lead"
    ),
    "shifted": field_follow.Shifted(
        "v_{i,t+1} = norm(v_{iL,t} + v_{iL,t−1} + κ_n n), observed as v_{i,(t−s_i) mod T}",
        "circularly shifted surrogates (Quian Quiroga et al. 2002)",
        "some UAVs lead",
        ("noise",),
    ),
}

#: Models of the suite ``limit``, which no environment draws.
LIMIT_MODELS: dict[str, FieldStrategy] = {
    "weak": field_follow.CopyingStrategy(
        "v_{i,t+1} = norm((1 − g_i) v_{i,t} + g_i v_{iL,t+1−d_i} + κ_n n), g_i from 0.1 to 0.3",
        breaks="a follower follows nothing but its head",
        parameters=("delays", "gains", "noise"),
        noise=0.18,  # of a smoother follower the track alone would tell that it is one
        delays=(1, 6), gains=(0.1, 0.3),
    ),
    "late": field_follow.CopyingStrategy(
        "v_{i,t+1} = norm((1 − g_i) v_{i,t} + g_i v_{iL,t+1−d_i} + κ_i n), d_i from 10 to 30",
        breaks="a follower answers soon",
        parameters=("delays", "gains", "noises", "noise"),
        delays=(10, 30), gains=(0.5, 1.0), noises=(0.5, 4.0),
    ),
}  # fmt: skip


def _vary(name: str, **changes: Any) -> FieldStrategy:
    return replace(FIELD_MODELS[name], **changes)


#: Models for swarms whose heads unseen UAVs lead (``led_by``). A flock needs a link, so that its UAVs copy a head. In a
#: chain the noise adds up from UAV to UAV, so it is small.
LED_MODELS: dict[str, FieldStrategy] = {
    "chain-led": _vary("chain", noise=0.02),
    "vicsek-led": _vary("vicsek", link=1.0),
    "couzin-led": _vary("couzin", link=1.0, attract=0.15),
    "informed-led": flock_follow.Linked(**{**vars(FIELD_MODELS["informed"]), "link": 1.0, "attract": 0.15}),
    "predator-led": _vary("predator", link=2.0, attract=0.15),  # as strong as alignment and flight together
}

_PAPER = {
    "f1": LaggedSum(1), "f2": LaggedSum(2), "f3": LaggedSum(3), "f4": LaggedSum(2, square=True),
    "f5": LaggedSum(3, square=True), "f6": StayInRange(), "f7": TanhNetworkStrategy(),
}  # fmt: skip
_RANDOM = {"random": EpisodeRandomStrategy()}
_BUILT_IN = {**_PAPER, **_RANDOM, **FIELD_MODELS, **CONTROLS, **LIMIT_MODELS, **LED_MODELS}
_BUILT_IN |= {**OPEN_LAWS, **SECOND_LAWS}

Lags, Network = LaggedSum, TanhNetworkStrategy  # their names in version 0.1.0

#: All follow strategies by name; ``"none"`` selects the control without followers.
FOLLOW_STRATEGIES = Registry[FollowStrategy](
    "follow strategy", "follow", "usnet.follow_strategies", __name__, accept_objects(FollowStrategy, FollowFunction),
    _BUILT_IN, reserved=("none",),
)  # fmt: skip


def register_follow_strategy(
    name: str, strategy: FollowStrategy | Callable[[FollowInputs], Singles], *, lags: int = 4,
    noise: float = KAPPA_NOISE, equation: str = "", replace: bool = False,
) -> None:  # fmt: skip
    """Register a follow strategy, so that ``follow=name`` selects it.

    Args:
        name: a new name.
        strategy: a :class:`FollowStrategy`, or a function from :class:`FollowInputs` of n followers to their directions
            ``(n, 3)``; the simulator adds noise and normalises.
        lags: for a function, the number of past head velocities that it uses.
        noise: for a function, kappa_n.
        equation: for a function, its equation as text for lists.
        replace: replace another strategy of this name, for example to run a notebook cell again.

    Raises:
        ArgumentError: another strategy has the name, ``strategy`` is neither a strategy nor a function, or a number is
            out of range.
    """
    if callable(strategy) and not isinstance(strategy, FollowStrategy | type):
        lags, noise = whole_number("lags", lags, 1, 1000), real_number("noise", noise, 0, 1e6)
        strategy = FollowFunction(strategy, lags, noise, equation)
    FOLLOW_STRATEGIES.register(name, strategy, replace=replace)

"""Random follow strategies for training and held-out tests; none of f1 to f7 can be drawn.

A strategy is a sum of one to three terms of the head's past velocities, followed by an output map. Every drawn strategy
has at least one part that no row of Table II has: a cube, a signed root, a product of axes, a small network or a
rotation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from usnet_env.arrays import Singles
from usnet_env.swarm import follow_kernels
from usnet_env.swarm.strategy import KAPPA_NOISE, FollowStrategy, TrajectoryBatch


@dataclass(frozen=True, eq=False)
class Term:
    """One summand: ``weight`` times a function of the head's velocity v, ``lag`` steps ago, on each axis.

    The ``kind`` is ``"linear"``, ``"cube"`` 1.7 v³, ``"root"`` sign(v) √|v|, ``"product"`` 3 v' v'' of the other axes,
    or ``"network"``.
    """

    kind: str
    lag: int
    weight: float
    layer: tuple[Singles, Singles] | None = None  # of a network of that velocity and the one before it


@dataclass(frozen=True, eq=False)
class RandomFollowStrategy(FollowStrategy):
    """A random strategy: norm(R g(sum of terms) + pull + kappa_n n) with g(x) = tanh(s x) / s on each axis.

    The follower is pulled towards the head's position plus ``offset``. ``None`` leaves out a part.
    """

    equation = "v_{i,t+1} = norm(R g(Σ_k w_k h_k(v_{iL,t−τ_k})) + κ_p g_i / max(‖g_i‖, 1) + κ_n n)"
    terms: tuple[Term, ...]
    rotation: Singles | None = None
    saturation: float | None = None
    offset: Singles | None = None
    pull: float = 0.0
    lags: int = 4
    noise: float = KAPPA_NOISE
    compiled = True

    def pack(self) -> Singles:
        """The coefficients ``(COEFFICIENTS,)`` that ``follow_kernels.fly_random`` reads; a part left out has zeros."""
        coefficients = np.zeros(follow_kernels.COEFFICIENTS, np.float32)
        rows = coefficients[: -follow_kernels.OUTPUT_SIZE].reshape(-1, follow_kernels.TERM_SIZE)
        for row, term in zip(rows, self.terms, strict=False):
            row[:3] = follow_kernels.TERM_KINDS.index(term.kind), term.lag, term.weight
            if term.layer is not None:
                row[3:] = np.concatenate([weights.ravel() for weights in term.layer])
        coefficients[-14:-5] = (np.eye(3) if self.rotation is None else self.rotation).ravel()
        coefficients[-5] = self.saturation or 0.0
        if self.offset is not None:
            coefficients[-4:-1], coefficients[-1] = self.offset, self.pull
        return coefficients

    def draw(self, rng: np.random.Generator) -> Singles:
        """The coefficients, which are the same in all episodes."""
        return self.pack()

    def fly(self, flight: TrajectoryBatch) -> None:
        """Compiled loop."""
        follow_kernels.fly_random(flight.parameters, np.float32(self.noise), flight.source, *flight.loop_arguments)


@dataclass(frozen=True)
class EpisodeRandomStrategy(RandomFollowStrategy):
    """``follow="random"``: in each episode another :class:`RandomFollowStrategy`."""

    equation = f"another one in each episode, none of f1 to f7: {RandomFollowStrategy.equation}"
    terms: tuple[Term, ...] = ()

    def draw(self, rng: np.random.Generator) -> Singles:
        """Draw the coefficients."""
        return random_follow_strategy(rng).pack()


def _draw_rotation(rng: np.random.Generator) -> Singles:
    """Draw a rotation ``(3, 3)`` by 30 to 150 degrees about a random axis (Rodrigues' formula)."""
    axis = rng.standard_normal(3)
    x, y, z = axis / np.linalg.norm(axis)
    angle = rng.uniform(np.pi / 6, 5 * np.pi / 6)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return (np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross).astype(np.float32)


def _draw_term(rng: np.random.Generator, kind: str) -> Term:
    layer = None
    if kind == "network":
        inner, outer = rng.normal(0.0, 1.0, (6, 8)), rng.standard_normal((8, 3)) / np.sqrt(8)
        layer = inner.astype(np.float32), outer.astype(np.float32)
    return Term(kind, int(rng.integers(0, 3)), float(rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5)), layer)


def random_follow_strategy(rng: np.random.Generator) -> RandomFollowStrategy:
    """Draw a follow strategy for ``SwarmConfig(follow=strategy)``, which has no further randomness but its noise."""
    kinds = rng.choice(("linear", "cube", "root", "product", "network"), size=int(rng.integers(1, 4))).tolist()
    terms = tuple(_draw_term(rng, kind) for kind in kinds)
    output = str(rng.choice(("none", "rotate", "saturate", "rotate+saturate")))
    if "rotate" not in output and all(kind == "linear" for kind in kinds):
        # Without a rotation, a positive sum of lags (saturated or not) would be close to f1, f2 or f3.
        output = "rotate"
    offset, pull = None, 0.0
    if rng.random() < 0.25:
        offset, pull = rng.normal(0.0, 30.0, 3).astype(np.float32), float(rng.uniform(0.2, 0.6))
    rotation = _draw_rotation(rng) if "rotate" in output else None
    saturation = float(rng.uniform(1.0, 3.0)) if "saturate" in output else None
    return RandomFollowStrategy(terms, rotation, saturation, offset, pull)

"""Evasive flight: what heads may choose for the next window, how the swarm then flies, and what the choices cost.

Three parts extend the simulator: a mobility that differs between heads, a follow strategy with a delay, and followers
that fly freely for one window. If every head chooses 0 everywhere, the flight equals the simulator's bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from usnet_env.arrays import Floats, Indices, Mask, Singles
from usnet_env.config import ArgumentError, Config, quote
from usnet_env.swarm import FollowInputs, FollowStrategy, Mobility, ObservationBatch, SwarmConfig, SwarmState, kernels
from usnet_env.swarm.config import Price
from usnet_env.swarm.mobility import MOBILITIES
from usnet_env.swarm.simulator import JITTER, advance
from usnet_env.swarm.strategy import TrajectoryBatch

Most = Annotated[int, Field(ge=0, le=1000)]


class Manoeuvres(Config):
    """What a head may choose for the next window, and the price in rounds (the unit of J_m).

    A decoy flies freely by its head's mobility for one window.
    """

    mobilities: Sequence[str] = Field(
        ("iid", "gauss_markov", "smooth_turn"),
        description="the mobilities to choose from; the first is the swarm's own and free",
    )
    most_decoys: Most = Field(2, description="most followers that a head may turn into decoys, the nearest first")
    most_delay: Most = Field(4, description="largest delay of the head's motion that its followers use, steps")
    mobility_price: Price = Field(0.1, description="of a mobility but the first, times the share of the head's cluster")
    jitter_price: Price = Field(0.05, description="of flying with the followers' noise, times the same share")
    decoy_price: Price = Field(1.0, description="of each decoy, times 1/N; 1 is that of a redundant candidate in J_m")
    delay_price: Price = Field(0.05, description="of each step of delay, times the share that follows the head")

    @model_validator(mode="after")
    def _known(self) -> Self:
        names = self.mobilities
        if not names or len(set(names)) != len(names) or not set(names) <= set(MOBILITIES):
            raise ArgumentError(f"mobilities must be different names of {', '.join(MOBILITIES)}, got {quote(names)}.")
        return self

    @property
    def choices(self) -> Indices:
        """``(4,)`` int64, sizes of the choices mobility, jitter, decoys and delay, as in ``MultiDiscrete``."""
        return np.array([len(self.mobilities), 2, self.most_decoys + 1, self.most_delay + 1])


@dataclass(frozen=True, eq=False)
class Plan:
    """The choices of all heads for the next window, in the order of the heads' indices; each ``(M,)`` int64."""

    mobility: Indices
    jitter: Indices
    decoys: Indices
    delay: Indices


@dataclass(frozen=True, eq=False)
class MixedMobility(Mobility):
    """A mobility that differs between UAVs: free UAV i flies by ``laws[which[i]]``, with noise if ``jitter[i]``."""

    laws: tuple[Mobility, ...]
    which: Indices
    jitter: Mask
    noise: float

    def start(self, rng: np.random.Generator, uavs: int) -> Floats:
        """Not defined: the states are those of the laws."""
        raise NotImplementedError("a mix of mobilities flies one window, and starts none")

    def fly(self, state: Floats, position: Singles, steps: int, rng: np.random.Generator) -> Singles:
        """Draw the directions of all UAVs, one law after another."""
        directions = np.empty((steps, len(position), 3), np.float32)
        for number in np.unique(self.which):
            rows = np.flatnonzero(self.which == number)
            part = state[rows]
            directions[:, rows] = self.laws[number].fly(part, position[rows], steps, rng)
            state[rows] = part
        if self.jitter.any():
            noise = rng.standard_normal(directions.shape, dtype=np.float32) * np.float32(self.noise)
            # A registered law may return directions of any length, but the noise is relative to length 1.
            length = np.sqrt((directions * directions).sum(axis=-1, keepdims=True) + np.float32(1e-12))
            directions = np.where(self.jitter[:, None], directions / length + noise, directions)
        return directions


@dataclass(frozen=True, eq=False)
class DelayedFollow(FollowStrategy):
    """A follow strategy whose followers use their head's motion of some steps before.

    During the flight every head with a ``delay`` ``(N,)`` gets a ghost: an extra UAV that repeats the head's track that
    many steps later. The followers follow the ghost, so that every strategy, compiled or not, runs its own code.
    """

    strategy: FollowStrategy
    delay: Indices

    def __post_init__(self) -> None:
        for name in ("noise", "shifts_tracks"):  # what `advance` asks a strategy for
            object.__setattr__(self, name, getattr(self.strategy, name))

    def direction(self, inputs: FollowInputs) -> Singles:
        """The direction of the strategy, whose inputs are then those of the ghost."""
        return self.strategy.direction(inputs)

    def fly(self, flight: TrajectoryBatch) -> None:
        """Fly with the ghosts appended to the UAVs, and remove them afterwards."""
        heads = np.flatnonzero(self.delay)
        if not len(heads):
            self.strategy.fly(flight)
            return
        uavs = flight.motion.shape[1]

        def widen(array: NDArray[Any], axis: int, value: int = 0) -> NDArray[Any]:
            return np.insert(array, [uavs] * len(heads), value, axis=axis)

        position, velocity = widen(flight.position, 2), widen(flight.velocity, 2)
        root, source = widen(flight.root, 1), widen(flight.source, 1)
        for ghost, head in enumerate(heads, start=uavs):
            late = int(self.delay[head])
            position[:, late : flight.start + 1, ghost] = flight.position[:, : flight.start + 1 - late, head]
            velocity[:, late:, ghost] = flight.velocity[:, :-late, head]
            for copied in (root, source):
                copied[copied == head] = ghost
                copied[:, ghost] = ghost
        noise, motion = widen(flight.noise, 2), widen(flight.motion, 1, kernels.FREE)
        swarm = root, flight.parameters, source, widen(flight.bystander, 1), flight.clock
        self.strategy.fly(TrajectoryBatch(position, velocity, noise, motion, *swarm))
        flight.position[...] = position[:, :, :uavs]
        flight.velocity[...] = velocity[:, :, :uavs]


def _sort_followers(state: SwarmState, head: int) -> NDArray[np.intp]:
    """The living followers of a head, the nearest first; ``state`` is a batch of one."""
    followers = np.flatnonzero((state.root[0] == head) & state.alive[0] & ~state.head[0] & ~state.decoy[0])
    gap = state.position[0, followers] - state.position[0, head]
    return followers[np.argsort((gap * gap).sum(axis=1), kind="stable")]


def select_decoys(state: SwarmState, plan: Plan) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Select the followers that become decoys, the nearest of each head first; each head keeps at least one follower.

    Returns their indices, and for each the row of its head in the plan; both ``(d,)``.
    """
    heads = np.flatnonzero(state.head[0])
    decoys = [_sort_followers(state, int(head))[:-1][:wanted] for head, wanted in zip(heads, plan.decoys, strict=True)]
    return np.concatenate(decoys), np.repeat(np.arange(len(heads)), [len(taken) for taken in decoys])


def compute_prices(manoeuvres: Manoeuvres, state: SwarmState, plan: Plan) -> Floats:
    """The price ``(M,)`` of the plan for each head, in rounds (the unit of J_m); 0 for a destroyed head.

    A head pays for each choice its price times the share of the swarm that flies differently because of it.
    """
    uavs = state.alive.shape[1]
    heads = np.flatnonzero(state.head[0])
    followers = np.array([len(_sort_followers(state, int(head))) for head in heads])
    _, rows = select_decoys(state, plan)
    decoys = np.bincount(rows, minlength=len(heads))
    cluster = np.where(plan.mobility > 0, manoeuvres.mobility_price, 0.0) + manoeuvres.jitter_price * plan.jitter
    cost = (followers + 1) * cluster + manoeuvres.decoy_price * decoys
    cost = cost + manoeuvres.delay_price * plan.delay * (followers - decoys)
    return np.asarray(np.where(state.alive[0, heads], cost / uavs, 0.0))


def fly_window(
    config: SwarmConfig,
    manoeuvres: Manoeuvres,
    state: SwarmState,
    flown: Indices,
    plan: Plan,
    rngs: Sequence[np.random.Generator],
) -> tuple[SwarmState, ObservationBatch, Indices]:
    """Fly the next window as the heads planned it; otherwise the same as :func:`usnet_env.swarm.advance`.

    ``state`` is a batch of one. ``flown`` ``(M,)`` has the mobility of each head before; a head that changes
    it gets a new state. It returns the state at the end, the window, and the mobility of each head in it.
    """
    laws = tuple(MOBILITIES.find(name) for name in manoeuvres.mobilities)
    heads = np.flatnonzero(state.head[0])
    free = state.free[0]
    row_of = {int(head): row for row, head in enumerate(heads)}
    decoys, decoy_rows = select_decoys(state, plan)
    rows = np.array([*(row_of.get(int(uav), -1) for uav in free), *decoy_rows], np.int64)  # -1: a decoy of the episode
    planned = rows >= 0
    now = np.where(state.alive[0, heads], plan.mobility, flown)
    which = np.where(planned, now[rows], 0)
    jitter = planned & (plan.jitter[rows] > 0)
    restarted = planned & (now[rows] != flown[rows])
    restarted[len(free) :] = True

    added = np.zeros((len(decoys), state.mobility_state.shape[2]))
    mobility_state = np.concatenate([state.mobility_state[0], added])
    for row in np.flatnonzero(restarted):
        mobility_state[row] = laws[which[row]].start(rngs[0], 1)[0]
    changes: dict[str, Mobility | FollowStrategy | str] = {}
    if jitter.any() or which.any():
        strategy = config.follow_strategy
        changes["mobility"] = MixedMobility(laws, which, jitter, JITTER if strategy is None else strategy.noise)
    delay = np.zeros(state.alive.shape[1], np.int64)
    delay[heads] = np.where(state.alive[0, heads], plan.delay, 0)
    if delay.any() and config.follow_strategy is not None:
        changes["follow"] = DelayedFollow(config.follow_strategy, delay)
    changed = config.model_copy(update=changes) if changes else config
    before = replace(state, free=np.concatenate([free, decoys])[None], mobility_state=mobility_state[None])
    after, sighting = advance(changed, before, rngs)
    kept = replace(after, free=state.free, mobility_state=after.mobility_state[:, : len(free)])
    return kept, sighting, now

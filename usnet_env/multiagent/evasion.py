"""How heads that know they are watched fly the next window, and what that costs their formation.

Everything here is put together from the simulator's parts: a mobility of several laws, a follow strategy that looks at
an older head, and followers that fly freely for one window. A swarm whose heads all fly as they always do takes the
simulator's ordinary way, bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from usnet_env.config import ArgumentError, Config, quote
from usnet_env.swarm import (
    FollowInputs,
    FollowStrategy,
    Mobility,
    ObservationBatch,
    SwarmConfig,
    SwarmState,
    advance,
    kernels,
)
from usnet_env.swarm.mobility import mobility
from usnet_env.swarm.simulator import JITTER
from usnet_env.swarm.trajectory import TrajectoryBatch

__all__ = ["Delayed", "Manoeuvres", "Mixed", "Plan", "fly", "followers_of", "handed", "price"]

Price = Annotated[float, Field(ge=0, le=1e6)]


class Manoeuvres(Config):
    """What a head may choose for the next window, and the price in rounds (the unit of J_m).

    Args:
        mobilities: names of the mobilities on offer; the first is the swarm's own, which costs nothing.
        most_decoys: a head may hand the role of a decoy to as many of its followers, the nearest first; each flies as
            its head does, by itself, for one window. At least one follower keeps following.
        most_delay: followers may steer by what their head did up to this many steps earlier.
        mobility_price: for flying another mobility, times the share of the swarm in the head's cluster.
        jitter_price: for flying with the followers' noise, times the same share.
        decoy_price: for each follower off its place, times 1/N, as a redundant candidate counts in J_m.
        delay_price: for each step of delay, times the share of the swarm that follows.
    """

    mobilities: tuple[str, ...] = ("iid", "gauss_markov", "smooth_turn")
    most_decoys: Annotated[int, Field(ge=0, le=1000)] = 2
    most_delay: Annotated[int, Field(ge=0, le=1000)] = 4
    mobility_price: Price = 0.1
    jitter_price: Price = 0.05
    decoy_price: Price = 1.0
    delay_price: Price = 0.05

    @model_validator(mode="after")
    def _known(self) -> Self:
        for name in self.mobilities:
            mobility(name)
        if not self.mobilities or len(set(self.mobilities)) != len(self.mobilities):
            raise ArgumentError(
                f"mobilities must hold one or more different names, got {quote(list(self.mobilities))}."
            )
        return self

    @property
    def choices(self) -> NDArray[np.int64]:
        """``(4,)`` how many values mobility, jitter, decoys and delay have: a head's ``MultiDiscrete``."""
        return np.array([len(self.mobilities), 2, self.most_decoys + 1, self.most_delay + 1])


@dataclass(frozen=True, eq=False)
class Plan:
    """How every head flies the next window, in the order of the heads' indices; all ``(M,)`` int64.

    Args:
        mobility: index into ``Manoeuvres.mobilities``.
        jitter: 1 for the followers' noise.
        decoys: how many followers get the role of a decoy.
        delay: steps.
    """

    mobility: NDArray[np.int64]
    jitter: NDArray[np.int64]
    decoys: NDArray[np.int64]
    delay: NDArray[np.int64]

    @classmethod
    def of(cls, choices: NDArray[np.int64]) -> Plan:
        """The plan in ``(M, 4)`` choices."""
        return cls(*np.asarray(choices, np.int64).T.copy())


@dataclass(frozen=True, eq=False)
class Mixed(Mobility):
    """Several mobilities at once: row i of the free UAVs flies by ``laws[which[i]]``, with jitter where ``jitter[i]``.

    Args:
        laws: the mobilities.
        which: ``(n,)`` int64.
        jitter: ``(n,)`` bool.
        noise: standard deviation of the jitter, per axis of a unit direction.
    """

    laws: tuple[Mobility, ...]
    which: NDArray[np.int64]
    jitter: NDArray[np.bool_]
    noise: float

    def start(self, rng: np.random.Generator, uavs: int) -> NDArray[np.float64]:
        """States of UAVs that begin to fly, each by its law."""
        state = np.zeros((uavs, kernels.MOBILITY_STATE))
        for number in np.unique(self.which):
            rows = np.flatnonzero(self.which == number)
            state[rows] = self.laws[number].start(rng, len(rows))
        return state

    def fly(
        self, state: NDArray[np.float64], position: NDArray[np.float32], steps: int, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        """Fly every row by its law, the laws one after another."""
        directions = np.empty((steps, len(position), 3), np.float32)
        for number in np.unique(self.which):
            rows = np.flatnonzero(self.which == number)
            part = state[rows]
            directions[:, rows] = self.laws[number].fly(part, position[rows], steps, rng)
            state[rows] = part
        if self.jitter.any():
            wobble = rng.standard_normal(directions.shape, dtype=np.float32) * np.float32(self.noise)
            # The laws of strangers give directions of any length, and jitter is relative to a length of one.
            length = np.sqrt((directions * directions).sum(axis=-1, keepdims=True) + np.float32(1e-12))
            directions = np.where(self.jitter[:, None], directions / length + wobble, directions)
        return directions


@dataclass(frozen=True, eq=False)
class Delayed(FollowStrategy):
    """A follow strategy whose followers see their head as it was some steps ago.

    For the flight, every head with a delay gets a ghost that flies the head's track so many steps later, and its
    followers follow the ghost: any strategy, compiled or not, then flies by its own code.

    Args:
        strategy: what the followers obey.
        delay: ``(N,)`` int64, steps by which the followers of each UAV lag, 0 for none.
    """

    strategy: FollowStrategy
    delay: NDArray[np.int64]

    @property
    def lags(self) -> int:  # type: ignore[override]  # follows from the fields
        """Steps of the past that are looked at, the delay included."""
        return self.strategy.lags + int(self.delay.max(initial=0))

    @property
    def noise(self) -> float:  # type: ignore[override]  # follows from the fields
        """kappa_n of the strategy."""
        return self.strategy.noise

    def draw(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """Parameters of the strategy."""
        return self.strategy.draw(rng)

    def direction(self, inputs: FollowInputs) -> NDArray[np.float32]:
        """That of the strategy: who follows a ghost sees the ghost's past."""
        return self.strategy.direction(inputs)

    def fly(self, flight: TrajectoryBatch) -> None:
        """Fly with ghosts at the end of the list of UAVs; they are gone afterwards."""
        heads = np.flatnonzero(self.delay)
        if not len(heads):
            self.strategy.fly(flight)
            return
        uavs, many = flight.motion.shape[1], len(heads)
        widened = [(0, 0), (0, 0), (0, many), (0, 0)]
        position, velocity, noise = (
            np.pad(array, widened) for array in (flight.position, flight.velocity, flight.noise)
        )
        leader = np.pad(flight.leader, [(0, 0), (0, many)])
        for number, head in enumerate(heads):
            ghost, late = uavs + number, int(self.delay[head])
            position[:, late : flight.start + 1, ghost] = flight.position[:, : flight.start + 1 - late, head]
            velocity[:, late:, ghost] = flight.velocity[:, :-late, head]
            leader[leader == head] = ghost
            leader[:, ghost] = ghost
        kind = np.pad(flight.motion, [(0, 0), (0, many)], constant_values=kernels.FREE)
        self.strategy.fly(TrajectoryBatch(position, velocity, noise, kind, leader, flight.parameters))
        flight.position[...] = position[:, :, :uavs]
        flight.velocity[...] = velocity[:, :, :uavs]


def _followers(state: SwarmState, head: int) -> NDArray[np.intp]:
    """Living followers of a head of a batch of one, the nearest first."""
    who = np.flatnonzero((state.leader[0] == head) & state.alive[0] & ~state.head[0] & ~state.decoy[0])
    gap = state.position[0, who] - state.position[0, head]
    return who[np.argsort((gap * gap).sum(axis=1), kind="stable")]


def followers_of(state: SwarmState) -> NDArray[np.int64]:
    """``(M,)`` how many living UAVs follow each head, in the order of the heads' indices; 0 for a destroyed one."""
    heads = np.flatnonzero(state.head[0])
    return np.array([len(_followers(state, int(h))) if state.alive[0, h] else 0 for h in heads], np.int64)


def handed(state: SwarmState, plan: Plan) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Which followers take the role of a decoy, and by which head's wish (a row of the plan).

    Args:
        state: a batch of one.
        plan: for its M heads; a destroyed head's row counts for nothing. A head keeps one follower at least.

    Returns:
        Indices of UAVs, and rows of the plan, of the same length.
    """
    who, rows = [], []
    for row, head in enumerate(np.flatnonzero(state.head[0])):
        if state.alive[0, head] and plan.decoys[row]:
            near = _followers(state, int(head))
            taken = near[: min(int(plan.decoys[row]), max(len(near) - 1, 0))]
            who.append(taken)
            rows.append(np.full(len(taken), row))
    if not who:
        return np.empty(0, np.intp), np.empty(0, np.intp)
    return np.concatenate(who), np.concatenate(rows)


def price(manoeuvres: Manoeuvres, state: SwarmState, plan: Plan) -> NDArray[np.float64]:
    """``(M,)`` what the plan costs each head, in rounds; 0 for a destroyed one.

    The price is for formation lost: the share of the swarm that flies otherwise than it would, weighted by choice.
    """
    uavs = state.alive.shape[1]
    heads = np.flatnonzero(state.head[0])
    led = followers_of(state)
    _, rows = handed(state, plan)
    off_place = np.bincount(rows, minlength=len(heads))
    cluster = np.where(plan.mobility > 0, manoeuvres.mobility_price, 0.0) + manoeuvres.jitter_price * plan.jitter
    cost = (led + 1) * cluster + manoeuvres.decoy_price * off_place
    cost = cost + manoeuvres.delay_price * plan.delay * (led - off_place)
    return np.asarray(np.where(state.alive[0, heads], cost / uavs, 0.0))


def fly(
    config: SwarmConfig,
    manoeuvres: Manoeuvres,
    state: SwarmState,
    flown: NDArray[np.int64],
    plan: Plan,
    rngs: Sequence[np.random.Generator],
) -> tuple[SwarmState, ObservationBatch, NDArray[np.int64]]:
    """Fly the next window of a batch of one as its heads planned it; else as :func:`usnet_env.swarm.advance`.

    Args:
        config: the swarm, with its own mobility and follow strategy.
        manoeuvres: what is on offer.
        state: a batch of one with a head left.
        flown: ``(M,)`` int64, the mobility that each head flew last: who changes starts anew.
        plan: what the heads chose.
        rngs: the episode's generator.

    Returns:
        The state at the window's end, the window, and the mobilities flown.
    """
    laws = tuple(mobility(name) for name in manoeuvres.mobilities)
    heads = np.flatnonzero(state.head[0])
    free = state.free[0]
    row_of = {int(head): row for row, head in enumerate(heads)}
    followers, wishes = handed(state, plan)
    rows = np.array([*(row_of.get(int(uav), -1) for uav in free), *wishes], np.int64)  # -1: a decoy of the episode
    led = rows >= 0
    now = np.where(state.alive[0, heads], plan.mobility, flown)
    which = np.where(led, now[rows], 0)
    jitter = led & (plan.jitter[rows] > 0)
    anew = led & (now[rows] != flown[rows])
    anew[len(free) :] = True

    room = np.zeros((len(followers), state.mobility_state.shape[2]))
    mobility_state = np.concatenate([state.mobility_state[0], room])
    for row in np.flatnonzero(anew):
        mobility_state[row] = laws[which[row]].start(rngs[0], 1)[0]
    changes: dict[str, Mobility | FollowStrategy | str] = {}
    if jitter.any() or which.any():
        strategy = config.follow_strategy
        changes["mobility"] = Mixed(laws, which, jitter, JITTER if strategy is None else strategy.noise)
    delay = np.zeros(state.alive.shape[1], np.int64)
    delay[heads] = np.where(state.alive[0, heads], plan.delay, 0)
    if delay.any() and config.follow_strategy is not None:
        changes["follow"] = Delayed(config.follow_strategy, delay)
    planned = config.model_copy(update=changes) if changes else config
    before = replace(state, free=np.concatenate([free, followers])[None], mobility_state=mobility_state[None])
    after, sighting = advance(planned, before, rngs)
    kept = replace(after, free=state.free, mobility_state=after.mobility_state[:, : len(free)])
    return kept, sighting, now

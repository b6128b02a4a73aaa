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
from usnet_env.swarm.flight import JITTER, normalise
from usnet_env.swarm.mobility import MOBILITIES
from usnet_env.swarm.simulator import advance
from usnet_env.swarm.state import find_each
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
    """The choices of all heads for the next window, in the order of the heads' indices; each ``(B, M)`` int64."""

    mobility: Indices
    jitter: Indices
    decoys: Indices
    delay: Indices


@dataclass(frozen=True, eq=False)
class MixedMobility(Mobility):
    """Free UAV i of swarm b flies by ``mobilities[which[b, i]]``, with noise if ``jitter[b, i]``; -1: as the first one.

    A swarm with fewer free UAVs than another of its batch names its first one again, as often as it lacks.
    """

    mobilities: tuple[Mobility, ...]
    which: Indices
    jitter: Mask
    noise: float

    start = fly = None  # type: ignore[assignment]  # the states are those of the mobilities, and it flies batches only

    def fly_batch(self, state: Floats, position: Singles, steps: int, rngs: Sequence[np.random.Generator]) -> Singles:
        """Draw the directions of the UAVs of each swarm, one mobility after another, and then the noise."""
        directions = np.zeros((len(rngs), steps, *position.shape[1:]), np.float32)
        for b, (rng, which, noisy) in enumerate(zip(rngs, self.which, self.jitter, strict=True)):
            for number in np.unique(which[which >= 0]).tolist():
                uavs = which == number
                part = state[b, uavs]
                flown = self.mobilities[number].fly_batch(part[None], position[[b]][:, uavs], steps, [rng])
                directions[b][:, uavs] = flown[0]
                state[b, uavs] = part
            if noisy.any():
                noise = rng.standard_normal((steps, int((which >= 0).sum()), 3), dtype=np.float32)[:, noisy[which >= 0]]
                # A registered mobility may return directions of any length, but the noise is relative to length 1.
                directions[b][:, noisy] = normalise(directions[b][:, noisy]) + noise * np.float32(self.noise)
            directions[b][:, which < 0] = directions[b][:, :1]
        return directions


@dataclass(frozen=True, eq=False)
class DelayedFollow(FollowStrategy):
    """A follow strategy whose followers use their head's motion of some steps before.

    During the flight every one of the ``heads`` ``(B, M)`` gets a ghost: an extra UAV that repeats the head's track
    ``delay`` ``(B, M)`` steps later. The followers follow the ghost, so that every strategy, compiled or not, runs its
    own code. If the delay is 0, no UAV follows the ghost.
    """

    strategy: FollowStrategy
    heads: Indices
    delay: Indices

    def __post_init__(self) -> None:
        for name in ("noise", "shifts_tracks"):  # what `advance` asks a strategy for
            object.__setattr__(self, name, getattr(self.strategy, name))

    def direction(self, inputs: FollowInputs) -> Singles:
        """The direction of the strategy, whose inputs are then those of the ghost."""
        return self.strategy.direction(inputs)

    def fly(self, flight: TrajectoryBatch) -> None:
        """Fly with the ghosts appended to the UAVs, and remove them afterwards."""
        (episodes, uavs), clusters = flight.motion.shape, self.heads.shape[1]
        ghosts = np.tile(np.arange(uavs, uavs + clusters), (episodes, 1))
        copied = np.tile(np.arange(uavs), (episodes, 1))
        np.put_along_axis(copied, self.heads, np.where(self.delay > 0, ghosts, self.heads), axis=1)
        root, source = (
            np.concatenate([np.where(leader < 0, leader, np.take_along_axis(copied, leader, axis=1)), ghosts], axis=1)
            for leader in (flight.root, flight.source)
        )

        def add_late(track: Singles) -> Singles:
            when = np.arange(track.shape[1])[:, None] - self.delay[:, None]
            late = track[np.arange(episodes)[:, None, None], np.maximum(when, 0), self.heads[:, None]]
            late[when < 0] = 0.0
            return np.concatenate([track, late], axis=2)

        def widen(array: NDArray[Any], axis: int, value: int = 0) -> NDArray[Any]:
            ghosts = np.full_like(array.take(range(clusters), axis), value)
            return np.concatenate([array, ghosts], axis=axis)

        position, velocity = add_late(flight.position), add_late(flight.velocity)
        noise, motion = widen(flight.noise, 2), widen(flight.motion, 1, kernels.FREE)
        swarm = root, flight.parameters, source, widen(flight.not_led, 1), flight.clock
        self.strategy.fly(TrajectoryBatch(position, velocity, noise, motion, *swarm))
        flight.position[...] = position[:, :, :uavs]
        flight.velocity[...] = velocity[:, :, :uavs]


def find_followers(state: SwarmState) -> Mask:
    """The living followers of each head, ``(B, M, N)``."""
    led = state.root[:, None] == find_each(state.head)[..., None]
    return np.asarray(led & (state.alive & ~state.head & ~state.decoy)[:, None])


def select_decoys(state: SwarmState, plan: Plan) -> tuple[Indices, Mask]:
    """Select the followers that become decoys, the nearest of each head first; each head keeps at least one follower.

    Returns followers of each head and which of them become decoys, both ``(B, M, d)``.
    """
    followers = find_followers(state)
    of_heads = np.take_along_axis(state.position, find_each(state.head)[..., None], axis=1)
    offset = state.position[:, None] - of_heads[:, :, None]
    nearest = np.argsort(np.where(followers, (offset * offset).sum(axis=-1), np.inf), axis=-1, kind="stable")
    nearest = nearest[..., : plan.decoys.max(initial=0)]
    return nearest, np.arange(nearest.shape[2]) < count_decoys(followers.sum(axis=-1), plan)[..., None]


def count_decoys(followers: Indices, plan: Plan) -> Indices:
    """How many of so many followers ``(B, M)`` become decoys."""
    return np.minimum(plan.decoys, np.maximum(followers - 1, 0))


def compute_prices(manoeuvres: Manoeuvres, state: SwarmState, plan: Plan) -> Floats:
    """The price ``(B, M)`` of the plan for each head, in rounds (the unit of J_m); 0 for a destroyed head.

    A head pays for each choice its price times the share of the swarm that flies differently because of it.
    """
    followers = find_followers(state).sum(axis=-1)
    decoys = count_decoys(followers, plan)
    cluster = np.where(plan.mobility > 0, manoeuvres.mobility_price, 0.0) + manoeuvres.jitter_price * plan.jitter
    cost = (followers + 1) * cluster + manoeuvres.decoy_price * decoys
    cost = cost + manoeuvres.delay_price * plan.delay * (followers - decoys)
    living = np.take_along_axis(state.alive, find_each(state.head), axis=1)
    return np.where(living, cost / state.alive.shape[1], 0.0)


def fly_windows(
    config: SwarmConfig,
    manoeuvres: Manoeuvres,
    state: SwarmState,
    flown: Indices,
    plan: Plan,
    decoys: tuple[Indices, Mask],
    rngs: Sequence[np.random.Generator],
) -> tuple[SwarmState, ObservationBatch, Indices]:
    """Fly the next windows as the heads planned it; otherwise the same as :func:`usnet_env.swarm.advance`.

    ``flown`` ``(B, M)`` has the mobility of each head before; a head that changes it gets a new state. ``decoys`` are
    those of :func:`select_decoys`. It returns the state at the end, the windows, and the mobility of each head in them.
    """
    mobilities = tuple(MOBILITIES.find(name) for name in manoeuvres.mobilities)
    heads, (uavs, taken) = find_each(state.head), decoys
    now = np.where(np.take_along_axis(state.alive, heads, axis=1), plan.mobility, flown)
    obeys = state.free[..., None] == heads[:, None]
    row = np.tile(np.repeat(np.arange(heads.shape[1]), taken.shape[2]), (len(heads), 1))
    row = np.concatenate([obeys.argmax(axis=2), row], axis=1)  # the head whose plan a free UAV obeys
    taken = taken.reshape(len(heads), -1)
    present = np.hstack([np.ones_like(state.free, bool), taken])
    planned = np.hstack([obeys.any(axis=2), taken])  # a decoy of the episode: by no head

    def plan_of(choice: Indices) -> Indices:
        return np.where(planned, np.take_along_axis(choice, row, axis=1), 0)

    which, jitter = plan_of(now), plan_of(plan.jitter) > 0
    free = np.hstack([state.free, np.where(taken, uavs.reshape(len(heads), -1), state.free[:, :1])])
    mobility_state = np.concatenate([state.mobility_state, np.zeros((*taken.shape, state.mobility_state.shape[2]))], 1)
    turned = np.hstack([np.zeros_like(state.free, bool), taken])  # into decoys
    for b, i in np.argwhere(turned | (which != plan_of(flown))).tolist():
        mobility_state[b, i] = mobilities[which[b, i]].start(rngs[b], 1)[0]
    before = replace(state, free=free, mobility_state=mobility_state)
    mixed = jitter.any(axis=1) | which.any(axis=1)
    kinds = np.where(mixed, -1, taken.sum(axis=1))  # swarms whose UAVs all fly by the swarm's mobility stay as they are
    noise = JITTER if config.follow_strategy is None else config.follow_strategy.noise
    flights, order = [], []
    for kind in np.unique(kinds):
        rows = np.flatnonzero(kinds == kind)
        changes: dict[str, Mobility | FollowStrategy] = {}
        swarms = before if len(rows) == len(kinds) else before.rows(rows)
        if kind < 0:
            changes["mobility"] = MixedMobility(mobilities, np.where(present, which, -1)[rows], jitter[rows], noise)
        else:
            free_uavs = {name: getattr(swarms, name)[present[rows]] for name in ("free", "mobility_state")}
            shaped = {name: part.reshape(len(rows), -1, *part.shape[1:]) for name, part in free_uavs.items()}
            swarms = replace(swarms, **shaped)
        delay = np.where(swarms.alive[np.arange(len(rows))[:, None], heads[rows]], plan.delay[rows], 0)
        if delay.any() and config.follow_strategy is not None:
            changes["follow"] = DelayedFollow(config.follow_strategy, heads[rows], delay)
        changed = config.model_copy(update=changes) if changes else config
        after, window = advance(changed, swarms, [rngs[b] for b in rows.tolist()])
        lasting = after.mobility_state[:, : state.free.shape[1]]
        flights.append((replace(after, free=state.free[rows], mobility_state=lasting), window))
        order.append(rows)
    if len(flights) == 1:
        return *flights[0], now
    back = np.argsort(np.concatenate(order))
    windows = {name: np.concatenate([getattr(each, name) for _, each in flights])[back] for name in vars(flights[0][1])}
    return SwarmState.join([swarms for swarms, _ in flights]).rows(back), ObservationBatch(**windows), now

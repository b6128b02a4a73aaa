"""The simulator: pure functions from a state and random generators to the next state and the observed window.

A batch has a leading axis B and one generator per episode. All random numbers of an episode come from its own
generator, in an order that does not depend on the batch. So episode b of a batch equals the single swarm with the same
seed, bit for bit. A free UAV is one that follows no UAV: a head, decoy or bystander, and every UAV with
``follow="none"``.

With the kinematics ``unit`` one call simulates all steps of a window. With any other, a step at a time is simulated:
first what the UAVs want, by the same mobilities and follow strategies, then what they fly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Singles
from usnet_env.swarm import kernels
from usnet_env.swarm.checks import check_returned
from usnet_env.swarm.config import SwarmConfig
from usnet_env.swarm.formation import FARTHEST, FORMATIONS, draw_corridors
from usnet_env.swarm.kinematics import Unit
from usnet_env.swarm.mobility import MOBILITIES, CompiledMobility, Mobility
from usnet_env.swarm.sensing import ObservationBatch, sense, shift_tracks
from usnet_env.swarm.state import Roles, SwarmState
from usnet_env.swarm.strategy import TrajectoryBatch

Generators = Sequence[np.random.Generator]

_CHUNK_BYTES = 1 << 20  # size of one chunk of noise: small enough to stay in the processor cache until it is used


def random_cluster_sizes(rng: np.random.Generator, clusters: int, followers: int) -> Indices:
    """Draw the number of followers of each cluster, ``(clusters,)`` int64, each at least 2.

    The remaining ``followers - 2 * clusters`` are split at random; all splits are equally likely (stars and bars).
    """
    rest = followers - 2 * clusters
    bars = np.sort(rng.choice(rest + clusters - 1, clusters - 1, replace=False)) if clusters > 1 else np.empty(0, int)
    edges = np.concatenate([[-1], bars, [rest + clusters - 1]])
    return np.diff(edges) - 1 + 2


def draw_roles(rng: np.random.Generator, config: SwarmConfig) -> Roles:
    """Draw the roles. Indices are permuted at random, so an index carries no information about the role."""
    sizes = config.cluster_sizes or random_cluster_sizes(rng, config.clusters, config.followers)
    counts = (config.clusters, config.decoys, config.followers, config.bystanders, config.traffic, config.clutter)
    order = rng.permutation(config.uavs)
    kind = np.empty(config.uavs, np.int64)
    kind[order] = np.repeat(np.arange(len(counts)), counts)
    head, decoy, _, bystander, traffic, clutter = (kind == k for k in range(len(counts)))
    heads, root = order[: config.clusters], np.arange(config.uavs)
    root[order[config.clusters + config.decoys :][: config.followers]] = np.repeat(heads, sizes)
    return Roles(head, decoy, root, bystander | traffic | clutter, traffic, clutter, root.copy(), heads)


def start(config: SwarmConfig, rngs: Generators) -> SwarmState:
    """Start B swarms, one per generator, and simulate T_0 steps, which are the past of the first round.

    In these T_0 steps followers move in random directions: they have no past of their head to follow yet.

    Args:
        config: the swarm.
        rngs: one generator per episode.

    Returns:
        The state after T_0 steps.
    """
    swarms = [_draw_swarm(config, rng) for rng in rngs]
    drawn = {name: np.stack([swarm[name] for swarm in swarms]) for name in swarms[0]}
    place, velocity = drawn.pop("place"), drawn.pop("velocity")
    (episodes, memory, all_uavs, _), uavs = velocity.shape, config.uavs
    position = np.zeros((episodes, memory + 1, all_uavs, 3), np.float32)
    position[:, 0] = place
    velocity /= np.sqrt((velocity * velocity).sum(axis=-1, keepdims=True))
    flights = _draw_flights(_laws(config, drawn["free"].shape[1]), memory, rngs)
    no_jitter = np.empty((0, memory, all_uavs, 3), np.float32)
    _fly_free(flights, drawn["free"], drawn["mobility_state"], position, velocity, 0, slice(None), rngs, no_jitter)
    kernels.integrate(0, position, velocity)
    return SwarmState(
        alive=np.ones((episodes, uavs), bool),
        past_position=position[:, :, :uavs],
        past_velocity=velocity[:, :, :uavs],
        clock=np.full(episodes, memory, np.int64),
        reference_position=position[:, :, uavs:],
        reference_velocity=velocity[:, :, uavs:],
        **drawn,
    )


def _draw_swarm(config: SwarmConfig, rng: np.random.Generator) -> dict[str, NDArray[Any]]:
    """Draw one swarm of N UAVs and R references before its past is flown.

    Returns:
        Arrays of :class:`SwarmState` by name, without a leading axis; and ``place`` ``(N + R, 3)``, metres, and
        ``velocity`` ``(T_0, N + R, 3)``, directions of any length.
    """
    strategy, kinematics, uavs = config.follow_strategy, config.kinematics_model, config.uavs
    references = config.clusters if strategy is not None and strategy.has_references else 0
    drawn = draw_roles(rng, config)
    place = FORMATIONS.find(config.formation)(rng, drawn)
    place = np.array(check_returned("formation", place, (uavs, 3), FARTHEST), np.float64)
    roles = drawn if strategy is None else strategy.arrange(rng, drawn)
    if strategy is not None and strategy.has_followers:
        by_mobility = drawn.decoy | (drawn.head & (references == 0))
    else:
        by_mobility = ~drawn.bystander
    alone = drawn.bystander & ~drawn.traffic & ~drawn.clutter
    free = np.concatenate(
        [
            np.flatnonzero(by_mobility),
            np.arange(uavs, uavs + references),
            *map(np.flatnonzero, (alone, drawn.traffic, drawn.clutter)),
        ]
    )
    states = [law.mobility.start(rng, law.count) for law in _laws(config, len(free))]
    mobility_state = np.concatenate(states, dtype=np.float64)
    if config.traffic:
        end = len(free) - config.clutter
        place[drawn.traffic], mobility_state[end - config.traffic : end, :3] = draw_corridors(rng, config.traffic)
    velocity = rng.standard_normal((config.memory, uavs + references, 3), dtype=np.float32)
    seeded = rng if config.follow_seed is None else np.random.default_rng(config.follow_seed)
    return {
        "head": roles.head,
        "decoy": roles.decoy,
        "root": roles.root,
        "bystander": roles.bystander,
        "source": roles.source,
        "free": free,
        "mobility_state": mobility_state,
        "parameters": np.empty(0, np.float32) if strategy is None else strategy.draw_for(seeded, uavs),
        "kinematic_state": kinematics.start(rng, uavs + references),
        "place": np.concatenate([place, place[drawn.drawn[:references]]]),
        "velocity": velocity,
    }


def advance(config: SwarmConfig, state: SwarmState, rngs: Generators) -> tuple[SwarmState, ObservationBatch]:
    """Simulate the next round: T_0 unobserved steps, then the observed window of T_ob samples.

    Args:
        config: the same configuration as in :func:`start`.
        state: B swarms, each with at least one living head unless no UAV leads it.
        rngs: one generator per episode.

    Returns:
        The state at the end of the window, and the observed windows.
    """
    episodes, uavs = state.alive.shape
    memory, steps = config.memory, config.steps
    all_uavs = uavs + state.reference_position.shape[2]
    position = np.zeros((episodes, memory + steps + 1, all_uavs, 3), np.float32)
    velocity = np.zeros((episodes, memory + steps, all_uavs, 3), np.float32)
    position[:, : memory + 1, :uavs], position[:, : memory + 1, uavs:] = state.past_position, state.reference_position
    velocity[:, :memory, :uavs], velocity[:, :memory, uavs:] = state.past_velocity, state.reference_velocity
    mobility_state, kinematic_state = state.mobility_state.copy(), state.kinematic_state.copy()
    motion = np.full((episodes, all_uavs), kernels.FOLLOWS, np.int8)
    np.put_along_axis(motion, state.free, np.int8(kernels.FREE), axis=1)
    motion[:, :uavs][~state.alive] = kernels.DESTROYED
    # Random numbers are drawn for destroyed UAVs too, so the draws of the others do not depend on which UAVs live.
    chunk = max(1, _CHUNK_BYTES // (steps * all_uavs * 12))
    noise = np.empty((min(chunk, episodes), steps, all_uavs, 3), np.float32)
    for first in range(0, episodes, chunk):
        part = slice(first, min(first + chunk, episodes))
        flight = TrajectoryBatch(
            position[part],
            velocity[part],
            noise[: part.stop - first],
            motion[part],
            state.root[part],
            state.parameters[part],
            state.source[part],
            state.bystander[part],
            state.clock[part],
        )
        _fly(config, flight, state.free[part], mobility_state[part], kinematic_state[part], rngs[part])
    end = memory + steps
    window = 2 * memory  # the window starts after the past and the unobserved steps
    flown = position[:, window:, :uavs], velocity[:, window:, :uavs]
    if config.follow_strategy is not None and config.follow_strategy.shifts_tracks:
        flown = shift_tracks(*flown, state.source, rngs)
    observed = sense(config, *flown, state.alive, rngs, state.free[:, state.free.shape[1] - config.clutter :])
    after = replace(
        state,
        past_position=position[:, end - memory :, :uavs].copy(),
        past_velocity=velocity[:, end - memory :, :uavs].copy(),
        mobility_state=mobility_state,
        clock=state.clock + steps,
        kinematic_state=kinematic_state,
        reference_position=position[:, end - memory :, uavs:].copy(),
        reference_velocity=velocity[:, end - memory :, uavs:].copy(),
    )
    return after, observed


def _fly(
    config: SwarmConfig,
    flight: TrajectoryBatch,
    free: Indices,
    mobility_state: Floats,
    kinematic_state: Singles,
    rngs: Generators,
) -> None:
    """Simulate the episodes of ``flight`` and write its positions and velocities, and both states, in place."""
    strategy, kinematics = config.follow_strategy, config.kinematics_model
    position, velocity, noise, motion = flight.position, flight.velocity, flight.noise, flight.motion
    if strategy is not None or config.head_jitter:
        for row, rng in zip(noise, rngs, strict=True):
            rng.standard_normal(out=row, dtype=np.float32)
    jitter = noise[:0]
    if config.head_jitter:
        jitter = noise * np.float32(strategy.noise if strategy is not None else JITTER)
    flights = _draw_flights(_laws(config, free.shape[1]), flight.steps, rngs)
    # Their velocity is assigned, not multiplied: the sign of a zero would show which of them were free.
    memory, gone = config.memory, motion == kernels.DESTROYED
    if isinstance(kinematics, Unit):
        _fly_free(flights, free, mobility_state, position, velocity, memory, slice(None), rngs, jitter)
        velocity[:, memory:].swapaxes(1, 2)[gone] = 0.0
        if strategy is None:
            kernels.integrate(memory, position, velocity)
        else:
            strategy.fly(flight)
        return
    normals = np.empty((*noise.shape[:3], kinematics.normals), np.float32)
    for row, rng in zip(normals, rngs, strict=True):
        rng.standard_normal(out=row, dtype=np.float32)
    for s in range(flight.steps):
        t, now = memory + s, slice(s, s + 1)
        _fly_free(flights, free, mobility_state, position, velocity, t, now, rngs, jitter[:, now])
        velocity[:, t][gone] = 0.0
        if strategy is not None:
            strategy.fly(
                replace(
                    flight,
                    position=position[:, s : t + 2],
                    velocity=velocity[:, s : t + 1],
                    noise=noise[:, now],
                    clock=flight.clock + s,
                )
            )
        kinematics.fly(t, motion, normals[:, s], kinematic_state, position, velocity)


JITTER = 0.05  # kappa_n of the head jitter with follow="none", which has no follow strategy to define it


@dataclass(frozen=True)
class _Law:
    """The free UAVs in the columns ``columns`` of ``free`` fly by ``mobility``; ``jitters``: with the head jitter."""

    mobility: Mobility
    columns: slice
    jitters: bool

    @property
    def count(self) -> int:
        return int(self.columns.stop - self.columns.start)


def _laws(config: SwarmConfig, free: int) -> list[_Law]:
    """How the free UAVs fly: heads, decoys and references first, then bystanders, traffic and false tracks."""
    others = {"smooth_turn": config.bystanders, "straight": config.traffic, "gauss_markov": config.clutter}
    first = free - sum(others.values())
    laws = [_Law(config.head_mobility, slice(0, first), True)]
    for name, count in others.items():
        if count:
            laws.append(_Law(MOBILITIES[name], slice(first, first + count), False))
        first += count
    return laws


Flights = list[tuple[_Law, Singles]]


def _draw_flights(laws: list[_Law], steps: int, rngs: Generators) -> Flights:
    """Draw the random numbers ``(B, S, n, k)`` of every compiled mobility; 0 for any other."""
    flights = []
    for law in laws:
        normals = np.empty((0, 0, 0, 0), np.float32)
        if isinstance(law.mobility, CompiledMobility):
            normals = np.empty((len(rngs), steps, law.count, law.mobility.normals), np.float32)
            for row, rng in zip(normals, rngs, strict=True):
                rng.standard_normal(out=row, dtype=np.float32)
        flights.append((law, normals))
    return flights


def _fly_free(
    flights: Flights,
    free: Indices,
    mobility_state: Floats,
    position: Singles,
    velocity: Singles,
    first: int,
    steps: slice,
    rngs: Generators,
    jitter: Singles,
) -> None:
    """Write the velocities of the free UAVs in place, from step ``first`` on, with the draws of the steps ``steps``."""
    for law, drawn in flights:
        mobility, columns, state = law.mobility, free[:, law.columns], mobility_state[:, law.columns]
        added = jitter if law.jitters else jitter[:0]
        if isinstance(mobility, CompiledMobility):
            constants, normals = mobility.constants(), drawn[:, steps]
            kernels.fly_free(mobility.code, constants, columns, first, normals, added, state, position, velocity)
            continue
        count = velocity.shape[1] - first if steps == slice(None) else 1
        for b, rng in enumerate(rngs):
            wanted = _normalise(mobility.fly(state[b], position[b, first, columns[b]], count, rng).astype(np.float32))
            if len(added):
                wanted = _normalise(wanted + added[b][:, columns[b]])
            velocity[b, first : first + count, columns[b]] = wanted.swapaxes(0, 1)


def _normalise(vectors: Singles) -> Singles:
    return np.asarray(vectors / np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True) + 1e-12))

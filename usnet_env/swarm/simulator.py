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

from usnet_env.arrays import Floats, Indices, Singles
from usnet_env.config import ArgumentError, quote
from usnet_env.swarm import kernels
from usnet_env.swarm.config import SwarmConfig
from usnet_env.swarm.formation import FORMATIONS, check_place, draw_corridors, draw_roles
from usnet_env.swarm.kinematics import Unit
from usnet_env.swarm.mobility import MOBILITIES, CompiledMobility, Mobility
from usnet_env.swarm.sensing import ObservationBatch, sense, shift_tracks
from usnet_env.swarm.state import SwarmState
from usnet_env.swarm.strategy import TrajectoryBatch

Generators = Sequence[np.random.Generator]

_CHUNK_BYTES = 1 << 20  # size of one chunk of noise: small enough to stay in the processor cache until it is used


def _check_types(config: Any, state: Any, rngs: Any) -> None:
    """Refuse arguments of another type; without a state, ``state`` is ``None``."""
    if not isinstance(config, SwarmConfig):
        raise ArgumentError(f"config must be a SwarmConfig, got {quote(config)}.")
    if state is not None and not isinstance(state, SwarmState):
        raise ArgumentError(f"state must be a SwarmState, got {quote(state)}.")
    if not isinstance(rngs, list | tuple) or not all(isinstance(rng, np.random.Generator) for rng in rngs):
        raise ArgumentError(f"rngs must be a list of NumPy generators, got {quote(rngs)}.")


def start(config: SwarmConfig, rngs: Generators) -> SwarmState:
    """Start B swarms, one per generator, and simulate T_0 steps, which are the past of the first round.

    In these T_0 steps followers move in random directions: they have no past of their head to follow yet.

    Args:
        config: the swarm.
        rngs: one generator per episode.

    Returns:
        The state after T_0 steps.

    Raises:
        ArgumentError: an argument has another type.
    """
    _check_types(config, None, rngs)
    episodes, uavs, memory = len(rngs), config.uavs, config.memory
    strategy = config.follow_strategy
    references = config.clusters if strategy is not None and strategy.has_references else 0
    others = config.bystanders + config.traffic + config.clutter
    followed = strategy is not None and strategy.has_followers
    count = config.clusters + config.decoys + others if followed else uavs
    laws, all_uavs = _laws(config, count), uavs + references
    formation, kinematics = FORMATIONS.find(config.formation), config.kinematics_model
    head, decoy, bystander = (np.empty((episodes, uavs), bool) for _ in range(3))
    root, source = (np.empty((episodes, uavs), np.int64) for _ in range(2))
    free = np.empty((episodes, count), np.int64)
    mobility_state = np.empty((episodes, count, kernels.MOBILITY_STATE))
    kinematic_state = np.empty((episodes, all_uavs, kinematics.values), np.float32)
    position = np.zeros((episodes, memory + 1, all_uavs, 3), np.float32)
    velocity = np.empty((episodes, memory, all_uavs, 3), np.float32)
    parameters = []
    for b, rng in enumerate(rngs):
        drawn = draw_roles(rng, config)
        place = check_place("formation", formation(rng, drawn), uavs)
        roles = drawn if strategy is None else strategy.arrange(rng, drawn)
        head[b], decoy[b], bystander[b] = roles.head, roles.decoy, roles.bystander
        root[b], source[b] = roles.root, roles.source
        led = drawn.head if not references else False
        by_mobility = drawn.decoy | led if followed else ~drawn.bystander
        free[b] = np.concatenate(
            [
                np.flatnonzero(by_mobility),
                np.arange(uavs, all_uavs),
                np.flatnonzero(drawn.bystander & ~drawn.traffic & ~drawn.clutter),
                np.flatnonzero(drawn.traffic),
                np.flatnonzero(drawn.clutter),
            ]
        )
        for law in laws:
            mobility_state[b, law.columns] = law.mobility.start(rng, law.count)
        if config.traffic:
            civil = slice(count - config.clutter - config.traffic, count - config.clutter)
            place[drawn.traffic], mobility_state[b, civil, :3] = draw_corridors(rng, config.traffic)
        position[b, 0, :uavs], position[b, 0, uavs:] = place, place[drawn.drawn[:references]]
        rng.standard_normal(out=velocity[b], dtype=np.float32)
        if strategy is not None:
            seeded = rng if config.follow_seed is None else np.random.default_rng(config.follow_seed)
            parameters.append(strategy.draw_for(seeded, uavs))
        kinematic_state[b] = kinematics.start(rng, all_uavs)
    velocity /= np.sqrt((velocity * velocity).sum(axis=-1, keepdims=True))
    flights = _draw_flights(laws, memory, rngs)
    none = np.empty((0, memory, all_uavs, 3), np.float32)
    _fly_free(flights, free, mobility_state, position, velocity, 0, slice(None), rngs, none)
    kernels.integrate(0, position, velocity)
    return SwarmState(
        head=head,
        decoy=decoy,
        alive=np.ones((episodes, uavs), bool),
        root=root,
        past_position=position[:, :, :uavs],
        past_velocity=velocity[:, :, :uavs],
        free=free,
        mobility_state=mobility_state,
        parameters=np.array(parameters, np.float32).reshape(episodes, -1) if episodes else np.empty((0, 0), np.float32),
        bystander=bystander,
        source=source,
        clock=np.full(episodes, memory, np.int64),
        kinematic_state=kinematic_state,
        reference_position=position[:, :, uavs:],
        reference_velocity=velocity[:, :, uavs:],
    )


def advance(config: SwarmConfig, state: SwarmState, rngs: Generators) -> tuple[SwarmState, ObservationBatch]:
    """Simulate the next round: T_0 unobserved steps, then the observed window of T_ob samples.

    Args:
        config: the same configuration as in :func:`start`.
        state: B swarms, each with at least one living head.
        rngs: one generator per episode.

    Returns:
        The state at the end of the window, and the observed windows.

    Raises:
        ArgumentError: an argument has another type, another number of generators than of swarms, or a swarm without a
            living head.
    """
    _check_types(config, state, rngs)
    if len(rngs) != len(state.alive):
        raise ArgumentError(f"rngs must hold one generator for each of {len(state.alive)} swarms, got {len(rngs)}.")
    led = state.head.any(axis=1)  # a swarm that no UAV leads has no heads from the start
    if config.follow_strategy is not None and not (state.heads_left[led] > 0).all():
        raise ArgumentError("state must have a living head in every swarm, got a swarm without one.")
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
        mobility_model, some, state = law.mobility, free[:, law.columns], mobility_state[:, law.columns]
        added = jitter if law.jitters else jitter[:0]
        if isinstance(mobility_model, CompiledMobility):
            kernels.fly_free(
                mobility_model.code,
                mobility_model.constants(),
                some,
                first,
                drawn[:, steps],
                added,
                state,
                position,
                velocity,
            )
            continue
        count = velocity.shape[1] - first if steps == slice(None) else 1
        for b, rng in enumerate(rngs):
            wanted = mobility_model.fly(state[b], position[b, first, some[b]], count, rng).astype(np.float32)
            for more in (0.0, added[b][:, some[b]] if len(added) else None):
                if more is not None:
                    wanted = wanted + np.float32(more)
                    wanted = wanted / np.sqrt((wanted * wanted).sum(axis=-1, keepdims=True) + 1e-12)
            velocity[b, first : first + count, some[b]] = wanted.swapaxes(0, 1)

"""Flights: B swarms fly S steps, in compiled loops where all their parts have one.

Swarms with one configuration fly together. A part of a user has no loop; with such a part and other kinematics than
``unit`` they fly step by step: first what the UAVs want, then what they fly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Singles
from usnet_env.swarm import kernels
from usnet_env.swarm.config import SwarmConfig
from usnet_env.swarm.kinematics import CompiledKinematics, Unit
from usnet_env.swarm.mobility import MOBILITIES, CompiledMobility, Mobility
from usnet_env.swarm.sensing import Generators, draw_normals
from usnet_env.swarm.state import SwarmState
from usnet_env.swarm.strategy import TrajectoryBatch

UNLED_MOBILITIES = ("smooth_turn", "straight", "gauss_markov")  # those of bystanders, traffic and false tracks
JITTER = 0.05  # kappa_n of the head jitter with follow="none", which has no follow strategy to define it


def group_by_config(configs: Sequence[SwarmConfig]) -> list[tuple[SwarmConfig, list[int]]]:
    """Each configuration with the indices of its swarms."""
    groups: dict[int, tuple[SwarmConfig, list[int]]] = {}
    for b, config in enumerate(configs):
        groups.setdefault(id(config), (config, []))[1].append(b)
    return list(groups.values())


def fly_steps(
    configs: Sequence[SwarmConfig], state: SwarmState, rngs: Generators, steps: int
) -> tuple[SwarmState, Singles, Singles]:
    """Fly S steps, unobserved: the state after them, and the flight with its past.

    This is positions ``(B, T_0 + S + 1, N + R, 3)`` in metres and velocities ``(B, T_0 + S, N + R, 3)`` in metres per
    step. All swarms have as many references as the one with the most; those that a swarm doesn't have stay at 0.
    """
    groups = group_by_config(configs)
    if len(groups) == 1:
        return _fly(configs[0], state, rngs, steps)
    flights = [_fly(config, state.rows(rows), [rngs[b] for b in rows], steps) for config, rows in groups]
    order = np.argsort(np.concatenate([rows for _, rows in groups]))
    next_state = SwarmState.join([flight[0] for flight in flights]).rows(order)
    width = max(position.shape[2] for _, position, _ in flights)
    position, velocity = (np.zeros((len(rngs), track.shape[1], width, 3), np.float32) for track in flights[0][1:])
    for (_, rows), (_, *tracks) in zip(groups, flights, strict=True):
        for joined, track in zip((position, velocity), tracks, strict=True):
            joined[rows, :, : track.shape[2]] = track
    return next_state, position, velocity


def _fly(config: SwarmConfig, state: SwarmState, rngs: Generators, steps: int) -> tuple[SwarmState, Singles, Singles]:
    """What :func:`fly_steps` returns, of swarms with one configuration."""
    strategy, kinematics, memory = config.follow_strategy, config.kinematics_model, config.memory
    (episodes, uavs), all_uavs = state.alive.shape, state.alive.shape[1] + state.reference_position.shape[2]
    position = np.zeros((episodes, memory + steps + 1, all_uavs, 3), np.float32)
    velocity = np.zeros((episodes, memory + steps, all_uavs, 3), np.float32)
    position[:, : memory + 1, :uavs], velocity[:, :memory, :uavs] = state.past_position, state.past_velocity
    position[:, : memory + 1, uavs:], velocity[:, :memory, uavs:] = state.reference_position, state.reference_velocity
    # Drawn for destroyed UAVs too, so the draws of the others do not depend on which UAVs live.
    has_noise = strategy is not None or config.head_jitter
    shape = steps, all_uavs
    noise = draw_normals(rngs, *shape, 3) if has_noise else np.empty((episodes, *shape, 3), np.float32)
    plan = draw_plan(config, state.free, state.mobility_state.copy(), steps, rngs)._replace(
        kinematic_noise=draw_normals(rngs, *shape, kinematics.normals),
        kinematic_state=state.kinematic_state.copy(),
    )
    source = np.concatenate([state.source, state.reference_source], axis=1)
    swarm = state.root, state.parameters, source, state.not_led, state.clock
    flight = TrajectoryBatch(position, velocity, noise, _find_motion(state, all_uavs), *swarm, plan)
    mobility_compiled = isinstance(config.head_mobility, CompiledMobility)
    follow_compiled = strategy is None or not strategy.has_followers or strategy.compiled
    if isinstance(kinematics, Unit):
        fly_free(config, flight.start, flight.start, plan, flight.motion, noise, position, velocity, rngs)
        _fly_followers(config, flight)
    elif isinstance(kinematics, CompiledKinematics) and mobility_compiled and follow_compiled:
        _fly_followers(config, flight)
    else:
        _fly_step_by_step(config, flight, rngs)
    next_state = replace(
        state,
        past_position=position[:, steps:, :uavs].copy(),
        past_velocity=velocity[:, steps:, :uavs].copy(),
        clock=state.clock + steps,
        mobility_state=plan.mobility_state,
        kinematic_state=plan.kinematic_state,
        reference_position=position[:, steps:, uavs:].copy(),
        reference_velocity=velocity[:, steps:, uavs:].copy(),
    )
    return next_state, position, velocity


def _find_motion(state: SwarmState, all_uavs: int) -> NDArray[np.int8]:
    """How each UAV and reference moves, ``(B, N + R)``."""
    motion = np.full((len(state.alive), all_uavs), kernels.FOLLOWS, np.int8)
    np.put_along_axis(motion, state.free, kernels.FREE, axis=1)
    motion[:, : state.alive.shape[1]][~state.alive] = kernels.DESTROYED
    return motion


def find_mobilities(config: SwarmConfig, free: int) -> list[tuple[Mobility, slice]]:
    """The mobilities of n free UAVs and their columns: of heads, decoys and references, of bystanders, of traffic, ….

    The columns are those of :attr:`SwarmState.free`.
    """
    groups = config.bystanders, config.traffic, config.clutter
    ends = np.cumsum([free - sum(groups), *groups]).tolist()
    mobilities = config.head_mobility, *(MOBILITIES[name] for name in UNLED_MOBILITIES)
    groups_of_columns = zip(mobilities, [0, *ends], ends, strict=False)
    return [(mobility, slice(first, end)) for mobility, first, end in groups_of_columns if first < end]


def draw_plan(
    config: SwarmConfig, free: Indices, mobility_state: Floats, steps: int, rngs: Generators
) -> kernels.FlightPlan:
    """How swarms fly. The noise and state of the kinematics are left empty."""
    strategy, kinematics, (swarms, uavs) = config.follow_strategy, config.kinematics_model, free.shape
    codes, constants = np.full(uavs, kernels.NOT_COMPILED), np.zeros((uavs, 6))
    noise = np.empty((swarms, steps, uavs, kernels.NORMALS), np.float32)
    mobilities, jitter = find_mobilities(config, uavs), np.zeros(uavs, np.float32)
    for mobility, columns in mobilities:
        if isinstance(mobility, CompiledMobility):
            codes[columns], constants[columns] = mobility.code, mobility.constants
            shape = steps, columns.stop - columns.start, mobility.normals
            noise[:, :, columns, : mobility.normals] = draw_normals(rngs, *shape)
    if config.head_jitter:
        jitter[mobilities[0][1]] = JITTER if strategy is None else strategy.noise
    plan = kernels.FlightPlan(free, codes, constants, noise, mobility_state, jitter)
    if isinstance(kinematics, CompiledKinematics):
        return plan._replace(kinematics=kinematics.code, kinematic_constants=kinematics.constants)
    return plan


def _fly_followers(config: SwarmConfig, flight: TrajectoryBatch) -> None:
    """Fly the UAVs that follow, in place."""
    strategy = config.follow_strategy
    if strategy is None or not strategy.has_followers:
        kernels.fly_without_followers(*flight.loop_arguments)
    else:
        strategy.fly(flight)


def _fly_step_by_step(config: SwarmConfig, flight: TrajectoryBatch, rngs: Generators) -> None:
    """Fly with other kinematics than ``unit`` where a part has no compiled loop, in place."""
    strategy, start, plan = config.follow_strategy, flight.start, flight.plan
    for s in range(flight.steps):
        t = start + s
        velocity = flight.velocity[:, : t + 1]
        fly_free(config, start, t, plan, flight.motion, flight.noise, flight.position, velocity, rngs)
        if strategy is not None and strategy.has_followers:
            position, noise = flight.position[:, s : t + 2], np.ascontiguousarray(flight.noise[:, s : s + 1])
            step = replace(flight, position=position, velocity=velocity[:, s:], noise=noise, clock=flight.clock + s)
            strategy.fly(replace(step, plan=kernels.FLOWN))
        noise = plan.kinematic_noise[:, s]
        config.kinematics_model.fly(t, flight.motion, noise, plan.kinematic_state, flight.position, flight.velocity)


def fly_free(
    config: SwarmConfig, start: int, first: int, plan: kernels.FlightPlan, motion: NDArray[np.int8], noise: Singles,
    position: Singles, velocity: Singles, rngs: Generators,
) -> None:  # fmt: skip
    """Write the velocities of the free UAVs from instant ``first`` on; step 0 is at ``start``."""
    kernels.fly_free(start, first, plan, motion, noise, position, velocity)
    if isinstance(config.head_mobility, CompiledMobility):
        return
    columns, swarms = find_mobilities(config, len(plan.codes))[0][1], np.arange(len(rngs))[:, None]
    uavs, steps = plan.free[:, columns], velocity.shape[1] - first
    state, present = plan.mobility_state[:, columns], position[swarms, first, uavs]
    direction = normalise(config.head_mobility.fly_batch(state, present, steps, rngs).astype(np.float32))
    if plan.jitter[0] > 0:
        jitter = noise[swarms, first - start : first - start + steps, uavs].swapaxes(1, 2)
        direction = normalise(direction + plan.jitter[0] * jitter)
    velocity[swarms, first : first + steps, uavs] = direction.swapaxes(1, 2)
    velocity[:, first:].swapaxes(1, 2)[motion == kernels.DESTROYED] = 0.0


def normalise(vectors: Singles) -> Singles:
    """Vectors ``(..., 3)`` scaled to length 1."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.asarray(vectors / np.sqrt(x * x + y * y + z * z + np.float32(1e-12))[..., None])

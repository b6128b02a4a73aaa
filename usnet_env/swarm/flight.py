"""Flights: B swarms fly S steps, in compiled loops where all their parts have one.

Swarms with one configuration fly together. A part of a user has no loop; with such a part and other kinematics than
``unit`` they fly step by step: first what the UAVs want, then what they fly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

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

OTHERS = ("smooth_turn", "straight", "gauss_markov")  # the mobilities of bystanders, traffic and false tracks
JITTER = 0.05  # kappa_n of the head jitter with follow="none", which has no follow strategy to define it


def sort_kinds(configs: Sequence[SwarmConfig]) -> list[tuple[SwarmConfig, list[int]]]:
    """Each configuration with the indices of its swarms."""
    kinds: dict[int, tuple[SwarmConfig, list[int]]] = {}
    for b, config in enumerate(configs):
        kinds.setdefault(id(config), (config, []))[1].append(b)
    return list(kinds.values())


def fly_steps(
    configs: Sequence[SwarmConfig], state: SwarmState, rngs: Generators, steps: int
) -> tuple[SwarmState, Singles, Singles]:
    """Fly S steps, unobserved: the state after them, and the flight with its past.

    This is positions ``(B, T_0 + S + 1, N + R, 3)`` and velocities ``(B, T_0 + S, N + R, 3)``. All swarms have as many
    references as the one with the most; those that a swarm doesn't have stay at 0.
    """
    kinds = sort_kinds(configs)
    if len(kinds) == 1:
        return _fly(configs[0], state, rngs, steps)
    parts = [_fly(config, state.rows(rows), [rngs[b] for b in rows], steps) for config, rows in kinds]
    after = SwarmState.join([part[0] for part in parts]).rows(np.argsort(np.concatenate([rows for _, rows in kinds])))
    width = max(position.shape[2] for _, position, _ in parts)
    position, velocity = (np.zeros((len(rngs), flown.shape[1], width, 3), np.float32) for flown in parts[0][1:])
    for (_, rows), (_, places, speeds) in zip(kinds, parts, strict=True):
        position[rows, :, : places.shape[2]], velocity[rows, :, : places.shape[2]] = places, speeds
    return after, position, velocity


def _fly(config: SwarmConfig, state: SwarmState, rngs: Generators, steps: int) -> tuple[SwarmState, Singles, Singles]:
    """What :func:`fly_steps` returns, of swarms with one configuration."""
    strategy, kinematics, memory = config.follow_strategy, config.kinematics_model, config.memory
    (episodes, uavs), all_uavs = state.alive.shape, state.alive.shape[1] + state.reference_position.shape[2]
    position = np.zeros((episodes, memory + steps + 1, all_uavs, 3), np.float32)
    velocity = np.zeros((episodes, memory + steps, all_uavs, 3), np.float32)
    position[:, : memory + 1, :uavs], velocity[:, :memory, :uavs] = state.past_position, state.past_velocity
    position[:, : memory + 1, uavs:], velocity[:, :memory, uavs:] = state.reference_position, state.reference_velocity
    # Drawn for destroyed UAVs too, so the draws of the others do not depend on which UAVs live.
    noisy = strategy is not None or config.head_jitter
    shape = steps, all_uavs
    noise = draw_normals(rngs, *shape, 3) if noisy else np.empty((episodes, *shape, 3), np.float32)
    craft = draw_craft(config, state.free, state.mobility_state.copy(), steps, rngs)._replace(
        pushes=draw_normals(rngs, *shape, kinematics.normals),
        kept=state.kinematic_state.copy(),
        rows=np.empty((10, all_uavs), np.float32),
    )
    source = np.concatenate([state.source, state.reference_source], axis=1)
    swarm = state.root, state.parameters, source, state.bystander, state.clock
    flight = TrajectoryBatch(position, velocity, noise, _find_motion(state, all_uavs), *swarm, craft)
    mobility_compiled = isinstance(config.head_mobility, CompiledMobility)
    leading_compiled = strategy is None or not strategy.has_followers or strategy.compiled
    if isinstance(kinematics, Unit):
        first, tracks = flight.start, (flight.motion, noise, position, velocity, rngs)
        fly_free(config, first, first, craft, *tracks)
        _fly_followers(config, flight)
    elif isinstance(kinematics, CompiledKinematics) and mobility_compiled and leading_compiled:
        _fly_followers(config, flight)
    else:
        _fly_step_by_step(config, flight, rngs)
    after = replace(
        state,
        past_position=position[:, steps:, :uavs].copy(),
        past_velocity=velocity[:, steps:, :uavs].copy(),
        clock=state.clock + steps,
        mobility_state=craft.state,
        kinematic_state=craft.kept,
        reference_position=position[:, steps:, uavs:].copy(),
        reference_velocity=velocity[:, steps:, uavs:].copy(),
    )
    return after, position, velocity


def _find_motion(state: SwarmState, all_uavs: int) -> NDArray[np.int8]:
    """How each UAV and reference moves, ``(B, N + R)``."""
    motion = np.full((len(state.alive), all_uavs), kernels.FOLLOWS, np.int8)
    np.put_along_axis(motion, state.free, kernels.FREE, axis=1)
    motion[:, : state.alive.shape[1]][~state.alive] = kernels.DESTROYED
    return motion


def draw_craft(config: SwarmConfig, free: Indices, state: Floats, steps: int, rngs: Generators) -> kernels.Craft:
    """How swarms fly. The state and draws of the kinematics are left empty."""
    strategy, kinematics = config.follow_strategy, config.kinematics_model
    groups = config.bystanders, config.traffic, config.clutter
    laws, constants = np.zeros((4, 3), np.int64), np.zeros((4, 6))
    for law, (mobility, count) in enumerate(
        zip(find_mobilities(config), (free.shape[1] - sum(groups), *groups), strict=True)
    ):
        laws[law] = kernels.NOT_COMPILED, count, 0
        if isinstance(mobility, CompiledMobility):
            laws[law], constants[law] = (mobility.code, count, mobility.normals), mobility.constants
    jitter = 0.0 if not config.head_jitter else JITTER if strategy is None else strategy.noise
    normals = draw_normals(rngs, steps * int((laws[:, 1] * laws[:, 2]).sum()))
    craft = kernels.Craft(free, laws, constants, steps, normals, state, np.float32(jitter))
    if isinstance(kinematics, CompiledKinematics):
        return craft._replace(kinematics=kinematics.code, numbers=np.asarray(kinematics.numbers, np.float32))
    return craft


def _fly_followers(config: SwarmConfig, flight: TrajectoryBatch) -> None:
    """Fly the UAVs that follow, in place."""
    strategy = config.follow_strategy
    if strategy is None or not strategy.has_followers:
        kernels.fly_alone(*flight.flown)
    else:
        strategy.fly(flight)


def _fly_step_by_step(config: SwarmConfig, flight: TrajectoryBatch, rngs: Generators) -> None:
    """Fly with other kinematics than ``unit`` where a part has no compiled loop, in place."""
    strategy, first, craft = config.follow_strategy, flight.start, flight.craft
    assert craft is not None
    for s in range(flight.steps):
        t = first + s
        until = flight.velocity[:, : t + 1]
        fly_free(config, first, t, craft, flight.motion, flight.noise, flight.position, until, rngs)
        if strategy is not None and strategy.has_followers:
            cut: dict[str, Any] = {
                "position": flight.position[:, s : t + 2],
                "velocity": flight.velocity[:, s : t + 1],
                "noise": np.ascontiguousarray(flight.noise[:, s : s + 1]),
            }
            strategy.fly(replace(flight, **cut, clock=flight.clock + s, craft=None))
        pushes = craft.pushes[:, s]
        config.kinematics_model.fly(t, flight.motion, pushes, craft.kept, flight.position, flight.velocity)


def find_mobilities(config: SwarmConfig) -> list[Mobility]:
    """How heads, decoys and references fly, then bystanders, traffic and false tracks."""
    return [config.head_mobility, *(MOBILITIES[name] for name in OTHERS)]


def fly_free(
    config: SwarmConfig,
    start: int,
    first: int,
    craft: kernels.Craft,
    motion: NDArray[np.int8],
    noise: Singles,
    position: Singles,
    velocity: Singles,
    rngs: Generators,
) -> None:
    """Write the velocities of the free UAVs from instant ``first`` on; step 0 is at ``start``."""
    kernels.fly_free(start, first, craft, motion, noise, position, velocity)
    if isinstance(config.head_mobility, CompiledMobility):
        return
    heads, swarms = slice(craft.laws[0, 1]), np.arange(len(rngs))[:, None]
    columns, place = craft.free[:, heads], position[swarms, first, craft.free[:, heads]]
    steps, chosen = velocity.shape[1] - first, np.ones(columns.shape, bool)
    directions = config.head_mobility.fly_batch(craft.state[:, heads], place, chosen, steps, rngs)
    wanted = normalise(directions.astype(np.float32))
    if craft.jitter > 0:
        pushed = noise[swarms, first - start : first - start + steps, columns].swapaxes(1, 2)
        wanted = normalise(wanted + craft.jitter * pushed)
    velocity[swarms, first : first + steps, columns] = wanted.swapaxes(1, 2)
    velocity[:, first:].swapaxes(1, 2)[motion == kernels.DESTROYED] = 0.0


def normalise(vectors: Singles) -> Singles:
    """Vectors ``(..., 3)`` scaled to length 1."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.asarray(vectors / np.sqrt(x * x + y * y + z * z + np.float32(1e-12))[..., None])

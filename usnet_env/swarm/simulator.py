"""The simulator: pure functions from a state and random generators to the next state and the observed window.

A batch has a leading axis B. All random numbers of an episode come from its own generator, so episode b of a batch
equals the single swarm with the same seed, bit for bit. A free UAV is one that follows no UAV: a head, decoy or
bystander, and every UAV with ``follow="none"``. With other kinematics than ``unit`` a step at a time is simulated:
first what the UAVs want, then what they fly. If all parts are compiled, one compiled loop does so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask, Singles
from usnet_env.swarm import kernels
from usnet_env.swarm.config import SwarmConfig
from usnet_env.swarm.formation import FORMATIONS, draw_corridors
from usnet_env.swarm.kinematics import CompiledKinematics, Unit
from usnet_env.swarm.mobility import MOBILITIES, CompiledMobility, Mobility
from usnet_env.swarm.sensing import Generators, ObservationBatch, draw_normals, sense, shift_tracks
from usnet_env.swarm.state import LASTING, Roles, SwarmState, destroy, join_rows
from usnet_env.swarm.strategy import TrajectoryBatch

Laws = list[tuple[Mobility, slice]]  # the mobilities, each with its columns of ``SwarmState.free``

# The arrays of a SwarmState that a flight changes and whose shapes may differ between swarms.
CHANGED = ("mobility_state", "kinematic_state", "reference_position", "reference_velocity")
JITTER = 0.05  # kappa_n of the head jitter with follow="none", which has no follow strategy to define it


def random_cluster_sizes(rngs: Generators, clusters: int, followers: int) -> Indices:
    """Draw the followers of each cluster, ``(B, clusters)`` int64, at least 2; all splits are equally likely."""
    slots, bars = followers - clusters - 1, np.empty((len(rngs), clusters - 1), np.int64)
    for row, rng in zip(bars, rngs if clusters > 1 else (), strict=clusters > 1):
        row[:] = np.sort(rng.choice(slots, clusters - 1, replace=False))
    return np.asarray(np.diff(bars, axis=1, prepend=-1, append=slots) + 1, np.int64)


def draw_roles(rngs: Generators, config: SwarmConfig) -> Roles:
    """Draw the roles of B swarms, with indices permuted at random; every array has a leading axis B."""
    sizes = np.array([config.cluster_sizes] * len(rngs)) if config.cluster_sizes else None
    sizes = random_cluster_sizes(rngs, config.clusters, config.followers) if sizes is None else sizes
    others = config.bystanders, config.traffic, config.clutter, config.absent
    counts = (config.clusters, config.decoys, config.followers, *others)
    order = np.array([rng.permutation(config.uavs) for rng in rngs])
    kind, root = np.empty_like(order), np.tile(np.arange(config.uavs), (len(rngs), 1))
    np.put_along_axis(kind, order, np.repeat(np.arange(len(counts)), counts)[None], axis=1)
    head, decoy, _, bystander, traffic, clutter, absent = (kind == k for k in range(len(counts)))
    root[absent] = -1
    heads, followers = order[:, : config.clusters], order[:, config.clusters + config.decoys :][:, : config.followers]
    np.put_along_axis(root, followers, np.repeat(heads.ravel(), sizes.ravel()).reshape(followers.shape), axis=1)
    return Roles(head, decoy, root, bystander | traffic | clutter, traffic, clutter, root.copy(), heads)


def start(config: SwarmConfig, rngs: Generators) -> SwarmState:
    """Start B swarms, one per generator, and simulate T_0 steps, which are the past of the first round.

    In these T_0 steps followers move in random directions: they have no past of their head to follow yet.
    """
    drawn = _draw_swarms(config, rngs)
    place, velocity, absent = (drawn.pop(name) for name in ("place", "velocity", "absent"))
    (episodes, memory, all_uavs, _), uavs = velocity.shape, config.uavs
    position = np.zeros((episodes, memory + 1, all_uavs, 3), np.float32)
    position[:, 0] = place
    x, y, z = np.moveaxis(velocity, -1, 0)  # faster than a sum over the last axis
    velocity /= np.sqrt(x * x + y * y + z * z)[..., None]
    free, state = drawn["free"], drawn["mobility_state"]
    craft = _draw_craft(laws := _find_laws(config, free.shape[1]), free, state, memory, rngs)
    _fly_free(laws, craft, np.empty((0, 0, 0, 3), np.float32), position, velocity, 0, rngs)
    kernels.integrate(0, position, velocity)
    begun = SwarmState(
        alive=np.ones((episodes, uavs), bool),
        past_position=position[:, :, :uavs],
        past_velocity=velocity[:, :, :uavs],
        clock=np.full(episodes, memory, np.int64),
        reference_position=position[:, :, uavs:],
        reference_velocity=velocity[:, :, uavs:],
        **drawn,
    )
    return destroy(begun, absent) if config.absent else begun


def _draw_swarms(config: SwarmConfig, rngs: Generators) -> dict[str, NDArray[Any]]:
    """Draw arrays of :class:`SwarmState` by name, and ``place`` and ``velocity`` of N UAVs and R references."""
    strategy, kinematics, uavs = config.follow_strategy, config.kinematics_model, config.uavs
    references = config.clusters if strategy is not None and strategy.has_references else 0
    drawn, formation = draw_roles(rngs, config), FORMATIONS.find(config.formation)
    swarms = drawn.split()
    place = np.array([formation(*pair) for pair in zip(rngs, swarms, strict=True)], np.float64).reshape(-1, uavs, 3)
    arranged = [strategy.arrange(*pair) for pair in zip(rngs, swarms, strict=True)] if strategy is not None else swarms
    changed = any(one is not other for one, other in zip(arranged, swarms, strict=True))
    roles = Roles(*map(np.array, zip(*arranged, strict=True))) if changed else drawn
    if strategy is not None and strategy.has_followers:
        by_mobility = drawn.decoy | (drawn.head & (references == 0))
    else:
        by_mobility = ~drawn.bystander
    alone = drawn.bystander & ~drawn.traffic & ~drawn.clutter
    points = np.tile(np.arange(uavs, uavs + references), (len(rngs), 1))
    free = [_find_each(by_mobility), points, *map(_find_each, (alone, drawn.traffic, drawn.clutter))]
    laws = _find_laws(config, sum(part.shape[1] for part in free))
    states = [np.array([law.start(rng, part.stop - part.start) for rng in rngs]) for law, part in laws]
    mobility_state = np.concatenate(states, axis=1, dtype=np.float64)
    if config.traffic:
        end = mobility_state.shape[1] - config.clutter
        corridors = zip(*(draw_corridors(rng, config.traffic) for rng in rngs), strict=True)
        places, mobility_state[:, end - config.traffic : end, :3] = map(np.array, corridors)
        place[drawn.traffic] = places.reshape(-1, 3)
    velocity = draw_normals(rngs, config.memory, uavs + references, 3)
    seeded = [np.random.default_rng(config.follow_seed) for _ in rngs] if config.follow_seed is not None else rngs
    parameters = [np.empty(0, np.float32) if strategy is None else strategy.draw_for(rng, uavs) for rng in seeded]
    from_heads = np.take_along_axis(place, drawn.drawn[:, :references, None], axis=1)
    return {
        **{name: getattr(roles, name) for name in LASTING},
        "absent": drawn.root < 0,
        "free": np.concatenate(free, axis=1),
        "mobility_state": mobility_state,
        "parameters": np.array(parameters),
        "kinematic_state": np.array([kinematics.start(rng, uavs + references) for rng in rngs]),
        "place": np.concatenate([place, from_heads], axis=1),
        "velocity": velocity,
    }


def _find_each(chosen: Mask) -> Indices:
    """The indices of the UAVs that are chosen in each swarm, ``(B, n)``; n is the same in all."""
    return np.asarray(np.nonzero(chosen)[1].reshape(len(chosen), -1))


def advance(config: SwarmConfig, state: SwarmState, rngs: Generators) -> tuple[SwarmState, ObservationBatch]:
    """:func:`advance_each` of B swarms with one configuration."""
    return advance_each([config] * len(rngs), state, rngs)


def advance_each(
    configs: Sequence[SwarmConfig], state: SwarmState, rngs: Generators
) -> tuple[SwarmState, ObservationBatch]:
    """Simulate the next round of B swarms: T_0 unobserved steps, then the observed window of T_ob samples.

    Each swarm has at least one living head unless no UAV leads it. It returns the state at the end of the window, and
    the windows.
    """
    kinds = sort_kinds(configs)
    order = [b for _, rows in kinds for b in rows]
    if len(kinds) > 1 and order != sorted(order):
        some = [configs[b] for b in order], state.rows(order), [rngs[b] for b in order]
        (after, window), back = advance_each(*some), np.argsort(order)
        return after.rows(back), ObservationBatch(**{name: part[back] for name, part in vars(window).items()})
    after, position, velocity, first = fly_round(configs, state, rngs)
    return after, sense(configs, position, velocity, state.alive, rngs, state.free, first=first)


def fly_round(
    configs: Sequence[SwarmConfig], state: SwarmState, rngs: Generators
) -> tuple[SwarmState, Singles, Singles, int]:
    """Fly the next round, unobserved: what :func:`fly_steps` returns, and the instant at which the window begins.

    Swarms with one configuration stand side by side.
    """
    after, position, velocity = fly_steps(configs, state, rngs, configs[0].steps)
    first, uavs = 2 * configs[0].memory, state.alive.shape[1]  # after the past and the unobserved steps
    for config, rows in sort_kinds(configs):
        if (strategy := config.follow_strategy) is not None and strategy.shifts_tracks:
            kind = slice(rows[0], rows[-1] + 1)
            places, speeds = position[kind, first:, :uavs], velocity[kind, first:, :uavs]
            places[:], speeds[:] = shift_tracks(places, speeds, state.source[kind], rngs[kind])
    return after, position, velocity, first


def sort_kinds(configs: Sequence[SwarmConfig]) -> list[tuple[SwarmConfig, list[int]]]:
    """Each configuration with the indices of its swarms, which fly together."""
    if len(set(map(id, configs))) == 1:
        return [(configs[0], list(range(len(configs))))]
    kinds: dict[int, tuple[SwarmConfig, list[int]]] = {}
    for b, config in enumerate(configs):
        kinds.setdefault(id(config), (config, []))[1].append(b)
    return list(kinds.values())


def fly_steps(
    configs: Sequence[SwarmConfig], state: SwarmState, rngs: Generators, steps: int
) -> tuple[SwarmState, Singles, Singles]:
    """Fly S steps, unobserved: the state after them, and the flight with its past.

    This is positions ``(B, T_0 + S + 1, N + R, 3)`` and velocities ``(B, T_0 + S, N + R, 3)``. Swarms with one
    configuration stand side by side, and fly together. All have as many references as the one with the most; those
    that a swarm doesn't have stay where they are.
    """
    (episodes, uavs), memory, kinds = state.alive.shape, configs[0].memory, sort_kinds(configs)
    references = [state.reference_position[rows[0]].shape[1] for _, rows in kinds]
    all_uavs = uavs + max(references)
    position = np.zeros((episodes, memory + steps + 1, all_uavs, 3), np.float32)
    velocity = np.zeros((episodes, memory + steps, all_uavs, 3), np.float32)
    position[:, : memory + 1, :uavs], velocity[:, :memory, :uavs] = state.past_position, state.past_velocity
    motion = np.full((episodes, all_uavs), kernels.DESTROYED, np.int8)
    motion[:, :uavs] = kernels.FOLLOWS
    for row, free in zip(motion, state.free, strict=True):
        row[free] = kernels.FREE
    motion[:, :uavs][~state.alive] = kernels.DESTROYED
    changed: dict[str, list[NDArray[Any]]] = {name: [] for name in CHANGED}
    for (config, rows), count in zip(kinds, references, strict=True):
        kind, own = slice(rows[0], rows[-1] + 1), slice(uavs, uavs + count)
        free, parameters, mobility_state, kinematic_state, *past = state.pick(kind, "free", "parameters", *CHANGED)
        position[kind, : memory + 1, own], velocity[kind, :memory, own] = past
        # Drawn for destroyed UAVs too, so the draws of the others do not depend on which UAVs live.
        if config.follow_strategy is not None or config.head_jitter:
            noise = draw_normals(rngs[kind], steps, own.stop, 3)
        else:
            noise = np.empty((len(free), steps, own.stop, 3), np.float32)
        swarm = state.root[kind], parameters, state.source[kind], state.bystander[kind], state.clock[kind]
        flight = TrajectoryBatch(position[kind], velocity[kind], noise, motion[kind], *swarm)
        mobility_state, kinematic_state = mobility_state.copy(), kinematic_state.copy()
        _fly(config, flight, free, mobility_state, kinematic_state, rngs[kind])
        ends = position[kind, steps:, own].copy(), velocity[kind, steps:, own].copy()
        for name, part in zip(CHANGED, (mobility_state, kinematic_state, *ends), strict=True):
            changed[name].append(part)
    after = replace(
        state,
        past_position=position[:, steps:, :uavs].copy(),
        past_velocity=velocity[:, steps:, :uavs].copy(),
        clock=state.clock + steps,
        **{name: join_rows(parts) for name, parts in changed.items()},
    )
    return after, position, velocity


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
    craft = _draw_craft(laws := _find_laws(config, free.shape[1]), free, mobility_state, flight.steps, rngs)
    if config.head_jitter:
        scale = np.float32(strategy.noise if strategy is not None else JITTER)
        craft = craft._replace(jittered=laws[0][1].stop, jitter=scale)
    led = strategy if strategy is not None and strategy.has_followers else None

    def fly_together(flight: TrajectoryBatch) -> None:
        if led is None:
            kernels.fly_alone(*flight.flown)
        else:
            led.fly(flight)

    # Their velocity is assigned, not multiplied: the sign of a zero would show which of them were free.
    width = noise.shape[2]  # without the references that only other swarms of the batch have
    memory = config.memory
    if isinstance(kinematics, Unit):
        _fly_free(laws, craft, noise, position, velocity, memory, rngs)
        if (gone := motion[:, :width] == kernels.DESTROYED).any():
            velocity[:, memory:, :width].swapaxes(1, 2)[gone] = 0.0
        fly_together(flight)
        return
    pushes = draw_normals(rngs, *noise.shape[1:3], kinematics.normals)
    compiled = all(isinstance(law, CompiledMobility) for law, _ in laws) and (led is None or led.compiled)
    if compiled and isinstance(kinematics, CompiledKinematics):
        rows = np.empty((10, motion.shape[1]), np.float32)
        craft = craft._replace(
            kinematics=kinematics.code, numbers=kinematics.numbers, pushes=pushes, kept=kinematic_state, rows=rows
        )
        fly_together(replace(flight, craft=craft))
        return
    position, velocity, motion = position[:, :, :width], velocity[:, :, :width], motion[:, :width]
    gone = motion == kernels.DESTROYED
    for s in range(flight.steps):
        t, now = memory + s, slice(s, s + 1)
        step = craft._replace(begin=craft.begin + s * craft.stride)
        _fly_free(laws, step, noise[:, now], position, velocity[:, : t + 1], t, rngs)
        velocity[:, t][gone] = 0.0
        if led is not None:
            cut: dict[str, Any] = {
                "position": position[:, s : t + 2],
                "velocity": velocity[:, s : t + 1],
                "noise": noise[:, now],
                "motion": motion,
            }
            led.fly(replace(flight, **cut, clock=flight.clock + s))
        kinematics.fly(t, motion, pushes[:, s], kinematic_state, position, velocity)


def _find_laws(config: SwarmConfig, free: int) -> Laws:
    """How the free UAVs fly: heads, decoys and references first, then bystanders, traffic and false tracks."""
    others = {"smooth_turn": config.bystanders, "straight": config.traffic, "gauss_markov": config.clutter}
    first = free - sum(others.values())
    laws: Laws = [(config.head_mobility, slice(0, first))]
    for name, count in others.items():
        if count:
            laws.append((MOBILITIES[name], slice(first, first + count)))
        first += count
    return laws


def _draw_craft(laws: Laws, free: Indices, state: Floats, steps: int, rngs: Generators) -> kernels.Craft:
    """The mobilities of all free UAVs, their states, and their random numbers, as a craft."""
    count, width = free.shape[1], 0
    (codes, begin, stride), constants = np.zeros((3, count), np.int64), np.zeros((count, 6))
    for law, part in laws:
        stride[part] = each = (part.stop - part.start) * law.normals
        begin[part] = np.arange(width, width + each, law.normals) if each else 0
        width += each * steps
        if isinstance(law, CompiledMobility):
            codes[part], constants[part] = law.code, law.constants
    drawn = draw_normals(rngs, width)
    return kernels.FLOWN._replace(
        mobility=codes, constants=constants, free=free, normals=drawn, begin=begin, stride=stride, state=state
    )


def _fly_free(
    laws: Laws,
    craft: kernels.Craft,
    noise: Singles,
    position: Singles,
    velocity: Singles,
    first: int,
    rngs: Generators,
) -> None:
    """Write the velocities of the free UAVs from step ``first`` on."""
    if all(isinstance(law, CompiledMobility) for law, _ in laws):
        kernels.fly_free(first, craft, noise, position, velocity)
        return
    count = velocity.shape[1] - first
    for law, part in laws:
        columns, state, jittered = craft.free[:, part], craft.state[:, part], part.start < craft.jittered
        swarms = np.arange(len(columns))[:, None]
        if isinstance(law, CompiledMobility):
            names = ("mobility", "constants", "begin", "stride")  # with one row of each free UAV
            rows = {name: getattr(craft, name)[part] for name in names}
            one = craft._replace(**rows, free=columns, state=state, jittered=jittered * part.stop)
            kernels.fly_free(first, one, noise, position, velocity)
            continue
        place = position[swarms, first, columns]
        wanted = normalise(law.fly_batch(state, place, np.ones(columns.shape, bool), count, rngs).astype(np.float32))
        if jittered:
            wanted = normalise(wanted + craft.jitter * noise[swarms, :, columns].swapaxes(1, 2))
        velocity[swarms, first : first + count, columns] = wanted.swapaxes(1, 2)


def normalise(vectors: Singles) -> Singles:
    """Vectors ``(..., 3)`` scaled to length 1."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.asarray(vectors / np.sqrt(x * x + y * y + z * z + np.float32(1e-12))[..., None])

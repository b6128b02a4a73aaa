"""Flights: B swarms fly S steps, in compiled loops where all their parts have one.

Swarms with one follow strategy fly together: a loop is compiled for each strategy, and takes the mobilities and
kinematics of its swarms as numbers. A part of a user has no loop. Then the swarms with one configuration fly together,
with other kinematics than ``unit`` step by step: first what the UAVs want, then what they fly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Singles
from usnet_env.swarm import kernels
from usnet_env.swarm.config import SwarmConfig
from usnet_env.swarm.kinematics import CompiledKinematics, Kinematics, Unit
from usnet_env.swarm.mobility import MOBILITIES, CompiledMobility, Mobility
from usnet_env.swarm.sensing import Generators
from usnet_env.swarm.state import SwarmState, cut_rows, pad_rows
from usnet_env.swarm.strategy import FollowStrategy, TrajectoryBatch

OTHERS = ("smooth_turn", "straight", "gauss_markov")  # the mobilities of bystanders, traffic and false tracks
JITTER = 0.05  # kappa_n of the head jitter with follow="none", which has no follow strategy to define it


class Kind(NamedTuple):
    """Swarms of a batch with one configuration, and the parts by which they fly."""

    config: SwarmConfig
    rows: list[int]  # their indices in the batch
    strategy: FollowStrategy | None
    leading: FollowStrategy | None  # the strategy, if UAVs follow
    mobility: Mobility  # of heads, decoys and references
    kinematics: Kinematics

    @classmethod
    def of(cls, config: SwarmConfig, rows: list[int]) -> Self:
        """Look up the parts."""
        strategy = config.follow_strategy
        leading = strategy if strategy is not None and strategy.has_followers else None
        return cls(config, rows, strategy, leading, config.head_mobility, config.kinematics_model)

    @property
    def compiled(self) -> bool:
        """Whether all parts have compiled loops."""
        compiled = (self.leading is None or self.leading.compiled) and isinstance(self.mobility, CompiledMobility)
        return compiled and isinstance(self.kinematics, Unit | CompiledKinematics)


def sort_kinds(configs: Sequence[SwarmConfig]) -> list[tuple[SwarmConfig, list[int]]]:
    """Each configuration with the indices of its swarms."""
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

    This is positions ``(B, T_0 + S + 1, N + R, 3)`` and velocities ``(B, T_0 + S, N + R, 3)``. All swarms have as many
    references as the one with the most; those that a swarm doesn't have stay where they are.
    """
    kinds = [Kind.of(*kind) for kind in sort_kinds(configs)]
    if len(kinds) > 1 and not all(kind.compiled for kind in kinds):
        return _fly_apart(kinds, configs, state, rngs, steps)
    (episodes, uavs), memory = state.alive.shape, configs[0].memory
    past = pad_rows(state.reference_position), pad_rows(state.reference_velocity)
    widths = [uavs + row.shape[1] for row in state.reference_position]
    all_uavs = max(widths)
    position = np.zeros((episodes, memory + steps + 1, all_uavs, 3), np.float32)
    velocity = np.zeros((episodes, memory + steps, all_uavs, 3), np.float32)
    position[:, : memory + 1, :uavs], velocity[:, :memory, :uavs] = state.past_position, state.past_velocity
    position[:, : memory + 1, uavs:], velocity[:, :memory, uavs:] = past
    which = np.zeros(episodes, np.int64)
    for k, kind in enumerate(kinds[1:], 1):
        which[kind.rows] = k
    # Drawn for destroyed UAVs too, so the draws of the others do not depend on which UAVs live.
    noise = _draw_noise(kinds, which, widths, steps, rngs)
    craft = draw_craft(kinds, which, state.free, pad_rows(state.mobility_state), steps, rngs)._replace(
        width=np.array(widths),
        pushes=_draw_pushes(kinds, which, widths, steps, rngs),
        kept=pad_rows(state.kinematic_state),
        rows=np.empty((10, all_uavs), np.float32),
    )
    swarm = state.root, state.parameters, state.source, state.bystander, state.clock
    flight = TrajectoryBatch(position, velocity, noise, _find_motion(state, all_uavs), *swarm)
    if kinds[0].compiled:
        _fly_compiled(kinds, flight, craft)
    else:
        _fly_kind(kinds[0], flight, craft, rngs)
    after = replace(
        state,
        past_position=position[:, steps:, :uavs].copy(),
        past_velocity=velocity[:, steps:, :uavs].copy(),
        clock=state.clock + steps,
        mobility_state=cut_rows(craft.state, state.mobility_state),
        kinematic_state=cut_rows(craft.kept, state.kinematic_state),
        reference_position=cut_rows(position[:, steps:, uavs:].copy(), state.reference_position),
        reference_velocity=cut_rows(velocity[:, steps:, uavs:].copy(), state.reference_velocity),
    )
    return after, position, velocity


def _find_motion(state: SwarmState, all_uavs: int) -> NDArray[np.int8]:
    """How each UAV and reference moves, ``(B, N + R)``."""
    motion = np.full((len(state.alive), all_uavs), kernels.DESTROYED, np.int8)
    motion[:, : state.alive.shape[1]] = kernels.FOLLOWS
    for row, free in zip(motion, state.free, strict=True):
        row[free] = kernels.FREE
    motion[:, : state.alive.shape[1]][~state.alive] = kernels.DESTROYED
    return motion


def _draw_noise(kinds: Sequence[Kind], which: Indices, widths: list[int], steps: int, rngs: Generators) -> Singles:
    """Draw the followers' noise ``(B, S, N + R, 3)``; a swarm with fewer references fills the beginning of its row."""
    noisy = [3 * (kind.strategy is not None or kind.config.head_jitter) for kind in kinds]
    noise = np.empty((len(rngs), steps * max(widths) * 3), np.float32)
    for row, k, width, rng in zip(noise, which.tolist(), widths, rngs, strict=True):
        rng.standard_normal(out=row[: steps * width * noisy[k]], dtype=np.float32)
    return noise.reshape(len(rngs), steps, -1, 3)


def _draw_pushes(kinds: Sequence[Kind], which: Indices, widths: list[int], steps: int, rngs: Generators) -> Singles:
    """Draw the random numbers of the kinematics, ``(B, S, N + R, k)``."""
    draws = [kind.kinematics.normals for kind in kinds]
    pushes = np.empty((len(rngs), steps, max(widths), max(draws)), np.float32)
    for row, k, width, rng in zip(pushes, which.tolist(), widths, rngs, strict=True) if max(draws) else ():
        if draws[k]:
            row[:, :width, : draws[k]] = rng.standard_normal((steps, width, draws[k]), np.float32)
    return pushes


@cache
def _find_others() -> tuple[tuple[CompiledMobility, ...], Floats]:
    """The mobilities of bystanders, traffic and false tracks, and their constants ``(3, 6)``."""
    found = tuple(law for name in OTHERS if isinstance(law := MOBILITIES[name], CompiledMobility))
    return found, np.array([law.constants for law in found])


def draw_craft(
    kinds: Sequence[Kind], which: Indices, free: Indices, state: Floats, steps: int, rngs: Generators
) -> kernels.Craft:
    """How swarms fly; ``which`` ``(B,)`` is the kind of each. The states and draws of the kinematics are left empty."""
    (others, other_constants), laws = _find_others(), []
    constants, numbers = np.zeros((len(kinds), 4, 6)), np.zeros((len(kinds), 4), np.float32)
    kinematics, jitter = np.full(len(kinds), kernels.UNIT), np.zeros(len(kinds), np.float32)
    constants[:, 1:] = other_constants
    for k, (config, rows, strategy, _, mobility, model) in enumerate(kinds):
        groups = config.bystanders, config.traffic, config.clutter
        heads, number, normals = len(free[rows[0]]) - sum(groups), kernels.NOT_COMPILED, 0
        if isinstance(mobility, CompiledMobility):
            number, normals, constants[k, 0] = mobility.code, mobility.normals, mobility.constants
        rest = ((law.code, count, law.normals) for law, count in zip(others, groups, strict=True))
        laws.append(((number, heads, normals), *rest))
        if isinstance(model, CompiledKinematics):
            kinematics[k], numbers[k] = model.code, model.numbers
        if config.head_jitter:
            jitter[k] = JITTER if strategy is None else strategy.noise
    draws = [steps * sum(count * each for _, count, each in row) for row in laws]
    drawn = np.empty((len(rngs), max(draws)), np.float32)
    for row, k, rng in zip(drawn, which.tolist(), rngs, strict=True):
        rng.standard_normal(out=row[: draws[k]], dtype=np.float32)
    return kernels.Craft(
        swarms=np.arange(len(rngs)),
        width=np.zeros(len(rngs), np.int64),
        free=pad_rows(free),
        laws=np.array(laws)[which],
        constants=constants[which],
        steps=steps,
        normals=drawn,
        state=state,
        jitter=jitter[which],
        kinematics=kinematics[which],
        numbers=numbers[which],
        **kernels.NO_KINEMATICS,
    )


def _fly_compiled(kinds: Sequence[Kind], flight: TrajectoryBatch, craft: kernels.Craft) -> None:
    """Fly a batch whose parts have compiled loops, those with one follow strategy together.

    It writes the positions and velocities of the flight, and the states of the craft, in place.
    """
    flights: dict[int, tuple[FollowStrategy | None, list[int]]] = {}
    for kind in kinds:
        flights.setdefault(id(kind.leading), (kind.leading, []))[1].extend(kind.rows)
    if unit := [b for kind in kinds if isinstance(kind.kinematics, Unit) for b in kind.rows]:
        first, tracks = flight.start, (flight.motion, flight.noise, flight.position, flight.velocity)
        kernels.fly_free(first, first, craft._replace(swarms=np.array(unit)), *tracks)
    for strategy, rows in flights.values():
        parameters = flight.parameters if strategy is None else _spread(flight.parameters, rows)
        chosen = {"craft": craft._replace(swarms=np.array(rows)), "parameters": parameters}
        some = TrajectoryBatch(**{**vars(flight), **chosen})  # faster than `replace`
        if strategy is None:
            kernels.fly_alone(*some.flown)
        else:
            strategy.fly(some)


def _spread(parameters: Singles, rows: list[int]) -> Singles:
    """An array of the parameters of some swarms of a batch, with a row of each swarm; the other rows may be zeros."""
    if parameters.dtype != object:
        return parameters
    spread = np.zeros((len(parameters), len(parameters[rows[0]])), np.float32)
    spread[rows] = np.stack(list(parameters[rows]))
    return spread


def _fly_apart(
    kinds: Sequence[Kind], configs: Sequence[SwarmConfig], state: SwarmState, rngs: Generators, steps: int
) -> tuple[SwarmState, Singles, Singles]:
    """What :func:`fly_steps` returns, if each kind with a part without a compiled loop flies by itself."""
    together = [b for kind in kinds if kind.compiled for b in kind.rows]
    groups = [rows for rows in (together, *(kind.rows for kind in kinds if not kind.compiled)) if rows]
    parts = [fly_steps([configs[b] for b in rows], state.rows(rows), [rngs[b] for b in rows], steps) for rows in groups]
    after = SwarmState.join([part[0] for part in parts]).rows(np.argsort(np.concatenate(groups)))
    width = max(position.shape[2] for _, position, _ in parts)
    position, velocity = (np.zeros((len(rngs), flown.shape[1], width, 3), np.float32) for flown in parts[0][1:])
    for rows, (_, places, speeds) in zip(groups, parts, strict=True):
        position[rows, :, : places.shape[2]], velocity[rows, :, : places.shape[2]] = places, speeds
    return after, position, velocity


def _fly_kind(kind: Kind, flight: TrajectoryBatch, craft: kernels.Craft, rngs: Generators) -> None:
    """Fly swarms of one kind that has a part without a compiled loop, as :func:`_fly_compiled` does."""
    position, velocity, noise, motion = flight.position, flight.velocity, flight.noise, flight.motion
    first, gone = flight.start, motion == kernels.DESTROYED
    if isinstance(kind.kinematics, Unit):
        fly_free(kind, first, first, craft, motion, noise, position, velocity, rngs)
        velocity[:, first:].swapaxes(1, 2)[gone] = 0.0
        if kind.leading is None:
            kernels.fly_alone(*flight.flown)
        else:
            kind.leading.fly(flight)
        return
    for s in range(flight.steps):
        t, now = first + s, slice(s, s + 1)
        fly_free(kind, first, t, craft, motion, noise, position, velocity[:, : t + 1], rngs)
        velocity[:, t][gone] = 0.0
        if kind.leading is not None:
            cut: dict[str, Any] = {
                "position": position[:, s : t + 2],
                "velocity": velocity[:, s : t + 1],
                "noise": np.ascontiguousarray(noise[:, now]),
            }
            kind.leading.fly(replace(flight, **cut, clock=flight.clock + s))
        kind.kinematics.fly(t, motion, craft.pushes[:, s], craft.kept, position, velocity)


def find_mobilities(config: SwarmConfig) -> list[Mobility]:
    """How heads, decoys and references fly, then bystanders, traffic and false tracks."""
    return [config.head_mobility, *(MOBILITIES[name] for name in OTHERS)]


def fly_free(
    kind: Kind,
    start: int,
    first: int,
    craft: kernels.Craft,
    motion: NDArray[np.int8],
    noise: Singles,
    position: Singles,
    velocity: Singles,
    rngs: Generators,
) -> None:
    """Write the velocities of the free UAVs of swarms of one kind from instant ``first`` on; step 0 is at ``start``."""
    kernels.fly_free(start, first, craft, motion, noise, position, velocity)
    if isinstance(kind.mobility, CompiledMobility):
        return
    heads, swarms = slice(craft.laws[0, 0, 1]), np.arange(len(rngs))[:, None]
    columns, place = craft.free[:, heads], position[swarms, first, craft.free[:, heads]]
    steps, chosen = velocity.shape[1] - first, np.ones(columns.shape, bool)
    directions = kind.mobility.fly_batch(craft.state[:, heads], place, chosen, steps, rngs)
    wanted = normalise(directions.astype(np.float32))
    if (craft.jitter > 0).any():
        pushed = noise[swarms, first - start : first - start + steps, columns].swapaxes(1, 2)
        wanted = normalise(wanted + craft.jitter[0] * pushed)
    velocity[swarms, first : first + steps, columns] = wanted.swapaxes(1, 2)


def normalise(vectors: Singles) -> Singles:
    """Vectors ``(..., 3)`` scaled to length 1."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.asarray(vectors / np.sqrt(x * x + y * y + z * z + np.float32(1e-12))[..., None])

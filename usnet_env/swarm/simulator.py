"""The simulator: pure functions from a state and random generators to the next state and the observed window.

A batch has a leading axis B and one generator per episode. All random numbers of an episode come from its own
generator, in an order that does not depend on the batch. So episode b of a batch equals the single swarm with the same
seed, bit for bit. A free UAV is one that follows no UAV: a head or a decoy, and every UAV with ``follow="none"``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask, Singles
from usnet_env.config import ArgumentError, quote
from usnet_env.swarm import kernels
from usnet_env.swarm.config import SwarmConfig
from usnet_env.swarm.formation import FORMATIONS, check_place, draw_roles
from usnet_env.swarm.mobility import CompiledMobility
from usnet_env.swarm.sensing import ObservationBatch, sense
from usnet_env.swarm.trajectory import TrajectoryBatch

__all__ = ["SwarmState", "advance", "destroy", "start"]

Generators = Sequence[np.random.Generator]

_CHUNK_BYTES = 1 << 20  # size of one chunk of noise: small enough to stay in the processor cache until it is used


@dataclass(frozen=True)
class SwarmState:
    """The true state of B swarms between two rounds; :meth:`episode` gives one swarm without the leading axis.

    Args:
        head: ``(B, N)`` bool, H_0, the heads at the start, destroyed or not.
        decoy: ``(B, N)`` bool.
        alive: ``(B, N)`` bool, false for destroyed UAVs.
        leader: ``(B, N)`` int64, the head of each follower (-1: no head is left); a head's or decoy's own index.
        past_position: ``(B, T_0 + 1, N, 3)`` float32, metres, oldest first; 0 for destroyed UAVs.
        past_velocity: ``(B, T_0, N, 3)`` float32, metres per step.
        free: ``(B, n)`` int64, indices of the free UAVs.
        mobility_state: ``(B, n, MOBILITY_STATE)`` float64, the mobility state of the free UAVs.
        parameters: ``(B, P)`` float32, parameters of the follow strategy.
    """

    head: Mask
    decoy: Mask
    alive: Mask
    leader: Indices
    past_position: Singles
    past_velocity: Singles
    free: Indices
    mobility_state: Floats
    parameters: Singles

    @property
    def position(self) -> Singles:
        """``(B, N, 3)`` metres, the present positions."""
        return self.past_position[..., -1, :, :]

    @property
    def heads_left(self) -> Indices:
        """``(B,)`` number of living heads, |H_r|."""
        return np.asarray((self.head & self.alive).sum(axis=-1))

    def roles(self) -> dict[str, NDArray[Any]]:
        """``alive``, ``head``, ``decoy`` and ``leader`` by name, as pictures take them."""
        return {name: getattr(self, name) for name in ("alive", "head", "decoy", "leader")}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Copies of all arrays by name; ``SwarmState(**arrays)`` restores the state."""
        return {field.name: getattr(self, field.name).copy() for field in fields(self)}

    def rows(self, episodes: NDArray[np.intp] | slice) -> Self:
        """The state of some episodes of the batch."""
        return replace(self, **{field.name: getattr(self, field.name)[episodes] for field in fields(self)})

    def with_rows(self, episodes: NDArray[np.intp], other: SwarmState) -> Self:
        """A copy of this batch in which ``other`` replaces some episodes."""
        arrays = self.arrays()
        for name, array in arrays.items():
            array[episodes] = getattr(other, name)
        return replace(self, **arrays)

    def episode(self, b: int = 0) -> SwarmState:
        """A copy of episode ``b`` without the leading axis."""
        return SwarmState(**{field.name: getattr(self, field.name)[b].copy() for field in fields(self)})


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
    strategy, mobility_model = config.follow_strategy, config.head_mobility
    formation = FORMATIONS.find(config.formation)
    count = uavs if strategy is None else config.clusters + config.decoys
    head, decoy = np.empty((episodes, uavs), bool), np.empty((episodes, uavs), bool)
    leader, free = np.empty((episodes, uavs), np.int64), np.empty((episodes, count), np.int64)
    mobility_state = np.empty((episodes, count, kernels.MOBILITY_STATE))
    position = np.zeros((episodes, memory + 1, uavs, 3), np.float32)
    velocity = np.empty((episodes, memory, uavs, 3), np.float32)
    parameters = []
    for b, rng in enumerate(rngs):
        roles = draw_roles(rng, config.clusters, uavs, config.decoys, config.cluster_sizes)
        head[b], decoy[b], leader[b] = roles.head, roles.decoy, roles.leader
        free[b] = np.arange(uavs) if strategy is None else np.flatnonzero(roles.head | roles.decoy)
        position[b, 0] = check_place("formation", formation(rng, roles), uavs)
        mobility_state[b] = mobility_model.start(rng, count)
        rng.standard_normal(out=velocity[b], dtype=np.float32)
        if strategy is not None:
            seeded = rng if config.follow_seed is None else np.random.default_rng(config.follow_seed)
            parameters.append(strategy.draw(seeded))
    velocity /= np.sqrt((velocity * velocity).sum(axis=-1, keepdims=True))
    _fly_free(config, free, mobility_state, position, velocity, 0, rngs, np.empty((0, memory, uavs, 3), np.float32))
    kernels.integrate(0, position, velocity)
    return SwarmState(
        head=head,
        decoy=decoy,
        alive=np.ones((episodes, uavs), bool),
        leader=leader,
        past_position=position,
        past_velocity=velocity,
        free=free,
        mobility_state=mobility_state,
        parameters=np.array(parameters, np.float32).reshape(episodes, -1) if episodes else np.empty((0, 0), np.float32),
    )


def destroy(state: SwarmState, candidates: Mask) -> SwarmState:
    """Destroy the candidates; followers of a destroyed head join the nearest remaining head (re-merge, paper §II-A).

    Args:
        state: B swarms.
        candidates: ``(B, N)`` bool.

    Returns:
        The state after the re-merge.

    Raises:
        ArgumentError: ``state`` has another type, or ``candidates`` another type or shape.
    """
    if not isinstance(state, SwarmState):
        raise ArgumentError(f"state must be a SwarmState, got {quote(state)}.")
    if not isinstance(candidates, np.ndarray) or candidates.dtype != bool or candidates.shape != state.alive.shape:
        raise ArgumentError(
            f"candidates must be a boolean array of shape {state.alive.shape}, got {quote(candidates)}."
        )
    alive = state.alive & ~candidates
    leader = state.leader.copy()
    position, velocity = state.past_position.copy(), state.past_velocity.copy()
    kernels.remerge(state.head, alive, state.decoy, state.position, leader)
    gone = state.alive & ~alive
    position.swapaxes(1, 2)[gone] = 0.0
    velocity.swapaxes(1, 2)[gone] = 0.0
    return replace(state, alive=alive, leader=leader, past_position=position, past_velocity=velocity)


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
    if config.follow_strategy is not None and not state.heads_left.all():
        raise ArgumentError("state must have a living head in every swarm, got a swarm without one.")
    episodes, uavs = state.alive.shape
    memory, steps = config.memory, config.steps
    position = np.zeros((episodes, memory + steps + 1, uavs, 3), np.float32)
    velocity = np.zeros((episodes, memory + steps, uavs, 3), np.float32)
    position[:, : memory + 1] = state.past_position
    velocity[:, :memory] = state.past_velocity
    mobility_state = state.mobility_state.copy()
    motion = np.full((episodes, uavs), kernels.FOLLOWS, np.int8)
    np.put_along_axis(motion, state.free, np.int8(kernels.FREE), axis=1)
    motion[~state.alive] = kernels.DESTROYED
    # Random numbers are drawn for destroyed UAVs too, so the draws of the others do not depend on which UAVs live.
    chunk = max(1, _CHUNK_BYTES // (steps * uavs * 12))
    noise = np.empty((min(chunk, episodes), steps, uavs, 3), np.float32)
    for first in range(0, episodes, chunk):
        part = slice(first, min(first + chunk, episodes))
        _fly(config, state, motion, mobility_state, position, velocity, noise, part, rngs)
    end = memory + steps
    window = 2 * memory  # the window starts after the past and the unobserved steps
    observed = sense(config, position[:, window:], velocity[:, window:], state.alive, rngs)
    after = replace(
        state,
        past_position=position[:, end - memory :].copy(),
        past_velocity=velocity[:, end - memory :].copy(),
        mobility_state=mobility_state,
    )
    return after, observed


def _fly(
    config: SwarmConfig,
    state: SwarmState,
    motion: NDArray[np.int8],
    mobility_state: Floats,
    position: Singles,
    velocity: Singles,
    noise: Singles,
    part: slice,
    rngs: Generators,
) -> None:
    """Simulate the episodes ``part`` and write their rows of the arrays in place."""
    strategy = config.follow_strategy
    rngs = rngs[part]
    noise = noise[: len(rngs)]
    none = noise[:0]
    if strategy is not None or config.head_jitter:
        for row, rng in zip(noise, rngs, strict=True):
            rng.standard_normal(out=row, dtype=np.float32)
    jitter = none
    if config.head_jitter:
        jitter = noise * np.float32(strategy.noise if strategy is not None else JITTER)
    _fly_free(
        config, state.free[part], mobility_state[part], position[part], velocity[part], config.memory, rngs, jitter
    )
    if not state.alive[part].all():
        # Assignment instead of multiplication: the sign of a zero would show which of the destroyed UAVs were free.
        velocity[part].swapaxes(1, 2)[~state.alive[part], config.memory :] = 0.0
    if strategy is None:
        kernels.integrate(config.memory, position[part], velocity[part])
        return
    strategy.fly(
        TrajectoryBatch(position[part], velocity[part], noise, motion[part], state.leader[part], state.parameters[part])
    )


JITTER = 0.05  # kappa_n of the head jitter with follow="none", which has no follow strategy to define it


def _fly_free(
    config: SwarmConfig,
    free: Indices,
    mobility_state: Floats,
    position: Singles,
    velocity: Singles,
    first: int,
    rngs: Generators,
    jitter: Singles,
) -> None:
    """Write the velocities of the free UAVs from step ``first`` to the end of ``velocity`` in place."""
    mobility_model = config.head_mobility
    episodes, count = free.shape
    steps = velocity.shape[1] - first
    if isinstance(mobility_model, CompiledMobility):
        normals = np.empty((episodes, steps, count, mobility_model.normals), np.float32)
        for row, rng in zip(normals, rngs, strict=True):
            rng.standard_normal(out=row, dtype=np.float32)
        kernels.fly_free(
            mobility_model.code,
            mobility_model.constants(),
            free,
            first,
            normals,
            jitter,
            mobility_state,
            position,
            velocity,
        )
        return
    for b, rng in enumerate(rngs):
        directions = mobility_model.fly(mobility_state[b], position[b, first, free[b]], steps, rng).astype(np.float32)
        for added in (0.0, jitter[b][:, free[b]] if len(jitter) else None):
            if added is not None:
                directions = directions + np.float32(added)
                directions = directions / np.sqrt((directions * directions).sum(axis=-1, keepdims=True) + 1e-12)
        velocity[b, first:, free[b]] = directions.swapaxes(0, 1)

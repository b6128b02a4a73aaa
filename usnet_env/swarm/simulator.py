"""State and generators in, the next window out: one swarm and a batch of swarms by the same code.

A batch has a leading axis B and one generator an episode. Every draw of an episode comes from its own generator in
an order that does not depend on the batch, and the compiled loops treat episodes one after the other: episode b of a
batch is the single swarm with the same seed, bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError
from usnet_env.swarm import kernels
from usnet_env.swarm.config import SwarmConfig
from usnet_env.swarm.flight import Flight
from usnet_env.swarm.formation import draw_roles, formation
from usnet_env.swarm.mobility import CompiledMobility
from usnet_env.swarm.sensing import Sighting, sense

__all__ = ["SwarmState", "advance", "destroy", "start"]

Generators = Sequence[np.random.Generator]

_CHUNK_BYTES = 1 << 20  # noise drawn at once: what it is used for should find it in the cache


@dataclass(frozen=True)
class SwarmState:
    """The truth about B swarms between two rounds; without the leading axis, about one (:meth:`episode`).

    Args:
        head: ``(B, N)`` bool, H_0, whether destroyed since or not.
        decoy: ``(B, N)`` bool.
        alive: ``(B, N)`` bool.
        leader: ``(B, N)`` int64, whom each follower follows (-1: no head is left); a head's or decoy's own index.
        past_position: ``(B, T_0 + 1, N, 3)`` float32, metres, oldest first; 0 for destroyed UAVs.
        past_velocity: ``(B, T_0, N, 3)`` float32, metres per step.
        free: ``(B, n)`` int64, indices of the UAVs that fly by themselves.
        mobility_state: ``(B, n, MOBILITY_STATE)`` float64.
        parameters: ``(B, P)`` float32, parameters of the follow strategy.
    """

    head: NDArray[np.bool_]
    decoy: NDArray[np.bool_]
    alive: NDArray[np.bool_]
    leader: NDArray[np.int64]
    past_position: NDArray[np.float32]
    past_velocity: NDArray[np.float32]
    free: NDArray[np.int64]
    mobility_state: NDArray[np.float64]
    parameters: NDArray[np.float32]

    @property
    def position(self) -> NDArray[np.float32]:
        """``(B, N, 3)`` metres, where the UAVs are now."""
        return self.past_position[..., -1, :, :]

    @property
    def heads_left(self) -> NDArray[np.int64]:
        """``(B,)`` number of living heads, |H_r|."""
        return np.asarray((self.head & self.alive).sum(axis=-1))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Copies of all arrays by name; ``SwarmState(**arrays)`` is the state again."""
        return {field.name: getattr(self, field.name).copy() for field in fields(self)}

    def rows(self, episodes: NDArray[np.intp] | slice) -> Self:
        """The state of some episodes of the batch."""
        return replace(self, **{field.name: getattr(self, field.name)[episodes] for field in fields(self)})

    def with_rows(self, episodes: NDArray[np.intp], other: SwarmState) -> Self:
        """This batch with some of its episodes exchanged for those of ``other``."""
        arrays = self.arrays()
        for name, array in arrays.items():
            array[episodes] = getattr(other, name)
        return replace(self, **arrays)

    def episode(self, b: int = 0) -> SwarmState:
        """Episode ``b`` alone, copied, without the leading axis."""
        return SwarmState(**{field.name: getattr(self, field.name)[b].copy() for field in fields(self)})


def start(config: SwarmConfig, rngs: Generators) -> SwarmState:
    """B new swarms, one a generator; they have flown T_0 steps, so that a past to look back to exists.

    The followers' first T_0 velocities are random unit vectors: nobody has followed yet.
    """
    episodes, uavs, memory = len(rngs), config.uavs, config.memory
    strategy, law, place = config.follow_strategy, config.head_mobility, formation(config.formation)
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
        position[b, 0] = place(rng, roles)
        mobility_state[b] = law.start(rng, count)
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


def destroy(state: SwarmState, candidates: NDArray[np.bool_]) -> SwarmState:
    """Destroy the candidates ``(B, N)``; orphans re-merge to the nearest remaining head (paper §II-A)."""
    alive = state.alive & ~candidates
    leader = state.leader.copy()
    position, velocity = state.past_position.copy(), state.past_velocity.copy()
    kernels.remerge(state.head, alive, state.decoy, state.position, leader)
    gone = state.alive & ~alive
    position.swapaxes(1, 2)[gone] = 0.0
    velocity.swapaxes(1, 2)[gone] = 0.0
    return replace(state, alive=alive, leader=leader, past_position=position, past_velocity=velocity)


def advance(config: SwarmConfig, state: SwarmState, rngs: Generators) -> tuple[SwarmState, Sighting]:
    """Fly the next round: T_0 unobserved steps after a re-merge, then the window of T_ob samples.

    Args:
        config: what the swarms were started with.
        state: B swarms, each with a head left.
        rngs: each episode's generator.

    Returns:
        The state at the window's end, and the windows.
    """
    if len(rngs) != len(state.alive):
        raise ArgumentError(f"rngs must hold one generator for each of {len(state.alive)} swarms, got {len(rngs)}.")
    if config.follow_strategy is not None and not state.heads_left.all():
        raise ArgumentError("state must have a head left in every swarm, got one without; the game is over there.")
    episodes, uavs = state.alive.shape
    memory, steps = config.memory, config.steps
    position = np.zeros((episodes, memory + steps + 1, uavs, 3), np.float32)
    velocity = np.zeros((episodes, memory + steps, uavs, 3), np.float32)
    position[:, : memory + 1] = state.past_position
    velocity[:, :memory] = state.past_velocity
    mobility_state = state.mobility_state.copy()
    kind = np.full((episodes, uavs), kernels.FOLLOWS, np.int8)
    np.put_along_axis(kind, state.free, np.int8(kernels.FREE), axis=1)
    kind[~state.alive] = kernels.DESTROYED
    # A destroyed UAV is flown along and wiped: its draws must not depend on who is alive.
    chunk = max(1, _CHUNK_BYTES // (steps * uavs * 12))
    noise = np.empty((min(chunk, episodes), steps, uavs, 3), np.float32)
    for first in range(0, episodes, chunk):
        part = slice(first, min(first + chunk, episodes))
        _fly(config, state, kind, mobility_state, position, velocity, noise, part, rngs)
    end = memory + steps
    window = 2 * memory  # the past, then the steps between a re-merge and the window
    sighting = sense(config, position[:, window:], velocity[:, window:], state.alive, rngs)
    after = replace(
        state,
        past_position=position[:, end - memory :].copy(),
        past_velocity=velocity[:, end - memory :].copy(),
        mobility_state=mobility_state,
    )
    return after, sighting


def _fly(
    config: SwarmConfig,
    state: SwarmState,
    kind: NDArray[np.int8],
    mobility_state: NDArray[np.float64],
    position: NDArray[np.float32],
    velocity: NDArray[np.float32],
    noise: NDArray[np.float32],
    part: slice,
    rngs: Generators,
) -> None:
    """Fly the episodes ``part``; writes their rows of the arrays in place."""
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
        # Assigned, not multiplied: the sign of a zero would tell which of the destroyed flew by themselves.
        velocity[part].swapaxes(1, 2)[~state.alive[part], config.memory :] = 0.0
    if strategy is None:
        kernels.integrate(config.memory, position[part], velocity[part])
        return
    strategy.fly(Flight(position[part], velocity[part], noise, kind[part], state.leader[part], state.parameters[part]))


JITTER = 0.05  # kappa_n where no follow strategy names one


def _fly_free(
    config: SwarmConfig,
    free: NDArray[np.int64],
    mobility_state: NDArray[np.float64],
    position: NDArray[np.float32],
    velocity: NDArray[np.float32],
    first: int,
    rngs: Generators,
    jitter: NDArray[np.float32],
) -> None:
    """Velocities of the free UAVs from step ``first`` to the end of ``velocity``, in place."""
    law = config.head_mobility
    episodes, count = free.shape
    steps = velocity.shape[1] - first
    if isinstance(law, CompiledMobility):
        normals = np.empty((episodes, steps, count, law.normals), np.float32)
        for row, rng in zip(normals, rngs, strict=True):
            rng.standard_normal(out=row, dtype=np.float32)
        kernels.fly_free(law.code, law.constants(), free, first, normals, jitter, mobility_state, position, velocity)
        return
    for b, rng in enumerate(rngs):
        directions = law.fly(mobility_state[b], position[b, first, free[b]], steps, rng).astype(np.float32)
        for wobble in (0.0, jitter[b][:, free[b]] if len(jitter) else None):
            if wobble is not None:
                directions = directions + np.float32(wobble)
                directions = directions / np.sqrt((directions * directions).sum(axis=-1, keepdims=True) + 1e-12)
        velocity[b, first:, free[b]] = directions.swapaxes(0, 1)

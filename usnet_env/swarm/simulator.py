"""The simulator: pure functions from a state and random generators to the next state and the observed window.

A batch has a leading axis B. All random numbers of an episode come from its own generator, so episode b of a batch
equals the single swarm with the same seed, bit for bit. A free UAV is one that follows no UAV: a head, decoy or
bystander, and every UAV with ``follow="none"``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Indices, Singles
from usnet_env.swarm import kernels
from usnet_env.swarm.config import SwarmConfig
from usnet_env.swarm.flight import draw_plan, find_mobilities, fly_free, fly_steps, group_by_config
from usnet_env.swarm.formation import FORMATIONS, draw_corridors, draw_offsets
from usnet_env.swarm.sensing import Generators, ObservationBatch, draw_normals, sense, shift_tracks
from usnet_env.swarm.state import LASTING, Roles, SwarmState, destroy, find_each

SETTLING = 20  # steps that swarms with unseen UAVs fly at the start, besides their lags


def random_cluster_sizes(rngs: Generators, clusters: int, followers: int) -> Indices:
    """Draw the followers of each cluster, ``(B, clusters)`` int64, at least 2; all splits are equally likely."""
    slots = followers - clusters - 1
    bars = np.full((len(rngs), clusters + 1), slots)
    bars[:, 0] = -1
    for row, rng in zip(bars, rngs, strict=True) if clusters > 1 else ():
        row[1:-1] = np.sort(rng.choice(slots, clusters - 1, replace=False))
    return np.asarray(bars[:, 1:] - bars[:, :-1] + 1)


def draw_roles(rngs: Generators, config: SwarmConfig) -> Roles:
    """Draw the roles of B swarms, with indices permuted at random; every array has a leading axis B."""
    sizes = np.array([config.cluster_sizes] * len(rngs)) if config.cluster_sizes else None
    sizes = random_cluster_sizes(rngs, config.clusters, config.followers) if sizes is None else sizes
    unled = config.bystanders, config.traffic, config.clutter, config.absent
    counts = (config.clusters, config.decoys, config.followers, *unled)
    order = np.array([rng.permutation(config.uavs) for rng in rngs])
    kind, root = np.empty_like(order), np.tile(np.arange(config.uavs), (len(rngs), 1))
    swarms = np.arange(len(rngs))[:, None]
    kind[swarms, order] = np.repeat(np.arange(len(counts)), counts)
    head, decoy, _, bystander, traffic, clutter, absent = (kind == k for k in range(len(counts)))
    root[absent] = -1
    heads, followers = order[:, : config.clusters], order[:, config.clusters + config.decoys :][:, : config.followers]
    root[swarms, followers] = np.repeat(heads.ravel(), sizes.ravel()).reshape(followers.shape)
    return Roles(head, decoy, root, bystander | traffic | clutter, traffic, clutter, root.copy(), heads)


def start(config: SwarmConfig, rngs: Generators) -> SwarmState:
    """Start B swarms and simulate T_0 steps, which are the past of the first round.

    In these T_0 steps followers move in random directions: they have no past of their head to follow yet.

    Args:
        config: the configuration of all swarms.
        rngs: B generators, one per swarm.

    Returns:
        The state of the B swarms, with all N UAVs alive but those that are ``absent``.

    Raises:
        ValueError: a registered formation or mobility returned an array of another shape.

    >>> state = start(SwarmConfig(clusters=2, uavs=9), [np.random.default_rng(seed) for seed in (0, 1, 2)])
    >>> state.position.shape, state.heads_left.tolist()
    ((3, 9, 3), [2, 2, 2])
    """
    swarms = _draw_swarms(config, rngs)
    first_position, velocity, absent = (swarms.pop(name) for name in ("position", "velocity", "absent"))
    (episodes, memory, all_uavs, _), uavs = velocity.shape, config.uavs
    position = np.zeros((episodes, memory + 1, all_uavs, 3), np.float32)
    position[:, 0] = first_position
    x, y, z = np.moveaxis(velocity, -1, 0)  # faster than a sum over the last axis
    velocity /= np.sqrt(x * x + y * y + z * z)[..., None]
    plan = draw_plan(config, swarms["free"], swarms["mobility_state"], memory, rngs)
    plan = plan._replace(jitter=np.zeros_like(plan.jitter))
    motion = np.full((episodes, all_uavs), kernels.FREE, np.int8)
    fly_free(config, 0, 0, plan, motion, np.empty((episodes, 0, all_uavs, 3), np.float32), position, velocity, rngs)
    position[:, 1:] = velocity
    np.cumsum(position, axis=1, out=position)
    state = SwarmState(
        alive=np.ones((episodes, uavs), bool),
        past_position=position[:, :, :uavs],
        past_velocity=velocity[:, :, :uavs],
        clock=np.full(episodes, memory, np.int64),
        reference_position=position[:, :, uavs:],
        reference_velocity=velocity[:, :, uavs:],
        **swarms,
    )
    state = destroy(state, absent) if config.absent else state
    return _settle(config, state, rngs) if config.unseen_levels[1] else state


def _settle(config: SwarmConfig, state: SwarmState, rngs: Generators) -> SwarmState:
    """Fly until no UAV's course shows that its chain began with random ones, and put all UAVs back where they started.

    Each of the K unseen UAVs, the head and the follower answers as many steps late as the strategy has lags.
    """
    strategy = config.follow_strategy
    steps = SETTLING + (config.unseen_levels[1] + 2) * (strategy.lags if strategy is not None else 0)
    settled, position, _ = fly_steps([config] * len(rngs), state, rngs, steps)
    shift, uavs = position[:, -1:] - position[:, config.memory, None], state.alive.shape[1]
    shifts = {"past_position": shift[:, :, :uavs], "reference_position": shift[:, :, uavs:]}
    return replace(settled, **{name: getattr(settled, name) - shift_of for name, shift_of in shifts.items()})


def _draw_swarms(config: SwarmConfig, rngs: Generators) -> dict[str, NDArray[Any]]:
    """Draw arrays of :class:`SwarmState` by name, and ``position`` and ``velocity`` of N UAVs and R references."""
    strategy, kinematics, uavs = config.follow_strategy, config.kinematics_model, config.uavs
    has_unseen = config.unseen_levels[1] > 0
    points = config.clusters if strategy is not None and strategy.has_references else 0
    initial, formation = draw_roles(rngs, config), FORMATIONS.find(config.formation)
    swarms, rows = initial.split(), np.arange(len(rngs))[:, None]
    position = np.array([formation(*pair) for pair in zip(rngs, swarms, strict=True)], np.float64).reshape(-1, uavs, 3)
    roles = initial
    if strategy is not None:
        arranged = [strategy.arrange(*pair) for pair in zip(rngs, swarms, strict=True)]
        if any(new is not old for new, old in zip(arranged, swarms, strict=True)):
            roles = Roles(*map(np.array, zip(*arranged, strict=True)))
    sources = np.tile(np.arange(uavs, uavs + points), (len(rngs), 1))
    reference_position = position[rows, initial.initial_heads[:, :points]]
    if has_unseen:
        roles, sources, visible = _draw_chains(config, rngs, initial, roles)
        points, offsets = visible.shape[1], np.array([draw_offsets(rng, sources.shape[1]) for rng in rngs])
        reference_position = np.tile(position[rows, visible], (1, config.unseen_levels[1], 1)) + offsets
    all_uavs = uavs + sources.shape[1]
    if strategy is not None and strategy.has_followers:
        is_free = (initial.decoy | (initial.head & (points == 0))) & (not has_unseen)
    else:
        is_free = ~initial.not_led
    bystander = initial.not_led & ~initial.traffic & ~initial.clutter
    groups = find_each(is_free), sources[:, :points], *map(find_each, (bystander, initial.traffic, initial.clutter))
    free = np.concatenate(groups, axis=1)
    counts = [(mobility, free[0, columns].size) for mobility, columns in find_mobilities(config, free.shape[1])]
    states = [np.array([mobility.start(rng, count) for rng in rngs]) for mobility, count in counts]
    mobility_state = np.concatenate(states, axis=1, dtype=np.float64)
    if config.traffic:
        end = mobility_state.shape[1] - config.clutter
        corridors = zip(*(draw_corridors(rng, config.traffic) for rng in rngs), strict=True)
        starts, mobility_state[:, end - config.traffic : end, :3] = map(np.array, corridors)
        position[initial.traffic] = starts.reshape(-1, 3)
    velocity = draw_normals(rngs, config.memory, all_uavs, 3)
    seeded = [np.random.default_rng(config.follow_seed) for _ in rngs] if config.follow_seed is not None else rngs
    copying = all_uavs if has_unseen else uavs
    parameters = [np.empty(0, np.float32) if strategy is None else strategy.draw_for(rng, copying) for rng in seeded]
    states = [kinematics.start(rng, all_uavs) for rng in rngs if kinematics.values]
    return {
        **{name: getattr(roles, name) for name in LASTING},
        "absent": initial.root < 0,
        "free": free,
        "mobility_state": mobility_state,
        "parameters": np.array(parameters),
        "kinematic_state": np.array(states, np.float32).reshape(len(rngs), all_uavs, -1),
        "position": np.concatenate([position, reference_position], axis=1),
        "velocity": velocity,
        "reference_source": sources,
    }


def _draw_chains(config: SwarmConfig, rngs: Generators, initial: Roles, roles: Roles) -> tuple[Roles, Indices, Indices]:
    """Put a chain of up to K unseen UAVs above each of the C heads and decoys, and draw how many of them lead it.

    It returns the roles, the sources ``(B, K C)`` of the unseen UAVs, level by level, and the heads and decoys
    ``(B, C)``. The first of a chain is free. The last ones follow one after another; those between, if fewer than K
    are drawn, follow the first, and no UAV follows them.
    """
    fewest, most = config.unseen_levels
    visible = np.concatenate([initial.initial_heads, find_each(initial.decoy)], axis=1)
    chains = visible.shape[1]
    unseen = initial.head.shape[1] + np.arange(most * chains).reshape(most, chains)
    length = np.array([rng.integers(fewest, most + 1, chains) for rng in rngs])
    is_linked = np.arange(most + 1)[:, None] > most + 1 - length[:, None]
    sources = np.where(is_linked, np.concatenate([unseen[:1], unseen]), unseen[0])  # (B, K + 1, C), visible ones last
    source = roles.source.copy()
    np.put_along_axis(source, visible, sources[:, -1], axis=1)
    source = np.where(roles.head, np.take_along_axis(source, roles.source, axis=1), source)
    return roles._replace(source=source), sources[:, :-1].reshape(len(rngs), -1), visible


def advance(config: SwarmConfig, state: SwarmState, rngs: Generators) -> tuple[SwarmState, ObservationBatch]:
    """Simulate the next round of B swarms with one configuration: T_0 unobserved steps, then the observed window.

    Args:
        config: the configuration of all swarms.
        state: the state from :func:`start`, :func:`destroy` or the last round; it is not changed.
        rngs: B generators, one per swarm; a swarm goes on with the generator that started it.

    Returns:
        The state at the end of the window, and the windows of T_ob velocity samples.

    >>> config, rngs = SwarmConfig(clusters=2, uavs=9, observation_steps=50), [np.random.default_rng(0)]
    >>> state, window = advance(config, start(config, rngs), rngs)
    >>> window.position.shape, window.velocity.shape
    ((1, 51, 9, 3), (1, 50, 9, 3))
    """
    return advance_each([config] * len(rngs), state, rngs)


def advance_each(
    configs: Sequence[SwarmConfig], state: SwarmState, rngs: Generators
) -> tuple[SwarmState, ObservationBatch]:
    """:func:`advance` of B swarms, each with its configuration; T_0, N and the sampling are those of the first.

    Each swarm has at least one living head unless no UAV leads it.
    """
    next_state, position, velocity, first = fly_round(configs, state, rngs)
    return next_state, sense(configs, position, velocity, state.alive, rngs, state.free, first=first)


def fly_round(
    configs: Sequence[SwarmConfig], state: SwarmState, rngs: Generators
) -> tuple[SwarmState, Singles, Singles, int]:
    """Fly the next round, unobserved: what :func:`fly_steps` returns, and the instant at which the window begins."""
    next_state, position, velocity = fly_steps(configs, state, rngs, configs[0].steps)
    first, uavs = 2 * configs[0].memory, state.alive.shape[1]  # after the past and the unobserved steps
    for config, rows in group_by_config(configs):
        if (strategy := config.follow_strategy) is not None and strategy.shifts_tracks:
            tracks = position[rows, first:, :uavs], velocity[rows, first:, :uavs]
            shifted = shift_tracks(*tracks, state.source[rows], [rngs[b] for b in rows])
            position[rows, first:, :uavs], velocity[rows, first:, :uavs] = shifted
    return next_state, position, velocity, first

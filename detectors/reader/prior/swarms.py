"""Swarms of the simulator: their configurations, and their motions with the truth."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from detectors.reader.prior.draws import draw_log, draw_name, draw_whole
from detectors.reader.prior.faults import clear_sensor, draw_sensor
from detectors.reader.prior.motion import Motion
from detectors.reader.prior.strategies import MEMORY, draw_strategy
from detectors.reader.prior.table import MODELS
from usnet_env.arrays import Indices, Mask
from usnet_env.envs.field import DISTRIBUTIONS
from usnet_env.swarm import SwarmConfig, SwarmState, advance, destroy, start
from usnet_env.swarm.field_follow import Frontness, Links
from usnet_env.swarm.field_kernels import DELAY

_MOBILITY = {"gauss_markov": 4, "smooth_turn": 2, "waypoint": 1.5, "local_waypoint": 1.5, "iid": 1.5, "straight": 0.4}
_KINEMATICS = {"unit": 6.5, **dict.fromkeys(("varied_speed", "lagged", "limited", "layered"), 0.875)}
_FORMATION = {"gathered": 0.6, "uniform": 0.25, "around": 0.15}
_OTHERS = ("clutter", "traffic", "bystanders", "decoys")


def draw_model_swarm(
    rng: np.random.Generator, name: str, steps: int, most_uavs: int, fault: str = "none"
) -> SwarmConfig:
    """Draw a swarm that follows by the model ``name``, seen by a sensor with the fault."""
    many = {"decoys": 4, "bystanders": 12, "traffic": 7, "clutter": 8}
    often = {"decoys": 0.25, "bystanders": 0.25, "traffic": 0.15, "clutter": 0.07 if fault == "none" else 0.15}
    uavs = draw_whole(rng, 6, min(60, most_uavs) if rng.random() < 0.98 else most_uavs)
    most_clusters = min(20 if rng.random() < 0.1 else 8, uavs // 3)
    arguments = {
        "follow": draw_strategy(rng, name),
        "mobility": draw_name(rng, _MOBILITY),
        "kinematics": draw_name(rng, _KINEMATICS),
        "formation": draw_name(rng, _FORMATION),
        "head_jitter": bool(rng.random() < 0.7),
        "clusters": int(rng.integers(1, most_clusters + 1)),
        **{other: int(rng.integers(1, many[other] + 1)) if rng.random() < often[other] else 0 for other in _OTHERS},
        **draw_sensor(rng, fault),
    }
    return _fit(arguments, uavs, steps)


def draw_field_swarm(rng: np.random.Generator, steps: int, most_uavs: int, without: Collection[str]) -> SwarmConfig:
    """Draw a swarm as ``USNET/Field`` does, its constants varied in half of the draws."""
    arguments = DISTRIBUTIONS[2].draw(rng)
    while arguments["follow"] in without:
        arguments = DISTRIBUTIONS[2].draw(rng)
    arguments["follow"] = draw_strategy(rng, arguments["follow"])
    uavs = min(most_uavs, draw_whole(rng, 24, 60))
    return _fit(clear_sensor(arguments, without), uavs, steps)


def _fit(arguments: dict[str, Any], uavs: int, steps: int) -> SwarmConfig:
    """The swarm of so many UAVs; each cluster has two followers at least, so others stay away until it has."""
    while 3 * arguments["clusters"] + sum(arguments[name] for name in _OTHERS if name in arguments) > uavs:
        for name in _OTHERS:
            arguments[name] = arguments.get(name, 0) // 2
        arguments["clusters"] = max(1, arguments["clusters"] * 2 // 3)
    return SwarmConfig(uavs=uavs, observation_steps=steps, memory=MEMORY, **arguments)


def fly_swarms(config: SwarmConfig, rng: np.random.Generator, windows: int) -> Motion:
    """Simulate windows of a swarm, in 15 % of the draws after the destruction of as many UAVs in each."""
    rngs = rng.spawn(windows)
    state = start(config, rngs)
    if rng.random() < 0.15 and config.uavs >= 12:
        gone = _draw_losses(state.head, rng, int(rng.integers(1, max(2, config.uavs // 5))))
        state, _ = advance(config, state, rngs)
        state = destroy(state, gone)
    state, sighting = advance(config, state, rngs)
    living = np.stack([np.flatnonzero(alive) for alive in sighting.alive])
    seen = np.take_along_axis(sighting.seen, living[:, None], axis=2)
    position, velocity = (
        np.take_along_axis(array, living[:, None, :, None], axis=2) for array in (sighting.position, sighting.velocity)
    )
    return _label(config, state, living)._replace(position=position, velocity=velocity, seen=seen)


def _draw_losses(head: Mask, rng: np.random.Generator, losses: int) -> Mask:
    """Draw which UAVs of each swarm are destroyed, equally many; one head and five others are spared."""
    gone = np.zeros(head.shape, bool)
    least = max(losses - int((~head).sum(axis=1).min()) + 5, 0)
    for row, heads in zip(gone, head, strict=True):
        most = min(losses, max(int(heads.sum()) - 1, 0))
        hit = min(int(rng.integers(min(least, most), most + 1)), most)
        row[rng.choice(np.flatnonzero(heads), hit, replace=False) if hit else []] = True
        row[rng.choice(np.flatnonzero(~heads), losses - hit, replace=False)] = True
    return gone


def _label(config: SwarmConfig, state: SwarmState, living: Indices) -> Motion:
    """The truth about the living UAVs ``(B, n)``, by their places among these."""
    windows, uavs = living.shape
    followed = config.follow != "none"
    place = np.full((windows, config.uavs), -1)
    np.put_along_axis(place, living, np.broadcast_to(np.arange(uavs), living.shape), axis=1)

    def find_places(target: Indices) -> Indices:
        target = np.take_along_axis(target, living, axis=1)
        inside = (target >= 0) & (target < config.uavs) & followed
        local = np.where(inside, np.take_along_axis(place, np.where(inside, target, 0), axis=1), -1)
        return np.where(local >= 0, local, np.arange(uavs))

    root = find_places(state.root)
    leader = np.where(root == np.arange(uavs), root, find_places(state.leader))  # a predator has a source, but no head
    head = np.take_along_axis(state.head & state.alive, living, axis=1) & followed
    strategy, follows = config.follow_strategy, leader != np.arange(uavs)
    if not getattr(strategy, "preference", 0.0):  # informed UAVs lead a flock whose UAVs have no head of their own
        for row, roots, led in zip(head, root, follows, strict=True):
            row &= np.isin(np.arange(uavs), roots[led])
    delay = np.full(living.shape, np.nan, np.float32)
    if isinstance(strategy, Frontness) or (isinstance(strategy, Links) and not strategy.strength):
        table = state.parameters.reshape(windows, -1, config.uavs)[:, DELAY]
        delay = np.where(follows, np.take_along_axis(table, living, axis=1), np.float32(np.nan))
    empty = np.empty(0, np.float32)
    return Motion(empty, np.empty(0, bool), head, leader, root, delay)


def draw_model(rng: np.random.Generator, without: Collection[str]) -> str:
    """Draw the name of a model that isn't left out."""
    return draw_name(rng, {name: weight for name, weight in MODELS.items() if name not in without})


def draw_steps(rng: np.random.Generator) -> int:
    """Draw T, the steps of a window."""
    return 100 if rng.random() < 0.55 else round(float(draw_log(rng, 20.0, 200.0)))

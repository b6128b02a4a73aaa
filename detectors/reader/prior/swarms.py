"""Swarms of the simulator: their configurations, and their motions with the truth."""

from collections.abc import Collection
from typing import Any

import numpy as np

from detectors.reader.examples import Examples
from detectors.reader.prior.families import draw_name, draw_whole
from detectors.reader.prior.observing import draw_sensors, make_examples
from detectors.reader.prior.random_laws import RandomLaw
from detectors.reader.prior.strategies import MEMORY, draw_strategy
from detectors.reader.prior.worlds.stage import link_leaders
from usnet_env.arrays import Indices, Mask, Singles
from usnet_env.envs.distribution import DISTRIBUTIONS
from usnet_env.swarm import FollowStrategy, SwarmConfig, SwarmState, advance, destroy, start
from usnet_env.swarm.field_follow import CopyingStrategy, Frontness
from usnet_env.swarm.field_kernels import COLUMNS, DELAY
from usnet_env.swarm.flock_follow import Flock

_MOBILITY = {"gauss_markov": 4, "smooth_turn": 2, "waypoint": 1.5, "local_waypoint": 1.5, "iid": 1.5, "straight": 2.5}
_KINEMATICS = {"unit": 5.0, **dict.fromkeys(("varied_speed", "lagged", "limited", "layered"), 1.25)}
_FORMATION = {"gathered": 0.6, "uniform": 0.25, "around": 0.15}
_EXTRAS = {"clutter": (0.1, 8), "traffic": (0.15, 7), "bystanders": (0.25, 12), "decoys": (0.35, 5)}  # how often, most
_P_LED_HEADS = 0.25  # how often heads and decoys follow unseen UAVs, as their followers follow them
_P_SMOOTH_HEADS = 0.2  # how often many decoys move as heads do, and these as smoothly as their followers
_SMOOTH = {"local_waypoint": 2.0, "smooth_turn": 1.0, "gauss_markov": 1.0}


def draw_model_swarm(
    rng: np.random.Generator, name: str, steps: int, most_uavs: int, fault: str = "", without: Collection[str] = ()
) -> SwarmConfig:
    """Draw a swarm that follows by the model ``name``, seen by a sensor with the fault; without one, often by noise."""
    if not fault and rng.random() < 0.4:
        fault = "fault:noise"
    fewest = 3 if rng.random() < 0.2 else 6
    uavs = draw_whole(rng, fewest, min(60, most_uavs) if rng.random() < 0.98 else most_uavs)
    most_clusters = min(20 if rng.random() < 0.1 else 8, uavs // 3)
    arguments = {
        "follow": draw_strategy(rng, name, steps),
        "mobility": draw_name(rng, _MOBILITY),
        "kinematics": draw_name(rng, _KINEMATICS),
        "formation": draw_name(rng, _FORMATION),
        "head_jitter": bool(rng.random() < 0.7),
        "clusters": int(rng.integers(1, most_clusters + 1)),
        **{name: int(rng.integers(most) + 1) if rng.random() < rate else 0 for name, (rate, most) in _EXTRAS.items()},
        "led_by": int(rng.integers(1, 5)) if rng.random() < _P_LED_HEADS else 0,
        **(draw_sensors(rng, without).get(fault, {}) if fault not in without else {}),
    }
    if rng.random() < _P_SMOOTH_HEADS:
        arguments |= {"head_jitter": True, "mobility": draw_name(rng, _SMOOTH), "decoys": int(rng.integers(2, 11))}
    return _fit(arguments, uavs, steps)


def draw_field_swarm(rng: np.random.Generator, steps: int, most_uavs: int, without: Collection[str]) -> SwarmConfig:
    """Draw a swarm as the field environment does, with constants of its model varied in half of the draws."""
    faults = [list(names)[-1] for fault, names in draw_sensors(rng).items() if fault in without]
    field = DISTRIBUTIONS["field-v1"]
    while (arguments := field.draw(rng))["follow"] in without or any(arguments.get(name) for name in faults):
        pass
    arguments["follow"] = draw_strategy(rng, arguments["follow"])
    uavs = draw_whole(rng, 24, 44 if rng.random() < 0.85 else 60)
    return _fit(arguments, min(most_uavs, uavs), steps)


def _fit(arguments: dict[str, Any], uavs: int, steps: int) -> SwarmConfig:
    """The swarm of so many UAVs; each cluster has two followers at least, so others stay away until it has."""
    while 3 * arguments["clusters"] + sum(arguments.get(name, 0) for name in _EXTRAS) > uavs:
        arguments.update({name: arguments.get(name, 0) // 2 for name in _EXTRAS})
        arguments["clusters"] = max(1, arguments["clusters"] * 2 // 3)
    memory = max(MEMORY, getattr(arguments["follow"], "lags", 0))
    return SwarmConfig(uavs=uavs, observation_steps=steps, memory=memory, **arguments)


def fly_swarms(config: SwarmConfig, rng: np.random.Generator, windows: int) -> Examples:
    """Simulate windows of a swarm, in 15 % of the draws after the destruction of as many UAVs in each."""
    rngs = rng.spawn(windows)
    state = start(config, rngs)
    if rng.random() < 0.15 and config.uavs >= 12:
        losses = _draw_losses(state.head, rng, int(rng.integers(config.uavs // 5)) + 1)
        state, _ = advance(config, state, rngs)
        state = destroy(state, losses)
    state, sighting = advance(config, state, rngs)
    living, row = np.stack([np.flatnonzero(alive) for alive in sighting.alive]), np.arange(windows)[:, None]
    seen = sighting.seen.swapaxes(1, 2)[row, living].swapaxes(1, 2)
    position, velocity = (
        array.swapaxes(1, 2)[row, living].swapaxes(1, 2) for array in (sighting.position, sighting.velocity)
    )
    return make_examples(position, seen, _find_truth(config, state, living), velocity)


def _draw_losses(head: Mask, rng: np.random.Generator, losses: int) -> Mask:
    """Draw which UAVs of each swarm are destroyed, equally many, heads more or less often; one head is spared."""
    rank = rng.random(head.shape) + rng.uniform(-0.5, 1.0, (len(head), 1)) * head
    rank[np.arange(len(head)), np.where(head, rank, -1.0).argmax(axis=1)] = -1.0
    return np.asarray(rank.argsort(axis=1).argsort(axis=1) >= head.shape[1] - losses)


def _find_truth(config: SwarmConfig, state: SwarmState, living: Indices) -> tuple[Any, ...]:
    """The truth about the living UAVs ``(B, n)``, by their indices among these: the fields of ``Examples``."""
    row, index = np.arange(len(living))[:, None], np.arange(living.shape[1])
    number = np.full((len(living), config.uavs + state.reference_position.shape[2] + 1), -1)  # the last is of no UAV
    number[row, living] = index

    def find_indices(target: Indices) -> Indices:
        local = number[row, target[row, living]]
        return np.where((local >= 0) & (config.follow != "none"), local, index)

    root = find_indices(state.root)
    leader = np.where(root == index, index, find_indices(state.leader))  # a predator has a source, but no head
    strategy, follows = config.follow_strategy, leader != index
    head = (state.head & state.alive)[row, living] & (config.follow != "none")
    if not getattr(strategy, "link", 0.0):  # informed UAVs lead a flock whose UAVs have no head of their own
        head &= np.stack([np.isin(index, roots[mask]) for roots, mask in zip(root, follows, strict=True)])
    delay = np.full(living.shape, np.nan, np.float32)
    if isinstance(strategy, Frontness) or (isinstance(strategy, CopyingStrategy) and not strategy.strength):
        table = state.parameters.reshape(len(living), COLUMNS, -1)[:, DELAY]
        delay[follows] = table[row, living][follows]
    if isinstance(strategy, RandomLaw) and not strategy.forgetting:
        slot = (np.cumsum(state.source != np.arange(config.uavs), axis=1) - 1)[row, living]
        delay[follows] = strategy.find_delays(state.parameters[row, slot])[follows]
    return head, leader, root, _find_links(strategy, leader, root), delay, ""


def _find_links(strategy: FollowStrategy | None, leader: Indices, root: Indices) -> Singles:
    """Which UAVs each one copies ``(B, n, n)``: its leader, in some models also those above it; NaN in flocks."""
    link = link_leaders(leader)
    if isinstance(strategy, Flock):
        link[:] = np.nan
    elif isinstance(strategy, CopyingStrategy):
        above = leader
        for _ in range(strategy.links - 1):
            above = np.where(above == root, above, np.take_along_axis(leader, above, axis=1))
            link = np.maximum(link, link_leaders(above))
    return link

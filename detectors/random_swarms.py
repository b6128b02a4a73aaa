"""Draws of simulated swarms, on which detectors are trained and calibrated."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from usnet_env.arrays import Mask
from usnet_env.swarm import SwarmConfig, SwarmState, advance, destroy, start
from usnet_env.swarm.random_follow import RandomFollowStrategy, random_follow_strategy
from usnet_env.window import Window

_CALIBRATION = ("iid", "gauss_markov", "smooth_turn", "local_waypoint", "waypoint", "straight")
_TRAINING = ("iid", "gauss_markov", "smooth_turn", "waypoint", "local_waypoint")
_SMOOTH = _CALIBRATION[1:4]


def _draw_log_uniform(rng: np.random.Generator, least: int, most: int) -> int:
    return round(math.exp(rng.uniform(math.log(least), math.log(most))))


def _draw_linear_strategy(rng: np.random.Generator) -> RandomFollowStrategy:
    """Draw a random strategy with linear terms only; these are rare in the grammar."""
    draws = iter(lambda: random_follow_strategy(rng), None)
    return next(drawn for drawn in draws if all(term.kind == "linear" for term in drawn.terms))


def draw_training_swarm(most_uavs: int, most_clusters: int, rng: np.random.Generator) -> SwarmConfig:
    """Draw the configuration of a swarm and its observer; the follow strategy is none of f1 to f7."""
    uavs = _draw_log_uniform(rng, 10, most_uavs)
    clusters = int(rng.integers(1, min(most_clusters, uavs // 3) + 1))
    decoys = int(rng.integers(0, min(5, uavs - 3 * clusters) + 1)) if rng.random() < 0.3 else 0
    noisy = rng.random() < 0.1
    return SwarmConfig(
        follow=random_follow_strategy(rng) if rng.random() < 0.97 else "none",
        mobility="iid" if rng.random() < 0.35 else str(rng.choice(_TRAINING)),
        formation=str(rng.choice(["uniform", "around"], p=[0.8, 0.2])),
        clusters=clusters,
        uavs=uavs,
        observation_steps=100 if rng.random() < 0.6 else _draw_log_uniform(rng, 8, 160),
        miss_rate=float(rng.uniform(0.0, 0.3)) if rng.random() < 0.2 else 0.0,
        position_noise=float(rng.uniform(0.02, 0.5)) if noisy else 0.0,
        sample_every=2 if rng.random() < 0.05 else 1,
        decoys=decoys,
        head_jitter=bool(rng.random() < 0.5),
    )


def draw_calibration_swarm(most_uavs: int, most_clusters: int, rng: np.random.Generator) -> SwarmConfig:
    """Draw the configuration of a swarm and its observer; the follow strategy is none of f1 to f7."""
    uavs = _draw_log_uniform(rng, 20, most_uavs)
    decoys = int(rng.integers(1, 6)) if rng.random() < 0.3 else 0
    clusters = int(rng.integers(1, min(most_clusters, (uavs - decoys) // 3) + 1))
    kind = rng.random()  # no UAV follows in 10 % of the swarms; all terms are linear in another 40 %
    follow = "none" if kind < 0.1 else _draw_linear_strategy(rng) if kind < 0.5 else random_follow_strategy(rng)
    drawn = SwarmConfig(
        follow=follow,
        mobility="iid" if rng.random() < 0.3 else str(rng.choice(_CALIBRATION)),
        formation=str(rng.choice(["uniform", "around"], p=[0.8, 0.2])),
        clusters=clusters,
        uavs=uavs,
        observation_steps=100 if rng.random() < 0.5 else _draw_log_uniform(rng, 12, 150),
        miss_rate=float(rng.uniform(0.0, 0.3)) if rng.random() < 0.15 else 0.0,
        position_noise=float(rng.uniform(0.1, 1.0)) if rng.random() < 0.2 else 0.0,
        decoys=decoys,
        head_jitter=bool(rng.random() < 0.5),
    )
    if drawn.position_noise > 0 and kind >= 0.1 and rng.random() < 0.5:
        # Linear strategies that are equal on all axes, with smooth heads, behind noise: rare otherwise.
        alike = _draw_linear_strategy(rng)
        while len(alike.terms) == 1 and alike.terms[0].lag == 0:  # that is f1
            alike = _draw_linear_strategy(rng)
        smooth = {"follow": replace(alike, rotation=np.eye(3, dtype=np.float32)), "mobility": str(rng.choice(_SMOOTH))}
        drawn = drawn.model_copy(update={**smooth, "head_jitter": True})
    return drawn


def observe(
    config: SwarmConfig, rng: np.random.Generator, rate: float, draw_losses: Callable[[Mask], Mask]
) -> tuple[Window, SwarmState]:
    """Observe one window of a swarm, of its first round, or with a probability ``rate`` after UAVs were destroyed.

    ``draw_losses`` draws these, ``(1, N)``, from the heads ``(1, N)``; one head and two other UAVs are always spared.
    """
    (own,) = rng.spawn(1)
    state = start(config, [own])
    if rng.random() < rate:
        gone = draw_losses(state.head)
        gone[0, rng.choice(np.flatnonzero(state.head[0]))] = False
        gone[0, rng.choice(np.flatnonzero(~state.head[0]), 2, replace=False)] = False
        state, _ = advance(config, state, [own])
        state = destroy(state, gone)
    state, sighting = advance(config, state, [own])
    return Window(sighting.position[0], sighting.velocity[0], sighting.seen[0], sighting.alive[0]), state


def draw_calibration_window(config: SwarmConfig, rng: np.random.Generator) -> tuple[Window, Mask]:
    """Draw a window of a swarm and its living heads ``(N,)``; in 20 % of the cases some UAVs were destroyed before."""

    def lose(head: Mask) -> Mask:
        chance = np.where(head[0], rng.uniform(0.0, 1.0), rng.uniform(0.0, 0.1))  # earlier rounds hit heads
        return np.asarray(rng.random((1, config.uavs)) < chance)

    window, state = observe(config, rng, 0.2, lose)
    return window, state.head[0] & state.alive[0] & (config.follow != "none")

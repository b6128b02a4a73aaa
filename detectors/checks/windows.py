"""The windows that the checks use: simulated swarms, and swarms that carry no information about their heads."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from usnet_env.detection import read_tags
from usnet_env.swarm import SwarmConfig, advance, destroy, start
from usnet_env.window import Window

STEPS = 30  # T_ob of most windows: what the checks look for shows in short windows too


def simulate_window(
    clusters: int = 3,
    uavs: int = 14,
    *,
    seed: int = 0,
    destroyed: int = 0,
    observation_steps: int = STEPS,
    round: int = 1,
    **config: Any,
) -> Window:
    """Simulate a swarm by the arguments of :class:`usnet_env.swarm.SwarmConfig` and return one window.

    Of the ``destroyed`` UAVs, heads included, there are at most N - 3; one head always survives.
    """
    swarm = SwarmConfig(clusters=clusters, uavs=uavs, observation_steps=observation_steps, **config)
    rng = np.random.default_rng(seed)
    state = start(swarm, [rng])
    spared = np.flatnonzero(state.head[0])[:1]
    order = rng.permutation(np.setdiff1d(np.arange(uavs), spared))
    gone = np.zeros((1, uavs), bool)
    gone[0, order[: min(destroyed, uavs - 3)]] = True
    _, sighting = advance(swarm, destroy(state, gone), [rng])
    return Window(sighting.position[0], sighting.velocity[0], sighting.seen[0], sighting.alive[0], round)


def draw_window(detector: Any, uavs: int = 14, *, observation_steps: int = STEPS, **more: Any) -> Window:
    """Simulate a window by :func:`simulate_window`, of at most ``uavs`` UAVs, that the detector takes by its tags."""
    uavs, steps = _fit_size(detector, uavs, observation_steps)
    more["clusters"] = min(more.get("clusters", 3), uavs // 3)
    return simulate_window(uavs=uavs, observation_steps=steps, **more)


def draw_two_rounds(detector: Any) -> list[Window]:
    """Simulate the windows of two rounds by :func:`draw_window`.

    Each call makes new ones, so that a detector that writes into windows fails ``check_input_unchanged`` only.
    """
    return [draw_window(detector), draw_window(detector, seed=1, destroyed=3, round=2)]


def simulate_missing_samples(detector: Any = None, seed: int = 0) -> Window:
    """Simulate a noisy window with missing samples: single ones, all of one UAV, and all UAVs at some steps."""
    window = draw_window(detector, seed=seed, miss_rate=0.3, position_noise=0.2, destroyed=2, round=2)
    seen = window.seen.copy()
    seen[:, np.flatnonzero(window.alive)[0]] = False
    seen[[0, 20, 21]] = False
    both = seen[1:] & seen[:-1]
    position, velocity = np.where(seen[..., None], window.position, 0), np.where(both[..., None], window.velocity, 0)
    return Window(position, velocity, seen, window.alive, window.round)


def make_hovering_window(detector: Any = None, *, together: bool = False) -> Window:
    """Make a window in which no UAV moves, so that every spread is 0 and no UAV looks like a head.

    If ``together``, all UAVs are at one point and differ in their indices only.
    """
    uavs, steps = _fit_size(detector, 8)
    place = np.random.default_rng(0).uniform(0, 100, (1 if together else uavs, 3))
    position = np.broadcast_to(place.astype(np.float32), (steps + 1, uavs, 3))
    return Window(
        position, np.zeros((steps, uavs, 3), np.float32), np.ones((steps + 1, uavs), bool), np.ones(uavs, bool)
    )


def permute_uavs(window: Window, order: NDArray[np.intp]) -> Window:
    """Return the window with UAV ``order[i]`` at index i."""
    arrays = (window.position[:, order], window.velocity[:, order], window.seen[:, order], window.alive[order])
    return Window(*arrays, window.round, window.step)


def start_environment(detector: Any = None, seed: int = 0, **arguments: Any) -> tuple[gym.Env[Any, Any], Window]:
    """Start an episode of ``USNET/MultiCluster-v0``; returns it, with its wrappers, and the first window.

    By default it has 15 UAVs, which no other window of the checks has, in 3 clusters.
    """
    uavs, steps = _fit_size(detector, 15)
    arguments = {"clusters": min(3, uavs // 3), "uavs": uavs, "observation_steps": steps, **arguments}
    # As in an evaluation: without Gymnasium's checker, which compares an environment with its specification.
    env: gym.Env[Any, Any] = gym.make("USNET/MultiCluster-v0", disable_env_checker=True, **arguments)
    observation, _ = env.reset(seed=seed)
    return env, Window.from_observation(observation)


def set_heads(env: Any, heads: NDArray[np.intp]) -> None:
    """Change the true heads of the swarm in an environment; the observations stay as they are."""
    state = env.unwrapped.get_state()
    head = np.zeros_like(state["swarm"]["head"])
    head[:, heads] = True
    root = np.where(head, np.arange(head.shape[1]), heads[0])
    state["swarm"] |= {"head": head, "root": root}
    env.unwrapped.set_state(state)


def _fit_size(detector: Any, uavs: int, steps: int = STEPS) -> tuple[int, int]:
    """N, lowered to the most UAVs that the detector takes by its tags, and T_ob, raised to its least steps."""
    tags = read_tags(detector)
    return uavs if tags.most_uavs is None else min(uavs, tags.most_uavs), max(steps, tags.least_steps)

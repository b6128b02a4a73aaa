"""Worlds in which followers copy the velocity of a leader, some steps late."""

from __future__ import annotations

import numpy as np

from detectors.reader.prior.draws import draw_log
from detectors.reader.prior.worlds.stage import Flight, Stage, draw_groups, draw_ways, place_groups, travel
from usnet_env.arrays import Floats, Indices


def _copy(rng: np.random.Generator, stage: Stage, source: Indices, delay: Indices, least: float) -> Floats:
    """Positions ``(B, T + 1, n, 3)`` of UAVs that copy ``source`` ``(T, n)``; who is its own flies its way.

    v_i(t) = g v_L(t - d_i) + (1 - g) u_i(t), u the last velocity of the UAV, or a way of its own, g ``least`` to 1.
    """
    source = np.concatenate([np.tile(source[:1], (int(delay.max()) + 5, 1)), source])
    velocity = draw_ways(rng, stage, len(source), stage.uavs)
    lone, gain = rng.random() < 0.4, stage.draw_each(rng, least, 1.0)[..., None]
    shake = draw_log(rng, 0.005, 0.3, stage.windows, 1, 1)
    window, own = np.arange(stage.windows)[:, None], np.arange(stage.uavs)
    for t in range(1, len(source)):
        led = np.flatnonzero(source[t] != own)
        copied = velocity[window, np.maximum(t - delay[:, led], 0), source[t, led]]
        base = velocity[:, t if lone else t - 1, led] + shake * stage.draw_normals(rng, len(led))
        velocity[:, t, led] = gain[:, led] * copied + (1.0 - gain[:, led]) * base
    return travel(place_groups(rng, stage, source[-1][source[-1]]), velocity[:, -stage.steps :])


def draw_star(rng: np.random.Generator, stage: Stage, groups: int = 4) -> Flight:
    """Up to so many groups whose UAVs all copy one leader."""
    leader, delay = draw_groups(rng, stage.uavs, groups), stage.draw_delays(rng)
    return Flight(_copy(rng, stage, np.tile(leader, (stage.steps, 1)), delay, 0.1), leader, delay)


def draw_graded(rng: np.random.Generator, stage: Stage) -> Flight:
    """A graded order: each UAV copies the one before it, or any before it, or one of the two before it."""
    later = np.arange(1, stage.uavs)
    low = [later - 1, np.zeros_like(later), np.maximum(later - 2, 0)][int(rng.integers(3))]
    leader, delay = (
        np.append(0, rng.integers(low, later)),
        stage.draw_delays(rng, stage.steps // (3 * min(stage.uavs, 8))),
    )
    return Flight(_copy(rng, stage, np.tile(leader, (stage.steps, 1)), delay, 0.4), leader, delay)


def draw_changes(rng: np.random.Generator, stage: Stage) -> Flight:
    """Others take the lead in turn; the leader is who leads longest, for at least half of the window."""
    leaders = int(rng.integers(2, min(4, stage.uavs - 1) + 1))
    longest = rng.uniform(0.5, 0.8)
    share = np.append(longest, (1.0 - longest) * rng.dirichlet(np.ones(leaders - 1)))
    order = rng.permutation(leaders)
    ends = np.cumsum(share[order])[:-1] * stage.steps
    head = order[np.searchsorted(ends, np.arange(stage.steps), side="right")]
    delay = stage.draw_delays(rng, stage.steps // 10)
    source = np.tile(head[:, None], (1, stage.uavs))
    return Flight(_copy(rng, stage, source, delay, 0.3), np.zeros(stage.uavs, np.int64), delay)


def draw_fission(rng: np.random.Generator, stage: Stage) -> Flight:
    """Some followers leave a leader for another one, so that two groups become one, or one becomes two."""
    leader = np.append([0, 1, 0, 1], rng.integers(2, size=stage.uavs - 4))
    movers = np.flatnonzero(rng.random(stage.uavs - 4) < rng.uniform(0.2, 1.0)) + 4
    source = np.tile(leader, (stage.steps, 1))
    source[: int(rng.uniform(0.15, 0.45) * stage.steps), movers] = 1 - leader[movers]
    delay = stage.draw_delays(rng, stage.steps // 10)
    return Flight(_copy(rng, stage, source[:: int(rng.choice([-1, 1]))], delay, 0.3), leader, delay)

"""Worlds in which followers copy the velocity of a leader, some steps late."""

from __future__ import annotations

import numpy as np

from detectors.reader.prior.draws import draw_log
from detectors.reader.prior.worlds.stage import Flight, Stage, draw_groups, draw_ways, place_groups, travel
from usnet_env.arrays import Floats, Indices


def _copy(
    rng: np.random.Generator, stage: Stage, source: Indices, delay: Indices, least: float = 0.1
) -> tuple[Floats, Floats]:
    """Start places ``(B, n, 3)`` and velocities ``(B, T, n, 3)`` of UAVs that copy ``source`` ``(T, n)``.

    v_i(t) = g v_L(t - d_i) + (1 - g) u_i(t), where u is the last velocity of the UAV, or a way of its own. The gain g
    is ``least`` to 1. A UAV that is its own source flies its way.
    """
    before = int(delay.max()) + 5
    source = np.concatenate([np.broadcast_to(source[:1], (before, stage.uavs)), source])
    velocity = draw_ways(rng, stage, len(source), stage.uavs)
    lone, gain = rng.random() < 0.4, stage.draw_each(rng, least, 1.0)[..., None]
    shake = draw_log(rng, 0.005, 0.3, (stage.windows, 1, 1))
    window, own = np.arange(stage.windows)[:, None], np.arange(stage.uavs)
    for t in range(1, len(source)):
        led = np.flatnonzero(source[t] != own)
        copied = velocity[window, np.maximum(t - delay[:, led], 0), source[t, led]]
        base = velocity[:, t, led] if lone else velocity[:, t - 1, led]
        velocity[:, t, led] = (
            gain[:, led] * copied + (1.0 - gain[:, led]) * base + shake * stage.draw_normals(rng, len(led))
        )
    root = source[-1]
    return place_groups(rng, stage, root[root]), velocity[:, before:]


def draw_star(rng: np.random.Generator, stage: Stage, groups: int = 4) -> Flight:
    """Up to so many groups whose UAVs all copy one leader."""
    leader, delay = draw_groups(rng, stage.uavs, groups), stage.draw_delays(rng)
    return Flight(travel(*_copy(rng, stage, np.tile(leader, (stage.steps, 1)), delay)), leader, delay)


def draw_chain(rng: np.random.Generator, stage: Stage) -> Flight:
    """A graded order: each UAV copies the one before it, or any before it, or one of the two before it."""
    later = np.arange(1, stage.uavs)
    low = [later - 1, np.zeros_like(later), np.maximum(later - 2, 0)][int(rng.integers(3))]
    leader = np.append(0, rng.integers(low, later))
    delay = np.minimum(stage.draw_delays(rng), max(1, stage.steps // (3 * min(stage.uavs, 8))))
    return Flight(travel(*_copy(rng, stage, np.tile(leader, (stage.steps, 1)), delay, 0.4)), leader, delay)


def draw_changes(rng: np.random.Generator, stage: Stage) -> Flight:
    """Others take the lead in turn; the leader is who leads longest, for at least half of the window."""
    leaders = int(rng.integers(2, min(4, stage.uavs - 1) + 1))
    share = np.append(rng.uniform(0.5, 0.8), rng.dirichlet(np.ones(leaders - 1)))
    share[1:] *= 1.0 - share[0]
    order = rng.permutation(leaders)
    ends = np.round(np.cumsum(share[order]) * stage.steps)
    head = order[np.minimum(np.searchsorted(ends, np.arange(stage.steps), side="right"), leaders - 1)]
    delay = np.minimum(stage.draw_delays(rng), max(1, stage.steps // 10))
    leads = np.tile(head[:, None], (1, stage.uavs))
    return Flight(travel(*_copy(rng, stage, leads, delay, 0.3)), np.zeros(stage.uavs, np.int64), delay)


def draw_fission(rng: np.random.Generator, stage: Stage) -> Flight:
    """Some followers leave a leader for another one, or both groups become one, or one becomes two."""
    leader = np.append([0, 1, 0, 1], rng.integers(2, size=stage.uavs - 4))
    moment, movers = int(rng.uniform(0.15, 0.45) * stage.steps), rng.random(stage.uavs) < rng.uniform(0.2, 1.0)
    movers[:4] = False
    source = np.tile(leader, (stage.steps, 1))
    source[:moment, movers] = 1 - leader[movers]  # they change to the leader that they have longer
    source = source[::-1] if rng.random() < 0.5 else source
    delay = np.minimum(stage.draw_delays(rng), max(1, stage.steps // 10))
    return Flight(travel(*_copy(rng, stage, source, delay, 0.3)), leader, delay)

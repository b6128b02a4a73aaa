"""Write files of tracks with known leaders, to try ``usnet detect`` on.

    python examples/make_tracks.py            # writes flock.csv, merging.csv, leaderless.csv, shepherd.csv

Each file has the columns id, t (seconds), x, y (metres) and leader (empty for those that follow no one).
"""

from __future__ import annotations

import csv
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
STEP = 0.5  # seconds between samples
SPEED = 4.0  # metres per second


def wander(rng: np.random.Generator, steps: int, memory: float = 0.9) -> Floats:
    """Velocities ``(steps, 2)`` of one that flies for itself: the direction turns by a smooth random rate."""
    rate = np.zeros(steps)
    for t in range(1, steps):
        rate[t] = memory * rate[t - 1] + rng.normal(0, 0.2)
    heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rate)
    return SPEED * np.stack([np.cos(heading), np.sin(heading)], axis=1)


def follow(rng: np.random.Generator, leader: Floats, delay: int, noise: float = 0.5) -> Floats:
    """Velocities ``(steps, 2)`` of one that copies its leader's velocity after ``delay`` steps."""
    return np.roll(leader, delay, axis=0) + rng.normal(0, noise, leader.shape)


def fly(rng: np.random.Generator, velocity: Floats, spread: float) -> Floats:
    """Positions ``(steps, 2)`` in metres, from a random start."""
    return rng.uniform(-spread, spread, 2) + np.cumsum(velocity, axis=0) * STEP


def flock(seed: int = 0, ids: int = 12, steps: int = 600) -> list[list[object]]:
    """A flock in which all others follow ``bird-0`` after 1 to 3 steps."""
    rng = np.random.default_rng(seed)
    leader = wander(rng, steps)
    velocities = [leader, *(follow(rng, leader, int(rng.integers(1, 4))) for _ in range(ids - 1))]
    return list(rows([fly(rng, each, 30) for each in velocities], [[""] + ["bird-0"] * (ids - 1)] * steps))


def merging(seed: int = 1, ids: int = 14, steps: int = 800) -> list[list[object]]:
    """Two groups, of ``bird-0`` and ``bird-1``; in the middle of the file, the second group joins the first."""
    rng = np.random.default_rng(seed)
    first, second = wander(rng, steps), wander(rng, steps)
    half = steps // 2
    second[half:] = np.roll(first, 2, axis=0)[half:] + rng.normal(0, 0.5, (steps - half, 2))
    velocities, leaders = [first, second], []
    for k in range(2, ids):
        led = np.where(np.arange(steps)[:, None] < half, (first, second)[k % 2], first)
        velocities.append(follow(rng, led, int(rng.integers(1, 4))))
    for t in range(steps):
        leaders.append(["", "" if t < half else "bird-0", *(f"bird-{k % 2 if t < half else 0}" for k in range(2, ids))])
    return list(rows([fly(rng, each, 30) for each in velocities], leaders))


def leaderless(seed: int = 2, ids: int = 10, steps: int = 600) -> list[list[object]]:
    """A flock without a leader: all follow a common route that none of them sets, at the same time."""
    rng = np.random.default_rng(seed)
    route = wander(rng, steps)
    places = [fly(rng, follow(rng, route, 0), 30) for _ in range(ids)]
    return list(rows(places, [[""] * ids] * steps))


def shepherd(seed: int = 3, ids: int = 12, steps: int = 600) -> list[list[object]]:
    """A herd that flees from ``dog``, which drives it from behind and leads no one."""
    rng = np.random.default_rng(seed)
    place = rng.normal(0, 10, (ids, 2))
    place[0] = (-60, 0)
    goal, course = np.zeros(2), wander(rng, steps, memory=0.8)
    places = np.empty((ids, steps, 2))
    for t in range(steps):
        herd = place[1:].mean(axis=0)
        goal += course[t] * STEP
        away = herd - goal
        target = herd + 35 * away / max(float(np.linalg.norm(away)), 1e-9)
        drive = target - place[0]
        place[0] += SPEED * 1.5 * STEP * drive / max(float(np.linalg.norm(drive)), 1.0)
        flee = place[1:] - place[0]
        distance = np.linalg.norm(flee, axis=1, keepdims=True)
        apart = place[1:] - herd
        step = SPEED * flee / distance * np.exp(-distance / 60) - 0.05 * apart + rng.normal(0, 0.5, apart.shape)
        place[1:] += step * STEP
        places[:, t] = place
    names = ["dog", *(f"sheep-{k}" for k in range(1, ids))]
    return list(rows(list(places), [[""] * ids] * steps, names))


def rows(places: list[Floats], leaders: list[list[str]], names: list[str] | None = None) -> Iterable[list[object]]:
    """Rows of a file in the order of time: id, t, x, y, leader."""
    names = names or [f"bird-{k}" for k in range(len(places))]
    for t, led in enumerate(leaders):
        for name, place, head in zip(names, places, led, strict=True):
            yield [name, t * STEP, round(float(place[t, 0]), 3), round(float(place[t, 1]), 3), head]


def main() -> None:
    """Write all files into the current folder."""
    for make in (flock, merging, leaderless, shepherd):
        with open(f"{make.__name__}.csv", "w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([["id", "t", "x", "y", "leader"], *make()])
        print(f"{make.__name__}.csv: {(make.__doc__ or '').replace('``', '')}")


if __name__ == "__main__":
    main()

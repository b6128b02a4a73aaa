"""Drawn tracks with known leaders, in 34 scenarios: whom `usnet detect` names and confirms in each window.

    OMP_NUM_THREADS=1 python benchmarks/scenarios.py --detector "reader(policy='map')" --rows out/scenarios.csv
    python benchmarks/scenarios.py --rows out/scenarios.csv --draw         # plays nothing: the tables of the rows

A file is drawn, written as CSV with the columns id, t, x, y, in every second file z, and the leader of each id, which
no detector sees. It is read and cut as `usnet detect` does: the chosen step, windows of 100 steps. A row is a window.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
from paper.shared import Game, cached, make_parser, run_missing
from pivot import across, fold, pivot
from scipy.signal import lfilter

from usnet_env.objectives import find_roots
from usnet_env.tracks import Tracks, find_leaders, read_tracks

LENGTH, SPEED, WARM_UP = 100, 1.5, 30.0  # steps of a window, metres a second, seconds that are flown but not recorded
Grid = tuple[np.random.Generator, int, float, int]  # S instants, the seconds between them, 2 or 3 axes
Flight = tuple[np.ndarray, np.ndarray]  # (S, N, d) metres, and (S, N) what each follows at that time, -1: none
Plan = tuple[tuple[float, tuple[int, ...]], ...]  # from which share of the record on each follows whom


def drift(grid: Grid, uavs: int, memory: float) -> np.ndarray:
    """``(S, N)`` Ornstein-Uhlenbeck processes of variance 1 with a memory in seconds."""
    rng, steps, dt, _ = grid
    phi = np.exp(-dt / memory)
    noise = rng.standard_normal((steps, uavs)) * np.sqrt(1 - phi**2)
    noise[0] /= np.sqrt(1 - phi**2)
    return lfilter([1.0], [1.0, -phi], noise, axis=0)


def walk(grid: Grid, uavs: int) -> np.ndarray:
    """Velocities ``(S, N, d)`` of smooth walks, metres a second, with turns and changes of speed."""
    rng, _, dt, axes = grid
    course = np.cumsum(0.35 * drift(grid, uavs, 4.0), axis=0) * dt + rng.uniform(-np.pi, np.pi, uavs)
    speed = SPEED * np.exp(0.25 * drift(grid, uavs, 5.0))
    course = [np.cos(course), np.sin(course), 0.3 * drift(grid, uavs, 4.0)][:axes]
    return (speed * np.stack(course)).transpose(1, 2, 0)


def fly_star(
    grid: Grid, uavs: int = 6, delay: float = 1.5, gain: float = 1.0,
    own: float = 0.1, plan: Plan | None = None, hidden: bool = False,
) -> Flight:  # fmt: skip
    """UAVs copy the velocity of their leader some seconds later, beside it; ``own`` weighs a walk of their own."""
    rng, steps, dt, axes = grid
    plan = plan or ((0.0, (-1, *[0] * (uavs - 1))),)
    velocity, leader = walk(grid, uavs), np.empty((steps, uavs), np.int64)
    own_walk, lags = velocity.copy(), np.round(delay * rng.uniform(0.8, 1.2, uavs) / dt).astype(int)
    warm_up = round(WARM_UP / dt)
    begins = [warm_up + round(share * (steps - warm_up)) if share else 0 for share, _ in plan]
    for (_, row), begin, end in zip(plan, begins, [*begins[1:], steps], strict=True):
        leader[begin:end], flown = row, [i for i in range(uavs) if row[i] < 0]
        while len(flown) < uavs:  # leaders first
            i = next(i for i in range(uavs) if i not in flown and row[i] in flown)
            past = np.maximum(np.arange(begin, end) - lags[i], 0)
            velocity[begin:end, i] = gain * velocity[past, row[i]] + own * own_walk[begin:end, i]
            flown.append(i)
    position = rng.uniform(0, 30, (uavs, axes)) + np.cumsum(velocity, axis=0) * dt
    return (position[:, 1:], np.full((steps, uavs - 1), -1)) if hidden else (position, leader)


def fly_path(grid: Grid, uavs: int = 6, delay: float = 3.0, file: bool = False) -> Flight:
    """UAVs go to the positions of their leader some seconds later, or in a file of the one before."""
    rng, steps, dt, axes = grid
    delays = delay * (np.arange(uavs) if file else np.append(0, rng.uniform(0.6, 1.4, uavs - 1)))
    path = np.cumsum(walk(grid, 1)[:, 0], axis=0) * dt
    position = path[np.maximum(np.arange(steps)[:, None] - np.round(delays / dt).astype(int), 0)]
    position += 0.5 * np.stack([drift(grid, uavs, 10.0) for _ in range(axes)], axis=2)
    leader = np.arange(uavs) - 1 if file else np.minimum(np.arange(uavs) - 1, 0)
    return position, np.broadcast_to(leader, (steps, uavs))


def set_off(grid: Grid, uavs: int = 6) -> Flight:
    """UAVs at rest set off one after another, on nearly straight lines side by side."""
    rng, steps, dt, axes = grid
    begins = WARM_UP + 0.5 * (steps * dt - WARM_UP) * (np.arange(uavs) + rng.uniform(0.1, 0.4, uavs)) / uavs
    speed = np.clip(np.arange(steps)[:, None] * dt - begins, 0, 1)
    step = SPEED * np.eye(axes)[0] + 0.05 * rng.standard_normal((steps, uavs, axes))
    position = np.arange(uavs)[:, None] * 2.0 * np.eye(axes)[1] + np.cumsum(speed[..., None] * step, axis=0) * dt
    return position, np.broadcast_to(np.minimum(np.arange(uavs) - 1, 0), (steps, uavs))


def walk_route(grid: Grid, uavs: int = 6) -> Flight:
    """Walks along one winding path, with a start and changes of speed of each UAV's own."""
    rng, steps, dt, axes = grid
    path = np.cumsum(walk((rng, 2 * steps, dt, axes), 1)[:, 0], axis=0) * dt
    length = np.append(0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    speed = SPEED * rng.uniform(0.9, 1.1, uavs) * np.exp(0.15 * drift(grid, uavs, 10.0))
    distance = rng.uniform(0, 30 * SPEED, uavs) + np.cumsum(speed, axis=0) * dt
    position = np.stack([np.interp(distance, length, axis) for axis in path.T], axis=2)
    return position + 0.3 * rng.standard_normal((1, uavs, axes)), np.full((steps, uavs), -1)


def drive_ring(grid: Grid, uavs: int = 8, closed: bool = False) -> Flight:
    """Cars on a circular road by the optimal velocity model (Bando et al. 1995); in an open convoy the first leads."""
    rng, steps, dt, axes = grid
    length = 20.0 * uavs * (1 if closed else 3)
    arc, speed = -20.0 * np.arange(uavs) + rng.normal(0, 1, uavs), np.full(uavs, 10.0)
    lead_speed, positions = 10.0 + 4.0 * drift(grid, 1, 6.0)[:, 0], np.empty((steps, uavs))
    for t in range(steps):
        positions[t] = arc
        gap = np.roll(arc, 1) - arc + length * (np.arange(uavs) == 0)
        goal = 10.0 * (np.tanh((gap - 20.0) / 8.0) + 1.0)
        goal[0] = goal[0] if closed else lead_speed[t]
        speed = speed + 1.0 * (goal - speed) * dt + 0.3 * np.sqrt(dt) * rng.standard_normal(uavs)
        arc = arc + np.maximum(speed, 0) * dt
    angle, radius = 2 * np.pi * positions / length, length / (2 * np.pi)
    position = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle][:axes], axis=2)
    return position, np.broadcast_to(np.full(uavs, -1) if closed else np.arange(uavs) - 1, (steps, uavs))


def fly_flock(grid: Grid, uavs: int = 15, delay: float = 0.0, reach: float = 12.0, driven: bool = False) -> Flight:
    """A flock that aligns, at once or some time later; a driver, the last UAV, may push it from behind."""
    rng, steps, dt, axes = grid
    position, driver_course = rng.uniform(0, 20, (uavs, axes)), walk(grid, 1)[:, 0] / SPEED
    course = np.eye(axes)[0] + 0.5 * rng.standard_normal((uavs, axes))
    lags, past, positions = np.round(delay * rng.uniform(0.5, 1.5, uavs) / dt).astype(int), [course], []
    members = uavs - driven
    for t in range(steps):
        positions.append(position)
        seen = np.stack(past)[-1 - np.minimum(lags, len(past) - 1)] if delay else course  # (i, j, d), or (j, d) of all
        gap = position[None] - position[:, None]
        distance = np.linalg.norm(gap, axis=2) + np.eye(uavs)
        is_near = ((distance < reach) & ~np.eye(uavs, dtype=bool))[..., None] * (np.arange(uavs) < members)[:, None]
        mean = (is_near * seen).sum(1) / np.maximum(is_near.sum(1), 1)
        push = (gap / distance[..., None] ** 2 * (distance < 3.0)[..., None]).sum(1)
        centre = position[:members].mean(axis=0)
        turn = 1.5 * (mean - course) * (is_near.sum(1) > 0) - 1.5 * push + 0.02 * (centre - position)
        if driven:
            turn -= 3.0 * gap[:, -1] / distance[:, -1:] * (distance[:, -1:] < 15.0)
            turn[-1] = 2.0 * ((centre - 12.0 * driver_course[t] - position[-1]) / 5.0 - course[-1])
        course = course + turn * dt + 0.4 * np.sqrt(dt) * rng.standard_normal((uavs, axes))
        course /= np.maximum(np.linalg.norm(course, axis=1, keepdims=True), 1e-6)
        past = [*past[-round(2 * delay / dt) :], course] if delay else past
        position = position + SPEED * course * dt
    return np.stack(positions), np.full((steps, uavs), -1)


CHANGES: Plan = ((0.0, (-1, 0, 0, 0, 0, 0)), (0.5, (1, -1, 1, 1, 1, 1)))
APART, TOGETHER = (-1, 0, 0, 0, -1, 4, 4, 4), (-1, 0, 0, 0, 0, 4, 4, 4)
MERGES: Plan = ((0.0, APART), (1 / 3, TOGETHER), (2 / 3, APART))
#: How a scenario flies, its samples a second, its seconds, and the noise of positions in metres.
SCENARIOS: dict[str, tuple[Callable[..., Flight], float, float, float]] = {
    "path N6 2Hz tau3s": (fly_path, 2, 320, 0),
    "path N2 2Hz tau3s": (partial(fly_path, uavs=2), 2, 320, 0),
    "path file of 8 chain 2s": (partial(fly_path, uavs=8, delay=2.0, file=True), 2, 320, 0),
    "path N6 1Hz gps 3m 600s": (fly_path, 1, 600, 3.0),
    "path N6 10Hz tau3s": (fly_path, 10, 200, 0),
    "path set off one after another": (set_off, 2, 50, 0),  # one window: later, nothing tells who was first
    **{f"star tau1.5s {hertz}Hz 300s N6": (fly_star, hertz, 300, 0) for hertz in (1, 5, 10, 30)},
    "star tau4s 10Hz 300s N6": (partial(fly_star, delay=4.0), 10, 300, 0),
    "star gps noise 3m 1Hz 600s": (fly_star, 1, 600, 3.0),
    "star gps noise 3m 1Hz 3000s": (fly_star, 1, 3000, 3.0),
    "star gain .2 own .5 2Hz 600s": (partial(fly_star, gain=0.2, own=0.5), 2, 600, 0),
    "star gain .5 own .3 2Hz 600s": (partial(fly_star, gain=0.5, own=0.3), 2, 600, 0),
    **{f"star N{uavs} 2Hz 200s": (partial(fly_star, uavs=uavs), 2, 200, 0) for uavs in (2, 3, 20, 60)},
    **{f"star T{seconds} 1Hz N6": (fly_star, 1, seconds, 0) for seconds in (30, 60, 100, 5000)},
    "leader changes halfway": (partial(fly_star, plan=CHANGES), 2, 400, 0),
    "merge and split": (partial(fly_star, uavs=8, plan=MERGES), 2, 400, 0),
    "chain of 6": (partial(fly_star, plan=((0.0, (-1, 0, 1, 2, 3, 4)),)), 2, 400, 0),
    "open circular convoy": (drive_ring, 2, 360, 0),
    "0 independent": (partial(fly_star, uavs=8, plan=((0.0, (-1,) * 8),)), 2, 400, 0),
    "0 Vicsek": (fly_flock, 2, 300, 0),
    "0 aligned with delay": (partial(fly_flock, uavs=8, delay=0.6, reach=1e9), 5, 300, 0),
    "0 hidden driver": (partial(fly_star, uavs=7, hidden=True), 2, 300, 0),
    "0 same route": (walk_route, 1, 300, 0),
    "0 shepherd behind": (partial(fly_flock, uavs=11, driven=True), 5, 300, 0),
    "0 closed ring road": (partial(drive_ring, closed=True), 2, 360, 0),
}
CONFOUNDS = ("0 hidden driver", "0 same route")
STAGES = ("named", "confirmed")
AIMS = ("some id leads (aim .97; .05)", "a driver or a route (aim .10)", "no id leads (aim .05)")


def read_file(scenario: str, file: int, seed: int) -> Tracks:
    """Draw a file of a scenario, its ids in random order, and read it with the step that is chosen."""
    rng = np.random.default_rng([seed, crc32(scenario.encode()), file])
    fly, hertz, seconds, noise = SCENARIOS[scenario]
    every, axes = int(np.ceil(10 / hertz)), 2 + file % 2
    dt = 1 / (hertz * every)
    flown = fly((rng, round((WARM_UP + seconds) / dt) + 1, dt, axes))
    position, leader = (values[round(WARM_UP / dt) :: every] for values in flown)
    position = position + noise * rng.standard_normal(position.shape)
    samples, uavs = leader.shape
    names = np.array([f"u{k:02d}" for k in rng.permutation(uavs)] + [""])
    table = {"id": np.tile(names[:-1], samples), "t": np.repeat(np.arange(samples) / hertz, uavs)}
    table |= {name: position[..., axis].ravel() for axis, name in enumerate("xyz"[:axes])}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tracks.csv"
        pd.DataFrame(table | {"leader": names[leader.ravel()]}).to_csv(path, index=False, float_format="%.5f")
        return read_tracks(path).resample(None)


def play(game: Game, seed: int) -> list[dict[str, Any]]:
    """Answer a file. Heads through most of a window are due; a UAV that is at no time of it a head is wrong."""
    tracks = cached(read_file, game["scenario"], game["file"], seed)
    owner, rows = np.repeat(np.arange(len(tracks.ids)), np.diff(tracks.offsets)), []

    def score(section: Any, answer: Any, detected: Any) -> None:
        leaders = np.full(section.window.uavs, -1) if section.leader is None else section.leader
        inside = (tracks.time >= section.start) & (tracks.time < section.end)
        leader, follower = tracks.leader[inside] if tracks.leader is not None else owner[:0], owner[inside]
        was_head = np.isin(section.rows, leader) & np.isin(section.rows, follower[: len(leader)][leader < 0])
        roots = find_roots(leaders)
        due = np.isin(np.arange(len(roots)), roots[roots != np.arange(len(roots))])
        confirmed = np.isin(np.arange(len(roots)), [section.ids.index(head.id) for head in detected.leaders])
        row = {"step": section.step, "window": len(rows), "due": due.sum()}
        for stage, chosen in zip(STAGES, (answer.candidates, confirmed), strict=True):
            row |= {f"{stage}_right": (chosen & due).sum(), f"{stage}_wrong": (chosen & ~was_head).sum()}
        rows.append(game | row)

    find_leaders(tracks, game["detector"], length=min(LENGTH, round(tracks.duration / tracks.step)), on_window=score)
    return rows


def format_found(stage: str, part: pd.DataFrame) -> str:
    """The share of the due leaders that is found, and the share of windows with a false one."""
    right, due, false = part[f"{stage}_right"].sum(), part.due.sum(), (part[f"{stage}_wrong"] > 0).mean()
    return "–" if not len(part) else f"{right / due:.3f} of {due}; {false:.3f}" if due else f"{false:.3f}"


def report(rows: pd.DataFrame) -> str:
    """The totals; then each scenario: due leaders found, and windows with a false one, named and confirmed."""
    columns = {}
    for stage in STAGES:
        columns |= across("detector", rows.detector.unique(), partial(format_found, stage), f"{{}} {stage}")
    return f"{summarise(rows)}\n\n{fold('Each scenario', pivot(rows, {'scenario': 'scenario'}, columns))}"


def summarise(rows: pd.DataFrame) -> str:
    """Each detector: the totals of the scenarios with a leader, with a driver or a route, and without."""
    kind = np.select([rows.scenario.isin(CONFOUNDS), rows.scenario.str.startswith("0")], AIMS[1:], AIMS[0])
    totals = {}
    for stage in STAGES:
        totals |= across("kind", AIMS, partial(format_found, stage), f"{stage}, {{}}")
    return pivot(rows.assign(kind=kind), {"detector": "detector"}, totals)


def main(argv: list[str] | None = None) -> None:
    parser = make_parser(__doc__, Path("out/scenarios.csv"))
    parser.add_argument("--files", type=int, default=10, help="of each scenario")
    parser.add_argument("--detector", nargs="+", default=["reader(policy='map')"])
    parser.add_argument("--scenario", nargs="+", choices=list(SCENARIOS), default=list(SCENARIOS))
    options = parser.parse_args(argv)
    keys = product(options.scenario, range(options.files), options.detector)
    games = [{"scenario": scenario, "file": file, "detector": name} for scenario, file, name in keys]
    print(report(run_missing(options, games, partial(play, seed=options.seed))))


if __name__ == "__main__":
    main()

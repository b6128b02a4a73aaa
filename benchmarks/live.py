"""Leaders while fixes come: wrong announcements, seconds until a new leader is named, and milliseconds an update.

    OMP_NUM_THREADS=1 python benchmarks/live.py        # writes benchmarks/results/live.csv.gz

A swarm is seen at 1 Hz, with noise of 0.1 m. Its leader turns by a smooth random rate at 4 m/s, and all others copy its
velocity after 1 to 3 s, with a motion of their own. From time to time, another one leads: it turns by itself from its
course on. A row is one leader's time. An announcement is wrong if it names one that has not led for as long as a
window is, or withdraws the present leader; only changes of the heads count, not those of single followers.
"""

from __future__ import annotations

from time import process_time
from typing import Any

import numpy as np
import pandas as pd
from paper.shared import RESULTS, Game, make_parser, run_missing
from pivot import CellFormatter, pivot

from usnet_env.tracks import LeaderTracker

ROWS = RESULTS / "live.csv.gz"
SWARMS = {10: 8, 50: 3, 200: 1}  # of so many UAVs
SECONDS, CHANGES, WINDOW, SPEED, NOISE = 240, 3, 16, 4.0, 0.1
OWN = {"little": 0.3, "much": 0.8}  # m/s, the motion of followers
SOON = 15  # seconds


def fly(rng: np.random.Generator, uavs: int, own: float) -> tuple[np.ndarray, np.ndarray]:
    """Places ``(T, N, 2)`` each second, and who leads then ``(T,)``."""
    rate, turns = np.zeros(uavs), np.cumsum(rng.dirichlet(np.full(CHANGES + 1, 20.0)) * SECONDS).astype(int)
    delay, leader = rng.integers(1, 4, uavs), np.zeros(SECONDS, int)
    velocity = rng.normal(0, own, (SECONDS, uavs, 2))
    course, head = rng.uniform(0, 2 * np.pi), int(rng.integers(uavs))
    for t in range(SECONDS):
        if t in turns[:-1]:
            head = int(rng.choice(np.setdiff1d(np.arange(uavs), head)))
            course = float(np.arctan2(*velocity[t - 1, head, ::-1]))
        rate = 0.8 * rate + rng.normal(0, 0.25, uavs)
        course += rate[head]
        velocity[t] += velocity[np.maximum(t - delay, 0), head] * (t > 0)
        velocity[t, head] = SPEED * np.cos(course), SPEED * np.sin(course)
        leader[t] = head
    place = rng.uniform(-30, 30, (uavs, 2)) + np.cumsum(velocity, axis=0)
    return place + rng.normal(0, NOISE, place.shape), leader


def play(game: Game) -> list[dict[str, Any]]:
    """Track one swarm: a row for the time of each leader."""
    uavs = game["uavs"]
    place, leader = fly(np.random.default_rng([game["seed"], uavs]), uavs, OWN[game["motion"]])
    tracker, rows, since = LeaderTracker(step=1.0, window=WINDOW), list[dict[str, Any]](), 0
    for t, now in enumerate(place):
        start = process_time()
        known = tracker.update(float(t), now, range(uavs))
        spent = 1000 * (process_time() - start)
        if not t or leader[t] != leader[t - 1]:
            rows.append({**game, "number": len(rows), "updates": 0, "wrong": 0, "named": None, "ms": []})
            since = t
        row, recent = rows[-1], {None, *leader[max(t - WINDOW, 0) : t + 1].tolist()}
        heads = [change for change in known.changes if change.kind not in ("joins", "leaves", "changes")]
        row["updates"] += 1
        row["wrong"] += sum(each.new not in recent or each.old == leader[t] for each in heads)
        row["ms"] += [spent] * (t >= WINDOW)
        if row["named"] is None and {*known.leaders} == {leader[t]}:
            row["named"] = t - since
    return [row | {"ms": np.median(row["ms"]), "ms_most": np.quantile(row["ms"], 0.95)} for row in rows]


def report(rows: pd.DataFrame) -> str:
    """A line for each size of a swarm and each motion."""

    def name(seconds: pd.Series) -> str:
        return f"{seconds.median():.0f}; " + (f"{seconds.max():.0f}" if seconds.notna().all() else "never")

    columns: dict[str, CellFormatter] = {
        "updates": lambda part: f"{part.updates.sum():,}",
        "wrong announcements": lambda part: f"{part.wrong.sum():.0f}",
        "first leader named after, s: median; most": lambda part: name(part[part.number == 0].named),
        "changes of the leader": lambda part: f"{(part.number > 0).sum()}",
        "new leader named after, s: median; most": lambda part: name(part[part.number > 0].named),
        f"within {SOON} s": lambda part: f"{(part[part.number > 0].named <= SOON).mean():.0%}",
        "ms an update: median; 95 %": lambda part: f"{part.ms.median():.0f}; {part.ms_most.median():.0f}",
    }
    return pivot(rows, {"UAVs": "uavs", "motion of their own": "motion"}, columns)


def main(argv: list[str] | None = None) -> None:
    options = make_parser(__doc__, ROWS).parse_args(argv)
    games = [
        {"uavs": uavs, "motion": motion, "seed": seed}
        for uavs, count in SWARMS.items()
        for motion in OWN
        for seed in range(options.seed, options.seed + count)
    ]
    print(report(run_missing(options, games, play)))


if __name__ == "__main__":
    main()

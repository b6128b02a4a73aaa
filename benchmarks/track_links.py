"""Files of simulated tracks with known links: are the arrows, delays and dates right that ``find_leaders`` gives?

    OMP_NUM_THREADS=1 python benchmarks/track_links.py             # writes benchmarks/results/track_links.csv.gz
    python benchmarks/track_links.py --draw                        # plays nothing: the tables of the rows

The worlds are drawn here, and by no code that trains a detector. A row is a file: of links, how many were found, drawn
as direct, and right; how far the delays of right ones are off; of changes of the leader, how many were found.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
from paper.shared import RESULTS, Game, make_parser, run_missing
from pivot import mean, pivot, size
from scipy.signal import lfilter

from usnet_env.evaluation.stats import rate_interval
from usnet_env.tracks import FoundLeaders, Tracks, find_leaders

ROWS = RESULTS / "track_links.csv.gz"
KINDS = ("star", "equal delays", "two leaders", "chain", "tree", "graded", "file")
IDS, RATES, WEAK, STRONG = (6, 12, 30, 60), (10, 2), (0.2, 0.02), (0.8, 0.3)  # own motion in m/s, noise of places in m
CHANGES = ("no change", "one change", "three changes", "two groups, one changes")
FILES, CHANGE_FILES = 2, 20  # of each kind and setting; of each kind of change
STEP, BEFORE, SPEED = 0.02, 45.0, 4.0  # seconds of the simulation; seconds that are thrown away; m/s
NEAR = 5.0  # steps by which a found change may be off

Floats = np.ndarray


def wander(rng: np.random.Generator, steps: int, many: int, memory: float, spread: float) -> Floats:
    """Smooth random series ``(steps, many, 2)`` with a memory in seconds (Ornstein–Uhlenbeck)."""
    kept = np.exp(-STEP / memory)
    return lfilter([spread * np.sqrt(1 - kept**2)], [1.0, -kept], rng.normal(size=(steps, many, 2)), axis=0)


def draw_parents(kind: str, ids: int, rng: np.random.Generator) -> list[list[int]]:
    """The ids that each id copies, with equal weights; none of a leader."""
    branches = {6: 2, 12: 2, 30: 3, 60: 4}[ids]
    of: dict[str, Any] = {
        "chain": lambda i: [i - 1],
        "file": lambda i: [i - 1],
        "tree": lambda i: [(i - 1) // branches],
        "two leaders": lambda i: [i % 2] if i > 1 else [],
        "graded": lambda i: rng.choice(i, min(i, int(rng.integers(1, 4))), replace=False).tolist(),
    }
    return [[], *(of.get(kind, lambda i: [0])(i) for i in range(1, ids))]


def simulate_links(kind: str, ids: int, rate: int, strong: bool, seed: int) -> tuple[Tracks, list[list[int]], Floats]:
    """Tracks, the ids that each one copies, and its delay in seconds ``(ids,)``.

    A follower has the velocity of the ids that it copies some time before, and its own motion; in a ``file`` it goes
    along the path of the one before it at a pace of its own.
    """
    rng = np.random.default_rng(seed)
    spread, noise = STRONG if strong else WEAK
    steps, before = round((100 if rate == 10 else 200) / STEP), round(BEFORE / STEP)
    deep = kind in ("chain", "file", "tree") and ids > 6
    delay = np.round(rng.uniform(0.3, 1.0 if deep else 3.0, ids) / STEP).astype(int)
    delay = np.full(ids, delay[0]) if kind == "equal delays" else delay
    parents = draw_parents(kind, ids, rng)
    heading = rng.uniform(0, 2 * np.pi, ids) + np.cumsum(wander(rng, steps + before, ids, 1.5, 0.6)[..., 0], 0) * STEP
    velocity = SPEED * np.stack([np.cos(heading), np.sin(heading)], axis=2)  # of leaders
    motion, pace = (wander(rng, steps + before, ids, memory, spread) for memory in (0.7, 2.0))
    for i in (i for i in range(ids) if parents[i]):
        copied = np.roll(velocity[:, parents[i]].mean(axis=1), delay[i], axis=0)
        velocity[:, i] = copied + (np.gradient(pace[:, i], STEP, axis=0) if kind == "file" else motion[:, i])
    start = rng.normal(0, 15, (ids, 2)) * (kind != "file")
    position = (np.cumsum(velocity, axis=0) * STEP)[before :: round(1 / rate / STEP)] + start
    position += rng.normal(0, noise, position.shape)
    order = rng.permutation(ids)  # place k of the file is that of order[k]
    place = np.argsort(order)
    named = [place[parents[i]].tolist() for i in order]
    return make_tracks(position[:, order], 1 / rate), named, delay[order] * STEP


def make_tracks(position: Floats, step: float) -> Tracks:
    """Tracks of the ids 0 to n - 1 at positions ``(T, n, 2)``."""
    instants, ids = position.shape[:2]
    names, time = np.tile(np.arange(ids), instants), np.repeat(np.arange(instants) * step, ids)
    return Tracks.from_samples(names.tolist(), time, position.reshape(-1, 2))


def draw_changes(kind: str, rng: np.random.Generator) -> list[tuple[range, list[tuple[int, int]]]]:
    """The groups: their ids, and from which step on each leader leads them."""
    first, second = (int(i) for i in rng.choice(6, 2, replace=False))
    change = int(rng.integers(60, 140))
    if kind == "three changes":
        leaders = [first, second, first, second]
        return [(range(8), [(50 * k + int(rng.integers(-5, 6)) * (k > 0), i) for k, i in enumerate(leaders)])]
    if kind == "two groups, one changes":
        return [(range(6), [(0, first), (change, second)]), (range(6, 12), [(0, int(rng.integers(6, 12)))])]
    return [(range(8), [(0, first), (change, second)][: 1 + (kind == "one change")])]


def simulate_changes(groups: list[tuple[range, list[tuple[int, int]]]], rng: np.random.Generator) -> Tracks:
    """200 steps of 1 s, in which each group follows its present leader after 1 to 3 steps."""
    steps, ids = 200, sum(len(members) for members, _ in groups)
    turn = lfilter([0.2], [1.0, -0.9], rng.normal(size=(steps, ids)), axis=0)
    heading = rng.uniform(0, 2 * np.pi, ids) + np.cumsum(turn, axis=0)
    free, velocity = SPEED * np.stack([np.cos(heading), np.sin(heading)], axis=2), np.zeros((steps, ids, 2))
    lag = rng.integers(1, 4, ids)
    for members, leaders in groups:
        for t in range(steps):
            (_, leader) = max(each for each in leaders if each[0] <= t)
            velocity[t, leader] = free[t, leader]
            for i in (i for i in members if i != leader):
                velocity[t, i] = velocity[max(0, t - lag[i]), leader] + rng.normal(0, 0.5, 2)
    position = rng.uniform(-30, 30, (ids, 2)) + np.cumsum(velocity, axis=0)
    return make_tracks(position + rng.normal(0, 0.05, position.shape), 1.0)


def score_links(found: FoundLeaders, parents: list[list[int]], delay: Floats) -> dict[str, Any]:
    """Counts of the links of all windows: all, drawn as direct, right; and the delays of the right ones."""
    links = [link for window in found.windows for link in window.links]
    right = [link for link in links if link.direct and link.leader in parents[int(link.follower)]]
    timed = [link for link in right if link.delay is not None]
    errors = [abs(link.delay - delay[int(link.follower)]) for link in timed]
    known = [link for link in timed if link.delay_low is not None and link.delay_high is not None]
    covered = [link.delay_low <= delay[int(link.follower)] <= link.delay_high for link in known]
    return {
        "possible": len(found.windows) * sum(map(bool, parents)),
        "links": len(links),
        "drawn": sum(link.direct for link in links),
        "right": len(right),
        "delay_error": float(np.mean(errors)) if errors else np.nan,
        "intervals": len(known),
        "covered": int(sum(covered)),
    }


def score_changes(found: FoundLeaders, groups: list[tuple[range, list[tuple[int, int]]]]) -> dict[str, Any]:
    """How many changes there were, were found in time with both leaders right, and were found where there was none."""
    true = [(start, old, new) for _, leaders in groups for (_, old), (start, new) in pairwise(leaders)]
    named = [event for event in found.events if event.old is not None and event.new is not None]
    errors = list[float]()
    for start, old, new in true:
        near = [event for event in named if (event.old, event.new) == (old, new) and abs(event.time - start) <= NEAR]
        if near:
            best = min(near, key=lambda event: abs(event.time - start))
            named.remove(best)
            errors.append(abs(best.time - start))
    middle = float(np.median(errors)) if errors else np.nan
    return {"changes": len(true), "found": len(errors), "false": len(named), "time_error": middle}


def play(game: Game) -> list[dict[str, Any]]:
    """The row of a file."""
    seed = crc32("{seed} {kind} {ids} {rate} {strong} {file}".format(**game).encode())
    if game["kind"] in CHANGES:
        rng = np.random.default_rng(seed)
        groups = draw_changes(game["kind"], rng)
        found = find_leaders(simulate_changes(groups, rng))
        links = score_links(found, [[] for _ in found.ids], np.zeros(len(found.ids)))  # not scored
        return [game | links | score_changes(found, groups)]
    tracks, parents, delay = simulate_links(game["kind"], game["ids"], game["rate"], bool(game["strong"]), seed)
    none = {"changes": 0, "found": 0, "false": 0, "time_error": np.nan}
    return [game | score_links(find_leaders(tracks), parents, delay) | none]


def count_share(part: str, whole: str) -> Any:
    """A share of counts of files, with an interval whose unit is the file."""

    def format_cell(rows: pd.DataFrame) -> str:
        values = [value for a, b in zip(rows[part], rows[whole], strict=True) for value in [1] * a + [0] * (b - a)]
        files = np.repeat(np.arange(len(rows)), rows[whole])
        if not values:
            return "–"
        middle, low, high = (f"{value:.3f}" for value in rate_interval(np.array(values), groups=files))
        return f"{middle} ({low}–{high})"

    return format_cell


def report(rows: pd.DataFrame) -> str:
    """The table of links and delays, and that of changes."""
    rows = rows.assign(episode=range(len(rows)))
    links = rows[rows.kind.isin(KINDS)]
    both = pd.concat([links, links.assign(kind="all")])
    first = pivot(
        both,
        {"kind": "kind"},
        {
            "files": size,
            "links found": count_share("links", "possible"),
            "drawn as direct": count_share("drawn", "links"),
            "right, of those drawn": count_share("right", "drawn"),
            "error of delays (s)": mean("delay_error", 3),
            "intervals that hold the delay": count_share("covered", "intervals"),
        },
    )
    changes = rows[rows.kind.isin(CHANGES)]
    total = {name: lambda part, name=name: f"{part[name].sum()}" for name in ("changes", "found", "false")}
    second = pivot(changes, {"kind": "kind"}, {"files": size, **total, "median error (s)": mean("time_error", 1)})
    return f"{first}\n\n{second}"


def main(argv: list[str] | None = None) -> None:
    parser = make_parser(__doc__, ROWS)
    parser.add_argument("--files", type=int, default=FILES, help="of each kind and setting")
    parser.add_argument("--changes", type=int, default=CHANGE_FILES, help="files of each kind of change")
    parser.add_argument("--ids", type=int, nargs="+", default=list(IDS))
    options = parser.parse_args(argv)
    games: list[Game] = [
        {"kind": kind, "ids": ids, "rate": rate, "strong": strong, "file": file, "seed": options.seed}
        for kind in KINDS
        for ids in options.ids
        for rate in RATES
        for strong in (0, 1)
        for file in range(options.files)
    ]
    games += [
        {"kind": kind, "ids": 8, "rate": 1, "strong": 0, "file": file, "seed": options.seed}
        for kind in CHANGES
        for file in range(options.changes)
    ]
    print(report(run_missing(options, games, play)))


if __name__ == "__main__":
    main()

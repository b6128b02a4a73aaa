"""Strategies that were never seen: the learned detector beside those that need no training. Resumable.

OMP_NUM_THREADS=1 python benchmarks/learned.py             # writes benchmarks/results/learned.{csv,md}
OMP_NUM_THREADS=1 python benchmarks/learned.py --limits    # the same where it is hard: learned_limits.{csv,md}
OMP_NUM_THREADS=1 python benchmarks/learned.py --table     # only the table of the rows that are there

`learned` was trained on random follow strategies, of which none is among f1 to f7 or among those of
follow_mixture_strategies.py. Every detector meets the same swarms, M=5, N=82, and isn't told M.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from follow_mixture import Cell
from follow_mixture import cells as all_cells
from follow_mixture import play as play_cell
from follow_mixture_strategies import OUT_OF_LIST
from multiagent_table import RESULTS, SEED, play_cells

from usnet_env.envs import MultiClusterEnv
from usnet_env.evaluation.agents import as_agent
from usnet_env.evaluation.episode import play_episode, warm_up
from usnet_env.evaluation.statistics import Interval, mean_interval, rate_interval
from usnet_env.files import atomic_write
from usnet_env.plugins import make_detector

LEARNED = "detectors.learned:Learned"
DETECTORS = {
    "learned": LEARNED,
    "follow-mixture": "follow-mixture",
    "lagged-regression": "lagged-regression",
    "one-per-round": "one-per-round",
    "destroy-all": "destroy-all",
    "random": "random",
}
SWARMS: dict[str, dict[str, Any]] = {
    "iid": {"mobility": "iid"},
    "gauss_markov, jitter": {"mobility": "gauss_markov", "head_jitter": True},
}
FOLLOW = ("f1", "f2", "f3", "f4", "f5", "f6", "f7", *OUT_OF_LIST)
GAMES = 20
LIMITS = ("learned", "lagged-regression")
TIERS = ("short", "noise", "missed", "straight", "decoys", "bare", "silence", "shifted")
KEPT = ("J", "rounds", "success", "exact", "ap_first", "seconds_per_round")


def play(cell: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """One episode of the evaluation with seed 2022."""
    env = MultiClusterEnv(follow=cell["follow"], **SWARMS[cell["swarm"]])
    label = cell["detector"]
    player = as_agent(make_detector(DETECTORS[label]))
    if seed == SEED:
        warm_up(env, player, label, SEED)
    row = play_episode(env, player, label, SEED, seed - SEED)
    return {name: round(row[name], 5) for name in KEPT}


def unseen_cells() -> list[dict[str, str]]:
    return [
        {"swarm": swarm, "follow": follow, "detector": detector}
        for detector in DETECTORS
        for swarm in SWARMS
        for follow in FOLLOW
    ]


def pivot(
    rows: Iterable[Mapping[str, str]],
    keys: Sequence[str],
    value: str,
    interval: Callable[[Sequence[float]], Interval],
    detectors: Sequence[str],
) -> str:
    """A Markdown table with a line for each cell of ``keys``, and for each detector the mean with its interval."""
    cells: dict[tuple[str, ...], dict[str, list[float]]] = {}
    for row in rows:
        found = cells.setdefault(tuple(row[key] for key in keys), {})
        found.setdefault(row["detector"], []).append(float(row[value]))
    lines = [f"| {' | '.join([*keys, 'n', *detectors])} |", f"|{' --- |' * (len(keys) + 1 + len(detectors))}"]
    for cell, found in cells.items():
        counts = sorted({len(values) for values in found.values()})
        shown = [_shown(interval(found[name])) if name in found else "" for name in detectors]
        lines.append(f"| {' | '.join([*cell, '–'.join(map(str, counts)), *shown])} |")
    return "\n".join(lines)


def _shown(interval: Interval) -> str:
    return f"{interval.mean:.2f} ({interval.low:.2f}–{interval.high:.2f})"


def report(rows: Sequence[Mapping[str, str]]) -> str:
    """Both tables, and the time of an answer."""
    names = list(DETECTORS)
    order = {name: number for number, name in enumerate([*SWARMS, *FOLLOW])}
    lines = sorted(rows, key=lambda row: (order[row["swarm"]], order[row["follow"]]))
    keys = ("swarm", "follow")
    return "\n\n".join(
        [
            "J_m, mean (95 % interval); at best 1, destroying all costs 1.94. Games are cut off after 20 rounds.",
            pivot(lines, keys, "J", mean_interval, names),
            "Share of games whose round 1 names the heads, no more and no less (95 % interval).",
            pivot(lines, keys, "exact", rate_interval, names),
            "Seconds of an answer (95 % interval of the mean), N=82.",
            pivot(lines, ("swarm",), "seconds_per_round", mean_interval, names),
        ]
    )


BARE = [  # heads and decoys in whose flight nothing varies
    Cell("bare", f"{follow}-{mobility}-5", {"follow": follow, "mobility": mobility, "decoys": 5, "uavs": 87})
    for follow in ("f1", "f4", "f7")
    for mobility in ("straight", "waypoint")
]
CELLS = {f"{cell.tier} {cell.name}": cell for cell in [*all_cells(), *BARE] if cell.tier in TIERS}


def limit_cells() -> list[dict[str, str]]:
    """Only ``learned`` is asked where nobody follows: it alone of the two may name nobody."""
    return [
        {"tier": cell.tier, "cell": cell.name, "detector": detector}
        for detector in LIMITS
        for cell in CELLS.values()
        if detector == "learned" or cell.kind == "P2"
    ]


def play_limit(cell: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """One episode of a cell of follow_mixture.py; where nobody follows, ``learned`` may name nobody."""
    limit, name = CELLS[f"{cell['tier']} {cell['cell']}"], DETECTORS[cell["detector"]]
    if name == LEARNED and limit.kind != "P2":
        name += "(policy='map')"
    row = play_cell(limit, make_detector(name), cell["detector"], SEED, seed - SEED)
    return {column: row[column] for column in ("J", "exact", "named", "decoys_named")}


def report_limits(rows: Sequence[Mapping[str, str]]) -> str:
    """A table for the games, one for the controls in which nobody may be named."""
    names, keys = list(LIMITS), ("tier", "cell")
    games = [row for row in rows if row["tier"] not in ("silence", "shifted")]
    decoys = [row for row in games if row["tier"] in ("decoys", "bare")]
    controls = [row for row in rows if row["tier"] in ("silence", "shifted")]
    return "\n\n".join(
        [
            "J_m, mean (95 % interval). short: T_ob; noise: standard deviation in metres; missed: share of samples.",
            pivot(games, keys, "J", mean_interval, names),
            "Share of games whose round 1 names the heads, no more and no less (95 % interval).",
            pivot(games, keys, "exact", rate_interval, names),
            "Decoys named in round 1, mean (95 % interval); the cell's last number is how many there are.",
            pivot(decoys, keys, "decoys_named", mean_interval, names),
            "Controls in which nobody follows anybody: UAVs named in one window, mean (95 % interval); 0 is right.",
            pivot(controls, keys, "named", mean_interval, ["learned"]),
        ]
    )


def main() -> None:
    """Play what is missing and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--games", type=int, default=GAMES, help="a cell")
    parser.add_argument("--detectors", nargs="*", default=list(DETECTORS), choices=list(DETECTORS))
    parser.add_argument("--limits", action="store_true", help="short, noisy and controlled windows instead")
    parser.add_argument("--table", action="store_true", help="play nothing")
    asked = parser.parse_args()
    if asked.limits:
        path, cells, one, text_of = RESULTS / "learned_limits.csv", limit_cells(), play_limit, report_limits
    else:
        path, cells, one, text_of = RESULTS / "learned.csv", unseen_cells(), play, report
    if asked.table:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    else:
        wanted = [cell for cell in cells if cell["detector"] in asked.detectors]
        rows = play_cells(path, wanted, lambda _: asked.games, one)
    text = text_of(rows)
    with atomic_write(path.with_suffix(".md")) as aside:
        aside.write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()

"""What both benchmarks of games of several agents share: play a grid of cells, keep a row a game, print means."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from usnet_env.evaluation.statistics import mean_interval, rate_interval
from usnet_env.files import atomic_write

RESULTS = Path(__file__).parent / "results"
SEED = 2022  # of the first game; seeds of published games were not used for tuning


def play_cells(
    path: Path,
    cells: Sequence[Mapping[str, Any]],
    games: Callable[[Mapping[str, Any]], int],
    play: Callable[[Mapping[str, Any], int], Mapping[str, Any]],
) -> list[dict[str, str]]:
    """Play the games of every cell, all on the same seeds, and write a row each after every cell.

    Rows that the file has already are kept and not played again: delete it to measure anew.
    """
    rows: list[dict[str, str]] = []
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    for cell in cells:
        plain = {name: str(value) for name, value in cell.items()}
        known = {int(row["seed"]) for row in rows if plain.items() <= row.items()}
        missing = [seed for seed in range(SEED, SEED + games(cell)) if seed not in known]
        began = time.perf_counter()
        for seed in missing:
            rows.append({**plain, "seed": str(seed), **{name: str(value) for name, value in play(cell, seed).items()}})
        if missing:
            with atomic_write(path) as aside, aside.open("w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
                writer.writeheader()
                writer.writerows(rows)
            print(*plain.values(), f"{time.perf_counter() - began:.1f} s", flush=True)
    return rows


def table(rows: Iterable[Mapping[str, Any]], keys: Sequence[str], columns: Mapping[str, str]) -> str:
    """A Markdown table: a row for every combination of ``keys``, a mean with its 95 % interval for every column.

    Args:
        rows: of the file.
        keys: columns that make a cell.
        columns: columns to average, and their titles; ``success`` is a rate.
    """
    groups: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    lines = [f"| {' | '.join([*keys, 'n', *columns.values()])} |", f"|{' --- |' * (len(keys) + 1 + len(columns))}"]
    for cell, members in groups.items():
        numbers = []
        for name in columns:
            values = [float(row[name]) for row in members]
            mean, low, high = (rate_interval if name == "success" else mean_interval)(values)
            numbers.append(f"{mean:.2f} ({low:.2f}–{high:.2f})")
        lines.append(f"| {' | '.join([*map(str, cell), str(len(members)), *numbers])} |")
    return "\n".join(lines)

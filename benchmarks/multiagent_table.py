"""What several benchmarks share: play the games of a grid of cells, and keep one row for each game."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from usnet_env.files import atomic_write

RESULTS = Path(__file__).parent / "results"
SEED = 2022  # of the first game; seeds below 1000 are for tuning


def play_cells(
    path: Path,
    cells: Sequence[Mapping[str, Any]],
    games: Callable[[Mapping[str, Any]], int],
    play: Callable[[Mapping[str, Any], int], Mapping[str, Any]],
    first_seed: int = SEED,
) -> list[dict[str, str]]:
    """Play the games of every cell, all with the same seeds, and write their rows after each cell.

    Games that the file holds are not played again: delete it to measure anew.
    """
    rows: list[dict[str, str]] = []
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    for cell in cells:
        plain = {name: str(value) for name, value in cell.items()}
        known = {int(row["seed"]) for row in rows if plain.items() <= row.items()}
        missing = [seed for seed in range(first_seed, first_seed + games(cell)) if seed not in known]
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

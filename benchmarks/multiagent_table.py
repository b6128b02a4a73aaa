"""What several benchmarks share: play the games of a grid of cells, and keep one row for each game."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from usnet_env.evaluation.store import RowFile

RESULTS = Path(__file__).parent / "results"
SEED = 2022  # of the first game; seeds below 1000 are for tuning


def play_cells(
    path: Path,
    cells: Sequence[Mapping[str, Any]],
    games: Callable[[Mapping[str, Any]], int],
    play: Callable[[Mapping[str, Any], int], Mapping[str, Any]],
    values: Sequence[str],
    first_seed: int = SEED,
) -> Sequence[dict[str, str]]:
    """Play the games of every cell, all with the same seeds, and append their rows: the cell, the seed, the values.

    Games that the file holds are not played again: delete it to measure anew.
    """
    with RowFile(path, dict.fromkeys((*cells[0], "seed", *values), "str")) as file:
        for cell in cells:
            plain = {name: str(value) for name, value in cell.items()}
            known = {int(row["seed"]) for row in file.table if plain.items() <= row.items()}
            missing = [seed for seed in range(first_seed, first_seed + games(cell)) if seed not in known]
            began = time.perf_counter()
            for seed in missing:
                row = {name: str(value) for name, value in play(cell, seed).items()}
                file.append([{**plain, "seed": str(seed), **row}])
            if missing:
                print(*plain.values(), f"{time.perf_counter() - began:.1f} s", flush=True)
        return file.table

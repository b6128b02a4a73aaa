"""GASSL before strategies that its additive IFSN can't say: products of two axes of the head's velocity.

OMP_NUM_THREADS=1 python benchmarks/gassl_products.py      # writes benchmarks/results/gassl_products.csv
"""

from __future__ import annotations

from pathlib import Path

import follow_mixture_strategies  # noqa: F401  registers the strategy

from usnet_env.reproduce.detection_rate import Cell, measure, rate_of, tasks_for

DETECTORS = ("gassl", "gassl(preset='paper')", "lagged-regression(clusters=1)")
FOLLOWERS = (2, 5, 15)
EPISODES = 24
SEED = 2022


def main() -> None:
    cells = [Cell("products", followers, decoys) for followers in FOLLOWERS for decoys in (0, 1)]
    path = Path(__file__).parent / "results" / "gassl_products.csv"
    rows = measure(tasks_for(DETECTORS, cells, lambda cell: EPISODES), SEED, path, 1)
    for detector in DETECTORS:
        for cell in cells:
            rate = rate_of(row for row in rows if (row.detector, row.cell) == (detector, cell))
            if rate is not None:
                n, (mean, low, high) = rate
                where = f"m={cell.followers}, {cell.decoys} decoys"
                print(f"{detector}, {where}: head alone named in {mean:.3f} ({low:.3f}-{high:.3f}), n={n}")


if __name__ == "__main__":
    main()

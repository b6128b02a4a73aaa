"""Measure ``neural-granger`` on a strategy that its additive network cannot represent: products of two coordinates.

OMP_NUM_THREADS=1 python benchmarks/neural_granger_products.py  # writes benchmarks/results/neural_granger_products.csv
"""

from __future__ import annotations

from pathlib import Path

import follow_mixture_strategies  # noqa: F401  registers the strategy

from detectors.studies.detection_rate import Cell, measure, rate_of, tasks_for

DETECTORS = ("neural-granger", "lagged-regression(clusters=1)")
FOLLOWERS = (2, 5, 15)
EPISODES = 24
SEED = 2022


def main() -> None:
    """Measure and print."""
    cells = [Cell("products", followers, decoys) for followers in FOLLOWERS for decoys in (0, 1)]
    path = Path(__file__).parent / "results" / "neural_granger_products.csv"
    rows = measure(tasks_for(DETECTORS, cells, lambda cell: EPISODES), SEED, path, 1)
    for detector in DETECTORS:
        for cell in cells:
            rate = rate_of(row for row in rows if (row.detector, row.cell) == (detector, cell))
            if rate is not None:
                n, (mean, low, high) = rate
                where = f"m={cell.followers}, {cell.decoys} decoys"
                print(f"{detector}, {where}: only the head named in {mean:.3f} ({low:.3f}-{high:.3f}), n={n}")


if __name__ == "__main__":
    main()

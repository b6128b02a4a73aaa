"""Measure ``neural-granger`` on a strategy that its additive network cannot represent: products of two coordinates.

OMP_NUM_THREADS=1 python benchmarks/neural_granger_products.py  # writes benchmarks/results/neural_granger_products.csv
"""

from __future__ import annotations

import follow_mixture_strategies  # noqa: F401  registers the strategy
from detectors.studies.table2 import Cell, make_suite, make_tasks, rate_of
from running import RESULTS, answer_help
from usnet_env.evaluation.report import group_rows

DETECTORS = ("neural-granger", "lagged-regression(clusters=1)")
FOLLOWERS = (2, 5, 15)
EPISODES = 24
SEED = 2022


def main() -> None:
    swarms = [("products", followers, decoys) for followers in FOLLOWERS for decoys in (0, 1)]
    tasks = make_tasks([Cell(name, *swarm) for name in DETECTORS for swarm in swarms], lambda cell: EPISODES)
    rows = make_suite(SEED).run(tasks, RESULTS / "neural_granger_products.csv")
    for cell, own in group_rows(rows, lambda row: (row.detector, row.followers, row.decoys)).items():
        detector, followers, decoys = cell
        n, (mean, low, high) = rate_of(own)
        where = f"m={followers}, {decoys} decoys"
        print(f"{detector}, {where}: only the head named in {mean:.3f} ({low:.3f}-{high:.3f}), n={n}")


if __name__ == "__main__":
    answer_help(__doc__)
    main()

"""Measure the gate of ``neural-granger``: how often it names no UAV, in swarms without and with followers.

OMP_NUM_THREADS=1 python benchmarks/neural_granger_gate.py  # writes benchmarks/results/neural_granger_gate.csv
"""

from __future__ import annotations

import os

from running import RESULTS, answer_help

from detectors.studies.table2 import Cell, make_suite, make_tasks, rate_of

FOLLOWERS = (2, 5, 15)
FOLLOW = ("none", "f1", "f2", "f3", "f4", "f5", "f6", "f7")
SEED = 2022


def main() -> None:
    swarms = [(follow, followers, decoys) for follow in FOLLOW for followers in FOLLOWERS for decoys in (0, 1)]
    cells = [Cell("neural-granger(gate=True)", *swarm) for swarm in swarms]
    tasks = make_tasks(cells, lambda cell: 200 if cell.follow == "none" else 60)
    rows = make_suite(SEED).run(tasks, RESULTS / "neural_granger_gate.csv", workers=os.cpu_count() or 1)
    for name, some in (("without followers", ("none",)), ("with followers", FOLLOW[1:])):
        for followers in FOLLOWERS:
            rate = rate_of((row for row in rows if row.follow in some and row.followers == followers), "named")
            if rate is not None:
                n, (mean, low, high) = rate
                print(f"{name}, m={followers}: no UAV named in {1 - mean:.3f} ({1 - high:.3f}-{1 - low:.3f}), n={n}")


if __name__ == "__main__":
    answer_help(__doc__)
    main()

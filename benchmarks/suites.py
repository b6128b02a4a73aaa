"""Keeps the rows of frozen suites that `usnet evaluate --suite NAME --out out/suites/NAME` has played.

    python benchmarks/suites.py out/suites/paper    # writes benchmarks/results/suites/paper-v1.csv.gz

`benchmarks/README.md` lists the commands that played them.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import io
from pathlib import Path

from running import RESULTS

from usnet_env.evaluation import SuiteResult, load_suite
from usnet_env.files import atomic_write

COLUMNS = (
    "detector", "episode", "swarm_seed", "J", "rounds", "redundancy", "success", "exact", "precision_first",
    "recall_first", "f1_first", "ap_first", "seconds_per_round",
)  # fmt: skip


def pack(folder: Path) -> Path:
    """Write the rows of a suite's folder, and return the file."""
    suite = load_suite(folder.name)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("cell", *COLUMNS))
    for cell, result in SuiteResult.load(folder, suite).results.items():
        for row in result.rows:
            values = (row[name] for name in COLUMNS)
            writer.writerow((cell, *(f"{value:.4g}" if isinstance(value, float) else value for value in values)))
    path = RESULTS / "suites" / f"{suite.name}-v{suite.version}.csv.gz"
    with atomic_write(path) as aside:
        aside.write_bytes(gzip.compress(text.getvalue().encode(), mtime=0))
    return path


def main() -> None:
    """Pack each folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    for folder in parser.parse_args().folders:
        print(pack(folder))


if __name__ == "__main__":
    main()

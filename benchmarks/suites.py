"""Keeps the rows of frozen suites that `usnet evaluate --suite NAME --out out/suites/NAME` has played.

    python benchmarks/suites.py out/suites/paper    # writes benchmarks/results/suites/paper-v1.csv.gz
    python benchmarks/suites.py out/first/field out/second/field    # detectors that were played apart, in one file

`benchmarks/README.md` lists the commands that played them.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import io
from collections.abc import Sequence
from pathlib import Path

from running import RESULTS

from usnet_env.evaluation import SuiteResult, load_suite
from usnet_env.evaluation.report import group_rows
from usnet_env.files import atomic_write

COLUMNS = (
    "detector", "episode", "swarm_seed", "J", "rounds", "redundancy", "success", "exact", "precision_first",
    "recall_first", "f1_first", "ap_first", "seconds_per_round",
)  # fmt: skip


def pack(folders: Sequence[Path]) -> Path:
    """Write the rows of the folders of one suite, cell by cell, and return the file."""
    suite = load_suite(folders[0].name)
    played = [SuiteResult.load(folder, suite).results for folder in folders]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("cell", *COLUMNS))
    for cell in suite.cells:
        for row in (row for results in played if cell in results for row in results[cell].rows):
            values = (row[name] for name in COLUMNS)
            writer.writerow((cell, *(f"{value:.4g}" if isinstance(value, float) else value for value in values)))
    path = RESULTS / "suites" / f"{suite.name}-v{suite.version}.csv.gz"
    with atomic_write(path) as aside:
        aside.write_bytes(gzip.compress(text.getvalue().encode(), mtime=0))
    return path


def main() -> None:
    """Pack the folders, suite by suite."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    for folders in group_rows(parser.parse_args().folders, lambda folder: folder.name).values():
        print(pack(folders))


if __name__ == "__main__":
    main()

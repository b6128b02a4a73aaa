"""Keeps the rows of frozen suites that `usnet evaluate --suite NAME --out out/suites/NAME` has played.

    python benchmarks/suites.py out/suites/paper    # writes benchmarks/results/suites/paper-v1.csv.gz
    python benchmarks/suites.py out/first/field out/second/field    # detectors that were played apart, in one file
    python benchmarks/suites.py --add out/mine/paper    # the same, and the other detectors of the file stay in it

`benchmarks/README.md` lists the commands that played them.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from result_pages.suites import read_suite
from running import RESULTS

from usnet_env.evaluation import SuiteResult, load_suite
from usnet_env.evaluation.report import group_rows
from usnet_env.files import atomic_write

COLUMNS = (
    "detector", "episode", "swarm_seed", "J", "rounds", "redundancy", "success", "exact", "precision_first",
    "recall_first", "f1_first", "ap_first", "seconds_per_round",
)  # fmt: skip


def pack(folders: Sequence[Path], add: bool = False, results: Path = RESULTS) -> Path:
    """Write the rows of the folders of one suite, cell by cell, and return the file.

    Args:
        folders: of one suite, whose name they have.
        add: whether the rows of other detectors, which the file holds, stay in it.
        results: the folder of the committed rows.

    Raises:
        ValueError: a detector lacks episodes, or rows of the file and of the folders are of different swarms.
    """
    suite = load_suite(folders[0].name)
    path = results / "suites" / f"{suite.name}-v{suite.version}.csv.gz"
    played = [SuiteResult.load(folder, suite).results for folder in folders]
    rows = [
        {"cell": cell, **{name: _format(row[name]) for name in COLUMNS}}
        for cell in suite.cells
        for found in played
        if cell in found
        for row in found[cell].rows
    ]
    own = Counter(row["detector"] for row in rows)
    expected = suite.episodes * len(suite.cells)
    if short := [name for name, count in own.items() if count != expected]:
        raise ValueError(f"each detector must have {expected} rows of {suite.label}, got another number of {short}.")
    if add and path.exists():
        rows += [row for row in read_suite(suite, results) if row["detector"] not in own]
        order = list(suite.cells)
        rows.sort(key=lambda row: order.index(row["cell"]))
    if len({(row["cell"], row["episode"], row["swarm_seed"]) for row in rows}) != expected:
        raise ValueError(f"all rows of {suite.label} must be of the same swarms: play with the secret of the others.")
    text = io.StringIO()
    writer = csv.DictWriter(text, ("cell", *COLUMNS), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with atomic_write(path) as aside:
        aside.write_bytes(gzip.compress(text.getvalue().encode(), mtime=0))
    return path


def _format(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main() -> None:
    """Pack the folders, suite by suite."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--add", action="store_true", help="keep the other detectors that the file holds")
    arguments = parser.parse_args()
    for folders in group_rows(arguments.folders, lambda folder: folder.name).values():
        print(pack(folders, arguments.add))


if __name__ == "__main__":
    main()

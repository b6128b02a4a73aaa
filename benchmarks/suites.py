"""Keeps the rows of frozen suites that `usnet evaluate --suite NAME --out out/suites/NAME` has played.

    python benchmarks/suites.py out/suites/paper    # writes benchmarks/results/suites/paper-v1.csv.gz
    python benchmarks/suites.py out/first/field out/second/field    # detectors that were played apart, in one file
    python benchmarks/suites.py --add out/mine/paper    # the same, and the other detectors of the file stay in it

A slow detector may have played the first episodes only (`--episodes`), as many of every cell.

`benchmarks/README.md` lists the commands that played them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from result_pages.suites import failures_file, read_failures, read_suite, rows_file
from running import RESULTS, make_parser, write_csv
from usnet_env.evaluation.report import group_rows

from usnet_env.evaluation import SuiteResult, load_suite

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
        ValueError: a detector lacks episodes of a cell, or the same episode has different swarms.
    """
    suite = load_suite(folders[0].name)
    path = results / rows_file(suite)
    played = [SuiteResult.load(folder, suite) for folder in folders]
    failed = [
        {"cell": cell, "detector": name, "reason": reason}
        for cell in suite.cells
        for found in played
        for name, reason in found.failures.get(cell, {}).items()
    ]
    without = {(row["cell"], row["detector"]) for row in failed}  # of these, no row counts
    rows = [
        {"cell": cell, **{name: _format(row[name]) for name in COLUMNS}}
        for cell in suite.cells
        for found in played
        if cell in found.results
        for row in found.results[cell].rows
        if (cell, row["detector"]) not in without
    ]
    played_cells = group_rows(rows, lambda row: (row["detector"], row["cell"]))
    by_detector = group_rows(rows, lambda row: row["detector"])
    most = {name: max(int(row["episode"]) for row in own) for name, own in by_detector.items()}
    short = [
        f"{name} in {cell}"
        for name in most
        for cell in suite.cells
        if (cell, name) not in without
        and [int(row["episode"]) for row in played_cells.get((name, cell), [])] != list(range(most[name] + 1))
    ]
    if short:
        raise ValueError(f"a detector must play the same episodes of every cell of {suite.label}; some lack: {short}.")
    if add and path.exists():
        new = {row["detector"] for row in rows + failed}
        rows += [row for row in read_suite(suite, results) if row["detector"] not in new]
        failed += [row for row in read_failures(suite, results) if row["detector"] not in new]
    swarms = {(row["cell"], row["episode"], row["swarm_seed"]) for row in rows}
    if len(swarms) != len({(row["cell"], row["episode"]) for row in rows}):
        raise ValueError(f"all rows of {suite.label} must be of the same swarms: play with the secret of the others.")
    order = list(suite.cells)
    write_csv(path, sorted(rows, key=lambda row: order.index(row["cell"])), ("cell", *COLUMNS))
    failures = results / failures_file(suite)
    if failed or failures.exists():
        columns = ("cell", "detector", "reason")
        write_csv(failures, sorted(failed, key=lambda row: order.index(row["cell"])), columns)
    return path


def _format(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main() -> None:
    parser = make_parser(__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--add", action="store_true", help="keep the other detectors that the file holds")
    arguments = parser.parse_args()
    for folders in group_rows(arguments.folders, lambda folder: folder.name).values():
        print(pack(folders, arguments.add))


if __name__ == "__main__":
    main()

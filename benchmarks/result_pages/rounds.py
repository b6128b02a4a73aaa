"""P2 round by round: against the follow strategy, M and N."""

from __future__ import annotations

from pathlib import Path

from running import RESULTS

from detectors.studies.rounds import COLUMNS, Row, report_studies
from result_pages.text import demoted, page
from usnet_env.evaluation.suite import read_rows

FOLDER = RESULTS / "rounds"
SHOWN = ("rounds", "redundancy", "J", "success", "exact", "purity_first", "head_in_cluster_first")


def files() -> list[Path]:
    """The row files, the paper's setting first."""
    return sorted(FOLDER.glob("rounds*.csv"), key=lambda path: (len(path.name), path.name))


def text() -> str:
    """The page."""
    parts = []
    columns = tuple(column for column in COLUMNS if column[0] in SHOWN)
    for path in files():
        rows = read_rows(path, Row)
        heads = rows[0].mobility + (" heads with jitter" if rows[0].head_jitter else " heads")
        parts += [
            f"## {heads}",
            demoted(report_studies(rows, "", with_paper=path.name.startswith("rounds-seed"), columns=columns)),
            f"![Rounds, redundancy and J_m](../../benchmarks/results/rounds/{path.with_suffix('.png').name})",
        ]
    return page(
        "P2: rounds against strategy, M and N",
        "The paper's studies of P2, beside its words. n differs between detectors and cells; each row gives it. "
        "A line *all* is the mean over the cells of a study that the detector has played.",
        *parts,
        files=[f"rounds/{path.name}" for path in files()],
    )

"""P2 round by round: against the follow strategy, M and N."""

from __future__ import annotations

from detectors.studies.common import describe_flight
from detectors.studies.rounds import COLUMNS, Row, report_studies
from running import RESULTS
from usnet_env.evaluation.suite import read_rows

from result_pages.text import demoted, page, picture, row_files

FILES = row_files(RESULTS / "rounds", "rounds")
SHOWN = ("rounds", "redundancy", "J", "success", "exact", "purity_first", "head_in_cluster_first")


def text() -> str:
    parts = []
    columns = tuple(column for column in COLUMNS if column[0] in SHOWN)
    for path in FILES:
        rows = read_rows(path, Row)
        parts += [
            f"## {describe_flight(rows[0])}",
            demoted(report_studies(rows, "", with_paper=path.name.startswith("rounds-seed"), columns=columns)),
            picture("Rounds, redundancy and J_m", f"rounds/{path.stem}.png"),
        ]
    return page(
        "P2: rounds against strategy, M and N",
        "The paper's studies of P2, beside its words. n differs between detectors and cells; each row gives it. "
        "A line *all* is the mean over the cells of a study that the detector has played.",
        *parts,
        files=[f"rounds/{path.name}" for path in FILES],
    )

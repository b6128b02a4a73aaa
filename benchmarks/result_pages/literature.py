"""Experiments of the literature on leaders."""

from __future__ import annotations

from collections.abc import Sequence

from running import RESULTS, read_csv
from usnet_env.evaluation.report import group_rows

from result_pages.text import Row, mean_of, page, table

_MINORITY = (
    "Couzin et al. (2005) found that a larger flock needs a smaller informed share to be steered as well. The model is "
    "`informed` with a preference of 0.5, ranges of alignment and attraction of 60 m, and straight courses; the value "
    "is the cosine of the angle between the course of the flock and the preferred course, after 10 windows. A share of "
    "0 has one informed UAV whose preference has no weight: the control. The swarm flies in three dimensions, theirs "
    "in two, and the accuracy here is a cosine, theirs an angular deviation: compare the shape and not the numbers."
)
_VICSEK = (
    "Mwaffo, Butail and Porfiri (2017) varied the interaction region and the noise of Vicsek flocks with one leader. "
    "The model is `vicsek` with 20 UAVs, in its first window; the value is the share of games in which the leader has "
    "the highest score (chance: 0.05). They combine three methods and fly in a periodic box, in which a leader cannot "
    "leave its flock: compare the shape and not the numbers."
)
_HIERARCHY = (
    "Nagy et al. (2010) found the hierarchy of pigeons by the delays of directional correlation. The model is "
    "`pigeons` with 10 UAVs; the first value is Kendall's rank correlation of the delays behind the head, found by "
    "directional correlation with it, with the true ones; the others are the shares of games in which the head has the "
    "highest score (chance: 0.1)."
)


def text() -> str:
    rows = group_rows(read_csv(RESULTS / "literature.csv"), lambda row: row["experiment"])
    minority = sorted(rows["minority"], key=lambda row: float(row["share"]))
    games = len({row["game"] for own in rows.values() for row in own})
    return page(
        "Experiments of the literature",
        f"{games} games a cell; means with 95 % bootstrap intervals over games.",
        "## An informed minority",
        _MINORITY,
        _cross(minority, "share", "size", "informed share", "N = {}"),
        "## One leader of a Vicsek flock",
        _VICSEK,
        *(
            f"Noise {noise}:\n\n" + _cross(own, "detector", "range", "detector", "range {} m")
            for noise, own in group_rows(rows["vicsek"], lambda row: row["noise"]).items()
        ),
        "## Delays in a hierarchy",
        _HIERARCHY,
        _hierarchy(rows["hierarchy"]),
        files=["literature.csv"],
    )


def _value(rows: Sequence[Row], column: str = "value") -> str:
    return mean_of(rows, column, 2, "game") if rows else "–"


def _cross(rows: Sequence[Row], down: str, across: str, heading: str, form: str) -> str:
    """A table of means by two columns."""
    columns = sorted({row[across] for row in rows}, key=float)
    lines = []
    for name, own in group_rows(rows, lambda row: row[down]).items():
        cells = group_rows(own, lambda row: row[across])
        lines.append((name, *(_value(cells.get(column, [])) for column in columns)))
    return table((heading, *(form.format(column) for column in columns)), lines)


def _hierarchy(rows: Sequence[Row]) -> str:
    by_noise = group_rows(rows, lambda row: row["noise"])
    detectors = list(dict.fromkeys(row["detector"] for row in rows))
    lines = []
    for noise, own in by_noise.items():
        by_detector = group_rows(own, lambda row: row["detector"])
        first = [_value(by_detector.get(name, []), "head_first") for name in detectors]
        lines.append((noise, _value(by_detector[detectors[0]]), *first))
    return table(("noise", "rank correlation of delays", *(f"`{name}`" for name in detectors)), lines)

"""What a large run costs: the tables of docs/clusters.md."""

from __future__ import annotations

from statistics import fmean

from running import RESULTS, read_csv

from detectors.studies.common import FOLLOW
from result_pages.speed import read
from result_pages.text import Row, table

#: The file of each detector's rows.
_FILES = {
    "lagged-regression": "rounds/rounds-seed2022.csv",
    "follow-mixture": "follow_mixture/paper.csv",
    "learned": "learned.csv",
    "neural-granger": "table2/episodes-seed2022.csv",
    "lead-votes": "rounds/rounds-seed2022.csv",
    "mc-gassl": "rounds/rounds-seed2022.csv",
}
#: Rows of the paper's swarms have these values in the columns that their file has.
_PAPER = {"clusters": ("5",), "uavs": ("82",), "swarm": ("iid",), "follow": FOLLOW}


def _seconds(row: Row) -> float:
    """Seconds of an episode."""
    return float(row["seconds"]) if "seconds" in row else float(row["seconds_per_round"]) * float(row["rounds"])


def detectors() -> str:
    """The mean seconds of an episode by detector, and the core hours of a million episodes."""
    lines = []
    for name, file in _FILES.items():
        own = [row for row in read_csv(RESULTS / file) if row["detector"] == name]
        own = [row for row in own if all(row[column] in known for column, known in _PAPER.items() if column in row)]
        mean = fmean(map(_seconds, own))
        lines.append((f"`{name}`", f"{mean:.2g}", f"{len(own):,}", f"`{file}`", _round(1e6 * mean / 3600)))
    header = ("detector", "seconds", "n", "rows in `benchmarks/results`", "core hours of a million episodes")
    return table(header, lines)


def engine() -> str:
    """What an episode costs the program that starts a run."""
    result = read("engine_speed.json")
    own = result["engine"]
    row = own["cpu_milliseconds_of_runner_and_store_for_an_episode"]
    summary = own["cpu_milliseconds_of_the_summary_for_an_episode"]
    tasks = sorted(result[part]["cpu_milliseconds_of_the_program_for_a_task"] for part in ("ray", "ray_computing"))
    most, least = (1e3 / (task + row + summary) for task in tasks)
    many = result["summary"]
    lines = [
        ("CPU for a task of Ray, two measurements", f"{tasks[0]:.2f} and {tasks[1]:.2f} ms"),
        ("CPU for the row of an episode", f"{row:.2f} ms"),
        ("CPU for the summary of an episode", f"{summary:.2f} ms"),
        ("the most episodes a second, from these three", f"{_round(least)} to {_round(most)}"),
        ("the least mean time of an episode that keeps 1,000 cores busy", f"{1e3 / least:.2f} s"),
        ("disk space for a row", f"{result['append']['1000000']['bytes']:.0f} bytes"),
        (f"reading and summarising {many['rows']:,} rows", f"{many['seconds']:.1f} s, {many['bytes'] / 1e9:.2f} GB"),
    ]
    return table(("what", "cost"), lines)


def _round(value: float) -> str:
    """Two significant digits."""
    return f"{float(f'{value:.2g}'):,.9g}"

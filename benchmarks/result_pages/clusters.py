"""What a large run costs: the tables of docs/clusters.md."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import fmean

from running import RESULTS, read_csv

from detectors.studies.common import FOLLOW
from result_pages.speed import read
from result_pages.text import Row, table


def _of_rounds(row: Row) -> float:
    return float(row["seconds_per_round"]) * float(row["rounds"])


def _of_paper(row: Row) -> bool:
    """Whether a row of the rounds is of the paper's sizes."""
    return (row["clusters"], row["uavs"]) == ("5", "82")


def _seconds() -> dict[str, tuple[list[float], str]]:
    """The seconds of each episode by detector, and the file of its rows."""
    rounds = [row for row in read_csv(RESULTS / "rounds/rounds-seed2022.csv") if _of_paper(row)]
    learned = [row for row in read_csv(RESULTS / "learned.csv") if row["swarm"] == "iid" and row["follow"] in FOLLOW]
    files: Mapping[str, list[tuple[str, float]]] = {
        "rounds/rounds-seed2022.csv": [(row["detector"], _of_rounds(row)) for row in rounds],
        "learned.csv": [(row["detector"], _of_rounds(row)) for row in learned],
        "follow_mixture/paper.csv": [
            (row["detector"], float(row["seconds"])) for row in read_csv(RESULTS / "follow_mixture/paper.csv")
        ],
        "table2/episodes-seed2022.csv": [
            (row["detector"], float(row["seconds"])) for row in read_csv(RESULTS / "table2/episodes-seed2022.csv")
        ],
    }
    shown = {
        "lagged-regression": "rounds/rounds-seed2022.csv",
        "follow-mixture": "follow_mixture/paper.csv",
        "learned": "learned.csv",
        "neural-granger": "table2/episodes-seed2022.csv",
        "lead-votes": "rounds/rounds-seed2022.csv",
        "mc-gassl": "rounds/rounds-seed2022.csv",
    }
    found = {}
    for name, file in shown.items():
        found[name] = [seconds for played, seconds in files[file] if played == name], file
    return found


def detectors() -> str:
    """The mean seconds of an episode by detector, and the core hours of a million episodes."""
    lines = [
        (f"`{name}`", f"{fmean(seconds):.2g}", f"{len(seconds):,}", f"`{file}`", _round(1e6 * fmean(seconds) / 3600))
        for name, (seconds, file) in _seconds().items()
    ]
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

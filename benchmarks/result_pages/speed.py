"""Speed and memory, from the files that the speed benchmarks write."""

from __future__ import annotations

import json
from typing import Any

from running import RESULTS

from result_pages.text import page, source, table


def read(name: str) -> Any:
    """A JSON file of results."""
    return json.loads((RESULTS / name).read_text(encoding="utf-8"))


def spread(values: list[float]) -> str:
    """The median and the range of the ratios of all turns."""
    ordered = sorted(values)
    return f"{ordered[len(ordered) // 2]:.3g} ({ordered[0]:.3g}–{ordered[-1]:.3g})"


def simulator() -> list[str]:
    """Stepping, growth with N, peers, memory."""
    result = read("speed.json")
    stepping = table(
        ("flight", "turns", "million UAV steps a second", "rate of stepping over rate of drawing the same normals"),
        [
            (name, str(len(row["ratios"])), f"{row['uav_steps_per_second'] / 1e6:.1f}", spread(row["ratios"]))
            for part in ("stepping", "field", "kinematics")
            for name, row in result[part].items()
        ],
    )
    sizes = next(iter(result["scaling"].values()))["uavs"]
    lines = []
    for name, row in result["scaling"].items():
        nanoseconds = [1e9 * each for each in row["seconds_per_uav_step"]]
        lines.append((f"{name}: ns of a UAV step", *(f"{each:.0f}" for each in nanoseconds)))
        if compared := row.get("compared"):
            lines.append((f"{name}: neighbours within {row['range']:g} m", *(f"{n:.0f}" for n in row["neighbours"])))
            lines.append((f"{name}: UAVs that a UAV is compared with", *(f"{n:.0f}" for n in compared)))
            shares = (f"{each / n:.0f}" for each, n in zip(nanoseconds, compared, strict=True))
            lines.append((f"{name}: ns of a comparison", *shares))
    growth = table(("at a fixed density", *(f"N = {uavs:,}" for uavs in sizes)), lines)
    peers = result["peers"]
    rates = peers["agent_steps_per_second"]
    beside = table(
        ("environment", "agent steps a second", "usnet over it"),
        [
            ("usnet", f"{rates['usnet']:,.0f}", ""),
            *(
                (name, f"{rates[name]:,.0f}", spread(peers[f"over_{name}"]["ratios"]))
                for name in ("simple_tag_v3", "vmas_flocking")
            ),
        ],
    )
    return [stepping, growth, beside, f"1,000 swarms of 82 UAVs take {result['memory']['bytes'] / 2**30:.2f} GiB."]


def mixture() -> list[str]:
    """follow-mixture: windows, growth with N, memory, beside one network fit for each UAV."""
    result = read("follow_mixture_speed.json")
    window = table(
        ("strategy", "windows", "ms for a window", "times one pass of `lagged-correlation`", "exact"),
        [
            (
                name,
                str(row["windows"]),
                f"{1e3 * row['seconds']:.1f}",
                spread(row["ratios"]),
                f"{row['exact']:.2f}",
            )
            for name, row in result["window"].items()
        ],
    )
    parts = [window]
    for series, grown in result["growth"].items():
        lines = [
            (
                uavs,
                str(row["clusters"]),
                f"{row['windows']} × {row['turns']}",
                f"{row['seconds']:.3f}",
                f"{row['exact']:.2f}",
            )
            for uavs, row in grown["sizes"].items()
        ]
        parts += [
            f"Seconds against N, {series}; they grow as N to the power {grown['exponent_fitted']:.2f}:",
            table(("N", "M", "windows × turns", "seconds", "exact"), lines),
        ]
    memory = ", ".join(f"{row['bytes'] / 2**30:.2f} GiB ({series})" for series, row in result["memory"].items())
    return [*parts, f"Peak memory of a process that answers one window of 10,000 UAVs: {memory}."]


def engine() -> list[str]:
    """The evaluator: a row, many rows, isolation."""
    result = read("engine_speed.json")
    rows = table(
        ("rows in the file", "CPU ms for one more", "bytes written"),
        [
            (f"{int(size):,}", f"{row['milliseconds']:.3f}", f"{row['bytes']:.0f}")
            for size, row in result["append"].items()
        ],
    )
    many = table(
        ("what", "rows", "seconds", "peak memory, MB"),
        [
            ("evaluate episodes that cost nothing", *_size(result["episodes"], "episodes")),
            ("read and summarise the rows of 5 detectors", *_size(result["summary"], "rows")),
        ],
    )
    answers = table(
        ("the detector `none`, N = 82", "ms for an answer", "ms more than in process"),
        [
            (name, f"{row['milliseconds']:.2f}", f"{row['milliseconds_added']:.2f}")
            for name, row in result["isolation"].items()
            if isinstance(row, dict)
        ],
    )
    started = f"A process starts in {result['isolation']['seconds_to_start_a_process']:.1f} s."
    return [rows, many, answers, started]


def _size(measured: dict[str, float], name: str) -> tuple[str, str, str]:
    return f"{measured[name]:,}", f"{measured['seconds']:.1f}", f"{measured['bytes'] / 1e6:.0f}"


def text() -> str:
    return page(
        "Speed and memory",
        "Ratios are medians over turns, with the range of all turns in brackets; contestants take turns in one run, as "
        "the speed of a shared machine drifts. The machine and the versions stand in the files.",
        "## The simulator",
        *simulator(),
        "## follow-mixture",
        *mixture(),
        "## The evaluator",
        *engine(),
        "## Raw results and commands",
        source(["speed.json", "follow_mixture_speed.json", "engine_speed.json"]),
    )

"""Write every published table from the committed rows: in docs and README.md.

    python benchmarks/tables.py            # write the tables that differ
    python benchmarks/tables.py --check    # write nothing; exit with 1 and name the files that differ

A table stands between the lines ``<!-- results:begin NAME -->`` and ``<!-- results:end -->``; all other text is written
by hand and stays. README.md has one block, without a name. Every table of rows is made by :func:`pivot.pivot`.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from functools import cache
from operator import attrgetter
from pathlib import Path

import evasion
import hacks
import leaks
import live
import numpy as np
import observers
import pandas as pd
import paper_tables
import peers
import probing
import probing_learners
import protocol
import reader
import reader_links
import recordings
import scenarios
import track_links
from paper.shared import RESULTS, ROOT, make_parser, read_rows
from pivot import CellFormatter, across, fold, markdown, mean, mean_by_recording, median, pivot, rate, share, size

from usnet_env.evaluation import list_suites
from usnet_env.files import write_text
from usnet_env.swarm.open_follow import OPEN_LAWS
from usnet_env.swarm.second_follow import SECOND_LAWS

DETECTOR = {"detector": "detector"}  # lines of a table
BLOCK = re.compile(r"(<!-- results:begin ?([\w-]*) -->)\n.*?<!-- results:end -->", re.DOTALL)
PAGES = (
    "README.md",
    "docs/suites.md",
    "docs/environments.md",
    "docs/live.md",
    "docs/probing.md",
    "docs/multiagent.md",
    *(f"docs/results/{name}.md" for name in ("paper", "reader", "tracks", "speed")),
)
SUITES = {  # those of README.md
    "field-v3": "field models, kinematics, disturbances; heads follow unseen UAVs",
    "limit-v2": "near the limit of what a window shows; heads follow unseen UAVs",
    "open": "laws drawn after the training; heads follow unseen UAVs",
    "open-second": "laws of a second grammar, drawn likewise; heads follow unseen UAVs",
    "paper-hard": "the paper's problems, in which heads don't stand out",
    "paper": "the game of the paper; in 11 of 12 cells one track alone shows a head",
}
SOLVED = ("field-v2", "limit", "controls-v2", "sensing-v2")
BEST = 8  # detectors of a table of cells
#: The detectors of a table of kinds of laws: the best ones, then controls that can't know who follows.
OF_LAWS = ("reader(policy='map')", "reader", "lagged-network", "reader(weights='blind')", "reader(weights='untrained')")
READER, BLIND = "reader(policy='map')", "reader(weights='blind')"
RECORDED = {  # the recordings of README.md
    "ants": "ants: tandem runs",
    "cars": "cars: platoons of five",
    "Rs": "termites: *R. speratus*",
    "Cf": "termites: *C. formosanus*",
    "platoons": "cars on a test track",
    "platoons-unseen": "the same, the first car without a track",
}
#: What a detector is, for the heat map; the others are baselines.
ABOUT = {"reader": "learned", "gassl": "the paper", "mc-gassl": "the paper"}
ABOUT |= dict.fromkeys(("central-most", "track-outlier"), "blind")
ABOUT |= dict.fromkeys(("none", "random", "destroy-all"), "trivial")


def suite_file(name: str) -> Path:
    """The file of the rows of a suite, which may not exist yet."""
    return RESULTS / "suites" / f"{name}-v{list_suites()[name].version}.csv.gz"


@cache
def read_suite(name: str) -> pd.DataFrame:
    """The rows of a suite; an episode in which a detector failed isn't exact, and has no other metric.

    The detectors that are exact most often come first.
    """
    rows = read_rows(suite_file(name))
    rows["exact"] = rows["exact"].fillna(0)
    best = rows.groupby("detector").exact.mean().sort_values(ascending=False, kind="stable").index
    return rows.sort_values("detector", key=lambda names: names.map(list(best).index), kind="stable")


def _group(name: str) -> str:
    """The column that names what was drawn for the rows of a suite, the unit of its intervals."""
    return "cell" if list_suites()[name].unit == "cell" else "episode"


def suite_block(name: str) -> str:
    """A line for each detector, over all cells; a line for each cell, or for each kind of law."""
    if not suite_file(name).exists():
        return "This version has no rows yet."
    rows, suite, group = read_suite(name), list_suites()[name], _group(name)
    columns: dict[str, CellFormatter] = {"n": size, "exact": rate("exact", group=group)}
    columns |= {"F1 in round 1": mean("f1_first", group=group), "J": mean("J", group=group)}
    parts = [pivot(rows, DETECTOR, {**columns, "seconds": median("seconds_per_round")})]
    counts = rows.groupby("detector", sort=False).episode.max() + 1
    few = [f"`{label}` {count}" for label, count in counts.items() if count < suite.episodes]
    if few:
        parts.append(f"Slow detectors played only the first of the {suite.episodes} episodes: {', '.join(few)}.")
    order = list(suite.cells)
    rows = rows.sort_values("cell", key=lambda cells: cells.map(order.index), kind="stable")
    if group == "cell":
        return "\n\n".join([*parts, *_compare_laws(name, rows)])
    percent = across("detector", counts.index[:BEST], lambda part: f"{100 * part.exact.mean():.0f}", "`{}`")
    title = f"Exact in percent, cell by cell, of the first {BEST} lines"
    return "\n\n".join([*parts, f"{title}:", pivot(rows, {"cell": "cell"}, percent | leaks.format_controls(name))])


def _compare_laws(suite: str, rows: pd.DataFrame) -> list[str]:
    """Tables of how followers answer, how they hear their head, how the answer is bent, and what the controls see."""
    columns: dict[str, CellFormatter] = {"laws": lambda part: str(part["cell"].nunique())}
    columns |= across("detector", OF_LAWS, rate("exact", group="cell"), "`{}`")
    kinds = {"the answer": "answers", "the head is heard": "hears", "the answer is bent": "bends"}
    laws = rows["cell"].map({**OPEN_LAWS, **SECOND_LAWS})
    rows = rows.assign(**{kind: laws.map(attrgetter(kind)) for kind in kinds.values()})
    controls = leaks.read_controls(suite).groupby("cell")
    given_away = {cell: "yes" if leaks.find_leaks(part) else "no" for cell, part in controls}
    kinds["given away by a control"] = "given_away"
    rows = rows.assign(given_away=rows["cell"].map(given_away))
    return [pivot(rows, {title: kind}, columns) for title, kind in kinds.items()]


def scale_block() -> str:
    """A line for each detector, and what it does in each cell of the suite ``scale``; a line for each cell."""

    def format_cell(rows: pd.DataFrame) -> str:
        return f"{median('f1_first', '.2f')(rows)}; {median('seconds_per_round')(rows)} s".replace("–; – s", "–")

    lines = pivot(read_suite("scale"), DETECTOR, across("cell", list_suites()["scale"].cells, format_cell))
    return f"{lines}\n\n{pivot(leaks.read_controls('scale'), {'cell': 'cell'}, leaks.CONTROLS)}"


def readme_block() -> str:
    """The tables of README.md: suites and recorded tracks."""
    body = []
    for name in (name for name in SUITES if suite_file(name).exists()):
        rows, suite, best = read_suite(name), list_suites()[name], rate("exact", group=_group(name))
        others = rows[~rows.detector.str.startswith("reader")]
        other, blind = others[others.detector == others.detector.iloc[0]], rows[rows.detector == BLIND]
        shares = [best(rows[rows.detector == READER]), f"`{other.detector.iloc[0]}` {100 * other.exact.mean():.1f} %"]
        about = [f"`{name}`", SUITES[name], f"{len(suite.cells)} × {suite.episodes}"]
        body.append([*about, *shares, f"{100 * blind.exact.mean():.1f} %" if len(blind) else "–"])
    heads = "suite", "swarms", "cells × episodes", f"`{READER}`", "best of all others", "blind twin"
    return "\n\n".join(
        [
            "In a [frozen suite](docs/suites.md) all detectors meet the same swarms, without the number of clusters. "
            "*Exact*: round 1 names all heads and no other UAV. The *blind twin* is the same network, trained on "
            "windows of the same prior, though fewer, without any feature of a pair of UAVs.",
            markdown(heads, body),
            "**Recorded tracks**: how many of the leaders each detector names, and how many of the ids that it names "
            "are leaders, in all windows together. [Sources, intervals, more detectors](docs/results/tracks.md).",
            recorded_block(),
        ]
    )


def recorded_block() -> str:
    """A line for each set of recordings: leaders that are named, and named ids that lead, of some detectors."""
    known, new = read_rows(RESULTS / "tracks.csv.gz"), read_rows(recordings.ROWS)
    new = new[~new.detector.str.startswith("reader") | (new.weights == recordings.hash_weights())]
    parts = known[known.chosen == 1].rename(columns={"named_heads": "named_right"}), new
    rows = pd.concat([part.assign(unseen=unseen) for part, unseen in zip(parts, ("no", "yes"), strict=True)])

    def format_cell(part: pd.DataFrame) -> str:
        sums = part[["named_right", "heads", "named"]].sum()
        return f"{sums.named_right / sums.heads:.2f}; {sums.named_right / max(sums.named, 1):.2f}" if len(part) else "–"

    names = (READER, "front-most", "mflica", "lagged-network", "random")
    columns: dict[str, CellFormatter] = {"windows": lambda part: str(part[part.detector == READER].shape[0])}
    columns |= across("detector", names, format_cell, "`{}`")
    lines = {"recordings": "set", "unseen when the weights were chosen": "unseen"}
    return pivot(rows.replace({"set": RECORDED}), lines, columns)


def ladder_block() -> str:
    """A line for each game of the ladder: J of some detectors, and the share of exact episodes of the last one."""
    rows, order = read_suite("ladder"), list(list_suites()["ladder"].cells)
    rows = rows.sort_values("cell", key=lambda cells: cells.map(order.index), kind="stable")
    names = ("none", "random", "destroy-all", "central-most", "track-outlier", "reader(weights='untrained')")
    names += ("reader(policy='map')",)
    columns = across("detector", names, mean("J"), "`{}`: J") | across("detector", names[-1:], rate("exact"), "exact")
    columns = {"n": lambda part: str(part.episode.nunique()), **columns, **leaks.format_controls("ladder")}
    return pivot(rows, {"game": "cell"}, columns)


def tracks_block() -> str:
    """A table for each set of recordings, whose steps were chosen; a recording is one value of a mean."""
    rows, parts = read_rows(RESULTS / "tracks.csv.gz"), []
    titles = {
        "ants": "Ants: tandem runs, a leader and a follower",
        "cars": "Cars: platoons of five, each after the next",
    }
    columns: dict[str, CellFormatter] = {
        "windows; recordings": lambda part: f"{len(part)}; {part.recording.nunique()}",
        "leader has the highest score": mean_by_recording("group_leader"),
        "named": mean_by_recording("named"),
        "of them right": share("named_heads", "named", 0),
        "confirmed": mean_by_recording("confirmed"),
        "of these right": share("confirmed_heads", "confirmed", 0),
        "seconds": median("seconds"),
    }
    for name, part in rows[rows.chosen == 1].groupby("set", sort=False):
        steps = f"{part.step.min():g} to {part.step.max():g} s, chosen from each file"
        parts.append(fold(f"{titles[name]}; step {steps}", pivot(part, DETECTOR, columns)))
    return "\n\n".join(parts)


def compare_block() -> str:
    """A line for each detector in the scenarios; the reader's rows, of more files, have a file of their own."""
    files = RESULTS / "reader/scenarios.csv.gz", RESULTS / "scenarios.csv.gz"
    return scenarios.summarise(pd.concat([read_rows(path) for path in files]))


def speed_block() -> str:
    """Rates and ratios of the parts that speed.py has measured."""
    parts, ratio = json.loads((RESULTS / "speed.json").read_text(encoding="utf-8")), "median (range of the turns)"
    flights = [
        [name, str(len(row["ratios"])), f"{row['uav_steps_per_second'] / 1e6:.1f}", format_range(row["ratios"])]
        for part in ("stepping", "field", "kinematics")
        for name, row in parts[part].items()
    ]
    games = [
        [name, f"{row['decisions_per_second']:,.0f}", row["what"], format_range(row["ratios"])]
        for name, row in parts["batches"].items()
    ]
    steps = [
        [name, *(f"{1e9 * each:.0f}" for each in row["seconds_per_uav_step"])] for name, row in parts["scaling"].items()
    ]
    detectors = [[f"`{name}`", row["what"], format_range(row["ratios"])] for name, row in parts["detectors"].items()]
    threads = [
        [re.sub("^(.*),", r"`\1`,", name), f"{loads['alone']['seconds']:.2g}"]
        + [format_range(row["ratios"]) for row in loads.values()]
        for name, loads in parts["threads"].items()
    ]
    peers = [
        [
            name,
            *(f"{row[f'{unit}_per_second'] / 1000:,.0f}" for unit in ("decisions", "steps")),
            format_range(row["ratios"]),
        ]
        for name, row in parts["peers"].items()
    ]
    uavs = next(iter(parts["scaling"].values()))["uavs"]
    return "\n\n".join(
        [
            markdown(("flight", "turns", "million UAV steps a second", "stepping over drawing normals"), flights),
            markdown(("games", "decisions a second", "ratio", ratio), games),
            markdown(
                (
                    "256 games of several agents",
                    "1,000 decisions a second",
                    "1,000 steps of a UAV or agent a second",
                    "decisions over those of usnet_evasion_v0",
                ),
                peers,
            ),
            markdown(("ns of a UAV step", *(f"N = {count:,}" for count in uavs)), steps),
            markdown(("detector", "ratio", ratio), detectors),
            "Seconds with threads as they come over seconds with one thread:",
            markdown(("detector", "seconds, one thread", "alone", "beside two busy loops"), threads),
            f"1,000 swarms of 82 UAVs take {parts['memory']['bytes'] / 2**30:.2f} GiB.",
        ]
    )


def format_range(ratios: list[float]) -> str:
    """The median of the turns, and their range."""
    return f"{np.median(ratios):.3g} ({min(ratios):.3g}–{max(ratios):.3g})"


def _report(name: str, report: Callable[[pd.DataFrame], str]) -> Callable[[], str]:
    return lambda: report(read_rows(RESULTS / "reader" / f"{name}.csv.gz"))


BLOCKS: dict[str, Callable[[], str]] = {
    "": readme_block,
    **{f"suite-{name}": lambda name=name: suite_block(name) for name in (*SUITES, *SOLVED)},
    "suite-scale": scale_block,
    "ladder": ladder_block,
    "scenarios": _report("scenarios", scenarios.report),
    "scenarios-compared": compare_block,
    "calibration": _report("calibration", reader.report),
    "links": _report("links", reader_links.report),
    "peers": _report("peers", peers.report),
    **{
        module.__name__.replace("_", "-"): lambda module=module: module.report(read_rows(module.ROWS))
        for module in (
            evasion,
            hacks,
            leaks,
            live,
            observers,
            probing,
            probing_learners,
            protocol,
            recordings,
            track_links,
        )
    },
    "algorithms": paper_tables.paper_algorithms,
    "table2": paper_tables.table2_block,
    "learning": paper_tables.learning_block,
    "rounds": paper_tables.rounds_block,
    "purity": paper_tables.purity_block,
    "tracks": tracks_block,
    "recorded": recorded_block,
    "speed": speed_block,
}


def fill(text: str) -> str:
    """A page with its blocks replaced; a KeyError names a block that is unknown."""
    return BLOCK.sub(lambda block: f"{block[1]}\n\n{BLOCKS[block[2]]()}\n\n<!-- results:end -->", text)


def main(argv: list[str] | None = None, root: Path = ROOT) -> int:
    parser = make_parser(__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if a table differs")
    check, differ = parser.parse_args(argv).check, False
    for name in PAGES:
        old = (root / name).read_text(encoding="utf-8")
        if (new := fill(old)) == old:
            continue
        differ = True
        if check:
            print(f"{name} differs from the rows: run python benchmarks/tables.py", file=sys.stderr)
        else:
            write_text(root / name, new)
    return int(check and differ)


if __name__ == "__main__":
    sys.exit(main())

"""Recorded tracks with known leaders: which ids detectors name, and which of them the test of leaders confirms.

    python examples/fetch_tracks.py ants cars --out data
    OMP_NUM_THREADS=1 python benchmarks/tracks.py data       # writes benchmarks/results/tracks.csv.gz

Each recording is cut into windows of 100 steps, of which at most 12 are used, once with the step that is chosen from
the file and once with 0.5 s. Windows in which no id moves are left out, as nothing in them tells who leads. A row is
one detector's answer to one window, compared with the leaders of the file.
"""

from __future__ import annotations

from pathlib import Path
from time import process_time
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
from paper.shared import RESULTS, parse, write_rows

from usnet_env import make_detector
from usnet_env.objectives import find_roots, group_leader_accuracy
from usnet_env.plugins import detector_label
from usnet_env.tracks import Tracks, read_tracks
from usnet_env.tracks.answers import answer_window
from usnet_env.tracks.confirm import confirm_leaders

LENGTH, MOST, STEP = 100, 12, 0.5
DETECTORS = (
    "random", "front-most", "directional-delays", "lagged-network", "net-lag-regression", "transfer-entropy", "mflica",
    "flica", "lagged-correlation", "lagged-regression", "granger", "factions", "reader",
    "reader(policy='map')",
)  # fmt: skip


def score(even: Tracks, cut: Any, name: str, seed: int) -> dict[str, Any]:
    """Answer one window, and compare the answer with the file's leaders."""
    detector, window = make_detector(name), cut.window
    start = process_time()
    answer, finest = answer_window(detector, even, cut, seed)
    seconds = process_time() - start
    everyone = np.arange(window.uavs)
    roots = find_roots(cut.leader)
    head = np.isin(everyone, roots[roots != everyone])
    named = np.flatnonzero(answer.candidates)
    found = answer.leader if answer.leader is not None else np.full(window.uavs, -1)
    groups = [np.flatnonzero((find_roots(found) == i) & (everyone != i)).tolist() for i in named]
    sure, _ = confirm_leaders(window, named, groups, finest.window)
    return {
        "uavs": window.uavs,
        "heads": int(head.sum()),
        "group_leader": group_leader_accuracy(cut.leader, answer.scores),
        "named": len(named),
        "named_heads": int(head[named].sum()),
        "confirmed": int(sure.sum()),
        "confirmed_heads": int(head[named[sure]].sum()),
        "seconds": seconds,
    }


def play(path: Path, given: float | None, detectors: list[str]) -> list[dict[str, Any]]:
    """All rows of one recording with one step; ``None``: the step that is chosen from the file."""
    even = read_tracks(path).resample(given)
    cuts, rows = [cut for cut in even.windows(LENGTH) if cut.window.velocity.any()], []
    for k in np.unique(np.linspace(0, len(cuts) - 1, min(MOST, len(cuts))).astype(int)) if cuts else ():
        about = {"set": path.parent.name, "recording": path.stem, "chosen": int(given is None)}
        about |= {"step": even.step, "window": int(k)}
        seed = crc32(f"{path.stem} {given} {k}".encode())
        rows += [{**about, "detector": detector_label(name), **score(even, cuts[k], name, seed)} for name in detectors]
    return rows


def main(argv: list[str] | None = None) -> None:
    parser = parse(__doc__)
    parser.add_argument("folder", type=Path, help="holds a folder of CSV files for each set")
    parser.add_argument("--rows", type=Path, default=RESULTS / "tracks.csv.gz")
    parser.add_argument("--detector", action="append", help="may repeat; by default all of the table")
    given = parser.parse_args(argv)
    rows = []
    for path in sorted(given.folder.glob("*/*.csv")):
        for step in (None, STEP):
            rows += play(path, step, given.detector or list(DETECTORS))
        print(path, f"{len(rows)} rows", flush=True)
    write_rows(given.rows, pd.DataFrame(rows).round(4))


if __name__ == "__main__":
    main()

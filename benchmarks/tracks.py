"""Recorded tracks with known leaders: which ids detectors name, and which of them the test of leaders confirms.

    python examples/fetch_tracks.py ants cars --out data
    OMP_NUM_THREADS=1 python benchmarks/tracks.py data       # writes benchmarks/results/tracks.csv.gz

Each recording is cut into windows of 100 steps, of which at most 12 are used, once with the step that is chosen from
the file and once with 0.5 s. Windows in which no id moves are left out, as nothing in them tells who leads. A row is
one detector's answer to one window, compared with the leaders of the file.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from time import process_time
from typing import Any
from zlib import crc32

import numpy as np
from paper.shared import RESULTS, Game, cached, make_parser, run_missing

from usnet_env import make_detector
from usnet_env.objectives import find_roots, group_leader_accuracy
from usnet_env.plugins import detector_label
from usnet_env.tracks import Tracks, read_tracks
from usnet_env.tracks.confirm import confirm_leaders
from usnet_env.tracks.leaders import answer_window

LENGTH, MAX_WINDOWS, STEP = 100, 12, 0.5
DETECTORS = (
    "random", "front-most", "directional-delays", "lagged-network", "net-lag-regression", "transfer-entropy", "mflica",
    "flica", "lagged-correlation", "lagged-regression", "granger", "factions", "reader",
    "reader(policy='map')",
)  # fmt: skip


def score(tracks: Tracks, section: Any, name: str, seed: int) -> dict[str, Any]:
    """Answer one window, and compare the answer with the file's leaders."""
    detector, window = make_detector(name), section.window
    start = process_time()
    answer, finest = answer_window(detector, tracks, section, seed)
    seconds = process_time() - start
    everyone = np.arange(window.uavs)
    roots = find_roots(section.leader)
    head = np.isin(everyone, roots[roots != everyone])
    named = np.flatnonzero(answer.candidates)
    leader = answer.leader if answer.leader is not None else np.full(window.uavs, -1)
    groups = [np.flatnonzero((find_roots(leader) == i) & (everyone != i)).tolist() for i in named]
    is_confirmed, _ = confirm_leaders(window, named, groups, finest.window)
    return {
        "uavs": window.uavs,
        "heads": int(head.sum()),
        "group_leader": group_leader_accuracy(section.leader, answer.scores),
        "named": len(named),
        "named_heads": int(head[named].sum()),
        "confirmed": int(is_confirmed.sum()),
        "confirmed_heads": int(head[named[is_confirmed]].sum()),
        "seconds": seconds,
    }


def play(game: Game, folder: Path) -> list[dict[str, Any]]:
    """All rows of a detector in one recording with one step, chosen from the file or :data:`STEP`."""
    step = None if game["chosen"] else STEP
    tracks = cached(read_resampled, folder / game["set"] / f"{game['recording']}.csv", step)
    sections = [section for section in tracks.windows(LENGTH) if section.window.velocity.any()]
    count, rows = min(MAX_WINDOWS, len(sections)), []
    for k in np.unique(np.linspace(0, len(sections) - 1, count).astype(int)).tolist():
        seed = crc32(f"{game['recording']} {step} {k}".encode())
        rows.append({**game, "step": tracks.step, "window": k, **score(tracks, sections[k], game["detector"], seed)})
    return rows


def read_resampled(path: Path, step: float | None) -> Tracks:
    """A recording with equal steps."""
    return read_tracks(path).resample(step)


def main(argv: list[str] | None = None) -> None:
    parser = make_parser(__doc__, RESULTS / "tracks.csv.gz")
    parser.add_argument("folder", type=Path, help="holds a folder of CSV files for each set")
    parser.add_argument("--detector", nargs="+", default=list(DETECTORS))
    options = parser.parse_args(argv)
    games = [
        {"set": path.parent.name, "recording": path.stem, "chosen": chosen, "detector": detector_label(name)}
        for path in sorted(options.folder.glob("*/*.csv"))
        for chosen in (1, 0)
        for name in options.detector
    ]
    run_missing(options, games, partial(play, folder=options.folder))


if __name__ == "__main__":
    main()

"""Score detectors on recorded tracks with known leaders, by window.

    python examples/fetch_tracks.py ants cars --out data
    python benchmarks/real_tracks.py data           # writes benchmarks/results/real_tracks.csv

Each file is resampled with the step that is chosen from it, and again with 0.5 s, and cut into windows of 100 steps, of
which at most 12, evenly spread, are used. The groups are known to the score only.
"""

from __future__ import annotations

import time
from pathlib import Path
from zlib import crc32

import numpy as np
from running import make_parser, write_csv

from usnet_env import make_detector
from usnet_env.detection import fit_window
from usnet_env.objectives import find_roots, group_leader_accuracy, leader_accuracy
from usnet_env.plugins import detector_label
from usnet_env.tracks import read_tracks
from usnet_env.tracks.confirm import confirm_leaders

LENGTH, MOST, STEP = 100, 12, 0.5
DETECTORS = (
    "random",
    "front-most",
    "directional-delays",
    "lagged-network",
    "net-lag-regression",
    "transfer-entropy",
    "mflica",
    "flica",
    "lagged-correlation",
    "lagged-regression",
    "granger",
    "factions",
    "follow-mixture",
    "follow-mixture(policy='map')",
    "learned",
    "learned(policy='map')",
)


def score(cut, name: str, seed: int) -> dict:
    """Answer one window, and compare the answer with the file's leaders."""
    detector, window = make_detector(name), cut.window
    detector.reset(seed)
    begun = time.perf_counter()
    answer = detector.detect(fit_window(detector, window))
    seconds = time.perf_counter() - begun
    roots = find_roots(cut.leader)
    head = np.isin(np.arange(window.uavs), roots[roots != np.arange(window.uavs)])
    named = np.flatnonzero(answer.candidates)
    found = answer.leader if answer.leader is not None else np.full(window.uavs, -1)
    led = [np.flatnonzero((find_roots(found) == i) & (np.arange(window.uavs) != i)).tolist() for i in named]
    sure, _ = confirm_leaders(window, named, led)
    return {
        "uavs": window.uavs,
        "heads": int(head.sum()),
        "group_leader": round(group_leader_accuracy(cut.leader, answer.scores), 4),
        "named": len(named),
        "named_heads": int(head[named].sum()),
        "confirmed": int(sure.sum()),
        "confirmed_heads": int(head[named[sure]].sum()),
        "direct": round(leader_accuracy(cut.leader, found), 4),
        "seconds": round(seconds, 4),
    }


def main() -> None:
    parser = make_parser(__doc__)
    parser.add_argument("folder", type=Path, help="holds a folder of CSV files for each set")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/real_tracks.csv"))
    parser.add_argument("--detector", action="append", help="default: all of them")
    arguments = parser.parse_args()
    rows = []
    for path in sorted(arguments.folder.glob("*/*.csv")):
        tracks = read_tracks(path)
        for given in (None, STEP):
            even = tracks.resample(given)
            cuts = list(even.windows(LENGTH))
            used = np.unique(np.linspace(0, len(cuts) - 1, min(MOST, len(cuts))).astype(int)) if cuts else []
            print(path, f"step {even.step:g} s, {len(used)} of {len(cuts)} windows", flush=True)
            for k in used:
                about = {
                    "set": path.parent.name,
                    "recording": path.stem,
                    "chosen": int(given is None),
                    "step": round(float(even.step), 4),
                    "window": int(k),
                }
                seed = crc32(f"{path.stem} {given} {k}".encode())
                for name in arguments.detector or DETECTORS:
                    rows.append({**about, "detector": detector_label(name), **score(cuts[k], name, seed)})
    write_csv(arguments.out, rows)


if __name__ == "__main__":
    main()

"""Read a CSV of 200 MB with 2,000 ids whose groups change, and find the leaders in it: seconds, memory, right heads.

    python benchmarks/tracks_speed.py --seed 1    # writes this seed's run to benchmarks/results/tracks_speed.json

The swarm has 100 groups. Every 650 steps a tenth of the followers change their group, ten heads join other groups with
all their followers, and ten followers of large groups become heads. A tenth of the ids that never lead come later or
leave earlier. A head is counted in a window if it leads at least three ids that are seen in half of the window's steps,
through four fifths of the window. A window is right if the detector names all these heads, and no id that leads no
other id in the window. The test of confirmed leaders was developed on the seeds 0 to 3 and 100 to
106; the seeds 10 to 13 were played after that.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from running import make_parser
from speed_helpers import write_json

from usnet_env.provenance import machine, versions

STEP, SPEED, LENGTH = 0.5, 4.0, 200
IDS, GROUPS, STEPS, EPOCH = 2000, 100, 3150, 650


def plan(rng: np.random.Generator, ids: int, groups: int, epochs: int) -> np.ndarray:
    """``(epochs, ids)`` index of each id's leader, -1 for heads."""
    leader = np.append(np.full(groups, -1), rng.integers(0, groups, ids - groups))
    plans = [leader]
    for _ in range(epochs - 1):
        leader = leader.copy()
        heads = np.flatnonzero(leader < 0)
        movers = rng.choice(np.flatnonzero(leader >= 0), ids // 10, replace=False)
        leader[movers] = rng.choice(heads, len(movers))
        joining = rng.choice(heads, groups // 10, replace=False)
        staying = np.setdiff1d(heads, joining)
        for head in joining:
            into = rng.choice(staying)
            leader[leader == head] = into
            leader[head] = into
        for head in rng.choice(np.flatnonzero(leader >= 0), groups // 10, replace=False):
            followers = np.flatnonzero(leader == leader[head])
            leader[head] = -1
            leader[rng.choice(followers[followers != head], min(10, len(followers) - 1), replace=False)] = head
        plans.append(leader)
    return np.stack(plans)


def write_file(path: Path, seed: int, ids: int, groups: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Write the CSV, sorted by time; returns leaders ``(steps, ids)`` and whether each id is seen ``(steps, ids)``."""
    rng = np.random.default_rng(seed)
    leaders = np.repeat(plan(rng, ids, groups, -(-steps // EPOCH)), EPOCH, axis=0)[:steps]
    never = (leaders >= 0).all(axis=0)  # an id that isn't seen can't be named
    begin = np.where(never & (rng.random(ids) < 0.05), rng.integers(0, steps // 2, ids), 0)
    end = np.where(never & (rng.random(ids) < 0.05), rng.integers(steps // 2, steps, ids), steps)
    delay = rng.integers(1, 4, ids)
    past = np.zeros((4, ids, 2))
    place = rng.uniform(-2000, 2000, (ids, 2))
    heading, rate = rng.uniform(0, 2 * np.pi, ids), np.zeros(ids)
    with path.open("w", encoding="ascii") as file:
        file.write("id,t,x,y\n")
        for t in range(steps):
            rate = 0.9 * rate + rng.normal(0, 0.2, ids)
            heading = heading + rate
            own = SPEED * np.stack([np.cos(heading), np.sin(heading)], axis=1)
            led = leaders[t] >= 0
            copied = past[delay, leaders[t]] + rng.normal(0, 0.5, (ids, 2))
            velocity = np.where(led[:, None], copied, own)
            past = np.concatenate([past[:1], velocity[None], past[1:-1]])
            place = place + velocity * STEP
            seen = np.flatnonzero((begin <= t) & (t < end))
            when = f"{t * STEP:.1f}"
            file.write(
                "".join(f"uav-{i:04d},{when},{x:.3f},{y:.3f}\n" for i, (x, y) in zip(seen, place[seen], strict=True))
            )
    at = np.arange(steps)[:, None]
    return leaders, (begin <= at) & (at < end)


def count_right(found: dict, leaders: np.ndarray, seen: np.ndarray) -> dict[str, float]:
    """Windows in which all heads and no others are named, and precision and recall of heads over all windows."""
    right, named_right, named_all, heads_all, heads_found = 0, 0, 0, 0, 0
    for window in found["windows"]:
        first = round(window["start"] / STEP)
        led, there = leaders[first : first + LENGTH], seen[first : first + LENGTH]
        present = there.sum(axis=0) > LENGTH / 2
        share = np.zeros((3, IDS))  # steps in which each id leads at least 1, 2 and 3 ids that are seen
        for now in led:
            count = np.bincount(now[(now >= 0) & present], minlength=IDS)
            share += np.stack([count >= 1, count >= 2, count >= 3])
        heads = set(np.flatnonzero((share[2] >= 0.8 * LENGTH) & present).tolist())
        possible = set(np.flatnonzero(share[0]).tolist())
        named = {int(leader["id"][4:]) for leader in window["leaders"]}
        right += heads <= named <= possible
        heads_all, heads_found = heads_all + len(heads), heads_found + len(heads & named)
        named_all, named_right = named_all + len(named), named_right + len(named & possible)
    return {
        "windows": len(found["windows"]),
        "right_windows": right / len(found["windows"]),
        "heads_named": heads_found / heads_all,
        "named_are_heads": named_right / max(named_all, 1),
    }


def detect(path: Path, detector: str, folder: Path) -> tuple[dict, dict[str, float]]:
    """Run ``usnet detect`` in a process; returns its JSON, seconds and the most memory."""
    words = ["detect", str(path), "--detector", detector, "--window", str(LENGTH), "--step", str(STEP), "--json"]
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    with (folder / "found.json").open("w") as out:
        subprocess.run([sys.executable, "-m", "usnet_env", *words], stdout=out, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    figures = {
        "seconds": time.perf_counter() - begun,
        "cpu_seconds": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        "peak_mib": after.ru_maxrss / 1024,
    }
    return json.loads((folder / "found.json").read_text()), figures


def main() -> None:
    parser = make_parser(__doc__)
    parser.add_argument("--out", default="benchmarks/results/tracks_speed.json")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--detector", action="append", help="default: net-lag-regression")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        path = folder / "tracks.csv"
        leaders, seen = write_file(path, arguments.seed, IDS, GROUPS, STEPS)
        result = {
            "file": {"bytes": path.stat().st_size, "rows": int(seen.sum()), "ids": IDS},
            "detect": {},
            "machine": machine(),
            "versions": versions(),
        }
        for detector in arguments.detector or ["net-lag-regression"]:
            found, figures = detect(path, detector, folder)
            result["detect"][detector] = {**figures, **count_right(found, leaders, seen)}
            print(detector, result["detect"][detector], flush=True)
    out = Path(arguments.out)
    runs = json.loads(out.read_text(encoding="utf-8"))["runs"] if out.exists() else {}
    whole = {"what": __doc__.splitlines()[0], "window": LENGTH, "runs": {**runs, str(arguments.seed): result}}
    write_json(out, whole)


if __name__ == "__main__":
    main()

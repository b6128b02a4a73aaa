"""Measure time, size and memory of writing a recording of 1,000 UAVs and 10 rounds.

    python benchmarks/replay_speed.py

The result is in ``benchmarks/results/replay_speed.json``.
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path

import gymnasium as gym
import rerun  # noqa: F401  # its import is not measured
from running import RESULTS, answer_help
from speed_helpers import write_json

import usnet_env.envs  # noqa: F401  # registers the environments
from usnet_env import make_detector
from usnet_env.provenance import versions
from usnet_env.replay import record_episode, write_recording

UAVS, CLUSTERS, ROUNDS = 1_000, 20, 10
TARGET = RESULTS / "replay_speed.json"


def read_memory(kind: str) -> float:
    """Resident memory of this process in megabytes: ``VmRSS``, the present one, or ``VmHWM``, the peak."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(kind)) * 1024 / 1e6


def main() -> None:
    env = gym.make("USNET/MultiCluster-v0", clusters=CLUSTERS, uavs=UAVS, follow="f3", max_rounds=ROUNDS)
    record = record_episode(env, make_detector("random"), seed=0, detector_seed=1)
    before = read_memory("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here on
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        path = write_recording(record, Path(folder) / "replay.rrd")
        seconds, size = time.perf_counter() - began, path.stat().st_size
    result = {
        "uavs": UAVS,
        "rounds": record.rounds,
        "seconds": round(seconds, 2),
        "file_MB": round(size / 1e6, 1),
        "memory_beyond_the_game_MB": round(read_memory("VmHWM") - before, 1),
        "versions": versions(["rerun-sdk"]),
    }
    write_json(TARGET, result)
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    answer_help(__doc__)
    main()

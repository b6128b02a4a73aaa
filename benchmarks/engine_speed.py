"""Speed and memory of the evaluator's store, of its summary, and of isolation.

    OMP_NUM_THREADS=1 python benchmarks/engine_speed.py     # writes benchmarks/results/engine_speed.json

``append``: milliseconds and bytes for a row, with few and with many rows in the file. ``episodes``: seconds and peak
memory of a process that evaluates episodes whose playing costs nothing. ``summary``: seconds and peak memory of a
process that reads the rows of a run and summarises them. ``isolation``: milliseconds of an answer of the detector
``none`` in its own process and in this one, in turns.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
from speed_helpers import ROOT, write_json

from usnet_env.evaluation.agents import as_agent
from usnet_env.evaluation.isolation import IsolatedAgent
from usnet_env.evaluation.metrics import METRICS
from usnet_env.evaluation.store import COLUMNS, RowFile
from usnet_env.plugins import make_detector
from usnet_env.processes import Limits
from usnet_env.provenance import machine, versions

OUT = Path(__file__).parent / "results" / "engine_speed.json"
PEAK = """
def peak():
    lines = open('/proc/self/status').read().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith('VmHWM'))
"""
SUMMARY = """
import json, sys, time
from pathlib import Path
from usnet_env.evaluation.result import summarise
from usnet_env.evaluation.store import COLUMNS
from usnet_env.evaluation.table import read_table
begun = time.perf_counter()
table = read_table(Path(sys.argv[1]), COLUMNS)
read = time.perf_counter() - begun
summary = summarise(table)
seconds = time.perf_counter() - begun
print(json.dumps({"rows": len(table), "seconds_reading": read, "seconds": seconds, "bytes": peak()}))
"""
EPISODES = """
import json, sys, time
from usnet_env import evaluate
from usnet_env.evaluation import METRICS, workers

def play_at_once(env, agent, label, episode, seeds):  # the episodes cost nothing, so that the engine is measured
    names = {"detector": label, "episode": episode, "swarm_seed": seeds[0], "detector_seed": seeds[1]}
    return names | {"uavs": 82, "heads": 5} | {name: episode % 2 for name in METRICS}

workers.play_episode = play_at_once
begun = time.perf_counter()
result = evaluate("USNET/MultiCluster-v0", "none", episodes=int(sys.argv[1]), out=sys.argv[2])
print(json.dumps({"episodes": len(result.rows), "seconds": time.perf_counter() - begun, "bytes": peak()}))
"""


def run(program: str, *arguments: object) -> dict[str, float]:
    """Run a program in a new process, and return what it prints."""
    command = [sys.executable, "-c", PEAK + program, *map(str, arguments)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout)


def made_up_rows(rows: int, detectors: int) -> list[dict[str, object]]:
    """Rows with random metrics; those of an integer column are small numbers."""
    rng = np.random.default_rng(0)
    values = rng.gamma(2.0, size=(rows, len(METRICS)))
    whole = {"rounds", "success", "exact"}
    return [
        {
            "detector": f"detector-{number % detectors}",
            "episode": number // detectors,
            "swarm_seed": number**3,
            "detector_seed": number,
            "uavs": 82,
            "heads": 5,
            **{
                name: int(value > 1) if name in whole else float(value)
                for name, value in zip(METRICS, values[number], strict=True)
            },
        }
        for number in range(rows)
    ]


def append(path: Path, sizes: tuple[int, ...]) -> dict[str, object]:
    """Cost of a row in files of several sizes."""
    rows = made_up_rows(1_000, 5)
    found: dict[str, object] = {}
    with RowFile(path, COLUMNS) as file:
        for size in sizes:
            while len(file.table) < size:
                file.append(rows)
            before, begun = path.stat().st_size, time.perf_counter()
            for row in rows:
                file.append([row])
            seconds = time.perf_counter() - begun
            found[f"{size}"] = {
                "milliseconds": 1e3 * seconds / len(rows),
                "bytes": (path.stat().st_size - before) / len(rows),
            }
    return found


def write_rows(path: Path, rows: int, detectors: int) -> None:
    """Write made-up rows in parts."""
    with RowFile(path, COLUMNS) as file:
        part = made_up_rows(50_000, detectors)
        for first in range(0, rows, len(part)):
            shift = first // detectors
            file.append({**row, "episode": row["episode"] + shift} for row in part)


def isolation(turns: int) -> dict[str, object]:
    """Wall milliseconds of an answer at N = 82, isolated (with and without limits) and in this process, in turns."""
    observation, _ = gym.make("USNET/MultiCluster-v0").reset(seed=0)
    agents = {
        "in process": as_agent(make_detector("none")),
        "isolated": IsolatedAgent("none", Limits()),
        "isolated, with limits": IsolatedAgent("none", Limits(seconds=60, megabytes=1000)),
    }
    for agent in agents.values():
        agent.reset(0)
        agent.answer(observation)
    taken = {name: [] for name in agents}
    for _ in range(turns):
        for name, agent in agents.items():
            begun = time.perf_counter()
            agent.answer(observation)
            taken[name].append(time.perf_counter() - begun)
    begun = time.perf_counter()
    IsolatedAgent("none", Limits()).start()
    found: dict[str, object] = {"turns": turns, "seconds_to_start_a_process": time.perf_counter() - begun}
    for name, seconds in taken.items():
        own = 1e3 * np.array(seconds)
        added = own - 1e3 * np.array(taken["in process"])
        found[name] = {
            "milliseconds": float(np.median(own)),
            "milliseconds_90_percent": float(np.quantile(own, 0.9)),
            "milliseconds_added": float(np.median(added)),
        }
    return found


def main() -> None:
    """Measure, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=1_000_000, help="of the summary")
    parser.add_argument("--episodes", type=int, default=200_000)
    parser.add_argument("--turns", type=int, default=500)
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    result: dict[str, object] = {"machine": machine(), "versions": versions()}
    with tempfile.TemporaryDirectory() as folder:
        result["isolation"] = isolation(arguments.turns)
        result["append"] = append(Path(folder) / "append.csv", (1_000, 10_000, 100_000))
        rows = Path(folder) / "rows.csv"
        write_rows(rows, arguments.rows, 5)
        result["summary"] = run(SUMMARY, rows)
        result["episodes"] = run(EPISODES, arguments.episodes, Path(folder) / "run")
    write_json(arguments.out, result)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()

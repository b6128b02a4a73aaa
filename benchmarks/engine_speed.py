"""Speed and memory of the evaluator: its store, its summary, isolation, its backends, and what the engine itself costs.

    OMP_NUM_THREADS=1 python benchmarks/engine_speed.py            # all parts but Ray's
    OMP_NUM_THREADS=1 RAY_worker_niceness=0 python benchmarks/engine_speed.py ray ray_computing    # needs Ray

The parts are merged into benchmarks/results/engine_speed.json. ``append``: milliseconds of CPU and bytes for a row,
with few and with many rows in the file. ``episodes``: seconds and peak memory of a process that evaluates episodes
whose playing costs nothing. ``summary``: seconds and peak memory of a process that reads the rows of a run and
summarises them. ``isolation``: milliseconds of an answer of the detector ``none`` in its own process and in this one,
in turns. ``engine``: what `evaluate` with a folder adds to a loop over the same episodes, whose detections take 10
ms; in turns. ``ray`` and ``ray_computing``: seconds of a run on one and on two nodes of one core, in turns, with a
detector that waits, and with one that computes, for half a second; tasks that cost nothing for each second.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from functools import partial
from pathlib import Path
from unittest.mock import patch

import gymnasium as gym
import numpy as np
from running import RESULTS, make_parser
from speed_helpers import alternate, run, write_json
from usnet_env.evaluation.episode import episode_seeds, play_episode
from usnet_env.evaluation.isolation import IsolatedAgent
from usnet_env.evaluation.metrics import METRICS
from usnet_env.evaluation.store import COLUMNS, RowFile, RunStore
from usnet_env.processes import Limits

from usnet_env import Detection, Window, evaluate
from usnet_env.evaluation.agents import as_agent
from usnet_env.evaluation.result import summarise
from usnet_env.provenance import machine, versions

SUMMARY = """
import json, sys, time
from pathlib import Path
from usnet_env.evaluation.result import summarise
from usnet_env.evaluation.store import COLUMNS
from usnet_env.evaluation.table import read_table
begun, used = time.perf_counter(), time.process_time()
table = read_table(Path(sys.argv[1]), COLUMNS)
read = time.perf_counter() - begun
summary = summarise(table)
seconds = time.perf_counter() - begun
print(json.dumps({"rows": len(table), "seconds_reading": read, "seconds": seconds,
                  "cpu_seconds": time.process_time() - used, "bytes": peak()}))
"""
EPISODES = """
import json, sys, time
from usnet_env import evaluate
from usnet_env.evaluation import METRICS, workers

def play_at_once(env, agent, label, episode, seeds):  # the episodes cost nothing, so that the engine is measured
    names = {"detector": label, "episode": episode, "swarm_seed": seeds[0], "detector_seed": seeds[1]}
    return names | {"uavs": 82, "heads": 5} | {name: episode % 2 for name in METRICS}

workers.play_episode = play_at_once
begun, used = time.perf_counter(), time.process_time()
result = evaluate("USNET/MultiCluster-v0", "none", episodes=int(sys.argv[1]), out=sys.argv[2])
print(json.dumps({"episodes": len(result.rows), "seconds": time.perf_counter() - begun,
                  "cpu_seconds": time.process_time() - used, "bytes": peak()}))
"""


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
            before, begun, used = path.stat().st_size, time.perf_counter(), time.process_time()
            for row in rows:
                file.append([row])
            seconds, cpu_seconds = time.perf_counter() - begun, time.process_time() - used
            found[f"{size}"] = {
                "milliseconds": 1e3 * cpu_seconds / len(rows),
                "wall_milliseconds": 1e3 * seconds / len(rows),
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
        "in process": as_agent("none"),
        "isolated": IsolatedAgent("none", Limits()),
        "isolated, with limits": IsolatedAgent("none", Limits(seconds=60, megabytes=1000)),
    }
    for agent in agents.values():
        agent.reset(0)
    taken = 1e3 * alternate(turns, *(partial(agent.answer, observation) for agent in agents.values())).T
    begun = time.perf_counter()
    IsolatedAgent("none", Limits()).start()
    found: dict[str, object] = {"turns": turns, "seconds_to_start_a_process": time.perf_counter() - begun}
    for name, own in zip(agents, taken, strict=True):
        found[name] = {
            "milliseconds": float(np.median(own)),
            "milliseconds_90_percent": float(np.quantile(own, 0.9)),
            "milliseconds_added": float(np.median(own - taken[0])),
        }
    return found


class Takes:
    """A detector that names all UAVs, so that an episode has one round, after a fixed time.

    Args:
        seconds: of an answer.
        computing: whether it computes for that time; else it waits.
    """

    def __init__(self, seconds: float = 0.01, computing: bool = False) -> None:
        self.seconds, self.computing = seconds, computing

    def reset(self, seed: int | None = None) -> None:
        """Start an episode."""

    def detect(self, window: Window) -> Detection:
        """Name all UAVs."""
        if self.computing:
            end = time.process_time() + self.seconds
            while time.process_time() < end:
                pass
        else:
            time.sleep(self.seconds)
        return Detection(window.alive, window.alive)


def engine(episodes: int, turns: int) -> dict[str, object]:
    """What the runner, the store and the summary add to a plain loop over episodes of one detection of 10 ms."""
    env = gym.make("USNET/MultiCluster-v0")
    taken: dict[str, list[float]] = {"loop": [], "evaluate": [], "summary": []}
    used: dict[str, list[float]] = {name: [] for name in taken}
    for turn in range(turns):
        for name in taken:
            begun, before = time.perf_counter(), time.process_time()
            if name == "loop":
                agent = as_agent(Takes())
                for episode in range(episodes):
                    play_episode(env, agent, "takes", episode, episode_seeds(turn, episode))
            elif name == "evaluate":
                with tempfile.TemporaryDirectory() as folder:
                    result = evaluate(env, Takes(), episodes=episodes, seed=turn, out=folder)
            else:
                summarise(result.rows)
            taken[name].append(time.perf_counter() - begun)
            used[name].append(time.process_time() - before)
    loop, whole, summary = (1e3 * np.array(used[name]) / episodes for name in used)
    added = float(np.median(whole - loop - summary))
    return {
        "episodes": episodes,
        "turns": turns,
        "seconds_of_the_loop": float(np.median(taken["loop"])),
        "share_of_seconds_added": float(np.median(np.array(taken["evaluate"]) / np.array(taken["loop"])) - 1),
        "cpu_milliseconds_of_runner_and_store_for_an_episode": added,
        "share_of_a_detection_of_10_ms": added / 10,
        "cpu_milliseconds_of_the_summary_for_an_episode": float(np.median(summary)),
    }


def ray_nodes(episodes: int, turns: int, computing: bool) -> dict[str, object]:
    """Seconds of a run on one and two nodes of one core of a local Ray cluster, which has started; in turns."""
    from ray.cluster_utils import Cluster
    from usnet_env.processes import RayPool

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    for _ in range(2):
        cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    import ray

    ray.init(cluster.address, log_to_driver=False)
    taken: dict[int, list[float]] = {1: [], 2: []}
    loads = []
    for turn in range(turns):
        for nodes, seconds in taken.items():
            seconds.append(time_run(Takes(0.5, computing), episodes, turn, nodes))
        loads.append(os.getloadavg()[0])
    ratios = np.array(taken[1]) / np.array(taken[2])
    found: dict[str, object] = {
        "episodes": episodes,
        "seconds_on_one_node": taken[1],
        "seconds_on_two_nodes": taken[2],
        "loads": loads,
        "ratio": float(np.median(ratios)),
    }
    pool = RayPool(abs, 2)
    times = [(time.perf_counter(), time.process_time()) for _ in pool.run(range(2_000))]
    (first, used), (last, used_at_last) = times[1_000], times[-1]
    found["empty_tasks_per_second"] = 999 / (last - first)
    found["cpu_milliseconds_of_the_program_for_a_task"] = 1e3 * (used_at_last - used) / 999
    ray.shutdown()
    cluster.shutdown()
    return found


def time_run(detector: Takes, episodes: int, seed: int, nodes: int) -> float:
    """Seconds of a run on Ray from its first rows to its last one: without the start of the workers."""
    ends: list[float] = []
    append = RunStore.append

    def note(store: RunStore, rows: list[dict[str, object]]) -> None:
        append(store, rows)
        ends.append(time.perf_counter())

    how = {"episodes": episodes, "seed": seed, "workers": nodes, "backend": "ray"}
    with patch.object(RunStore, "append", note), tempfile.TemporaryDirectory() as folder:
        evaluate("USNET/MultiCluster-v0", detector, **how, out=folder)
    return ends[-1] - ends[episodes // 4]  # the second node may start later


def main() -> None:
    parser = make_parser(__doc__)
    parser.add_argument("parts", nargs="*", help="which parts; by default all but ray")
    parser.add_argument("--rows", type=int, default=1_000_000, help="of the summary")
    parser.add_argument("--episodes", type=int, default=200_000)
    parser.add_argument("--turns", type=int, default=500, help="of the isolation")
    parser.add_argument("--out", type=Path, default=RESULTS / "engine_speed.json")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = Path(folder) / "rows.csv"

        def summary() -> dict[str, float]:
            write_rows(rows, arguments.rows, 5)
            return run(SUMMARY, rows)

        parts = {
            "isolation": lambda: isolation(arguments.turns),
            "append": lambda: append(Path(folder) / "append.csv", (1_000, 10_000, 100_000, 1_000_000)),
            "summary": summary,
            "episodes": lambda: run(EPISODES, arguments.episodes, Path(folder) / "run"),
            "engine": lambda: engine(200, 5),
            "ray": lambda: ray_nodes(40, 5, computing=False),
            "ray_computing": lambda: ray_nodes(40, 3, computing=True),
        }
        for name in arguments.parts or [name for name in parts if not name.startswith("ray")]:
            load, values = os.getloadavg()[0], parts[name]()
            how = {
                "command": f"OMP_NUM_THREADS=1 python benchmarks/engine_speed.py {name}",
                "load_before_and_after": [load, os.getloadavg()[0]],  # other processes share the cores above about 1
            }
            result = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
            measured = result.get("measured", {}) | {name: how}
            about = {"machine": machine(), "versions": versions(["ray"]) | result.get("versions", {})}
            write_json(arguments.out, result | about | {name: values, "measured": measured})
            print(json.dumps({name: values, **how}, indent=1), flush=True)


if __name__ == "__main__":
    main()

"""Measure the time and memory of a round of ``mc-gassl`` and of ``lead-votes``, and of the parts of these rounds.

    OMP_NUM_THREADS=1 python benchmarks/mc_gassl_speed.py  # writes benchmarks/results/mc_gassl_speed.json

A round is one window of a swarm of N UAVs in M clusters. These are timed on the same window: each clusterer with M
given, both rules for the number of clusters, the features of the GRU network, lines 4 and 5 of Algorithm 2 in the true
number of clusters, and whole rounds. Seconds are processor time. The parts take turns, and the median of the turns
counts. A part that has used up its limit of seconds has no further turns; the file gives the number of turns.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from speed_helpers import MEMORY, peak_memory, play, write_json
from speed_helpers import seconds as seconds_by
from speed_helpers import window_of as first_window

import usnet_env
from detectors.clustering import clusterers, compute_gap_statistic, estimate_count_by_eigengap, make_clusterer
from detectors.clustering.affinity import compute_affinity
from detectors.clustering.features import compute_features
from detectors.gassl import Gassl
from detectors.mc_gassl.algorithm_2 import detect_heads, update_gru
from detectors.mc_gassl.features import MODES, gru_features
from detectors.mc_gassl.gru import GruSizes, draw_parameters
from detectors.mc_gassl.online_training import OnlineTraining
from usnet_env.plugins import make_detector
from usnet_env.provenance import machine, versions

CLUSTERS = {82: 5, 185: 8, 500: 20}  # M for each N
ROUNDS = ("mc-gassl", "lead-votes", "lagged-regression")
LIMIT = 10.0  # seconds after which a part has no further turns


def measure_seconds(function: Callable[[], object]) -> float:
    """Measure the processor seconds of a call."""
    return seconds_by(function, time.process_time)


def window_of(uavs: int) -> usnet_env.Window:
    """Return the window of a swarm of N UAVs."""
    return first_window("MultiCluster", follow="f1", clusters=CLUSTERS[uavs], uavs=uavs)


def make_parts(uavs: int) -> dict[str, Callable[[], object]]:
    """Make the functions that are timed, by name."""
    window, clusters = window_of(uavs), CLUSTERS[uavs]
    series = compute_features("velocities", window, MEMORY)
    parts: dict[str, Callable[[], object]] = {}
    for name in clusterers():
        count = "own" if name == "hdbscan" else clusters
        clusterer = make_clusterer(name, count=count)
        parts[f"cluster: {name}"] = lambda clusterer=clusterer: clusterer.cluster(window, np.random.default_rng(0))
    parts["affinity: lag"] = lambda: compute_affinity("lag", series, 4)
    parts["count: gap, scaled"] = lambda: compute_gap_statistic(
        compute_features("scaled", window, MEMORY), np.random.default_rng(0)
    )
    lag = compute_affinity("lag", series, 4)
    parts["count: eigengap"] = lambda: estimate_count_by_eigengap(lag, np.random.default_rng(0))
    parameters = draw_parameters(GruSizes(), torch.Generator().manual_seed(0))
    for mode in MODES:
        parts[f"features: gru, {mode}"] = partial(gru_features, window, parameters, mode)
    clustering = make_clusterer("kmeans", count=clusters).cluster(window, np.random.default_rng(0))
    gassl = Gassl(memory=MEMORY)
    gamma = gassl.draw_gamma(np.random.default_rng(0))
    parts["line 4: heads by gassl"] = lambda: detect_heads(window, clustering, gassl, np.random.default_rng(0))
    parts["line 5: re-clustering, on-line training"] = lambda: update_gru(
        window, parameters, clusters, gamma, gassl, OnlineTraining(), np.random.default_rng(0)
    )
    for name in ROUNDS:
        parts[f"round: {name}"] = partial(play, make_detector(name), window)
    return parts


def time_parts(parts: dict[str, Callable[[], object]], turns: int) -> dict[str, dict[str, object]]:
    """Measure the processor seconds of each part; the first call is not counted, unless it exceeds the limit."""
    taken: dict[str, list[float]] = {}
    for name, part in parts.items():
        first = measure_seconds(part)  # compiles, loads
        if first > LIMIT:
            taken[name] = [first]
    for _ in range(turns):
        for name, part in parts.items():
            if sum(taken.get(name, [])) <= LIMIT:
                taken.setdefault(name, []).append(measure_seconds(part))
    return {name: {"seconds": float(np.median(values)), "turns": len(values)} for name, values in taken.items()}


def measure_memory(detector: str, uavs: int) -> dict[str, object]:
    """Measure the peak memory of a process that answers one window."""
    return {
        "what": f"peak resident bytes of a process that answers one window of {uavs} UAVs",
        **peak_memory(
            ["import detectors.clustering, torch", "from usnet_env.plugins import make_detector"],
            f"gym.make('USNET/MultiCluster-v0', follow='f1', clusters={CLUSTERS[uavs]}, uavs={uavs})",
            f"make_detector({detector!r})",
        ),
    }


def main() -> None:
    """Measure, print and write the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--uavs", type=int, nargs="+", choices=CLUSTERS, default=list(CLUSTERS))
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "mc_gassl_speed.json")
    arguments = parser.parse_args()
    parts = {}
    for uavs in arguments.uavs:
        parts[str(uavs)] = time_parts(make_parts(uavs), arguments.turns)
        print(f"N={uavs}, M={CLUSTERS[uavs]}:")
        for name, one in parts[str(uavs)].items():
            print(f"  {name}: {one['seconds']:.4f} s ({one['turns']} turns)", flush=True)
    memory = {name: measure_memory(name, min(arguments.uavs)) for name in ROUNDS[:2]}
    for name, peak in memory.items():
        print(f"{name}: peak {peak['bytes'] / 2**30:.2f} GiB for {min(arguments.uavs)} UAVs")
    result = {
        "machine": machine(),
        "versions": versions(("torch",)),
        "seconds": "processor time",
        "torch_threads": torch.get_num_threads(),
        "turns": arguments.turns,
        "clusters": {str(uavs): CLUSTERS[uavs] for uavs in arguments.uavs},
        "parts": parts,
        "memory": memory,
    }
    write_json(arguments.out, result)


if __name__ == "__main__":
    main()

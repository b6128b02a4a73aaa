"""Speed and memory of a round of MC-GASSL and of its parts, as ratios within one run.

    python benchmarks/mc_gassl_speed.py            # writes benchmarks/results/mc_gassl_speed.json

A round is one window of a swarm of N UAVs in M clusters. The parts are timed beside it on the same windows: each
clusterer, both ways to count clusters, the GRU's features, and the whole answer of a detector. At N=82 a round is held
against the paper's literal loop over the whole swarm (``tests/detectors/gassl/literal.py``), of which a few steps of
some UAVs are timed and scaled up linearly, as ``gassl_speed.py`` does. Seconds are those of the processor, all threads
together: where other work runs on the same cores, the clock on the wall tells of that work as well (the loop's few
steps gave 330 s, 420 s and less than nothing). Contestants take turns, and the median of the turns' ratios counts;
what takes long has fewer turns, and says so. Run it with ``OMP_NUM_THREADS=1``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from detectors.gassl.input_pooling import InputPooling
from speed_helpers import LITERAL_STEPS, MEMORY, literal_loop, peak_memory, play, write_json
from speed_helpers import seconds as seconds_by
from speed_helpers import window_of as first_window

import usnet_env
from detectors.clustering import clusterers, compute_gap_statistic, estimate_count_by_eigengap, make_clusterer
from detectors.clustering.affinity import compute_affinity
from detectors.clustering.features import compute_features
from detectors.mc_gassl.features import MODES, gru_features
from detectors.mc_gassl.gru import GruSizes, draw_parameters
from usnet_env.plugins import make_detector
from usnet_env.provenance import machine, versions

SIZES = {82: 5, 185: 8, 500: 20, 2000: 60}  # M for each N
DETECTORS = {
    "mc-gassl": "detectors.mc_gassl.detector:McGassl",
    "mc-gassl, paper": "detectors.mc_gassl.detector:McGassl(preset='paper')",
    "lagged-regression": "lagged-regression",
}
PAPER_UP_TO = 185  # UAVs: above, the paper's networks take many minutes
LITERAL_UAVS = 4
BAR, MEMORY_BAR = 1 / 10, 4 * 2**30
PATIENCE = 20.0  # seconds after which a part is timed no further


def seconds(function: Callable[[], object]) -> float:
    """Of the processor."""
    return seconds_by(function, time.process_time)


def window_of(uavs: int) -> usnet_env.Window:
    return first_window("MultiCluster", follow="f1", clusters=SIZES[uavs], uavs=uavs)


def parts_of(uavs: int) -> dict[str, Callable[[], object]]:
    """What is timed, by name."""
    window, clusters = window_of(uavs), SIZES[uavs]
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
    for name, detector in DETECTORS.items():
        if "paper" not in name or uavs <= PAPER_UP_TO:
            parts[f"round: {name}"] = partial(play, make_detector(detector), window)
    return parts


def timed(parts: dict[str, Callable[[], object]], turns: int) -> dict[str, dict[str, object]]:
    """Seconds of each part: the first time untimed, then in turns."""
    taken: dict[str, list[float]] = {}
    for name, part in parts.items():
        first = seconds(part)  # compiles, loads
        if first > PATIENCE:
            taken[name] = [first]
    for _ in range(turns):
        for name, part in parts.items():
            if sum(taken.get(name, [])) <= PATIENCE:
                taken.setdefault(name, []).append(seconds(part))
    return {name: {"seconds": float(np.median(own)), "turns": len(own)} for name, own in taken.items()}


def against_the_loop(turns: int) -> dict[str, object]:
    """Rounds at N=82 against the literal loop over the whole swarm."""
    window, settings = window_of(82), InputPooling()
    literal_round = literal_loop(window, settings, LITERAL_UAVS, time.process_time)
    literal_round()
    rounds = {name: partial(play, make_detector(DETECTORS[name]), window) for name in ("mc-gassl", "mc-gassl, paper")}
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in rounds}
    for turn in range(turns):
        loop = literal_round()
        for name, play_round in rounds.items():
            if turn == 0 or name == "mc-gassl":
                taken[name].append((seconds(play_round), loop))
    answer: dict[str, object] = {
        "what": "processor seconds of a round of 82 UAVs over those of the literal GASSL loop over the whole swarm",
        "literal_seconds": float(np.median([loop for _, loop in taken["mc-gassl"]])),
        "literal_scaled_from": {"steps": LITERAL_STEPS, "uavs": LITERAL_UAVS, "to_steps": settings.steps},
        "bar": BAR,
    }
    for name, pairs in taken.items():
        ratios = [own / loop for own, loop in pairs]
        own = float(np.median([own for own, _ in pairs]))
        answer[name] = {"seconds": own, "ratio": float(np.median(ratios)), "ratios": ratios}
    return answer


def memory(detector: str, uavs: int) -> dict[str, object]:
    """Peak resident memory of a process that answers one window, and what its imports take of it."""
    return {
        "what": f"peak resident bytes of a process that answers one window of {uavs} UAVs",
        "detector": detector,
        **peak_memory(
            ["import detectors.clustering, torch", "from usnet_env.plugins import make_detector"],
            f"gym.make('USNET/MultiCluster-v0', follow='f1', clusters={SIZES[uavs]}, uavs={uavs})",
            f"make_detector({detector!r})",
        ),
        "bar": MEMORY_BAR,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--uavs", type=int, nargs="+", choices=SIZES, default=list(SIZES))
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "mc_gassl_speed.json")
    arguments = parser.parse_args()
    parts = {}
    for uavs in arguments.uavs:
        parts[str(uavs)] = timed(parts_of(uavs), arguments.turns)
        print(f"N={uavs}, M={SIZES[uavs]}:")
        for name, one in parts[str(uavs)].items():
            print(f"  {name}: {one['seconds']:.4f} s ({one['turns']} turns)")
    loop = against_the_loop(arguments.turns)
    print(f"N=82, literal loop: {loop['literal_seconds']:.1f} s (scaled up linearly)")
    for name in ("mc-gassl", "mc-gassl, paper"):
        print(f"  {name}: {loop[name]['seconds']:.2f} s, 1/{1 / loop[name]['ratio']:.1f} of it (bar 1/{1 / BAR:.0f})")
    peak = memory(DETECTORS["mc-gassl"], max(arguments.uavs))
    print(f"{peak['what']}: {peak['bytes'] / 2**30:.2f} GiB (bar {MEMORY_BAR / 2**30:.0f})")
    result = {
        "machine": machine(),
        "versions": versions(("torch",)),
        "seconds": "processor time",
        "torch_threads": torch.get_num_threads(),
        "turns": arguments.turns,
        "clusters": {str(uavs): SIZES[uavs] for uavs in arguments.uavs},
        "parts": parts,
        "against_the_loop": loop,
        "memory": peak,
    }
    write_json(arguments.out, result)


if __name__ == "__main__":
    main()

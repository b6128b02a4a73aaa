"""Measure the time and memory of ``gassl``, compiled and as printed, and of ``neural-granger``.

    OMP_NUM_THREADS=1 python benchmarks/gassl_speed.py  # writes benchmarks/results/gassl_speed.json

``gassl(implementation='printed')`` is Algorithm 1 as a readable loop over PyTorch tensors; ``gassl`` computes the same
in compiled loops. Both answer the same windows, with the same small number of steps for each UAV, because the printed
loop is slow. ``gassl`` and ``neural-granger`` also answer them with their default numbers of steps. Seconds are
processor time. Contestants take turns, each turn gives one ratio, and the median counts.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from speed_helpers import peak_memory, play, take_turns, window_of, write_json

from usnet_env.plugins import make_detector
from usnet_env.provenance import machine, versions

STEPS = {5: 10, 50: 2}  # of both implementations, for each number of followers
DEFAULTS = ("gassl", "neural-granger")
GROWTH = (50, 200)  # followers
GROWTH_STEPS = 5
MEMORY_UAVS = 201


def episode(detector: str, followers: int) -> Callable[[], object]:
    """An episode with one head and its followers."""
    return partial(play, make_detector(detector), window_of("SingleCluster", follow="f1", followers=followers))


def compare_implementations(followers: int, turns: int) -> dict[str, object]:
    """Compare the implementations of ``gassl`` with equal steps, and time the defaults."""
    steps = STEPS[followers]
    compiled, printed = f"gassl(steps={steps})", f"gassl(steps={steps}, implementation='printed')"
    taken = take_turns({name: episode(name, followers) for name in (compiled, printed, *DEFAULTS)}, turns)
    ratios = taken[printed] / taken[compiled]
    return {
        "what": f"processor seconds of an episode of {followers + 1} UAVs",
        "seconds": {name: float(np.median(values)) for name, values in taken.items()},
        "printed_over_compiled": float(np.median(ratios)),
        "ratios": ratios.tolist(),
    }


def measure_growth(detector: str, turns: int) -> dict[str, object]:
    """Measure the power of N with which the time of an episode grows."""
    small, large = (followers + 1 for followers in GROWTH)
    taken = take_turns({str(uavs): episode(detector, uavs - 1) for uavs in (small, large)}, turns)
    exponents = np.log(taken[str(large)] / taken[str(small)]) / np.log(large / small)
    return {
        "what": f"power of N with which the processor seconds of an episode grow from {small} to {large} UAVs",
        "seconds": {uavs: float(np.median(values)) for uavs, values in taken.items()},
        "exponent": float(np.median(exponents)),
        "exponents": exponents.tolist(),
    }


def measure_memory(detector: str) -> dict[str, object]:
    """Measure the peak memory of a process that answers one window."""
    return {
        "what": f"peak resident bytes of a process that answers one window of {MEMORY_UAVS} UAVs",
        **peak_memory(
            ["from usnet_env.plugins import make_detector", "import torch"],
            f"gym.make('USNET/SingleCluster-v0', followers={MEMORY_UAVS - 1})",
            f"make_detector({detector!r})",
        ),
    }


def main() -> None:
    """Measure, print and write the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "gassl_speed.json")
    arguments = parser.parse_args()
    compared = {}
    for followers in STEPS:
        row = compared[str(followers)] = compare_implementations(followers, arguments.turns)
        ratio = row["printed_over_compiled"]
        print(f"m={followers}: the printed loop takes {ratio:.0f} times as long as the compiled one", flush=True)
        for name, value in row["seconds"].items():
            print(f"  {name}: {value:.3f} s", flush=True)
    growth, memory = {}, {}
    for detector in (f"gassl(steps={GROWTH_STEPS})", "neural-granger(steps=20)"):
        growth[detector] = measure_growth(detector, arguments.turns)
        memory[detector] = measure_memory(detector)
        print(f"{detector}: time grows as N^{growth[detector]['exponent']:.2f}", flush=True)
        print(f"{detector}: peak {memory[detector]['bytes'] / 2**30:.2f} GiB for {MEMORY_UAVS} UAVs", flush=True)
    result = {
        "machine": machine(),
        "versions": versions(("torch",)),
        "seconds": "processor time",
        "torch_threads": torch.get_num_threads(),
        "turns": arguments.turns,
        "implementations": compared,
        "growth": growth,
        "memory": memory,
    }
    write_json(arguments.out, result)


if __name__ == "__main__":
    main()

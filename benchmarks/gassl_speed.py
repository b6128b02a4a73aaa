"""Speed and memory of GASSL, as ratios within one run.

    python benchmarks/gassl_speed.py            # writes benchmarks/results/gassl_speed.json

Algorithm 1 as the paper writes it (``tests/detectors/gassl/literal.py``: one UAV after another, all 96 times in every
step) takes minutes an episode, so a few steps of some UAVs are timed and scaled up linearly to all UAVs and as many
steps as the detector takes. A shared machine is noisy: contestants take turns, each turn gives one ratio, and the
median counts. Threads are as PyTorch sets them; where other work runs on the same cores, ``OMP_NUM_THREADS=1`` keeps
its threads from waiting for each other.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from speed_helpers import LITERAL_STEPS, literal_loop, peak_memory, play, seconds, window_of, write_json

from detectors.gassl import Gassl
from detectors.gassl.input_pooling import InputPooling
from usnet_env.provenance import machine, versions

LITERAL_UAVS = {5: 6, 50: 4}
BARS = {5: {"default": 1 / 5, "paper": 1 / 5}, 50: {"default": 1 / 15, "paper": 1 / 10}}
FEWER_STEPS = 20  # of the paper preset where it would take minutes


def episode(followers: int, **arguments: object) -> Callable[[], object]:
    """An episode of GASSL beside one head and its followers."""
    return partial(play, Gassl(**arguments), window_of("SingleCluster", follow="f1", followers=followers))


def against_the_loop(followers: int, turns: int) -> dict[str, object]:
    """Both presets against the literal loop."""
    window = window_of("SingleCluster", follow="f1", followers=followers)
    loop = literal_loop(window, InputPooling(), LITERAL_UAVS[followers])
    players = {preset: episode(followers, preset=preset) for preset in ("default", "paper")}
    for player in (loop, *players.values()):
        player()
    taken = [(loop(), *(seconds(player) for player in players.values())) for _ in range(turns)]
    table = np.array(taken)
    answer: dict[str, object] = {
        "what": f"seconds an episode of {followers + 1} UAVs over those of the literal loop with as many steps",
        "literal_seconds": float(np.median(table[:, 0])),
        "literal_scaled_from": {
            "steps": LITERAL_STEPS,
            "uavs": LITERAL_UAVS[followers],
            "to_steps": InputPooling().steps,
        },
    }
    for column, preset in enumerate(players, start=1):
        ratios = table[:, column] / table[:, 0]
        answer[preset] = {
            "seconds": float(np.median(table[:, column])),
            "ratio": float(np.median(ratios)),
            "ratios": ratios.tolist(),
            "bar": BARS[followers][preset],
        }
    return answer


def growth(turns: int, **arguments: object) -> dict[str, object]:
    """The power of N with which an episode's time grows from 50 to 200 followers."""
    small, large = (episode(followers, **arguments) for followers in (50, 200))
    for player in (small, large):
        player()
    taken = np.array([[seconds(small), seconds(large)] for _ in range(turns)])
    exponents = np.log(taken[:, 1] / taken[:, 0]) / np.log(201 / 51)
    return {
        "what": "power of N with which the seconds of an episode grow from 51 to 201 UAVs",
        "arguments": arguments,
        "seconds": dict(zip(("51", "201"), np.median(taken, axis=0).tolist(), strict=True)),
        "exponent": float(np.median(exponents)),
        "exponents": exponents.tolist(),
        "bar": 2.0,
    }


def memory(**arguments: object) -> dict[str, object]:
    """Peak resident memory of a process that answers one window of 201 UAVs, and what its imports take of it."""
    return {
        "what": "peak resident bytes of a process that answers one window of 201 UAVs",
        "arguments": arguments,
        **peak_memory(
            ["from detectors.gassl import Gassl"],
            "gym.make('USNET/SingleCluster-v0', followers=200)",
            f"Gassl(**{arguments!r})",
        ),
        "bar": 1.5 * 2**30,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "gassl_speed.json")
    arguments = parser.parse_args()
    loops = {str(followers): against_the_loop(followers, arguments.turns) for followers in (5, 50)}
    grown = {
        "default": growth(arguments.turns),
        "paper": growth(1, preset="paper", steps=FEWER_STEPS),
    }
    peaks = {"default": memory(), "paper": memory(preset="paper", steps=FEWER_STEPS)}
    result = {
        "machine": machine(),
        "versions": versions(("torch",)),
        "torch_threads": torch.get_num_threads(),
        "turns": arguments.turns,
        "against_the_loop": loops,
        "growth": grown,
        "memory": peaks,
    }
    write_json(arguments.out, result)
    for followers, row in loops.items():
        print(
            f"m={followers}: literal loop {row['literal_seconds']:.1f} s (scaled up linearly from {LITERAL_STEPS} steps"
            f" of {LITERAL_UAVS[int(followers)]} UAVs)"
        )
        for preset in ("default", "paper"):
            one = row[preset]
            print(f"  {preset}: {one['seconds']:.2f} s, 1/{1 / one['ratio']:.1f} of it (bar 1/{1 / one['bar']:.0f})")
    for preset, row in grown.items():
        print(f"{preset}: time grows as N^{row['exponent']:.2f} (bar 2)")
    for preset, row in peaks.items():
        above = row["bytes_above_imports"] / 2**30
        print(f"{preset}: peak {row['bytes'] / 2**30:.2f} GiB (bar 1.5), {above:.2f} GiB above the imports")


if __name__ == "__main__":
    main()

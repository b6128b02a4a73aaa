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
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch

import usnet_env  # registers the environments
from detectors.gassl import Gassl
from detectors.gassl.agat import Agat, AgatSizes
from detectors.gassl.ifsn import Ifsn
from detectors.gassl.input_pooling import InputPooling, standardise
from detectors.gassl.inputs import samples_of
from usnet_env.provenance import machine, versions

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "detectors" / "gassl"))

import literal  # noqa: E402  lives beside the tests that hold the fast GASSL against it

MEMORY = 4
LITERAL_STEPS = 10
LITERAL_UAVS = {5: 6, 50: 4}
BARS = {5: {"default": 1 / 5, "paper": 1 / 5}, 50: {"default": 1 / 15, "paper": 1 / 10}}
FEWER_STEPS = 20  # of the paper preset where it would take minutes


def seconds(function: Callable[[], object]) -> float:
    begun = time.perf_counter()
    function()
    return time.perf_counter() - begun


def window_of(followers: int, seed: int = 0) -> usnet_env.Window:
    env = gym.make("USNET/SingleCluster-v0", follow="f1", followers=followers)
    observation, _ = env.reset(seed=seed)
    return usnet_env.Window.from_observation(observation)


def episode(window: usnet_env.Window, **arguments: object) -> Callable[[], object]:
    """An episode of a detector: reset, and one window."""
    detector = Gassl(**arguments)

    def play() -> object:
        detector.reset(0)
        return detector.detect(window)

    return play


def literal_episode(window: usnet_env.Window, settings: InputPooling) -> Callable[[], float]:
    """Seconds that the literal loop would take for all UAVs and ``settings.steps`` steps, scaled up."""
    samples = samples_of([window], [np.arange(window.uavs)], MEMORY, torch.device("cpu"))
    inputs = standardise(samples)
    generator = torch.Generator().manual_seed(0)
    sizes = AgatSizes(MEMORY, settings.query_hidden, settings.query, settings.key, settings.similarity_hidden)
    agat = Agat(1, window.uavs, sizes, generator)
    ifsn = Ifsn(1, 6 * MEMORY + 6, settings.ifsn_hidden, generator)
    uavs = list(range(LITERAL_UAVS[window.uavs - 1]))

    def play(steps: int) -> float:
        return seconds(lambda: literal.train(agat, ifsn, inputs, settings, steps, uavs))

    def scaled() -> float:
        around = play(0)
        each_step = (play(LITERAL_STEPS) - around) / LITERAL_STEPS
        return (around + each_step * settings.steps) * window.uavs / len(uavs)

    return scaled


def against_the_loop(followers: int, turns: int) -> dict[str, object]:
    """Both presets against the literal loop."""
    window = window_of(followers)
    loop = literal_episode(window, InputPooling())
    players = {preset: episode(window, preset=preset) for preset in ("default", "paper")}
    for play in (loop, *players.values()):
        play()
    taken = [(loop(), *(seconds(play) for play in players.values())) for _ in range(turns)]
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
    small, large = (episode(window_of(followers), **arguments) for followers in (50, 200))
    for play in (small, large):
        play()
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
    program = (
        "import json, gymnasium as gym, usnet_env\n"
        "from detectors.gassl import Gassl\n"
        "env = gym.make('USNET/SingleCluster-v0', followers=200)\n"
        "window = usnet_env.Window.from_observation(env.reset(seed=0)[0])\n"
        # Not getrusage: a child begins with the peak of the process that started it.
        "def peak():\n"
        "    lines = open('/proc/self/status').read().splitlines()\n"
        "    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith('VmHWM'))\n"
        "before = peak()\n"
        f"detector = Gassl(**{arguments!r})\n"
        "detector.reset(0)\n"
        "detector.detect(window)\n"
        "print(json.dumps([before, peak()]))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    before, peak = json.loads(done.stdout)
    return {
        "what": "peak resident bytes of a process that answers one window of 201 UAVs",
        "arguments": arguments,
        "bytes": peak,
        "bytes_after_imports": before,
        "bytes_above_imports": peak - before,
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
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    aside = arguments.out.with_suffix(".part")
    aside.write_text(json.dumps(result, indent=1) + "\n")
    aside.replace(arguments.out)
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

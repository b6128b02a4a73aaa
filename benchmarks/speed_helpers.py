"""What the speed benchmarks of the detectors share: clocks, windows, the literal GASSL loop, peak memory, files."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch

import usnet_env  # registers the environments
from detectors.gassl.agat import Agat, AgatSizes
from detectors.gassl.ifsn import Ifsn
from detectors.gassl.input_pooling import InputPooling, standardise
from detectors.gassl.inputs import samples_of
from usnet_env.files import atomic_write

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "detectors" / "gassl"))

import literal  # noqa: E402  lives beside the tests that hold the fast GASSL against it

MEMORY = 4
LITERAL_STEPS = 10


def seconds(function: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """What a call takes: by the clock on the wall, or of the processor (``time.process_time``)."""
    begun = clock()
    function()
    return clock() - begun


def window_of(env: str, seed: int = 0, **arguments: object) -> usnet_env.Window:
    """The first window of an episode of ``USNET/<env>-v0``."""
    observation, _ = gym.make(f"USNET/{env}-v0", **arguments).reset(seed=seed)
    return usnet_env.Window.from_observation(observation)


def play(detector: object, window: usnet_env.Window) -> object:
    """An episode of one round: reset, and one window."""
    detector.reset(0)
    return detector.detect(window)


def literal_loop(
    window: usnet_env.Window, settings: InputPooling, uavs: int, clock: Callable[[], float] = time.perf_counter
) -> Callable[[], float]:
    """Seconds that the literal loop of Algorithm 1 would take for all UAVs and ``settings.steps`` steps.

    Scaled up linearly from ``LITERAL_STEPS`` steps of ``uavs`` UAVs.
    """
    samples = samples_of([window], [np.arange(window.uavs)], MEMORY, torch.device("cpu"))
    inputs = standardise(samples)
    generator = torch.Generator().manual_seed(0)
    sizes = AgatSizes(MEMORY, settings.query_hidden, settings.query, settings.key, settings.similarity_hidden)
    agat = Agat(1, window.uavs, sizes, generator)
    ifsn = Ifsn(1, 6 * MEMORY + 6, settings.ifsn_hidden, generator)
    some = list(range(uavs))

    def taken(steps: int) -> float:
        return seconds(lambda: literal.train(agat, ifsn, inputs, settings, steps, some), clock)

    def scaled() -> float:
        around = taken(0)
        each_step = (taken(LITERAL_STEPS) - around) / LITERAL_STEPS
        return (around + each_step * settings.steps) * window.uavs / len(some)

    return scaled


def peak_memory(imports: Sequence[str], env: str, detector: str) -> dict[str, int]:
    """Peak resident bytes of a fresh process that answers one window, and what its imports and the window take of it.

    Args:
        imports: lines of code.
        env: an expression that makes the environment.
        detector: an expression that makes the detector.
    """
    program = "\n".join(
        [
            "import json, gymnasium as gym, usnet_env",
            *imports,
            f"window = usnet_env.Window.from_observation({env}.reset(seed=0)[0])",
            # Not getrusage: a child begins with the peak of the process that started it.
            "def peak():",
            "    lines = open('/proc/self/status').read().splitlines()",
            "    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith('VmHWM'))",
            "before = peak()",
            f"detector = {detector}",
            "detector.reset(0)",
            "detector.detect(window)",
            "print(json.dumps([before, peak()]))",
        ]
    )
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True, cwd=ROOT)
    before, peak = json.loads(done.stdout)
    return {"bytes": peak, "bytes_after_imports": before, "bytes_above_imports": peak - before}


def write_json(path: Path, result: dict[str, object]) -> None:
    """The file appears whole."""
    with atomic_write(path) as aside:
        aside.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")

"""Functions that the speed benchmarks share: programs in new processes with their peak memory, turns, ratios, files."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from usnet_env.files import atomic_write

ROOT = Path(__file__).parents[1]
# Not getrusage: a child begins with the peak of the process that started it.
PEAK = """
def peak():
    lines = open('/proc/self/status').read().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith('VmHWM'))
"""


def run(program: str, *arguments: object) -> Any:
    """Run a program in a new process, and return the JSON that it prints; ``peak()`` is its peak resident bytes."""
    command = [sys.executable, "-c", PEAK + program, *map(str, arguments)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout)


def alternate(turns: int, *contestants: Callable[[], object]) -> np.ndarray:
    """Seconds ``(turns, contestants)`` of contestants that take turns, after one warm-up each."""

    def seconds(function: Callable[[], object]) -> float:
        begun = time.perf_counter()
        function()
        return time.perf_counter() - begun

    for contestant in contestants:
        contestant()
    return np.array([[seconds(contestant) for contestant in contestants] for _ in range(turns)])


def describe_ratios(ratios: np.ndarray) -> dict[str, object]:
    """The ratio of each turn, and their median."""
    return {"ratio": float(np.median(ratios)), "ratios": ratios.tolist()}


def write_json(path: Path, result: dict[str, object]) -> None:
    """Write a JSON file; it is replaced as a whole."""
    with atomic_write(path) as aside:
        aside.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")

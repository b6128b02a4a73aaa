"""Functions that the speed benchmarks of the detectors share: clocks, windows, peak memory, files."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import usnet_env  # registers the environments
from usnet_env.files import atomic_write

ROOT = Path(__file__).parents[1]
# Not getrusage: a child begins with the peak of the process that started it.
PEAK = """
def peak():
    lines = open('/proc/self/status').read().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith('VmHWM'))
"""


def seconds(function: Callable[[], object]) -> float:
    """Measure the processor seconds of a call."""
    begun = time.process_time()
    function()
    return time.process_time() - begun


def play(detector: object, window: usnet_env.Window) -> object:
    """Play an episode of one round: a reset, and one window."""
    detector.reset(0)
    return detector.detect(window)


def run(program: str, *arguments: object) -> Any:
    """Run a program in a new process, and return the JSON that it prints; ``peak()`` is its peak resident bytes."""
    command = [sys.executable, "-c", PEAK + program, *map(str, arguments)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout)


def peak_memory(imports: Sequence[str], env: str, detector: str) -> dict[str, int]:
    """Measure the peak resident bytes of a fresh process that answers one window, and those before the answer.

    Args:
        imports: lines of code.
        env: an expression that makes the environment.
        detector: an expression that makes the detector.
    """
    before, peak = run(
        "\n".join(
            [
                "import json, gymnasium as gym, usnet_env",
                *imports,
                f"window = usnet_env.Window.from_observation({env}.reset(seed=0)[0])",
                "before = peak()",
                f"detector = {detector}",
                "detector.reset(0)",
                "detector.detect(window)",
                "print(json.dumps([before, peak()]))",
            ]
        )
    )
    return {"bytes": peak, "bytes_after_imports": before, "bytes_above_imports": peak - before}


def write_json(path: Path, result: dict[str, object]) -> None:
    """Write a JSON file; it is replaced as a whole."""
    with atomic_write(path) as aside:
        aside.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")

"""What observers do to the motion of a swarm: faults of the simulator's sensor, and faults of arrays."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from detectors.reader.prior.draws import draw_log
from detectors.reader.prior.motion import Motion

#: The arguments of the simulator's sensor that a fault is; a family that is left out has none of them.
_ARGUMENTS = {
    "fault:noise": ("position_noise",),
    "fault:correlated": ("noise_memory",),
    "fault:course": ("course_noise",),
    "fault:missed": ("miss_rate", "miss_burst"),
    "fault:bursts": ("miss_burst",),
    "fault:partial": ("partial_tracks",),
    "fault:swaps": ("swap_rate",),
}
_ON_ARRAYS = ("fault:noise", "fault:missed", "fault:bursts", "fault:jumps", "fault:rounding")


def draw_sensor(rng: np.random.Generator, fault: str) -> dict[str, Any]:
    """Draw the arguments of the simulator's sensor for a fault; of none for a fault that it doesn't have."""
    low, high = {"fault:course": (0.03, 0.2), "fault:correlated": (0.1, 1.5)}.get(fault, (0.03, 0.6))
    size, memory = float(draw_log(rng, low, high)), float(rng.uniform(0.5, 0.97))
    missed, burst = float(rng.uniform(0.03, 0.35)), float(rng.uniform(2.0, 12.0))
    faults: dict[str, dict[str, Any]] = {
        "fault:noise": {"position_noise": size},
        "fault:correlated": {"position_noise": size, "noise_memory": memory},
        "fault:course": {"position_noise": size, "course_noise": float(draw_log(rng, 1.5, 6.0))},
        "fault:missed": {"miss_rate": missed},
        "fault:bursts": {"miss_rate": missed, "miss_burst": burst},
        "fault:partial": {"partial_tracks": float(rng.uniform(0.05, 0.5))},
        "fault:swaps": {"swap_rate": float(draw_log(rng, 0.0003, 0.01))},
    }
    if fault != "fault:mix":
        return faults.get(fault, {})
    mixed: dict[str, Any] = {}
    for name in rng.choice(sorted(faults), int(rng.integers(2, 6)), replace=False).tolist():
        mixed.update(faults[name])
    for name in ("position_noise", "swap_rate"):
        if name in mixed:
            mixed[name] /= 2.0
    return mixed


def clear_sensor(arguments: dict[str, Any], without: Collection[str]) -> dict[str, Any]:
    """The arguments of a sensor that lacks the faults ``without``."""
    gone = {name for fault in without for name in _ARGUMENTS.get(fault, ())}
    return {name: value for name, value in arguments.items() if name not in gone}


def observe(motion: Motion, rng: np.random.Generator, without: Collection[str], fault: str | None = None) -> Motion:
    """Spoil the positions and what is seen of a motion by a fault, or by one that is drawn.

    Lengths are relative to the median way of a UAV in a step.
    """
    names = [name for name in _ON_ARRAYS if name not in without]
    if not names:
        return motion
    fault = fault or str(rng.choice(names))
    position, seen = np.array(motion.position, np.float64), motion.seen
    step = np.linalg.norm(np.diff(position, axis=1), axis=-1)
    unit = float(np.median(step[seen[:, 1:] & seen[:, :-1]])) + 0.1 * float(step.mean())
    if fault == "fault:noise":
        position += unit * draw_log(rng, 0.02, 0.6) * rng.standard_normal(position.shape) * position.any((0, 1, 2))
    elif fault == "fault:rounding":
        grain = unit * draw_log(rng, 0.1, 3.0)
        position = grain * np.round(position / grain)
    else:
        rate = float(draw_log(rng, 0.001, 0.02) if fault == "fault:jumps" else rng.uniform(0.02, 0.3))
        last = int(rng.integers(2, 9)) if fault != "fault:missed" else 1
        begin = rng.random(seen.shape) < rate / last
        hit = np.logical_or.reduce([np.roll(begin, lag, axis=1) for lag in range(last)])
        if fault != "fault:jumps":
            return motion._replace(seen=seen & ~hit)
        way = rng.standard_normal((*seen.shape[:1], 1, *seen.shape[2:], 3)) * position.any((0, 1, 2))
        position += hit[..., None] * unit * draw_log(rng, 3.0, 50.0) * way
    return motion._replace(position=position, velocity=None)

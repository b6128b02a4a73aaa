"""What observers do to the motion of a swarm: faults of the simulator's sensor, and faults of arrays."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from detectors.reader.prior.draws import draw_log
from detectors.reader.prior.motion import Motion

_ON_ARRAYS = ("fault:noise", "fault:missed", "fault:bursts", "fault:jumps", "fault:rounding")


def _draw_sensors(rng: np.random.Generator) -> dict[str, dict[str, Any]]:
    """Draw the arguments of the simulator's sensor for each fault that it has; the last is the fault itself."""
    noise, missed = float(draw_log(rng, 0.03, 0.6)), float(rng.uniform(0.03, 0.35))
    return {
        "fault:noise": {"position_noise": noise},
        "fault:correlated": {"position_noise": 2.0 * noise, "noise_memory": float(rng.uniform(0.5, 0.97))},
        "fault:course": {"position_noise": noise / 3.0, "course_noise": float(draw_log(rng, 1.5, 6.0))},
        "fault:missed": {"miss_rate": missed},
        "fault:bursts": {"miss_rate": missed, "miss_burst": float(rng.uniform(2.0, 12.0))},
        "fault:partial": {"partial_tracks": float(rng.uniform(0.05, 0.5))},
        "fault:swaps": {"swap_rate": float(draw_log(rng, 0.0003, 0.01))},
    }


def draw_sensor(rng: np.random.Generator, fault: str, without: Collection[str]) -> dict[str, Any]:
    """Draw the arguments of the simulator's sensor for a fault; a mix has 2 to 5 that aren't left out."""
    drawn = _draw_sensors(rng)
    if fault != "fault:mix":
        return drawn.get(fault, {})
    names = [name for name in drawn if name not in without]
    chosen = rng.permutation(names)[: int(rng.integers(2, 6))].tolist()
    return {key: value for name in chosen for key, value in drawn[name].items()}


def clear_sensor(arguments: dict[str, Any], without: Collection[str]) -> dict[str, Any]:
    """The arguments of a sensor that lacks the faults ``without``."""
    gone = {list(names)[-1] for fault, names in _draw_sensors(np.random.default_rng(0)).items() if fault in without}
    return {name: value for name, value in arguments.items() if name not in gone}


def observe(motion: Motion, rng: np.random.Generator, without: Collection[str], fault: str | None = None) -> Motion:
    """Spoil positions, or what is seen of a motion, by a fault, or by one that is drawn and isn't left out.

    Lengths are relative to the median way of a UAV in a step.
    """
    names = [name for name in _ON_ARRAYS if name not in without]
    fault = fault or str(rng.choice([*names, "none"]))
    position, seen = np.array(motion.position, np.float64), motion.seen
    way = np.linalg.norm(np.diff(position, axis=1), axis=-1)
    unit = float(np.median(way)) + 0.1 * float(np.minimum(way, 5.0 * np.median(way)).mean()) + 1e-9
    noise = rng.standard_normal(position.shape) * position.any((0, 1, 2))  # none in an axis without motion
    if fault == "fault:noise":
        position += unit * draw_log(rng, 0.02, 0.6) * noise
    elif fault == "fault:rounding":
        grain = unit * draw_log(rng, 0.1, 3.0)
        position = grain * np.round(position / grain)
    elif fault != "none":
        last = 1 if fault == "fault:missed" else int(rng.integers(2, 9))
        rate = draw_log(rng, 0.001, 0.02) if fault == "fault:jumps" else rng.uniform(0.02, 0.3)
        begin = rng.random(seen.shape) < rate / last
        hit = np.logical_or.reduce([np.roll(begin, lag, axis=1) for lag in range(last)])
        if fault != "fault:jumps":
            return motion._replace(seen=seen & ~hit)
        position += hit[..., None] * unit * draw_log(rng, 3.0, 50.0) * noise[:, :1]
    return motion._replace(position=position, velocity=None)

"""What observers make of a motion: the examples, how they are sampled, and the faults of sensors."""

from collections.abc import Collection
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from detectors.reader.examples import Examples
from detectors.reader.prior.families import draw_log
from usnet_env.arrays import Floats, Mask, Singles

_ON_ARRAYS = ("fault:noise", "fault:missed", "fault:bursts", "fault:partial", "fault:jumps", "fault:rounding")


def make_examples(position: Floats | Singles, seen: Mask, truth: Any, velocity: Singles | None = None) -> Examples:
    """The windows of a motion with its ``truth``, the fields from ``head`` on; velocities follow from the places."""
    change = np.diff(position, axis=1) if velocity is None else velocity
    both_seen = (seen[:, 1:] & seen[:, :-1])[..., None]
    position, change = np.where(seen[..., None], position, 0.0), np.where(both_seen, change, 0.0)
    return Examples(position.astype(np.float32), change.astype(np.float32), seen, *truth)


def resample(examples: Examples, instants: Floats, degree: int) -> Examples:
    """Sample at evenly spaced instants, in steps; between those of the examples by splines, if all is seen there."""
    position, rows = examples.position, instants.astype(np.int64)
    if instants[1] > 1 or examples.seen.all():
        position = make_interp_spline(np.arange(position.shape[1]), position, degree, axis=1)(instants)
        delay = examples.delay / np.float32(instants[1])
        return make_examples(position, examples.seen[:, rows], examples._replace(delay=delay)[3:])
    return examples


def stride_examples(examples: Examples) -> Examples:
    """Every second sample of the windows."""
    delay = examples.delay / np.float32(2)
    return make_examples(examples.position[:, ::2], examples.seen[:, ::2], examples._replace(delay=delay)[3:])


def draw_sensors(rng: np.random.Generator, without: Collection[str] = ()) -> dict[str, dict[str, Any]]:
    """Draw the arguments of the simulator's sensor for each fault that it has; the last is the fault itself."""
    noise, missed = float(draw_log(rng, 0.03, 0.6)), float(rng.uniform(0.03, 0.35))
    drawn: dict[str, dict[str, Any]] = {
        "fault:noise": {"position_noise": noise},
        "fault:correlated": {"position_noise": 2.0 * noise, "noise_memory": float(rng.uniform(0.5, 0.97))},
        "fault:course": {"position_noise": noise / 3.0, "course_noise": float(draw_log(rng, 1.5, 6.0))},
        "fault:missed": {"miss_rate": missed},
        "fault:bursts": {"miss_rate": missed, "miss_burst": float(rng.uniform(2.0, 12.0))},
        "fault:partial": {"partial_tracks": float(rng.uniform(0.05, 0.5))},
        "fault:swaps": {"swap_rate": float(draw_log(rng, 0.0003, 0.01))},
    }
    names = rng.permutation([name for name in drawn if name not in without])[: int(rng.integers(2, 6))].tolist()
    return drawn | {"fault:mix": {key: value for name in names for key, value in drawn[name].items()}}


def _draw_stays(rng: np.random.Generator, windows: int, instants: int, uavs: int) -> Mask:
    """When UAVs are in view ``(B, T + 1, n)``: many always, others once, for a tenth of the window or more."""
    stay = instants * draw_log(rng, 0.1, 1.0, windows, 1, uavs)
    time = np.arange(instants)[:, None] - rng.uniform(0.0, instants - stay)
    always = rng.random((windows, 1, uavs)) < rng.uniform(0.4, 0.9)
    return always | ((time >= 0.0) & (time <= stay))


def observe(examples: Examples, rng: np.random.Generator, without: Collection[str], fault: str = "") -> Examples:
    """Spoil the places, or what is seen, by a fault, or by one that is drawn; lengths in ways of a step."""
    fault = fault or str(rng.choice([name for name in _ON_ARRAYS if name not in without] or ["none"]))
    position, seen = examples.position.astype(np.float64), examples.seen
    speed = np.linalg.norm(examples.velocity, axis=-1)
    unit = float(np.median(speed)) + 0.1 * float(speed.mean()) + 1e-9
    noise = unit * rng.standard_normal(position.shape) * position.any((0, 1, 2))  # none in an axis without motion
    duration = 1 if fault == "fault:missed" else int(rng.integers(2, 9))
    rate = draw_log(rng, 0.001, 0.02) if fault == "fault:jumps" else rng.uniform(0.02, 0.3)
    begin = rng.random(seen.shape) < rate / duration
    is_hit = np.logical_or.reduce([np.roll(begin, lag, axis=1) for lag in range(duration)])
    if fault == "fault:noise":
        position += draw_log(rng, 0.02, 0.8) * noise
    elif fault == "fault:rounding":
        grain = unit * draw_log(rng, 0.1, 3.0)
        position = grain * np.round(position / grain)
    elif fault == "fault:jumps":
        position += is_hit[..., None] * draw_log(rng, 3.0, 50.0) * noise[:, :1]
    elif fault == "fault:partial":
        seen = seen & _draw_stays(rng, *seen.shape)
    elif fault != "none":
        seen = seen & ~is_hit
    return make_examples(position, seen, examples[3:])

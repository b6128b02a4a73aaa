"""The prior: everything that the reader learns from, drawn family by family."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from detectors.reader.examples import Examples
from detectors.reader.prior.draws import draw_log, draw_name
from detectors.reader.prior.faults import observe
from detectors.reader.prior.motion import Motion, make_examples, resample
from detectors.reader.prior.swarms import draw_field_swarm, draw_model_swarm, fly_swarms
from detectors.reader.prior.table import (
    FAULT_SHARE,
    FAULTS,
    FIELD_SHARE,
    MODEL_SHARE,
    MODELS,
    PRIOR_VERSION,
    WORLD_SHARE,
)
from detectors.reader.prior.worlds import WORLDS

__all__ = ["FAMILIES", "PRIOR_VERSION", "draw_examples"]

_PARTS = (
    (MODEL_SHARE, MODELS),
    (FAULT_SHARE, FAULTS),
    (WORLD_SHARE, {name: world.weight for name, world in WORLDS.items()}),
)
_WEIGHTS = {"field": FIELD_SHARE} | {
    name: share * weight / sum(part.values()) for share, part in _PARTS for name, weight in part.items()
}
FAMILIES: tuple[str, ...] = tuple(_WEIGHTS)


def _keep(weights: dict[str, float], without: Collection[str]) -> dict[str, float]:
    return {name: weight for name, weight in weights.items() if name not in without}


def draw_examples(
    rng: np.random.Generator,
    windows: int,
    *,
    without: Collection[str] = (),
    family: str | None = None,
    most_uavs: int = 82,
) -> Examples:
    """Draw labelled windows of one family, all with the same number of UAVs and steps.

    Args:
        rng: the generator; equal generators draw equal windows, bit for bit.
        windows: B, number of windows.
        without: models, faults and worlds that are left out, as parts of other families too.
        family: the family; ``None``: drawn.
        most_uavs: the largest number of UAVs, at least 8.
    """
    family = family or draw_name(rng, _keep(_WEIGHTS, without))
    steps = 100 if rng.random() < 0.55 else round(float(draw_log(rng, 20.0, 200.0)))
    if family == "field":
        motion = fly_swarms(draw_field_swarm(rng, steps, most_uavs, without), rng, windows)
    elif family in FAULTS:
        model = draw_name(rng, _keep(MODELS, without))
        motion = fly_swarms(draw_model_swarm(rng, model, steps, most_uavs, family, without), rng, windows)
        if family in ("fault:jumps", "fault:rounding"):
            motion = observe(motion, rng, without, family)
    else:
        motion = _draw_sampled(rng, family, windows, steps, most_uavs)
        if family in WORLDS and rng.random() < 0.25:
            motion = observe(motion, rng, without)
    return make_examples(motion, family)


def _draw_sampled(rng: np.random.Generator, family: str, windows: int, steps: int, most_uavs: int) -> Motion:
    """Draw motions of a model or world, of which 8 % are sampled slowly, 8 % fast, and 8 % seen on a plane."""
    pace, times = rng.random(), int(rng.integers(2, 6))
    instants = np.arange(steps + 1.0)
    if pace < 0.08:
        instants *= min(times, 400 // steps)
    elif pace > 0.92:
        instants /= max(1, min(times, steps // 16))
    flown = int(np.ceil(instants[-1]))
    if family in WORLDS:
        motion = WORLDS[family].draw(rng, windows, flown, most_uavs)
    else:
        motion = fly_swarms(draw_model_swarm(rng, family, flown, most_uavs, "none", ()), rng, windows)
    if instants[1] > 1 or (instants[1] < 1 and motion.seen.all()):
        motion = resample(motion, instants, int(rng.choice([1, 3])))
    if rng.random() < 0.08:
        motion = motion._replace(position=motion.position * np.array([1.0, 1.0, 0.0]), velocity=None)
    return motion

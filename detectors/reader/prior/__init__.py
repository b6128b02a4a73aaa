"""The prior: everything that the reader learns from, drawn family by family."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from detectors.reader.examples import Examples
from detectors.reader.prior.draws import draw_name
from detectors.reader.prior.faults import observe
from detectors.reader.prior.motion import Motion, fill, flatten, make_examples, thin
from detectors.reader.prior.swarms import draw_field_swarm, draw_model, draw_model_swarm, draw_steps, fly_swarms
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


def _weigh_families() -> dict[str, float]:
    """The probability of each family."""
    weights = {"field": FIELD_SHARE}
    parts = (
        (MODELS, MODEL_SHARE),
        (FAULTS, FAULT_SHARE),
        ({name: world.weight for name, world in WORLDS.items()}, WORLD_SHARE),
    )
    for names, share in parts:
        weights.update({name: share * weight / sum(names.values()) for name, weight in names.items()})
    return weights


_WEIGHTS = _weigh_families()
FAMILIES: tuple[str, ...] = tuple(_WEIGHTS)


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
        without: families that are left out, of a draw within another family too: a model, a fault or a world.
        family: the family; ``None``: drawn.
        most_uavs: the largest number of UAVs.
    """
    weights = {name: weight for name, weight in _WEIGHTS.items() if name not in without}
    family = family or draw_name(rng, weights)
    steps = draw_steps(rng)
    if family == "field" or family in FAULTS:
        if family == "field":
            config = draw_field_swarm(rng, steps, most_uavs, without)
        else:
            config = draw_model_swarm(rng, draw_model(rng, without), steps, most_uavs, family)
        motion = fly_swarms(config, rng, windows)
        if family in ("fault:jumps", "fault:rounding"):
            motion = observe(motion, rng, without, family)
        return make_examples(motion, family)
    return make_examples(_draw_motion(rng, family, windows, steps, most_uavs, without), family)


def _draw_motion(
    rng: np.random.Generator, family: str, windows: int, steps: int, most_uavs: int, without: Collection[str]
) -> Motion:
    """Draw motions of a model or world, sampled slowly or interpolated in 8 % each, flat in 8 %."""
    pace, times = rng.random(), int(rng.integers(2, 6))
    slow, fast = min(times, 400 // steps), max(1, min(times, steps // 16))
    flown = steps * slow if pace < 0.08 else -(-steps // fast) if pace > 0.92 else steps
    if family in WORLDS:
        motion = WORLDS[family].draw(rng, windows, flown, most_uavs)
    else:
        motion = fly_swarms(draw_model_swarm(rng, family, flown, most_uavs), rng, windows)
    if pace < 0.08:
        motion = thin(motion, slow)
    elif pace > 0.92 and motion.seen.all():
        motion = fill(motion, fast, steps, bool(rng.random() < 0.5))
    if rng.random() < 0.08:
        motion = flatten(motion)
    return observe(motion, rng, without) if family in WORLDS and rng.random() < 0.25 else motion

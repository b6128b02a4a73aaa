"""The prior: everything that the reader learns from, drawn family by family."""

from collections.abc import Collection

import numpy as np

from detectors.reader.examples import Examples
from detectors.reader.features import LEAST_STRIDED
from detectors.reader.prior.families import (
    FAULTS,
    LAWS,
    MODELS,
    OBSERVED,
    PRIOR_VERSION,
    SHARES,
    WORLDS,
    draw_name,
    draw_steps,
)
from detectors.reader.prior.observing import make_examples, observe, resample, stride_examples
from detectors.reader.prior.swarms import draw_field_swarm, draw_model_swarm, fly_swarms
from detectors.reader.prior.worlds import fly_world

__all__ = ["FAMILIES", "PRIOR_VERSION", "draw_examples"]

_WEIGHTS = {name: share * weight / sum(part.values()) for share, part in SHARES for name, weight in part.items()}
_STRIDED = 1 / 3  # share of the windows of which every second sample is seen, as the detector also reads them
_LAWS_SPOILED = 0.4  # share of random laws among the models whose sensors have a fault
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
        without: models, faults and worlds that are left out, as parts of other families too.
        family: the family; ``None``: drawn.
        most_uavs: the largest number of UAVs, at least 8.
    """
    family = family or draw_name(rng, _WEIGHTS, without)
    steps = draw_steps(rng, family)
    if family == "field":
        drawn = fly_swarms(draw_field_swarm(rng, steps, most_uavs, without), rng, windows)
    elif family in FAULTS:
        model = draw_name(rng, LAWS if rng.random() < _LAWS_SPOILED else MODELS, without)
        drawn = fly_swarms(draw_model_swarm(rng, model, steps, most_uavs, family, without), rng, windows)
        if family in ("fault:jumps", "fault:rounding"):
            drawn = observe(drawn, rng, without, family)
    else:
        drawn = _draw_sampled(rng, family, windows, steps, most_uavs, without)
        if family in WORLDS and rng.random() < OBSERVED.get(family, 0.25):
            drawn = observe(drawn, rng, without)
    if drawn.velocity.shape[1] >= LEAST_STRIDED and rng.random() < _STRIDED:
        drawn = stride_examples(drawn)
    return drawn._replace(family=family)


def _draw_sampled(
    rng: np.random.Generator, family: str, windows: int, steps: int, most_uavs: int, without: Collection[str]
) -> Examples:
    """Draw windows of a model or world, of which 8 % are sampled slowly, 8 % fast, and 8 % seen on a plane."""
    case, times, instants = rng.random(), int(rng.integers(2, 6)), np.arange(steps + 1.0)
    if case < 0.08:
        instants *= min(times, 400 // steps)
    elif case > 0.92:
        instants /= max(1, min(times, steps // 16))
    flown_steps = int(np.ceil(instants[-1]))
    if family in WORLDS:
        drawn = fly_world(rng, family, windows, flown_steps, most_uavs)
    else:
        drawn = fly_swarms(draw_model_swarm(rng, family, flown_steps, most_uavs, without=without), rng, windows)
    if instants[1] != 1:
        drawn = resample(drawn, instants, int(rng.choice([1, 3])))
    if rng.random() < 0.08:
        drawn = make_examples(drawn.position * np.array([1.0, 1.0, 0.0]), drawn.seen, drawn[3:])
    return drawn

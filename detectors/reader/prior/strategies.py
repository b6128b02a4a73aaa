"""Follow strategies of the prior: random ones, and the field models with their constants varied."""

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np

from detectors.reader.prior.random_laws import draw_law
from usnet_env.swarm import FOLLOW_STRATEGIES, FollowStrategy
from usnet_env.swarm.field_follow import Chain, CopyingStrategy, FormationSlots, Hierarchy, MixedStrategies
from usnet_env.swarm.random_follow import RandomFollowStrategy, random_follow_strategy

MEMORY = 12  # T_0, steps that a strategy may use


def _draw_random(rng: np.random.Generator) -> RandomFollowStrategy:
    """Draw a random strategy; of a third all terms are linear, and half of these turn nothing."""
    linear, unturned, drawn = rng.random() < 1 / 3, rng.random() < 0.5, random_follow_strategy(rng)
    while linear and any(term.kind != "linear" or (term.lag == 0 and term.weight > 0) for term in drawn.terms):
        drawn = random_follow_strategy(rng)  # without the second condition f1, f2 and f3 could be drawn
    rotation = None if linear and unturned else drawn.rotation
    return replace(drawn, rotation=rotation, noise=drawn.noise * float(2.0 ** rng.integers(-1, 3)))


def draw_strategy(rng: np.random.Generator, name: str, steps: int = 100) -> str | FollowStrategy:
    """Draw the strategy of a family; half of the field models have other constants than their own."""
    if name == "random":
        return _draw_random(rng)
    if name == "random_law":
        return draw_law(rng, steps)
    if name == "none" or rng.random() < 0.5:
        return name
    strategy: Any = FOLLOW_STRATEGIES.find(name)
    spread = 0.3 if rng.random() < 0.7 else 0.7
    numbers = {field.name: getattr(strategy, field.name) for field in fields(strategy)}
    changed: dict[str, Any] = {
        key: value * math.exp(spread * rng.standard_normal()) for key, value in numbers.items() if type(value) is float
    }
    for probability in changed.keys() & {"share", "response_probability"}:
        changed[probability] = min(changed[probability], 0.95)
    if isinstance(strategy, CopyingStrategy | MixedStrategies):
        changed["block_steps"] = int(rng.integers(6, 41))
    if isinstance(strategy, CopyingStrategy) and not strategy.strength:
        links = int(rng.integers(1, 5)) if isinstance(strategy, Hierarchy) else 1
        latest = int(rng.integers(1, MEMORY // links + 1))
        low, high = np.sort(rng.uniform(0.1 if rng.random() < 0.2 else 0.4, 1.0, 2)).tolist()
        changed.update(links=links, delays=(int(rng.integers(1, latest + 1)), latest), gains=(low, high))
        changed["noises"] = (0.5, float(rng.uniform(1.0, 4.0)))
    if isinstance(strategy, Chain):
        changed["depth"] = int(rng.integers(1, 6))
    if isinstance(strategy, FormationSlots):
        changed.update(delays=(1, int(rng.integers(1, MEMORY + 1))), smoothing=int(rng.integers(3, MEMORY + 1)))
    return replace(strategy, **changed)

"""Small draws that all families share."""

from collections.abc import Mapping

import numpy as np

from usnet_env.arrays import Floats


def draw_name(rng: np.random.Generator, weights: Mapping[str, float]) -> str:
    """Draw a name by its weight."""
    share = np.array(list(weights.values()))
    return list(weights)[int(rng.choice(len(share), p=share / share.sum()))]


def draw_log(rng: np.random.Generator, low: float, high: float, *shape: int) -> Floats:
    """Draw log-uniform numbers of a shape, by default one."""
    return np.exp(rng.uniform(np.log(low), np.log(high), shape))


def draw_whole(rng: np.random.Generator, low: int, high: int) -> int:
    """Draw one log-uniform whole number, both ends included."""
    return int(np.clip(np.rint(draw_log(rng, low - 0.49, high + 0.49)), low, high))

"""Feature classes: the functions of a head's past of which a follow strategy may be a linear combination."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from math import prod

import numpy as np

from usnet_env.arrays import Floats, Indices

_ALL = 1_000_000  # of the last velocities: all L
#: Of each class: how many of the last velocities ``v`` and of their axis-wise squares ``v²`` it has, and whether it has
#: the products ``vv`` of two axes of the newest velocity, and those ``v×v`` of its axes with those of the one before.
CLASSES = {
    "v(1)": (1, 0, 0, 0),
    "v²(1)": (0, 1, 0, 0),
    "v(L)": (_ALL, 0, 0, 0),
    "v²(L)": (0, _ALL, 0, 0),
    "v+v²+vv(1)": (1, 1, 1, 0),
    "v+v²(L)": (_ALL, _ALL, 0, 0),
    "v+v²+v×v(2)": (2, 2, 0, 1),
}
#: The search begins with few classes, and takes all if these leave a doubt.
LEVELS = (("v(1)", "v²(1)", "v(L)"), tuple(CLASSES))
#: Classes by which a single UAV chooses a head: of few features, because it pays for them alone.
LONE = ("v(1)", "v²(1)")
#: Classes by which candidates are screened; they contain the others.
SCREENED = tuple(name for name in CLASSES if name != "v²(L)")


def make_features(past: Floats, names: Iterable[str]) -> tuple[Floats, dict[str, Indices]]:
    """Compute the features of some classes, each once, although several classes have it.

    Args:
        past: ``(n, L, a, R)`` velocities before each of R times, newest first.
        names: of the classes; with L = 1, those of several velocities are left out.

    Returns:
        The features ``(n, p, R)``, each with mean 0, and the indices ``(k,)`` of those of each class.
    """
    uavs, lags, axes, rows = past.shape
    (depth, squares, both, crossed), columns = _list_columns(tuple(names), lags, axes)
    blocks = [past[:, :depth], past[:, :squares] ** 2]
    if both:
        one, other = np.triu_indices(axes, 1)
        blocks.append(past[:, 0, one[::-1]] * past[:, 0, other[::-1]])
    if crossed:
        blocks.append(past[:, 0, :, None] * past[:, 1, None, :])
    values = np.concatenate([block.reshape(uavs, prod(block.shape[1:-1]), rows) for block in blocks], axis=1)
    values -= values.mean(axis=2, keepdims=True)
    return values, columns


@cache
def _list_columns(names: tuple[str, ...], lags: int, axes: int) -> tuple[tuple[int, ...], dict[str, Indices]]:
    """The parts that some of the classes have, and the indices of the features of each class among all of them."""
    parts = {name: CLASSES[name] for name in names if lags > 1 or max(CLASSES[name]) == 1}
    whole = tuple(map(max, zip(*parts.values(), strict=True)))

    def count(part: tuple[int, ...]) -> list[int]:
        singles = [axes * min(number, lags) for number in part[:2]]
        return [*singles, part[2] * axes * (axes - 1) // 2, part[3] * axes**2]

    starts = np.cumsum([0, *count(whole)])
    ranges = {name: zip(starts, count(part), strict=False) for name, part in parts.items()}
    return whole, {name: np.concatenate([s + np.arange(k) for s, k in some]) for name, some in ranges.items()}

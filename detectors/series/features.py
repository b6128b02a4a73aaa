"""Feature classes: the functions of a head's past of which a follow strategy may be a linear combination."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import prod

import numpy as np

from usnet_env.arrays import Floats

#: Name of each class and the features of it: ``v`` velocities, ``v²`` their axis-wise squares, ``vv`` products of two
#: axes of the newest velocity, ``v×v`` products of each axis of the newest velocity with each axis of the one before.
CLASSES = {
    "v(1)": "the newest velocity",
    "v²(1)": "its axis-wise squares",
    "v(L)": "the last L velocities",
    "v²(L)": "their axis-wise squares",
    "v+v²+vv(1)": "the newest velocity, its squares and its products of two axes",
    "v+v²(L)": "the last L velocities and their axis-wise squares",
    "v+v²+v×v(2)": "the last two velocities, their squares and the products of their axes",
}
#: The search begins with few classes, and takes all if these leave a doubt.
LEVELS = (("v(1)", "v²(1)", "v(L)"), tuple(CLASSES))
#: Classes by which a single UAV chooses a head: of few features, because it pays for them alone.
LONE = ("v(1)", "v²(1)")
#: Classes by which candidates are screened; they contain the others.
SCREENED = ("v(1)", "v²(1)", "v(L)", "v+v²+vv(1)", "v+v²(L)", "v+v²+v×v(2)")


def make_features(past: Floats, names: Iterable[str]) -> Iterator[tuple[str, Floats]]:
    """Yield the name and the features ``(n, R, p)`` of the classes that L allows; each column has mean 0.

    Args:
        past: ``(n, R, L, a)`` velocities before each row's time, newest first.
        names: of the classes.
    """
    newest, two = past[:, :, :1], past[:, :, :2]
    one, other = np.triu_indices(past.shape[3], 1)
    for name in names:
        if name == "v(1)":
            parts = [newest]
        elif name == "v²(1)":
            parts = [newest**2]
        elif name == "v+v²+vv(1)":
            parts = [newest, newest**2, newest[..., one[::-1]] * newest[..., other[::-1]]]
        elif past.shape[2] == 1:
            continue
        elif name == "v(L)":
            parts = [past]
        elif name == "v²(L)":
            parts = [past**2]
        elif name == "v+v²(L)":
            parts = [past, past**2]
        else:
            parts = [two, two**2, past[:, :, 0, :, None] * past[:, :, 1, None, :]]
        flat = np.concatenate([part.reshape(*part.shape[:2], prod(part.shape[2:])) for part in parts], axis=2)
        yield name, np.asarray(flat - flat.mean(axis=1, keepdims=True))

"""Names in figures: abbreviated in the middle, and placed beside points so that they can be read."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env.arrays import Floats
from usnet_env.drawing.style import escape_math

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Text

_OFFSET = 7  # points between a point and its name
_INSET = 4  # points between a name and the frame; in a file with more pixels, texts are a little wider
_WEIGHT = 10  # a name on another one is worse than a name on a point
_LINES = (1, -1, 2, -2, 3, -3, 4, -4)  # heights of a text above or below the places next to its point
_POINT = 6  # points around a point that names leave free


def abbreviate(names: Sequence[str], longest: int) -> list[str]:
    """Shorten names in their middle, so that different ones stay different.

    A long name keeps its start and its end. Names that share both keep also the part between in which they differ, with
    all digits of a number; so they may be longer than ``longest``.

    Args:
        names: the names.
        longest: characters of a name that are kept, at least 5.
    """
    while True:
        short = _shorten(names, longest)
        if len(set(short)) == len(set(names)):
            return short
        longest += 1  # at last, no name is shortened


def _shorten(names: Sequence[str], longest: int) -> list[str]:
    """Shorten names one by one, and then those that became equal by what is common to them."""
    half = (longest - 1) // 2
    short = {each: each if len(each) <= longest else f"{each[: longest - 1 - half]}…{each[-half:]}" for each in names}
    alike: dict[str, list[str]] = {}
    for name, shown in short.items():
        alike.setdefault(shown, []).append(name)
    for group in alike.values():
        if len(group) > 1:
            short |= _shorten_common(group, longest // 3)
    return [short[each] for each in names]


def _shorten_common(names: Sequence[str], kept: int) -> dict[str, str]:
    """Shorten the start and the end that names have in common to some characters; those between stay."""
    start = _common_start(names).rstrip("0123456789")
    rest = [name[len(start) :] for name in names]
    end = _common_start([each[::-1] for each in rest])[::-1].lstrip("0123456789")
    head = start if len(start) <= kept + 1 else f"{start[:kept]}…"
    tail = end if len(end) <= kept + 1 else f"…{end[-kept:]}"
    return {name: f"{head}{each.removesuffix(end)}{tail}" for name, each in zip(names, rest, strict=True)}


def _common_start(texts: Sequence[str]) -> str:
    first, last = min(texts), max(texts)  # all others are between them
    length = next((k for k, (one, other) in enumerate(zip(first, last, strict=False)) if one != other), len(first))
    return first[:length]


def text_size(text: Text) -> tuple[float, float]:
    """Width and height of a text in pixels. Characters that the font lacks count as boxes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the figure's file warns of them
        box = text.get_window_extent()
    return float(box.width), float(box.height)


def annotate_points(axes: Axes, places: Floats, names: Sequence[str], **style: Any) -> None:
    """Write names beside points: inside the frame, and where they cover the fewest other names and points.

    Args:
        axes: axes whose limits and place in the figure are final.
        places: ``(n, 2)`` the points in the units of the axes.
        names: the n names.
        style: of the texts, as ``Axes.annotate`` takes it.
    """
    figure: Any = axes.get_figure(root=True)
    pixels = figure.dpi / 72
    frame = axes.get_window_extent().padded(-_INSET * pixels)
    points = axes.transData.transform(places)
    around = np.hstack([points - _POINT * pixels, points + _POINT * pixels])
    written = np.empty((0, 4))
    for k, (name, point) in enumerate(zip(names, points, strict=True)):
        text = axes.annotate(
            escape_math(name), places[k].tolist(), (0, 0), textcoords="offset points", annotation_clip=False, **style
        )
        size = np.array(text_size(text))
        corners = _find_corners(point, size, _OFFSET * pixels)
        corners = np.clip(corners, (frame.x0, frame.y0), np.maximum((frame.x1, frame.y1) - size, (frame.x0, frame.y0)))
        boxes = np.hstack([corners, corners + size])
        best = boxes[int(np.argmin(_WEIGHT * _cover(boxes, written) + _cover(boxes, around)))]
        text.set_position(((best[:2] - point) / pixels).tolist())
        written = np.vstack([written, best])


def _find_corners(point: Floats, size: Floats, offset: float) -> Floats:
    """Lower left corners ``(n, 2)`` of a text of a size around a point, the preferred one first, in pixels."""
    width, height = size
    right, left, centre = offset, -offset - width, -width / 2
    above, below, beside = offset, -offset - height, -height / 2
    near = [(x, y) for y in (above, below, beside) for x in (right, left)] + [(centre, above), (centre, below)]
    return point + np.array([(x, y + lines * height) for lines in (0, *_LINES) for x, y in near])


def _cover(boxes: Floats, taken: Floats) -> Floats:
    """The area that each of some boxes ``(n, 4)`` shares with those that are taken ``(m, 4)``, ``(n,)``."""
    low = np.maximum(boxes[:, None, :2], taken[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], taken[None, :, 2:])
    return np.asarray(np.maximum(high - low, 0).prod(axis=2).sum(axis=1))

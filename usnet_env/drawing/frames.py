"""Frames of an episode as pixels, for the environments' ``render``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.drawing.maps import Limits, draw_round, last_seen_position, limits_around, new_figure

_MARGIN_OF_FRAMES = 0.4  # room for the swarm to drift and spread before the axes have to grow


def round_frame(*window: Any, size: tuple[int, int] = (960, 720), **look: Any) -> NDArray[np.uint8]:
    """Render :func:`draw_round` to pixels, ``(H, W, 3)`` uint8.

    Args:
        window: as :func:`draw_round` takes them: the arrays of a window, the truth, and the candidates.
        size: width and height in pixels.
        look: keyword arguments of :func:`draw_round`, but for ``axes``.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    width, height = size
    figure = new_figure(9.6, 9.6 * height / width, dpi=width / 9.6)
    axes = figure.add_axes((0.07, 0.08, 0.66, 0.86))
    draw_round(*window, axes=axes, **look)
    canvas: Any = figure.canvas
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def describe_frame(
    number: int, hits: int, redundant: int, objective: float, reward: float | None = None, over_budget: bool = False
) -> str:
    """The title of the frame of a round that was played: its result, J so far, and the reward."""
    found = f"{hits} {'head' if hits == 1 else 'heads'} hit, {redundant} redundant"
    result = "over the shot budget" if over_budget else found
    return f"round {number}: {result}   J {objective:.3f}" + ("" if reward is None else f"   reward {reward:.3f}")


class EpisodeFrames:
    """Renders the frames of one episode: on axes that stay in place, with the UAVs destroyed in earlier rounds.

    The axes fit the first window with a margin. If a later window does not fit, they are fitted to all windows so far.
    """

    def __init__(self) -> None:
        self._limits: Limits | None = None
        self._corners = np.full((2, 3), np.nan, np.float32)  # of the box around all UAVs of all windows
        self._last: NDArray[np.float32] | None = None  # where each UAV was seen last

    def watch(self, position: NDArray[np.float32], seen: NDArray[np.bool_]) -> None:
        """Take note of a window; to be called once for each window of the episode, in their order.

        Args:
            position: ``(T_ob + 1, N, 3)`` metres.
            seen: ``(T_ob + 1, N)`` bool.
        """
        place = last_seen_position(position, seen)
        self._last = place if self._last is None else np.where(np.isfinite(place), place, self._last)
        if not np.isfinite(place).any():
            return
        corners = np.stack([np.nanmin(place, axis=0), np.nanmax(place, axis=0)])
        self._corners = np.stack([np.fmin(corners[0], self._corners[0]), np.fmax(corners[1], self._corners[1])])
        x, y, half = self._limits or (0.0, 0.0, -1.0)
        if (np.abs(corners[:, :2] - (x, y)) > half).any():
            self._limits = limits_around(self._corners, _MARGIN_OF_FRAMES)

    def render(self, **scene: Any) -> NDArray[np.uint8]:
        """Render a window as :func:`round_frame` does, ``(H, W, 3)`` uint8.

        Args:
            scene: arguments of :func:`draw_round` by name, but for ``axes``, ``destroyed_at`` and ``limits``.

        Raises:
            MissingExtraError: matplotlib is not installed.
        """
        return round_frame(**scene, destroyed_at=self._last, limits=self._limits)

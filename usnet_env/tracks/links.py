"""Direct leaders of followers in a window of recorded tracks, and the delays in seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from usnet_env.arrays import Floats
from usnet_env.detection import Detection
from usnet_env.tracks.windows import TrackWindow

_MOST_LAG = 12  # steps
_DIGITS = 9  # decimals of a delay
_LEAST_STEPS = 4  # of the window for each step of the longest lag


@dataclass(frozen=True)
class Link:
    """A follower and the id that it follows directly.

    Args:
        follower: as in the file.
        leader: the id that it follows directly: a head, or a relay that follows the head itself.
        head: the leader of the whole group.
        delay: seconds, a whole number of steps, after which the velocity of the follower agrees best with that of the
            leader. ``None``: no delay of a step or more fits better than none, or one of the two does not change its
            velocity while both are seen.
    """

    follower: str | int
    leader: str | int
    head: str | int
    delay: float | None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return dict(vars(self))


def find_links(
    cut: TrackWindow, detection: Detection, heads: Sequence[int], followers: Sequence[Sequence[int]]
) -> tuple[Link, ...]:
    """Find the direct leader of each follower of some heads, and the delay.

    Args:
        cut: the window.
        detection: the detector's answer; where it has no leaders, all followers of a head follow it directly.
        heads: indices of the heads.
        followers: for each head the indices of the UAVs that follow it, directly or through others.
    """
    links = []
    direct = detection.leader
    for head, led in zip(heads, followers, strict=True):
        for i in led:
            ahead = head if direct is None else int(direct[i])
            delay = _measure_delay(cut, i, ahead)
            links.append(Link(cut.ids[i], cut.ids[ahead], cut.ids[head], delay))
    return tuple(links)


def _measure_delay(cut: TrackWindow, follower: int, leader: int) -> float | None:
    """The lag, in seconds, at which the follower's velocity is most correlated with the leader's earlier velocity.

    ``None`` if this lag is 0: the delay is shorter than the step, or there is none.
    """
    window = cut.window
    seen = window.velocity_seen[:, [leader, follower]]
    both = seen.all(axis=1)
    if not both.any():
        return None
    velocity = window.velocity[:, [leader, follower]].astype(np.float64)  # (T, 2, 3)
    centred: Floats = np.where(seen[..., None], velocity - velocity[both].mean(axis=0), 0.0)
    ahead, behind = centred[:, 0], centred[:, 1]
    most = min(_MOST_LAG, len(centred) // _LEAST_STEPS)
    curve = np.array([(ahead[: len(ahead) - lag] * behind[lag:]).sum() for lag in range(most + 1)])
    lag = int(curve.argmax())
    return round(lag * cut.step, _DIGITS) if lag else None

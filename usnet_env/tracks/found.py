"""What is found in a window of recorded tracks: leaders, and who follows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usnet_env.arrays import Indices

CONFOUNDS = {
    "one path": "go along one path, each at a pace of its own",
    "one signal": "move alike, but none ahead: they follow one signal, each other, or an id without a track",
}


@dataclass(frozen=True)
class Link:
    """A follower and the id that it follows directly.

    Args:
        follower: as in the file.
        leader: the id that it follows directly: a head, or a relay that follows the head itself.
        head: the leader of the whole group.
        delay: seconds, a whole number of steps, after which the velocity of the follower agrees best with that of the
            leader; ``None``: less than a step.
    """

    follower: str | int
    leader: str | int
    head: str | int
    delay: float | None


@dataclass(frozen=True)
class Leader:
    """A leader in a window, or over the whole file.

    Args:
        id: as in the file.
        probability: the detector's probability that the id leads, or ``None``; over the file, the mean over the windows
            in which it leads.
        followers: the ids that follow it, directly or through others; over the file, in at least half of its windows.
        reason: why, a sentence.
        group: number of its group; a group keeps its number from window to window.
        score: the detector's score; over the file, the mean over the windows in which it leads.
        share: over the file, the share of the windows in which it leads; ``None`` for the leader of one window.
    """

    id: str | int
    probability: float | None
    followers: tuple[str | int, ...]
    reason: str
    group: int
    score: float
    share: float | None = None


@dataclass(frozen=True, eq=False)
class DetectedWindow:
    """A window with the leaders that a detector found in it.

    Args:
        start: time of the first instant as in the file.
        end: time of the last instant.
        leaders: the detector's candidates that are confirmed, the highest score first.
        not_confirmed: ids of the candidates that are not confirmed.
        links: the followers of the leaders, each with the id that it follows directly and its delay.
        left_out: ids that are seen in too few steps, so that the detector did not get them.
        confound: ``"one path"`` or ``"one signal"``, which ids without a confirmed leader follow, or ``""``.
        alike: these ids.
    """

    start: float | int | str
    end: float | int | str
    leaders: tuple[Leader, ...]
    not_confirmed: tuple[str | int, ...] = ()
    links: tuple[Link, ...] = ()
    left_out: tuple[str | int, ...] = ()
    confound: str = ""
    alike: tuple[str | int, ...] = ()

    def roots(self, ids: Sequence[str | int]) -> Indices:
        """``(N,)`` index of the leader of each of the window's ids; a leader has its own index, -1: none."""
        follows = {name: leader.id for leader in self.leaders for name in leader.followers}
        follows |= {leader.id: leader.id for leader in self.leaders}
        return np.array([ids.index(follows[name]) if name in follows else -1 for name in ids], np.int64)

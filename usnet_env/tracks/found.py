"""What is found in windows of recorded tracks: leaders, their followers, and what changes from window to window."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from usnet_env.arrays import Indices
from usnet_env.config import format_count, list_names
from usnet_env.detection import Detection
from usnet_env.tracks.tracks import TrackWindow

Name = str | int
Time = float | int | str  # as in the file
Kind = Literal["leads", "ends", "joins", "leaves", "changes", "merges", "splits", "takes over"]
CONFOUNDS = {
    "one path": "go along one path, each at a pace of its own",
    "one signal": "move alike, but none is seen ahead: they may follow one signal, each other, or one without a track",
}
_MAX_NAMES = 6
_SENTENCES = {
    "leads": "{new} leads {who}.",
    "ends": "{old} leads no more.",
    "joins": "{who} {follow} {new}.",
    "leaves": "{who} no longer {follow} {old}.",
    "changes": "{who} {follow} {new} instead of {old}.",
    "merges": "{old}{group} {new}.",
    "splits": "{new}, which followed {old}, leads {who}.",
    "takes over": "{new} leads {who} instead of {old}.",
}


@dataclass(frozen=True)
class Link:
    """A follower and the id that it follows directly.

    Args:
        follower: as in the file.
        leader: the id that it follows directly: a head, or a relay that follows the head itself.
        head: the leader of the whole group.
        delay: seconds after which the velocity of the follower agrees best with that of the leader; ``None``: less than
            half a sampling interval, or longer than 12 steps.
        delay_low: lower end of its 95 % interval.
        delay_high: upper end.
        direct: whether the tracks show that it follows this id directly. If not, ``leader`` is the head, which it
            follows directly or through others.
        behind_head: seconds at which its velocity agrees best with the earlier velocity of the head.
        correlation: of both velocities, at this delay.
        by_chance: the largest such correlation at any delay after 19 shifts in time.
        path: mean squared distance to where the head was, some time before, as a share of that to where it is.
    """

    follower: str | int
    leader: str | int
    head: str | int
    delay: float | None
    delay_low: float | None = None
    delay_high: float | None = None
    direct: bool = True
    behind_head: float | None = None
    correlation: float | None = None
    by_chance: float | None = None
    path: float | None = None


@dataclass(frozen=True)
class Leader:
    """A leader in a window, or over the whole file.

    Args:
        id: as in the file.
        probability: the detector's probability that the id leads, or ``None``; over the file, the mean over the windows
            in which it leads.
        followers: the ids that follow it, directly or through others; over the file, in at least half of those of its
            windows in which they are seen.
        reason: why, a sentence.
        group: number of its group; a group keeps its number from window to window.
        score: the detector's score; over the file, the mean over the windows in which it leads.
        share: over the file, the share of the windows in which it leads; ``None`` for the leader of one window.
    """

    id: str | int
    probability: float | None
    followers: tuple[Name, ...]
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

    start: Time
    end: Time
    leaders: tuple[Leader, ...]
    not_confirmed: tuple[Name, ...] = ()
    links: tuple[Link, ...] = ()
    left_out: tuple[Name, ...] = ()
    confound: str = ""
    alike: tuple[Name, ...] = ()

    def roots(self, ids: Sequence[Name]) -> Indices:
        """``(N,)`` index of the leader of each of the window's ids; a leader has its own index, -1: none."""
        follows = {name: leader.id for leader in self.leaders for name in leader.followers}
        follows |= {leader.id: leader.id for leader in self.leaders}
        return np.array([ids.index(follows[name]) if name in follows else -1 for name in ids], np.int64)


Found = tuple[TrackWindow, Detection, DetectedWindow]  # a window, the detector's answer, and what was found


@dataclass(frozen=True)
class Event:
    """A change of leaders; its text is a sentence.

    Args:
        time: when the ids begin to copy the new head, or else of the first instant of the later window, as in the file.
        kind: what happened.
        ids: those that follow another head than before, without the heads of both.
        old: the head before, or ``None``.
        new: the head from now on, or ``None``.
        low: lower end of the 95 % interval of the time; ``None``: the time is that of a window.
        high: upper end.
        probability: that it happens at all, by the detector, or ``None``.
    """

    time: Time
    kind: Kind
    ids: tuple[Name, ...]
    old: Name | None
    new: Name | None
    low: Time | None = None
    high: Time | None = None
    probability: float | None = None

    def __str__(self) -> str:
        follow = "follows" if len(self.ids) == 1 else "follow"
        group = f" and its {format_count(len(self.ids), 'follower')} follow" if self.ids else " follows"
        words = {"who": list_names(self.ids, _MAX_NAMES), "follow": follow, "group": group}
        interval = "" if self.low in (None, self.time) else f" ({self.low} to {self.high})"
        return f"From {self.time}{interval}: {_SENTENCES[self.kind].format(**words, old=self.old, new=self.new)}"


def find_events(windows: Iterable[DetectedWindow]) -> tuple[Event, ...]:
    """Compare the heads of all ids in each window with those in the window before; before the first, there are none."""
    events, old_heads = list[Event](), dict[Name, Name]()
    for window in windows:
        heads = {leader.id: leader.id for leader in window.leaders}
        heads |= {link.follower: link.head for link in window.links}
        events += compare_heads(old_heads, heads, window.start)
        old_heads = heads
    return tuple(events)


def compare_heads(old_heads: Mapping[Name, Name], new_heads: Mapping[Name, Name], time: Time) -> list[Event]:
    """The changes from the old head of each id to the new one; a leader is its own head."""
    events, moves = list[Event](), dict[tuple[Name | None, Name | None], list[Name]]()
    for name in dict.fromkeys([*old_heads, *new_heads]):
        if old_heads.get(name) != new_heads.get(name):
            moves.setdefault((old_heads.get(name), new_heads.get(name)), []).append(name)
    for (old, new), ids in sorted(moves.items(), key=lambda move: (-len(move[1]), str(move[0]))):
        members = tuple(name for name in ids if name not in (old, new))
        events.append(Event(time, name_kind(old in ids, new in ids, old, new), members, old, new))
    return [event for event in events if event.ids or event.kind in ("ends", "merges")]


def name_kind(old_moves: bool, new_moves: bool, old: Name | None, new: Name | None) -> Kind:
    """What happens to ids, perhaps with their old or new head among them, that follow ``new`` instead of ``old``."""
    if old is None:
        return "leads" if new_moves else "joins"
    if new is None:
        return "ends" if old_moves else "leaves"
    if old_moves:
        return "takes over" if new_moves else "merges"
    return "splits" if new_moves else "changes"

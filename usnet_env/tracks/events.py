"""What changes from window to window: who leads, joins, leaves and takes over."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from usnet_env.config import format_count
from usnet_env.tracks.found import DetectedWindow

Name = str | int
Kind = Literal["leads", "ends", "joins", "leaves", "changes", "merges", "splits", "takes over"]
_MOST_NAMES = 6
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
class Event:
    """A change from one window to the next; its text is a sentence.

    Args:
        time: of the first instant of the later window, as in the file.
        kind: what happened.
        ids: those that follow another head than before, without the heads of both.
        old: the head before, or ``None``.
        new: the head from now on, or ``None``.
    """

    time: float | int | str
    kind: Kind
    ids: tuple[Name, ...]
    old: Name | None
    new: Name | None

    def __str__(self) -> str:
        more = f" and {len(self.ids) - _MOST_NAMES} more" * (len(self.ids) > _MOST_NAMES)
        who, follow = ", ".join(map(str, self.ids[:_MOST_NAMES])) + more, "follow" + "s" * (len(self.ids) == 1)
        follow = "follow" if self.kind == "leaves" else follow
        group = f" and its {format_count(len(self.ids), 'follower')} follow" if self.ids else " follows"
        names = {"who": who, "follow": follow, "group": group, "old": self.old, "new": self.new}
        return f"From {self.time}: {_SENTENCES[self.kind].format(**names)}"


def find_events(windows: Iterable[DetectedWindow]) -> tuple[Event, ...]:
    """Compare the heads of all ids in each window with those in the window before; before the first, there are none."""
    events, before = list[Event](), dict[Name, Name]()
    for window in windows:
        now = {leader.id: leader.id for leader in window.leaders} | {link.follower: link.head for link in window.links}
        moves: dict[tuple[Name | None, Name | None], list[Name]] = {}
        for name in dict.fromkeys([*before, *now]):
            if before.get(name) != now.get(name):
                moves.setdefault((before.get(name), now.get(name)), []).append(name)
        for (old, new), ids in sorted(moves.items(), key=lambda move: (-len(move[1]), str(move[0]))):
            rest = tuple(name for name in ids if name not in (old, new))
            events.append(Event(window.start, _name_kind(old in ids, new in ids, old, new), rest, old, new))
        before = now
    return tuple(event for event in events if event.ids or event.kind in ("ends", "merges"))


def _name_kind(old_moves: bool, new_moves: bool, old: Name | None, new: Name | None) -> Kind:
    if old is None:
        return "leads" if new_moves else "joins"
    if new is None:
        return "ends" if old_moves else "leaves"
    if old_moves:
        return "takes over" if new_moves else "merges"
    return "splits" if new_moves else "changes"

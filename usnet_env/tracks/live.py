"""Who leads now: fixes come one after the other, and a change is announced when several answers agree on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from usnet_env.arrays import Floats, Indices
from usnet_env.config import ArgumentError, quote, real_number, whole_number
from usnet_env.detection import Detection
from usnet_env.objectives import find_roots, list_followers
from usnet_env.plugins import DetectorLike, find_detector
from usnet_env.tracks.confirm import LEAST_STEPS, confirm_leaders
from usnet_env.tracks.found import Event, Name, compare_heads
from usnet_env.tracks.leaders import DEFAULT_DETECTOR, answer_window
from usnet_env.tracks.samples import sort_samples
from usnet_env.tracks.tracks import Tracks, TrackWindow
from usnet_env.window import as_array, frozen_array

_SURE = 0.8  # an answer counts for a leader from this probability on, and against it from the rest down
_WINDOWS = 4  # whose fixes are kept: a leader is confirmed by at most so many
_UNSURE, _NOT_YET = object(), object()  # no head, and not None


@dataclass(frozen=True)
class LiveLeaders:
    """What a tracker knows after an update.

    Args:
        time: of the latest fix.
        leaders: the probability of each leader that is announced, in the last answer.
        follows: the head of each id that follows one.
        changes: what is announced or withdrawn since the update before; the text of each is a sentence.
        sure: whether the last answer is sure of every id, and agrees with what is announced. Without leaders, it is
            known that no id leads, or, if it isn't sure, not known yet.
    """

    time: float
    leaders: Mapping[Name, float] = field(default_factory=dict)
    follows: Mapping[Name, Name] = field(default_factory=dict)
    changes: tuple[Event, ...] = ()
    sure: bool = False


class LeaderTracker:
    """Finds the leaders while fixes come.

    As soon as there are 16 steps, a detector answers a window of the latest ones as in
    :func:`usnet_env.tracks.find_leaders`. An answer counts where the probability of a leader is at least 0.8, or at
    most 0.2. The head of an id is announced or withdrawn when ``patience`` answers in a row say so, and changed when as
    many of the last ``2 patience - 1`` do. A new leader must also be confirmed in the last window, or half of its group
    had another head before. If an answer doubts the leaders that are announced, the last three quarters of the window
    are answered, too, and the surer answer counts.

    Args:
        step: seconds between the instants of a window.
        window: steps of a window, at least 16. A longer one stands more noise, and names a new leader later.
        detector: a name as :func:`usnet_env.make_detector` takes it, or a detector.
        patience: how many answers must agree.
        stride: steps from an answer to the next.
        seed: seeds the detector.

    Attributes:
        track_window: the window of the last answer, or ``None``; its times count from the earliest fix that is kept.
        detection: the last answer, or ``None``.

    Raises:
        ArgumentError: an argument is refused.

    Example:
        >>> turns = np.random.default_rng(0).normal(size=(41, 2))
        >>> first, second = turns[1:].cumsum(axis=0), turns[:-1].cumsum(axis=0)
        >>> tracker = LeaderTracker(step=1.0, detector="lagged-correlation")
        >>> for t in range(40):
        ...     for change in tracker.update(t, [first[t], second[t]], ["a", "b"]).changes:
        ...         print(change)
        From 18.0: a leads b.
    """

    def __init__(
        self,
        step: float,
        window: int = LEAST_STEPS,
        detector: str | DetectorLike = DEFAULT_DETECTOR,
        *,
        patience: int = 3,
        stride: int = 1,
        seed: int = 0,
    ) -> None:
        self._step = real_number("step", step, 1e-9, 1e9)
        self._length = whole_number("window", window, LEAST_STEPS, 10**5)
        self._patience = whole_number("patience", patience, 1, 10**5)
        self._stride = whole_number("stride", stride, 1, 10**5)
        self._seed = whole_number("seed", seed, 0)
        self._player = find_detector(detector)
        self._names = dict[Name, int]()
        self._fixes = [np.empty((0, 5))]  # the number of an id, a time, and a position
        self._due = -np.inf  # the time from which on the next answer is asked for
        self._heads = dict[Name, Name | None]()  # what is announced
        self._whole = max(self._patience, -(-self._length // self._stride))  # answers of a whole window
        self._kept = _WINDOWS * self._whole
        self._votes = dict[Name, list[Any]]()  # of the last answers, the latest one last
        self._known = LiveLeaders(-np.inf)
        self.track_window: TrackWindow | None = None
        self.detection: Detection | None = None

    def update(self, t: ArrayLike, positions: ArrayLike, ids: Sequence[Name]) -> LiveLeaders:
        """Take fixes of some ids.

        Args:
            t: seconds, one number or ``(n,)``. A late fix counts while a window reaches back to it.
            positions: ``(n, 2)`` or ``(n, 3)`` metres; a row with NaN is no fix.
            ids: the n ids, texts or whole numbers; ids may be missing, come and go.

        Raises:
            ArgumentError: an argument is refused, or the detector's answer is.
        """
        fixes = self._take_fixes(t, positions, ids)
        self._fixes.append(fixes)
        latest, before = float(fixes[:, 1].max(initial=self._known.time)), self._heads
        if latest >= self._due and np.isfinite(latest):
            self._due = (np.floor(latest / self._step + 1e-6) + self._stride) * self._step
            self._heads, self._known = self._ask(latest)
        changes = compare_heads(_drop_none(before), _drop_none(self._heads), latest)
        self._known = replace(self._known, time=latest, changes=tuple(changes))
        return self._known

    def _take_fixes(self, t: ArrayLike, positions: ArrayLike, ids: Sequence[Name]) -> Floats:
        """The fixes ``(n, 5)`` of an update."""
        points, names = np.asarray(as_array("positions", positions), np.float64), as_array("ids", ids).tolist()
        if points.shape not in ((len(names), 2), (len(names), 3)):
            raise ArgumentError(f"positions must have shape ({len(names)}, 2 or 3) for the ids, got {points.shape}.")
        if not all(isinstance(name, str | int) for name in names):
            raise ArgumentError(f"ids must hold texts or whole numbers, got {quote(ids)}.")
        time = as_array("t", t)
        fixes = np.zeros((len(names), 5))
        fixes[:, 0] = [self._names.setdefault(name, len(self._names)) for name in names]
        fixes[:, 1] = frozen_array("t", np.repeat(time, len(names)) if time.ndim == 0 else time, float, (len(names),))
        fixes[:, 2 : 2 + points.shape[1]] = points
        return fixes[np.isfinite(points).all(axis=1)]

    def _ask(self, latest: float) -> tuple[dict[Name, Name | None], LiveLeaders]:
        """Ask the detector for the latest window: the heads that are announced from now on, and what is known."""
        fixes = np.concatenate(self._fixes)
        fixes = fixes[fixes[:, 1] > latest - (_WINDOWS * self._length + 1.5) * self._step]
        self._fixes, names = [fixes], [*self._names]
        rows, codes = np.unique(fixes[:, 0].astype(np.int64), return_inverse=True)
        there = tuple(names[row] for row in rows)
        kept = {there[code] for code in np.unique(codes[fixes[:, 1] >= latest - self._length * self._step])}
        heads = {name: head for name, head in self._heads.items() if name in kept}
        tracks, self.track_window, self.detection = _resample(there, codes, fixes[:, 1:], self._step), None, None
        if tracks is not None:
            self.track_window = _cut_last(tracks, self._length)
        if tracks is None or self.track_window is None:
            self._votes = {}
            return _settle(heads), LiveLeaders(latest)
        self.detection = answer_window(self._player, tracks, self.track_window, self._seed).detection
        votes = _read_votes(self.detection, self.track_window.ids)
        if _drop_none(heads) and not _agree(votes, heads, self.track_window.ids):  # perhaps another one leads now
            votes = self._ask_again(tracks) or votes
        ids = self.track_window.ids
        chance = dict(zip(ids, _read_probability(self.detection).tolist(), strict=True))
        self._votes = {name: [*self._votes.get(name, []), votes.get(name, _UNSURE)][-self._kept :] for name in ids}
        ready = {name: vote for name, vote in votes.items() if self._is_settled(name, vote)}
        trusted = {name for name, vote in ready.items() if name == vote and self._is_trusted(name, tracks)}
        heads = _settle(heads | {name: vote for name, vote in ready.items() if vote is None or vote in trusted})
        leaders = {name: chance.get(name, self._known.leaders.get(name, 0.0)) for name in heads if heads[name] == name}
        follows = {name: head for name, head in _drop_none(heads).items() if name != head}
        return heads, LiveLeaders(latest, leaders, follows, (), _agree(votes, heads, ids))

    def _ask_again(self, tracks: Tracks) -> dict[Name, Name | None]:
        """Ask for the last three quarters of the window; the votes of this answer if it is the surer one."""
        part = _cut_last(tracks, 3 * self._length // 4)
        if part is None or self.detection is None:
            return {}
        answer = answer_window(self._player, tracks, part, self._seed).detection
        if _measure_certainty(answer) <= _measure_certainty(self.detection):
            return {}
        self.track_window, self.detection = part, answer
        return _read_votes(answer, part.ids)

    def _is_settled(self, name: Name, vote: Name | None) -> bool:
        """Whether enough of the last answers agree on the head of an id, or that it has none.

        It gets a first head by ``patience`` answers in a row, and another one by as many of the last ``2 patience - 1``
        if none of these names a third. All answers of a whole window must agree on none, as a window that spans a
        change looks as if no id led; or if two leaders are announced, as the tracks of two may be alike for some steps.
        """
        votes, old = self._votes[name], self._heads.get(name)
        if vote is None or (old not in (None, vote) and self._heads.get(vote) == vote):
            return votes[-self._whole :].count(vote) == self._whole
        if old is None:
            return votes[-self._patience :].count(vote) == self._patience
        recent = votes[1 - 2 * self._patience :]
        return recent.count(vote) >= self._patience and all(each in (vote, None, _UNSURE) for each in recent)

    def _is_trusted(self, leader: Name, tracks: Tracks) -> bool:
        """Whether a leader is announced, or half of its group had another one, or it is confirmed since it is named."""
        group = [name for name, votes in self._votes.items() if votes[-1] == leader]
        led = sum(self._heads.get(name) is not None for name in group)
        if self._heads.get(leader) == leader or 2 * led > len(group):
            return True
        named = [*takewhile(lambda vote: vote == leader, reversed(self._votes[leader]))]
        cut = _cut_last(tracks, self._length + self._stride * (len(named) - 1))
        if cut is None or leader not in cut.ids:
            return False
        followers = [k for k, name in enumerate(cut.ids) if name in group and name != leader]
        return bool(confirm_leaders(cut.window, [cut.ids.index(leader)], [followers])[0][0])


def _resample(ids: tuple[Name, ...], codes: Indices, fixes: Floats, step: float) -> Tracks | None:
    """The tracks of some ids, of fixes ``(S, 4)``, times and positions; ``None`` if they are too short."""
    time, *axes = fixes.T
    if len(ids) == len(codes) or np.ptp(time) < LEAST_STEPS * step:
        return None
    return Tracks(**sort_samples(ids, codes, time, axes, duplicates="first")).resample(step)


def _cut_last(tracks: Tracks, most: int) -> TrackWindow | None:
    """The last window, of so many steps or as many as there are; ``None`` if fewer than two ids are in it."""
    steps = round(tracks.duration / float(tracks.step or 1.0))
    return [None, *tracks.windows(min(most, steps), steps)][-1]


def _read_probability(answer: Detection) -> Floats:
    return np.asarray(answer.extras.get("probability", answer.candidates), np.float64)


def _read_votes(answer: Detection, ids: Sequence[Name]) -> dict[Name, Name | None]:
    """The head of each id of which an answer is sure, ``None``: it follows none; others are left out.

    While any id may lead or not, it isn't sure that another one follows none.
    """
    chance = _read_probability(answer)
    doubtful = {name for name, p in zip(ids, chance, strict=True) if 1 - _SURE < p < _SURE}
    votes: dict[Name, Name | None] = {} if doubtful else dict.fromkeys(ids)
    for head in np.flatnonzero(answer.candidates).tolist():
        for member in (head, *list_followers(answer, head)):
            votes[ids[member]] = ids[head]
    return {name: head for name, head in votes.items() if head not in doubtful}


def _agree(votes: Mapping[Name, Any], heads: Mapping[Name, Name | None], ids: Sequence[Name]) -> bool:
    """Whether an answer is sure of the head of every id, and it is what is announced."""
    return all(votes.get(name, _UNSURE) == heads.get(name, _NOT_YET) for name in ids)


def _measure_certainty(answer: Detection) -> float:
    """The logarithm of the probability that exactly those lead that an answer holds for leaders."""
    chance = _read_probability(answer)
    return float(np.log(np.maximum(chance, 1 - chance)).sum())


def _settle(heads: Mapping[Name, Name | None]) -> dict[Name, Name | None]:
    """The heads, where each is its own, and has followers; one that follows another passes its followers on to it."""
    names = [*heads]
    place = {name: k for k, name in enumerate(names)}
    root = find_roots([-1 if head is None else place.get(head, -1) for head in heads.values()])
    leads = [heads[names[k]] == names[k] and (root == k).sum() > 1 for k in range(len(names))]
    return {name: names[k] if k >= 0 and leads[k] else None for name, k in zip(names, root, strict=True)}


def _drop_none(heads: Mapping[Name, Name | None]) -> dict[Name, Name]:
    return {name: head for name, head in heads.items() if head is not None}

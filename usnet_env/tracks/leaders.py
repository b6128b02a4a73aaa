"""Leaders and followers in recorded tracks: a detector answers each window, and groups are followed in the file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.special import bdtrc

from usnet_env.arrays import Indices
from usnet_env.config import ArgumentError, format_count, quote, whole_number
from usnet_env.detection import Detection, fit_window
from usnet_env.objectives import list_followers
from usnet_env.parts import describe_error
from usnet_env.plugins import DetectorLike, detector_label, make_detector
from usnet_env.tracks.confirming import LEVEL, confirm_leaders
from usnet_env.tracks.links import Link, find_links
from usnet_env.tracks.tracks import Tracks
from usnet_env.tracks.windows import TrackWindow

DEFAULT_DETECTOR = "follow-mixture(policy='map')"
_SAME_GROUP = 0.25  # two groups are one if they share this part of all their members
_SAME_LEADER = 0.25
_UNLIKELY = 0.01  # a leader in as many windows is called chance if that is more probable than this

Group = tuple[int, set[int]]  # the row of its leader in ``Tracks.ids``, and those of its members


@dataclass(frozen=True)
class Leader:
    """A leader in a window, or over the whole file.

    Args:
        id: as in the file.
        probability: the detector's probability that the id leads; over the file, the mean over the windows in which it
            leads. ``None``: the detector gives no probabilities.
        followers: the ids that follow it, directly or through others; over the file, those that follow it in at least
            half of its windows.
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

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; only a leader over the file has a share."""
        values = {**vars(self), "followers": list(self.followers)}
        if self.share is None:
            del values["share"]
        return values


@dataclass(frozen=True, eq=False)
class DetectedWindow:
    """A window with the leaders that a detector found in it.

    Args:
        start: time of the first instant as in the file.
        end: time of the last instant as in the file.
        leaders: the detector's candidates that are confirmed, the highest score first.
        not_confirmed: ids of the candidates that are not confirmed.
        links: the followers of the leaders, each with the id that it follows directly and its delay.
        left_out: ids that are seen in too few steps, so that the detector did not get them.
    """

    start: float | int | str
    end: float | int | str
    leaders: tuple[Leader, ...]
    not_confirmed: tuple[str | int, ...] = ()
    links: tuple[Link, ...] = ()
    left_out: tuple[str | int, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "start": self.start,
            "end": self.end,
            "leaders": [leader.as_dict() for leader in self.leaders],
            "not_confirmed": list(self.not_confirmed),
            "links": [link.as_dict() for link in self.links],
            "left_out": list(self.left_out),
        }


@dataclass(frozen=True, eq=False)
class FoundLeaders:
    """The leaders of each window, and over the file.

    Args:
        windows: all windows, in the order of time.
        leaders: an entry for each id that leads a group in a window, the one with the most windows first.
        detector: label of the detector.
    """

    windows: tuple[DetectedWindow, ...]
    leaders: tuple[Leader, ...]
    detector: str

    def as_dict(self) -> dict[str, Any]:
        """The windows and the leaders over the file as plain values for JSON."""
        return {
            "windows": [each.as_dict() for each in self.windows],
            "leaders": [leader.as_dict() for leader in self.leaders],
        }

    def rows(self) -> list[dict[str, Any]]:
        """A row for each leader of each window; a window without leaders has one row without an id."""
        rows = []
        for each in self.windows:
            for leader in each.leaders or (None,):
                rows.append(
                    {
                        "start": each.start,
                        "end": each.end,
                        "group": leader and leader.group,
                        "id": leader and leader.id,
                        "probability": leader and leader.probability,
                        "score": leader and leader.score,
                        "followers": [] if leader is None else list(leader.followers),
                        "reason": leader and leader.reason,
                        "not_confirmed": list(each.not_confirmed),
                        "left_out": list(each.left_out),
                    }
                )
        return rows

    def link_rows(self) -> list[dict[str, Any]]:
        """A row for each follower of each window: its direct leader, its head, and the delay in seconds."""
        return [
            {"start": each.start, "end": each.end, **link.as_dict()} for each in self.windows for link in each.links
        ]


def find_leaders(
    tracks: Tracks,
    detector: str | DetectorLike = DEFAULT_DETECTOR,
    *,
    length: int = 100,
    stride: int | None = None,
    seed: int = 0,
    confirm: bool = True,
    on_window: Callable[[TrackWindow, Detection, DetectedWindow], None] | None = None,
) -> FoundLeaders:
    """Let a detector answer every window of tracks.

    Every window is an episode of its own: the detector is reset before it. Groups, a leader and its followers, are
    followed from window to window: a group keeps its number where it shares the most members with an earlier one.

    Args:
        tracks: the tracks; if they are not resampled, the step is chosen.
        detector: a name as :func:`usnet_env.make_detector` takes it, or a detector.
        length: steps of a window.
        stride: steps from the start of a window to the start of the next; ``None``: ``length``.
        seed: seeds the detector.
        confirm: whether to leave out candidates whose followers don't move like them later, or that follow another id
            in half of the window, by the tests of :mod:`usnet_env.tracks.confirming`; their probability becomes 0.
            So no candidate of a detector that says nothing about followers is confirmed.
        on_window: called with each window, the detector's answer and the leaders.

    Returns:
        The leaders of each window, and over the file.

    Raises:
        ArgumentError: an argument is refused, the tracks hold no window, or the detector fails in one.
    """
    if not isinstance(tracks, Tracks):
        raise ArgumentError(f"tracks must be Tracks, got {quote(tracks)}.")
    player = make_detector(detector) if isinstance(detector, str) else detector
    if isinstance(player, type) or not isinstance(player, DetectorLike):
        raise ArgumentError(f"detector must have the methods detect(window) and reset(seed), got {quote(player)}.")
    seed = whole_number("seed", seed, 0)
    if not isinstance(confirm, bool):
        raise ArgumentError(f"confirm must be True or False, got {quote(confirm)}.")
    if on_window is not None and not callable(on_window):
        raise ArgumentError(f"on_window must be a function or None, got {quote(on_window)}.")
    groups: list[Group] = []
    windows = []
    seen, sure = np.zeros(len(tracks.ids), np.int64), True
    for number, cut in enumerate(tracks.windows(length, stride)):
        start, end = tracks.file_time(cut.start), tracks.file_time(cut.end)
        detection = _answer(player, cut, seed, number, f"from {start} to {end}")
        heads = np.flatnonzero(detection.candidates)
        heads = heads[np.argsort(-detection.scores[heads], kind="stable")]
        followers = [list_followers(detection, int(head)) for head in heads]
        rejected = heads[:0]
        if confirm:
            confirmed, followers = confirm_leaders(cut.window, heads, followers)
            rejected, heads = heads[~confirmed], heads[confirmed]
            followers = [led for led, kept in zip(followers, confirmed, strict=True) if kept]
        groups_here = [
            (int(cut.rows[head]), {int(cut.rows[i]) for i in (int(head), *led)})
            for head, led in zip(heads, followers, strict=True)
        ]
        labels = _number_groups(groups_here, groups)
        given = detection.extras.get("probability")
        probability = None if given is None else np.array(given, np.float64)
        if probability is not None:
            probability[rejected] = 0.0
        reasons = _reasons(detection, heads, followers, len(cut.ids))
        found = DetectedWindow(
            start,
            end,
            tuple(
                Leader(
                    cut.ids[head],
                    None if probability is None else float(probability[head]),
                    tuple(cut.ids[i] for i in led),
                    reason,
                    label,
                    float(detection.scores[head]),
                )
                for head, led, reason, label in zip(heads, followers, reasons, labels, strict=True)
            ),
            tuple(cut.ids[head] for head in rejected),
            find_links(cut, detection, heads.tolist(), followers),
            cut.left_out,
        )
        windows.append(found)
        seen[cut.rows] += 1
        sure = sure and probability is not None
        if on_window is not None:
            on_window(cut, detection, found)
    if not windows:
        raise ArgumentError("tracks must hold a window in which at least 2 ids are seen together; no window does.")
    leaders = _summarise(windows, tracks.ids, seen if confirm else None, sure)
    return FoundLeaders(tuple(windows), leaders, detector_label(player))


def _answer(player: DetectorLike, cut: TrackWindow, seed: int, number: int, when: str) -> Detection:
    """Ask the detector for one window.

    Raises:
        ArgumentError: the detector fails, or its answer is none for this window.
    """
    try:
        player.reset(int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1)[0]))
        detection = player.detect(fit_window(player, cut.window))
    except ArgumentError:
        raise
    except Exception as error:  # a detector may raise anything
        raise ArgumentError(
            f"detector must answer every window, got {describe_error(error)} from {detector_label(player)} in the "
            f"window {when}."
        ) from error
    if not isinstance(detection, Detection) or len(detection.candidates) != len(cut.ids):
        raise ArgumentError(f"detector must answer a Detection for {len(cut.ids)} UAVs, got {quote(detection)}.")
    return detection


def _reasons(detection: Detection, heads: NDArray[np.intp], followers: list[list[int]], uavs: int) -> list[str]:
    """A sentence for each head: the detector's own if it gives one, otherwise the rank of its score."""
    named, given = detection.extras.get("heads"), detection.extras.get("reasons")
    own: dict[int, str] = {}
    if named is not None and given is not None and len(named) == len(given):
        own = {int(head): str(reason) for head, reason in zip(named, given, strict=True)}
    ranks = {int(i): rank for rank, i in enumerate(np.argsort(-detection.scores, kind="stable"), start=1)}
    return [
        own.get(int(head))
        or f"Has score {detection.scores[head]:.3g}, rank {ranks[int(head)]} of {uavs}, and "
        f"{format_count(len(led), 'follower')}."
        for head, led in zip(heads, followers, strict=True)
    ]


def _number_groups(found: list[Group], known: list[Group]) -> list[int]:
    """Number the groups of a window from 1, so that a group keeps its number from window to window.

    A group has the number of the earlier group with which it shares the most members; a common leader counts as a
    quarter of them. It has a new number if it shares less than a quarter with each.

    Args:
        found: the groups of the window.
        known: each group as it was found last, in the order of the numbers; updated in place.
    """
    labels = [0] * len(found)
    if found and known:
        share = np.array(
            [
                [len(now & then) / len(now | then) + _SAME_LEADER * (head == leader) for leader, then in known]
                for head, now in found
            ]
        )
        for k, g in zip(*linear_sum_assignment(-share), strict=True):
            if share[k, g] >= _SAME_GROUP:
                labels[k] = int(g) + 1
    for k, group in enumerate(found):
        if labels[k]:
            known[labels[k] - 1] = group
        else:
            known.append(group)
            labels[k] = len(known)
    return labels


def _summarise(
    windows: list[DetectedWindow], ids: tuple[str | int, ...], seen: Indices | None, sure: bool
) -> tuple[Leader, ...]:
    """The leaders over the file, the one with the most windows first.

    Args:
        windows: all windows.
        ids: the ids of the tracks.
        seen: ``(N,)`` number of windows that hold each id, or ``None`` if the leaders are not confirmed.
        sure: whether the detector gives probabilities in all windows.
    """
    row = {each: k for k, each in enumerate(ids)}
    led: dict[tuple[int, int], list[Leader]] = {}  # by the group and the row of its leader
    for window in windows:
        for leader in window.leaders:
            led.setdefault((leader.group, row[leader.id]), []).append(leader)
    found = []
    for (group, head), entries in sorted(led.items(), key=lambda item: (-len(item[1]), item[0])):
        count = len(entries)
        times_behind = Counter(each for leader in entries for each in leader.followers)
        behind = sorted((each for each, times in times_behind.items() if times >= count / 2), key=row.__getitem__)
        probability, score = np.mean([(leader.probability or 0.0, leader.score) for leader in entries], axis=0).tolist()
        reason = f"Leads group {group} in {count} of {format_count(len(windows), 'window')}."
        # The probability that a group without a leader has a confirmed one in as many of its windows.
        chance = 0.0 if seen is None else float(bdtrc(count - 1, int(seen[head]), LEVEL))
        if chance > _UNLIKELY:
            what = "By chance, a group without a leader has a confirmed leader in as many windows"
            reason += f" {what} with probability {chance:.2g}."
        share = count / len(windows)
        found.append(Leader(ids[head], probability if sure else None, tuple(behind), reason, group, score, share))
    return tuple(found)


def find_date(found: FoundLeaders) -> str:
    """The date of all windows if the times are timestamps of one day, otherwise nothing."""
    times = [time for window in found.windows for time in (window.start, window.end)]
    dates = {time.partition("T")[0] for time in times if isinstance(time, str)}
    return dates.pop() if len(dates) == 1 else ""


def format_time(time: float | int | str, date: str) -> str:
    """A time of the file: up to 12 digits, or a timestamp in UTC without ``date`` and final zeros."""
    if not isinstance(time, str):
        return f"{time:.12g}" if isinstance(time, float) else str(time)
    day, _, clock = time.removesuffix("Z").partition("T")
    clock = clock.rstrip("0").removesuffix(".") if "." in clock else clock
    return clock if day == date else f"{day} {clock}"

"""Find the leaders of recorded tracks: a detector answers each window, and groups are followed in the file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, count, product
from typing import Any, NamedTuple

import numpy as np

from usnet_env.config import ArgumentError, format_count, format_number, quote, whole_number
from usnet_env.detection import Detection, ask
from usnet_env.objectives import list_followers
from usnet_env.parts import describe_error
from usnet_env.plugins import DetectorLike, detector_label, find_detector
from usnet_env.tracks.changes import Period, blur_links, trace_periods
from usnet_env.tracks.clocks import describe_late_clocks
from usnet_env.tracks.confirm import LEAST_STEPS, LEVEL, confirm_leaders, find_confound
from usnet_env.tracks.evidence import add_evidence, compare_with_head, describe_lead
from usnet_env.tracks.found import DetectedWindow, Found, Leader, Link
from usnet_env.tracks.links import find_links, sample_finely
from usnet_env.tracks.read import read_tracks
from usnet_env.tracks.result import FoundLeaders
from usnet_env.tracks.silence import describe_windows
from usnet_env.tracks.tracks import Tracks, TrackWindow

DEFAULT_DETECTOR = "reader(policy='map')"
_MIN_SHARED_PART = 0.25  # two groups are one if they share this part of all their members
_LEADER_BONUS = 0.25
_MAX_JOINED = 1000  # steps of a window with its neighbours

Group = tuple[int, set[int]]  # the row of its leader in ``Tracks.ids``, and those of its members


def find_leaders(
    tracks: Any,
    detector: str | DetectorLike = DEFAULT_DETECTOR,
    *,
    step: float | None = None,
    window: int | None = None,
    length: int | None = None,
    stride: int | None = None,
    seed: int = 0,
    confirm: bool = True,
    on_window: Callable[[TrackWindow, Detection, DetectedWindow], None] | None = None,
) -> FoundLeaders:
    """Let a detector answer every window of tracks.

    The detector is reset before every window. If it gives the probability that no id leads, the window is read at
    other steps, too (:func:`answer_window`). Groups, a leader and its followers, are followed from window to window: a
    group keeps its number where it shares the most members with an earlier one.

    Args:
        tracks: the tracks, or what :func:`read_tracks` takes: a path, a data frame, or a dataset of xarray.
        detector: a name as :func:`usnet_env.make_detector` takes it, or a detector.
        step: seconds between the instants of a window; ``None``: that of resampled tracks, otherwise it is chosen.
        window: steps of a window; ``None``: as many as fit the tracks (:meth:`Tracks.choose_length`).
        length: another name of ``window``.
        stride: steps from the start of a window to the start of the next; ``None``: ``window``.
        seed: seeds the detector.
        confirm: whether to leave out candidates that have no followers, whose followers don't move like them later, or
            that follow another id in half of the window, by the tests of :mod:`usnet_env.tracks.confirm`. A candidate
            that fails is tested once more in the window joined with those before and after it that name it, too.
        on_window: called with each window, the detector's answer and the leaders.

    Raises:
        ArgumentError: an argument is refused, the tracks hold no window, or the detector fails in one.

    Example:
        >>> steps = np.random.default_rng(0).normal(size=(200, 2))
        >>> followers = [np.roll(steps, lag, axis=0).cumsum(axis=0) for lag in (0, 1, 2)]
        >>> time, position = np.repeat(np.arange(200), 3), np.stack(followers, axis=1).reshape(-1, 2)
        >>> print(find_leaders(Tracks.from_samples([*"abc"] * 200, time, position), "lagged-correlation"))
        a leads 2 ids in 100% of the windows.
        From 0.0: a leads b, c.
    """
    tracks = tracks if isinstance(tracks, Tracks) else read_tracks(tracks)
    player = find_detector(detector)
    seed = whole_number("seed", seed, 0)
    found = list[Found]()
    length = length if window is None else window
    resampled = tracks if step is None and tracks.step is not None else tracks.resample(step, length=length or 0)
    search = _Search(player, resampled, sample_finely(resampled), confirm)
    seeds = (int(np.random.SeedSequence(seed, spawn_key=(k,)).generate_state(1)[0]) for k in count())
    for before, asked, after in _with_neighbours(map(search.ask, resampled.windows(length, stride), seeds)):
        for part, answer, found_there in search.read_window(asked, [other for other in (before, after) if other]):
            found.append((part, replace(answer, attention=None), found_there))  # N by N numbers that nothing here reads
            if on_window is not None:
                on_window(part, answer, found_there)
    if not found:
        hint = "no window does (--window makes them shorter)"
        raise ArgumentError(f"tracks must hold a window in which 2 ids are seen in half of the steps; {hint}.")
    track_windows, answers, windows = zip(*found, strict=True)
    facts = [*resampled.facts, describe_windows(track_windows), *describe_late_clocks(found, search.fine)]
    if confirm and track_windows[0].window.observation_steps < LEAST_STEPS:
        facts.append(f"Windows of fewer than {LEAST_STEPS} steps are too short for the test that confirms leaders.")
    elif confirm:
        facts.append(_describe_chance(windows))
    periods: tuple[Period, ...] = ()
    if "probability" in answers[0].extras:
        periods = trace_periods(resampled, found, partial(_ask_detector, player, seed), confirm)
        windows = tuple(blur_links(window, part, periods, tracks.ids) for part, _, window in found)
    leaders = _summarise_leaders(windows, track_windows, tracks.ids)
    details = tuple(facts), resampled, track_windows, answers, seed, periods
    return FoundLeaders(windows, leaders, detector_label(player), tracks.ids, *details)


class Answer(NamedTuple):
    """A detector's answer to a window, and the window with the shortest step that it was asked for."""

    detection: Detection
    shortest_step_window: TrackWindow


def answer_window(player: DetectorLike, resampled: Tracks, track_window: TrackWindow, seed: int) -> Answer:
    """Ask a detector for a window.

    If its answer has ``p_no_leader``, the detector is also asked at :attr:`Tracks.other_steps`. A step that is too long
    hides a leader, so only those count at which an id probably leads. Of their answers, the one
    that names most nearly what all of them name is returned, or of several the one that is surest that somebody leads.
    """
    answer = partial(_ask_detector, player, seed)

    def read_p_no_leader(detection: Detection) -> float:
        return float(detection.extras.get("p_no_leader", detection.extras.get("silent", 0.0)))

    track_windows, answers = [track_window], [answer(track_window)]
    if answers[0].extras.keys() & {"p_no_leader", "silent"}:  # the latter of version 0.1
        track_windows += filter(None, (other.cut_like(track_window) for other in resampled.other_steps))
        answers += map(answer, track_windows[1:])
    answers.sort(key=read_p_no_leader)
    answers = [detection for detection in answers if read_p_no_leader(detection) < 0.5] or answers[:1]
    mean_candidates = np.mean([detection.candidates for detection in answers], axis=0)
    chosen = min(answers, key=lambda detection: round(float(np.abs(detection.candidates - mean_candidates).sum()), 6))
    return Answer(chosen, min(track_windows, key=lambda window: window.step))


class _Asked(NamedTuple):
    """A window, the seed of the detector, and its answer."""

    track_window: TrackWindow
    seed: int
    answer: Answer


def _with_neighbours(items: Iterator[_Asked]) -> Iterator[tuple[_Asked | None, _Asked, _Asked | None]]:
    """Each item with the one before and the one after it."""
    before, here = None, next(items, None)
    while here is not None:
        after = next(items, None)
        yield before, here, after
        before, here = here, after


def _ask_detector(player: DetectorLike, seed: int, track_window: TrackWindow) -> Detection:
    player.reset(seed)
    return ask(player, track_window.window)[0]


@dataclass(frozen=True)
class _Search:
    """What the windows of a file share; ``groups`` has each group as it was found last, in the order of the numbers."""

    player: DetectorLike
    resampled: Tracks
    fine: Tracks
    confirm: bool
    groups: list[Group] = field(default_factory=list)

    def ask(self, track_window: TrackWindow, seed: int) -> _Asked:
        """Ask the detector for a window."""
        try:
            return _Asked(track_window, seed, answer_window(self.player, self.resampled, track_window, seed))
        except Exception as error:  # a detector may raise anything
            start, end = map(self.resampled.file_time, (track_window.start, track_window.end))
            fault = f"{describe_error(error)} from {quote(detector_label(self.player))} in the window from {start}"
            raise ArgumentError(f"detector must answer every window, got {fault} to {end}.") from error

    def read_window(self, asked: _Asked, neighbours: Sequence[_Asked] = ()) -> list[Found]:
        """Read one window, and its halves if its ids move alike without a leader: it may change there.

        Halves have 32 steps or more, and count if both have a leader, and not the same.
        """
        track_window, seed, answer = asked
        detected = self._name_leaders(track_window, answer, neighbours)
        found, steps = [(track_window, answer.detection, detected)], track_window.window.observation_steps
        if detected.confound != "one signal" or steps < 4 * LEAST_STEPS:
            return found
        middle = track_window.start + steps // 2 * track_window.step
        halves = replace(track_window, end=middle), replace(track_window, start=middle)
        found_in = [self.read_window(self.ask(part, seed)) for part in map(self.resampled.cut_like, halves) if part]
        names = [{leader.id for _, _, window in half for leader in window.leaders} for half in found_in]
        return [*chain(*found_in)] if all(names) and names[0] != names[-1] else found

    def _name_leaders(self, track_window: TrackWindow, answer: Answer, neighbours: Sequence[_Asked]) -> DetectedWindow:
        """The leaders that an answer names in a window; their groups update those of earlier windows."""
        (detection, shortest_step_window), window = answer, track_window.window
        ids, rows, scores, extras = track_window.ids, track_window.rows, detection.scores, detection.extras
        order = np.argsort(-scores, kind="stable")
        heads = order[detection.candidates[order]]
        followers = [list_followers(detection, int(head)) for head in heads]
        confirmed = np.ones(len(heads), bool)
        if self.confirm:
            named = followers
            confirmed, followers = confirm_leaders(window, heads, named, shortest_step_window.window)
            for c in np.flatnonzero(~confirmed).tolist():
                if longer := self._lengthen(track_window, int(heads[c]), neighbours):
                    confirmed[[c]], followers[c : c + 1] = confirm_leaders(longer.window, heads[[c]], [named[c]])
        followers_of = {int(heads[k]): followers[k] for k in np.flatnonzero(confirmed)}
        members_of = [(int(rows[head]), set(rows[[head, *members]].tolist())) for head, members in followers_of.items()]
        labels = _number_groups(members_of, self.groups)
        reasons = dict(zip(map(int, extras.get("heads", ())), extras.get("reasons", ()), strict=False))
        leaders, links = list[Leader](), list[Link]()
        for (head, members), label in zip(followers_of.items(), labels, strict=True):
            head_links = find_links(self.fine, track_window, head, members, detection.leader) if members else []
            head_links = add_evidence(head_links, compare_with_head(self.fine, track_window, head, members))
            reason = str(reasons.get(head) or describe_lead(head_links))
            probability = float(extras["probability"][head]) if "probability" in extras else None
            follower_ids = tuple(ids[i] for i in members)
            leaders.append(Leader(ids[head], probability, follower_ids, reason, label, float(scores[head])))
            links += head_links
        confound, alike = find_confound(window) if self.confirm and not leaders else ("", [])
        return DetectedWindow(
            self.resampled.file_time(track_window.start),
            self.resampled.file_time(track_window.end),
            tuple(leaders),
            tuple(ids[head] for head in heads[~confirmed]),
            tuple(links),
            track_window.left_out,
            confound,
            tuple(ids[i] for i in alike),
        )

    def _lengthen(self, track_window: TrackWindow, head: int, neighbours: Sequence[_Asked]) -> TrackWindow | None:
        """The window together with those before and after it that name the head, too; ``None`` if none does."""
        row, start, end = track_window.rows[head], track_window.start, track_window.end
        for other, _, answer in neighbours:
            touches = other.start <= track_window.end + other.step and track_window.start <= other.end + other.step
            if touches and row in other.rows[answer.detection.candidates]:
                start, end = min(start, other.start), max(end, other.end)
        if (start, end) == (track_window.start, track_window.end):
            return None
        return self.resampled.cut_like(replace(track_window, start=start, end=end), most=_MAX_JOINED)


def _number_groups(groups: list[Group], known_groups: list[Group]) -> list[int]:
    """Number the groups of a window from 1, by the known ones, which are updated, that share the most members."""
    from scipy.optimize import linear_sum_assignment  # a refusal does not wait for SciPy

    share = np.zeros((len(groups), len(known_groups)))
    for (k, (head, members)), (g, (known_head, known_members)) in product(enumerate(groups), enumerate(known_groups)):
        share[k, g] = len(members & known_members) / len(members | known_members)
        share[k, g] += _LEADER_BONUS * (head == known_head)
    same = {k: int(g) for k, g in zip(*linear_sum_assignment(-share), strict=True) if share[k, g] >= _MIN_SHARED_PART}
    for k, group in enumerate(groups):
        g = same.setdefault(k, len(known_groups))
        known_groups[g : g + 1] = [group]
    return [same[k] + 1 for k in range(len(groups))]


def _describe_chance(windows: Sequence[DetectedWindow]) -> str:
    """How many of the confirmed leaders chance would give if no id led."""
    leaders = sum(len(window.leaders) for window in windows)
    candidates = leaders + sum(len(window.not_confirmed) for window in windows)
    expected = f"about {format_number(LEVEL * candidates, 2)} expected by chance"
    return f"Confirmed in all windows: {leaders} of {format_count(candidates, 'candidate')}; {expected}."


def _summarise_leaders(
    windows: Sequence[DetectedWindow], track_windows: Sequence[TrackWindow], ids: Sequence[str | int]
) -> tuple[Leader, ...]:
    """The leaders over the file."""
    row = {name: k for k, name in enumerate(ids)}
    found: dict[tuple[int, int], list[tuple[Leader, TrackWindow]]] = {}  # by the group and the row of its leader
    for window, track_window in zip(windows, track_windows, strict=True):
        for leader in window.leaders:
            found.setdefault((leader.group, row[leader.id]), []).append((leader, track_window))
    leaders = []
    for (group, head), pairs in sorted(found.items(), key=lambda item: (-len(item[1]), item[0])):
        entries, count = [leader for leader, _ in pairs], len(pairs)
        seen = Counter(name for _, track_window in pairs for name in track_window.ids)
        windows_led = Counter(name for leader in entries for name in leader.followers)
        followers = sorted((name for name, led in windows_led.items() if led >= seen[name] / 2), key=row.__getitem__)
        numbers = [(np.nan if leader.probability is None else leader.probability, leader.score) for leader in entries]
        probability, score = np.mean(numbers, axis=0).tolist()
        reason = f"Leads group {group} in {count} of {format_count(len(windows), 'window')}."
        links = [link for window in windows for link in window.links if link.head == ids[head]]
        if links := [link for link in links if link.follower in followers]:
            reason += f" {describe_lead(links)}"
        p_leads = None if np.isnan(probability) else probability
        leaders.append(Leader(ids[head], p_leads, tuple(followers), reason, group, score, count / len(windows)))
    return tuple(leaders)

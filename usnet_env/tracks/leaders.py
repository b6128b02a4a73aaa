"""Leaders and followers in recorded tracks: a detector answers each window, and groups are followed in the file."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import cycle, product
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from usnet_env.arrays import Floats, Indices
from usnet_env.config import ArgumentError, format_count, quote, whole_number
from usnet_env.detection import Detection
from usnet_env.drawing import CLUSTER_COLORS
from usnet_env.objectives import list_followers
from usnet_env.parts import describe_error
from usnet_env.plugins import DetectorLike, detector_label, find_detector
from usnet_env.tracks.answers import Answer, answer_window
from usnet_env.tracks.confirm import LEVEL, confirm_leaders, find_confound
from usnet_env.tracks.events import Event, find_events
from usnet_env.tracks.read import read_tracks
from usnet_env.tracks.tracks import Tracks, TrackWindow

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DEFAULT_DETECTOR = "reader(policy='map')"
_SAME_GROUP = 0.25  # two groups are one if they share this part of all their members
_SAME_LEADER = 0.25
_UNLIKELY = 0.01  # a leader in as many windows is called chance if that is more probable than this
_MOST_LAG = 12  # steps
CONFOUNDS = {
    "one path": "go along one path, each at a pace of its own",
    "one signal": "move alike, but none ahead: they follow one signal, each other, or an id without a track",
}
_LEAST_STEPS = 4  # of the window for each step of the longest lag
_COLUMNS = {  # of the tables
    "windows": "start end group id probability score followers reason not_confirmed left_out confound alike",
    "leaders": "id probability followers reason group score share",
    "rows": "start end id leader head delay probability group",
    "links": "start end follower leader head delay",
}

Group = tuple[int, set[int]]  # the row of its leader in ``Tracks.ids``, and those of its members


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


@dataclass(frozen=True, eq=False)
class FoundLeaders:
    """The leaders of each window, and over the file.

    Args:
        windows: in the order of time.
        leaders: an entry for each id that leads a group in a window, the one with the most windows first.
        detector: label of the detector.
        ids: all ids of the tracks.
    """

    windows: tuple[DetectedWindow, ...]
    leaders: tuple[Leader, ...]
    detector: str
    ids: tuple[str | int, ...] = ()

    def __repr__(self) -> str:
        names = ", ".join(str(leader.id) for leader in self.leaders[:6]) + ", …" * (len(self.leaders) > 6)
        return f"<FoundLeaders in {format_count(len(self.windows), 'window')} by {self.detector}: {names or 'nobody'}>"

    def __str__(self) -> str:
        said = [(each.id, format_count(len(each.followers), "id"), each.share or 0.0) for each in self.leaders]
        lines = [f"{name} leads {count} in {share:.0%} of the windows." for name, count, share in said]
        return "\n".join([*(lines or ["No leader was found."]), *self.confounds, *map(str, self.events)])

    def _repr_html_(self) -> str:
        rows = [[each.id, each.probability, ", ".join(map(str, each.followers)), each.reason] for each in self.leaders]
        table = pd.DataFrame(rows, columns=["leader", "p", "followers", "why"]).astype({"p": float})
        html = table.to_html(index=False, na_rep="", float_format="{:.2f}".format)
        return str(html) if rows else "<p>No leader was found.</p>"

    @property
    def confounds(self) -> list[str]:
        """A sentence about what ids follow instead of a leader, if they do so in at least half of the windows."""
        sentences, all_windows = [], format_count(len(self.windows), "window")
        for kind, words in CONFOUNDS.items():
            counts = [len(window.alike) for window in self.windows if window.confound == kind]
            if 2 * len(counts) >= len(self.windows):
                ids = format_count(round(np.mean(counts)), "id")
                sentences.append(f"In {len(counts)} of {all_windows} nobody leads, and {ids} {words}.")
        return sentences

    @property
    def events(self) -> tuple[Event, ...]:
        """Who leads, joins, leaves and takes over when, from window to window."""
        return find_events(self.windows)

    @property
    def colors(self) -> dict[str | int, str]:
        """The colour of each id that leads, in all pictures and in the replay."""
        leading = {leader.id for window in self.windows for leader in window.leaders}
        return dict(zip((name for name in self.ids if name in leading), cycle(CLUSTER_COLORS), strict=False))

    def to_frame(self) -> pd.DataFrame:
        """A row for each window and each id that leads or follows in it.

        The columns are ``start``, ``end``, ``id``, ``leader`` (the id that it follows directly, missing for a head),
        ``head``, ``delay`` in seconds, and ``probability`` and ``group`` of the head.
        """
        rows = []
        for window in self.windows:
            of = {leader.id: {"probability": leader.probability, "group": leader.group} for leader in window.leaders}
            found: list[Any] = [{"id": leader.id, "head": leader.id} for leader in window.leaders]
            found += [vars(link) | {"id": link.follower} for link in window.links]
            rows += [{"start": window.start, "end": window.end} | each | of[each["head"]] for each in found]
        return pd.DataFrame(rows, columns=[*_COLUMNS["rows"].split()])

    def plot(self) -> Figure:
        """Draw who follows whom: an arrow leads to the one that is followed; see :mod:`usnet_env.tracks.plots`."""
        from usnet_env.tracks.plots import draw_network

        return draw_network(self)

    def plot_delays(self) -> Figure:
        """Draw the median delay in seconds of each id behind each one that it follows."""
        from usnet_env.tracks.plots import draw_delays

        return draw_delays(self)

    def plot_timeline(self) -> Figure:
        """Draw which head each id follows in each window."""
        from usnet_env.tracks.plots import draw_timeline

        return draw_timeline(self)

    def as_dict(self) -> dict[str, Any]:
        """The windows and the leaders over the file as plain values for JSON."""
        values = {"windows": [asdict(window) for window in self.windows], "leaders": [*map(asdict, self.leaders)]}
        for window in values["windows"]:
            for leader in window["leaders"]:
                del leader["share"]
        return values

    def tables(self) -> dict[str, pd.DataFrame]:
        """Three tables, as they are written to CSV: ``windows``, ``leaders`` and ``links``.

        A window without leaders has one row without an id. Ids are joined by semicolons; in them, a semicolon or a
        backslash has a backslash before it.
        """
        rows: dict[str, list[dict[str, Any]]] = {"leaders": [vars(leader) for leader in self.leaders]}
        rows["windows"] = [
            vars(window) | (vars(leader) if leader else {})
            for window in self.windows
            for leader in window.leaders or (None,)
        ]
        rows["links"] = [vars(window) | vars(link) for window in self.windows for link in window.links]
        return {
            name: pd.DataFrame(rows[name], columns=names.split(), dtype=object).map(_cell)
            for name, names in _COLUMNS.items()
            if name in rows
        }


def _cell(value: Any) -> Any:
    return ";".join(re.sub(r"([;\\])", r"\\\1", str(name)) for name in value) if isinstance(value, tuple) else value


def find_leaders(
    tracks: Tracks | str | os.PathLike[str] | pd.DataFrame,
    detector: str | DetectorLike = DEFAULT_DETECTOR,
    *,
    length: int | None = None,
    stride: int | None = None,
    seed: int = 0,
    confirm: bool = True,
    on_window: Callable[[TrackWindow, Detection, DetectedWindow], None] | None = None,
) -> FoundLeaders:
    """Let a detector answer every window of tracks.

    The detector is reset before every window. If it tells the probability that nobody leads, the window is read at
    other steps, too (:func:`answer_window`). Groups, a leader and its followers, are followed from window to window: a
    group keeps its number where it shares the most members with an earlier one.

    Args:
        tracks: the tracks, or what :func:`read_tracks` takes; if they are not resampled, the step is chosen.
        detector: a name as :func:`usnet_env.make_detector` takes it, or a detector.
        length: steps of a window; ``None``: as many as fit the tracks (:meth:`Tracks.choose_length`).
        stride: steps from the start of a window to the start of the next; ``None``: ``length``.
        seed: seeds the detector.
        confirm: whether to leave out candidates that have no followers, whose followers don't move like them later, or
            that follow another id in half of the window, by the tests of :mod:`usnet_env.tracks.confirm`.
        on_window: called with each window, the detector's answer and the leaders.

    Raises:
        ArgumentError: an argument is refused, the tracks hold no window, or the detector fails in one.
    """
    tracks = tracks if isinstance(tracks, Tracks) else read_tracks(tracks)
    player = find_detector(detector)
    seed = whole_number("seed", seed, 0)
    groups: list[Group] = []
    windows: list[DetectedWindow] = []
    seen = np.zeros(len(tracks.ids), np.int64)
    even = tracks if tracks.step is not None else tracks.resample(length=length or 0)
    for number, cut in enumerate(even.windows(length, stride)):
        times = tracks.file_time(cut.start), tracks.file_time(cut.end)
        answer = _try_answer(player, even, cut, seed, number, times)
        found = _detect_window(cut, answer, confirm, groups, times)
        windows.append(found)
        seen[cut.rows] += 1
        if on_window is not None:
            on_window(cut, answer.detection, found)
    if not windows:
        hint = "no window does (--window makes them shorter)"
        raise ArgumentError(f"tracks must hold a window in which 2 ids are seen in half of the steps; {hint}.")
    leaders = _summarise(windows, tracks.ids, seen if confirm else None)
    return FoundLeaders(tuple(windows), leaders, detector_label(player), tracks.ids)


def _try_answer(
    player: DetectorLike, even: Tracks, cut: TrackWindow, seed: int, number: int, times: tuple[Any, Any]
) -> Answer:
    """Ask the detector for one window; what it raises becomes an ``ArgumentError`` that names the window."""
    try:
        drawn = int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1)[0])
        return answer_window(player, even, cut, drawn)
    except Exception as error:  # a detector may raise anything
        found = f"{describe_error(error)} from {quote(detector_label(player))} in the window from {times[0]}"
        raise ArgumentError(f"detector must answer every window, got {found} to {times[1]}.") from error


def _detect_window(
    cut: TrackWindow, answer: Answer, confirm: bool, groups: list[Group], times: tuple[Any, Any]
) -> DetectedWindow:
    """The leaders that an answer names in a window; their groups update those of earlier windows."""
    detection, ids = answer.detection, cut.ids
    scores, extras = detection.scores, detection.extras
    order = np.argsort(-scores, kind="stable")
    heads = order[detection.candidates[order]]
    followers = [list_followers(detection, int(head)) for head in heads]
    confirmed = np.ones(len(heads), bool)
    if confirm:
        confirmed, followers = confirm_leaders(cut.window, heads, followers, answer.finest.window)
    led = {int(heads[k]): followers[k] for k in np.flatnonzero(confirmed)}
    found = [(int(cut.rows[head]), set(cut.rows[[head, *members]].tolist())) for head, members in led.items()]
    labels = _number_groups(found, groups)
    reasons = dict(zip(map(int, extras.get("heads", ())), extras.get("reasons", ()), strict=False))
    ranks = np.argsort(order) + 1
    leaders, links = [], []
    for (head, members), label in zip(led.items(), labels, strict=True):
        why = f"Has score {scores[head]:.3g}, rank {ranks[head]} of {len(scores)}, and "
        why = str(reasons.get(head) or why + f"{format_count(len(members), 'follower')}.")
        probability = float(extras["probability"][head]) if "probability" in extras else None
        behind = tuple(ids[i] for i in members)
        leaders.append(Leader(ids[head], probability, behind, why, label, float(scores[head])))
        for i in members:
            ahead = head if detection.leader is None else int(detection.leader[i])
            links.append(Link(ids[i], ids[ahead], ids[head], _measure_delay(cut, i, ahead)))
    rejected = tuple(ids[head] for head in heads[~confirmed])
    confound, alike = find_confound(cut.window) if confirm and not leaders else ("", [])
    others = tuple(ids[i] for i in alike)
    return DetectedWindow(*times, tuple(leaders), rejected, tuple(links), cut.left_out, confound, others)


def _measure_delay(cut: TrackWindow, follower: int, leader: int) -> float | None:
    """The lag, in seconds, at which the follower's velocity is most correlated with the leader's; ``None`` for 0."""
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
    return round(lag * cut.step, 9) if lag else None


def _number_groups(found: list[Group], known: list[Group]) -> list[int]:
    """Number the groups of a window from 1, by the earlier groups with which they share the most members.

    ``known`` holds each group as it was found last, in the order of the numbers, and is updated.
    """
    from scipy.optimize import linear_sum_assignment  # a refusal does not wait for SciPy

    share = np.zeros((len(found), len(known)))
    for (k, (head, now)), (g, (leader, then)) in product(enumerate(found), enumerate(known)):
        share[k, g] = len(now & then) / len(now | then) + _SAME_LEADER * (head == leader)
    same = {k: int(g) for k, g in zip(*linear_sum_assignment(-share), strict=True) if share[k, g] >= _SAME_GROUP}
    for k, group in enumerate(found):
        g = same.setdefault(k, len(known))
        known[g : g + 1] = [group]
    return [same[k] + 1 for k in range(len(found))]


def _summarise(windows: list[DetectedWindow], ids: Sequence[str | int], seen: Indices | None) -> tuple[Leader, ...]:
    """The leaders over the file; ``seen`` ``(N,)`` windows hold each id, ``None`` if leaders are not confirmed."""
    from scipy.special import bdtrc

    row = {name: k for k, name in enumerate(ids)}
    entries_of: dict[tuple[int, int], list[Leader]] = {}  # by the group and the row of its leader
    for window in windows:
        for leader in window.leaders:
            entries_of.setdefault((leader.group, row[leader.id]), []).append(leader)
    found = []
    for (group, head), entries in sorted(entries_of.items(), key=lambda item: (-len(item[1]), item[0])):
        count = len(entries)
        times_behind = Counter(name for leader in entries for name in leader.followers)
        behind = sorted((name for name, times in times_behind.items() if times >= count / 2), key=row.__getitem__)
        numbers = [(np.nan if leader.probability is None else leader.probability, leader.score) for leader in entries]
        probability, score = np.mean(numbers, axis=0).tolist()
        reason = f"Leads group {group} in {count} of {format_count(len(windows), 'window')}."
        chance = 0.0 if seen is None else float(bdtrc(count - 1, int(seen[head]), LEVEL))
        if chance > _UNLIKELY:
            what = "By chance, a group without a leader has a confirmed leader in as many windows"
            reason += f" {what} with probability {chance:.2g}."
        sure = None if np.isnan(probability) else probability
        found.append(Leader(ids[head], sure, tuple(behind), reason, group, score, count / len(windows)))
    return tuple(found)

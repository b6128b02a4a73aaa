"""The leaders of recorded tracks: as sentences, tables, pictures, an episode, and a folder of all of them."""

from __future__ import annotations

import json
import os
import re
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from usnet_env.config import ArgumentError, MissingExtraError, format_count, list_names, quote
from usnet_env.detection import Detection
from usnet_env.drawing import CLUSTER_COLORS, write_figure
from usnet_env.files import as_path, replace_files, reserve_folder, write_text
from usnet_env.provenance import versions
from usnet_env.tracks import draw
from usnet_env.tracks.changes import Period, list_events
from usnet_env.tracks.evidence import compare_with_head
from usnet_env.tracks.found import DetectedWindow, Event, Leader, find_events
from usnet_env.tracks.links import sample_finely
from usnet_env.tracks.page import collect_data, write_page
from usnet_env.tracks.samples import Clock
from usnet_env.tracks.silence import explain_silence
from usnet_env.tracks.tracks import Tracks, TrackWindow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from usnet_env.replay import EpisodeRecord

_COLUMNS = {  # of the tables
    "windows": "start end group id probability score followers reason not_confirmed left_out confound alike",
    "leaders": "id probability followers reason group score share",
    "rows": "start end id leader head delay delay_low delay_high direct probability group",
    "links": "start end follower leader head delay delay_low delay_high direct behind_head correlation by_chance path",
    "probabilities": "start end id probability",
}
_PICTURES = ("network.png", "timeline.png", "picture.png", "delays.png", "evidence.png", "probabilities.png")
_OPTIONAL = ("probabilities.csv", "episode.npz", "replay.rrd", *_PICTURES)  # files


@dataclass(frozen=True, eq=False)
class FoundLeaders:
    """The leaders of each window, and over the file.

    Args:
        windows: in the order of time.
        leaders: an entry for each id that leads a group in a window, the one with the most windows first.
        detector: label of the detector.
        ids: all ids of the tracks.
        facts: sentences about the tracks, and how they were resampled.
        tracks: the resampled tracks; it, the windows of them and the answers are needed for maps and an episode only.
        track_windows: the windows of the tracks.
        answers: the detector's answer to each window.
        seed: that of the detector.
        periods: who leads each group when, if windows differ and the detector gives probabilities.
    """

    windows: tuple[DetectedWindow, ...]
    leaders: tuple[Leader, ...]
    detector: str
    ids: tuple[str | int, ...] = ()
    facts: tuple[str, ...] = ()
    tracks: Tracks | None = None
    track_windows: tuple[TrackWindow, ...] = ()
    answers: tuple[Detection, ...] = ()
    seed: int = 0
    periods: tuple[Period, ...] = ()

    def __repr__(self) -> str:
        names = list_names([leader.id for leader in self.leaders], 6, ", …") or "no leader"
        return f"<FoundLeaders in {format_count(len(self.windows), 'window')} by {self.detector}: {names}>"

    def __str__(self) -> str:
        leading = [(each.id, format_count(len(each.followers), "id"), each.share or 0.0) for each in self.leaders]
        lines = [f"{name} leads {count} in {share:.0%} of the windows." for name, count, share in leading]
        return "\n".join([*(lines or [self._silence]), *self.confounds, *map(str, self.events)])

    def _repr_html_(self) -> str:
        rows = [[each.id, each.probability, ", ".join(map(str, each.followers)), each.reason] for each in self.leaders]
        table = pd.DataFrame(rows, columns=["leader", "p", "followers", "why"]).astype({"p": float})
        html = table.to_html(index=False, na_rep="", float_format="{:.2f}".format)
        return str(html) if rows else f"<p>{self._silence}</p>"

    @property
    def _silence(self) -> str:
        """What to say if no window has a leader: the periods may have one for a part of a window."""
        partly = "No leader is confirmed in a whole window; one is found for a part of the time."
        return partly if self.colors else "No leader was found."

    @property
    def confounds(self) -> list[str]:
        """Sentences about windows without a leader, if they are half of all (:mod:`usnet_env.tracks.silence`)."""
        return explain_silence(self.windows, self.track_windows, self.answers)

    @property
    def events(self) -> tuple[Event, ...]:
        """Who leads, joins, leaves and takes over when, by the periods, or else from window to window."""
        return list_events(self.periods, self._resampled) if self.periods else find_events(self.windows)

    @property
    def colors(self) -> dict[str | int, str]:
        """The colour of each id that leads, in all pictures and in the replay."""
        leading = {leader.id for window in self.windows for leader in window.leaders}
        leading |= {self.ids[period.leader] for period in self.periods if period.leader >= 0}
        return dict(zip((name for name in self.ids if name in leading), cycle(CLUSTER_COLORS), strict=False))

    def to_frame(self) -> pd.DataFrame:
        """A row for each window and each id that leads or follows in it.

        The columns are ``start``, ``end``, ``id``, ``leader`` (the id that it follows directly, missing for a head),
        ``head``, ``delay`` in seconds with its 95 % interval ``delay_low`` and ``delay_high``, ``direct`` (whether it
        surely follows ``leader`` directly; if not, that is the head), and ``probability`` and ``group`` of the head.
        Timestamps are datetimes, in the time zone of the file.
        """
        frame, clock = self._list_rows(), self.tracks.clock if self.tracks else Clock()
        if clock.timestamps and not clock.recordings:
            moments = {end: pd.to_datetime(frame[end], utc=True).dt.tz_convert(clock.zone) for end in ("start", "end")}
            frame = frame.assign(**moments)
        kind = "Int64" if all(isinstance(name, int) for name in self.ids) else object
        return frame.astype(dict.fromkeys(("id", "leader", "head"), kind))

    def _list_rows(self) -> pd.DataFrame:
        rows = []
        for window in self.windows:
            head_of = {head.id: {"probability": head.probability, "group": head.group} for head in window.leaders}
            roles: list[Any] = [{"id": leader.id, "head": leader.id} for leader in window.leaders]
            roles += [vars(link) | {"id": link.follower} for link in window.links]
            rows += [{"start": window.start, "end": window.end} | role | head_of[role["head"]] for role in roles]
        frame = pd.DataFrame(rows, columns=_COLUMNS["rows"].split())
        return frame.assign(leader=pd.Series([row.get("leader") for row in rows], dtype=object))  # whole numbers stay

    def evidence(self, leader: str | int) -> pd.DataFrame:
        """Why an id was named: a row for each of its followers, by the windows in which it leads them.

        The columns are ``follower``, ``windows``, their number, ``behind_head``, the median delay behind the leader in
        seconds, ``correlation`` of both velocities at this delay, ``by_chance``, the largest one after shifts in time,
        and ``path``, the mean squared distance to where the leader was before, as a share of that to where it is.
        """
        numbers = ["behind_head", "correlation", "by_chance", "path"]
        links = pd.DataFrame([vars(link) for window in self.windows for link in window.links if link.head == leader])
        if links.empty:
            raise ArgumentError(f"leader must be an id that leads in a window, got {quote(leader)}.")
        parts = links.astype(dict.fromkeys(numbers, float)).groupby("follower", sort=False)
        return parts.size().to_frame("windows").join(parts[numbers].median()).reset_index()

    def plot_evidence(self, leader: str | int, ax: Axes | None = None) -> Figure:
        """Draw how the velocity of each follower is correlated with that of its leader before and after."""
        self.evidence(leader)  # refuses an id that leads in no window
        curves, chance = self._compute_lag_curves(leader)
        if curves is None:
            raise ArgumentError(f"leader must lead in a window of more steps, got {quote(leader)}.")
        return draw.draw_evidence(curves, chance, leader, ax)

    def _compute_lag_curves(self, leader: str | int) -> tuple[pd.DataFrame | None, float]:
        """The median correlation by lag (index, seconds) and follower, if any window is long enough, and by chance."""
        fine, curves, chance = sample_finely(self._resampled), list[pd.DataFrame](), np.nan
        for window, track_window in zip(self.windows, self.track_windows, strict=True):
            followers = [link.follower for link in window.links if link.head == leader]
            if not followers:
                continue
            head, *members = map(track_window.ids.index, (leader, *followers))
            head_curves = compare_with_head(fine, track_window, head, members)
            if head_curves is not None:
                curves.append(pd.DataFrame(head_curves.correlation.T, head_curves.lags.round(9), followers))
                chance = np.fmax(chance, head_curves.by_chance.max())
        return (pd.concat(curves).groupby(level=0).median() if curves else None), float(chance)

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the network of links, with an arrow from a follower to its leader; see :mod:`usnet_env.tracks.draw`."""
        return draw.draw_network(self.to_frame(), len(self.windows), self.colors, ax)

    def plot_delays(self, ax: Axes | None = None) -> Figure:
        """Draw the median delay in seconds of each id behind each one that it follows."""
        return draw.draw_delays(self.to_frame(), ax)

    def plot_timeline(self, ax: Axes | None = None) -> Figure:
        """Draw which head each id follows when."""
        return draw.draw_timeline(self._spans, self.ids, [window.start for window in self.windows], self.colors, ax)

    def plot_probabilities(self, ax: Axes | None = None) -> Figure:
        """Draw the detector's probability that each id leads in each window, and that none does."""
        starts = [window.start for window in self.windows]
        return draw.draw_probabilities(pd.DataFrame(self._probabilities, index=starts), self.colors, ax)

    @property
    def _probabilities(self) -> list[dict[Any, float]]:
        """Of each window: the probability to lead of each id, and under ``None`` that none leads, if known."""
        rows = []
        for track_window, answer in zip(self.track_windows, self.answers, strict=True):
            probabilities = np.asarray(answer.extras.get("probability", []), float).tolist()
            row: dict[Any, float] = dict(zip(track_window.ids, probabilities, strict=False))
            rows.append(row | ({None: float(answer.extras["p_no_leader"])} if "p_no_leader" in answer.extras else {}))
        return rows

    @property
    def _probability_rows(self) -> list[dict[str, Any]]:
        return [
            {"start": window.start, "end": window.end, "id": name, "probability": chance}
            for window, chances in zip(self.windows, self._probabilities, strict=False)
            for name, chance in chances.items()
        ]

    @property
    def _spans(self) -> list[tuple[str | int, str | int, float, float]]:
        """An id, its head, begin and end in windows: by the periods, or else by windows."""
        if not self.periods:
            number = {window.start: k for k, window in enumerate(self.windows)}
            rows = self._list_rows()[["id", "head", "start"]].itertuples(index=False)
            return [(name, head, number[start], number[start] + 1) for name, head, start in rows]
        starts = [*(track_window.start for track_window in self.track_windows), self.track_windows[-1].end]
        led = [period for period in self.periods if period.leader >= 0]
        times = [(row, each.leader, each.start, each.end) for each in led for row in each.rows if row != each.leader]
        for leader in {each.leader for each in led}:  # it may be in no group
            parts = list[list[float]]()
            for start, end in sorted((each.start, each.end) for each in led if each.leader == leader):
                parts += [] if parts and start <= parts[-1][1] else [[start, end]]
                parts[-1][1] = max(parts[-1][1], end)
            times += [(leader, leader, start, end) for start, end in parts]
        spans = []
        for row, leader, *seconds in times:
            begin, end = np.interp(seconds, starts, np.arange(len(starts))).tolist()
            spans.append((self.ids[row], self.ids[leader], begin, end))
        return spans

    def plot_maps(self, title: str = "tracks") -> Figure:
        """Draw up to six windows from above, in the coordinates of the file; ``title`` is what the tracks are."""
        return draw.draw_maps(self._resampled, self.track_windows, self.windows, [*self.colors], title, self.detector)

    @property
    def _resampled(self) -> Tracks:
        if self.tracks is None:
            raise ArgumentError("tracks must be given for maps and episodes, got leaders without them.")
        return self.tracks

    def as_dict(self) -> dict[str, Any]:
        """The windows and the leaders over the file as plain values for JSON."""
        values = {"windows": [asdict(window) for window in self.windows], "leaders": [*map(asdict, self.leaders)]}
        for window in values["windows"]:
            for leader in window["leaders"]:
                del leader["share"]
        values["probabilities"] = self._probability_rows
        values["events"] = [asdict(event) | {"text": str(event)} for event in self.events]
        return values

    def tables(self) -> dict[str, pd.DataFrame]:
        """Tables, as they are written to CSV: ``windows``, ``leaders``, ``links`` and ``probabilities``.

        In the last one, a row without an id has the probability that no id leads. A window without leaders has one row
        without an id in ``windows``. Ids are joined by semicolons; in them, a semicolon or a backslash has a backslash
        before it.
        """
        rows: dict[str, list[dict[str, Any]]] = {"leaders": [vars(leader) for leader in self.leaders]}
        rows["windows"] = [
            vars(window) | (vars(leader) if leader else {})
            for window in self.windows
            for leader in window.leaders or (None,)
        ]
        if self._probability_rows:
            rows["probabilities"] = self._probability_rows
        rows["links"] = [vars(window) | vars(link) for window in self.windows for link in window.links]
        return {
            name: pd.DataFrame(rows[name], columns=names.split(), dtype=object).map(_join_names)
            for name, names in _COLUMNS.items()
            if name in rows
        }

    def to_episode(self, title: str = "tracks") -> EpisodeRecord:
        """A record with a round for each window, without truth and destroyed UAVs; ``title`` is what the tracks are."""
        from usnet_env.replay import EpisodeRecord

        tracks, results = self._resampled, zip(self.track_windows, self.answers, self.windows, strict=True)
        steps = max(track_window.window.observation_steps for track_window in self.track_windows)  # parts have fewer
        windows = [track_window.among(len(tracks.ids), steps) for track_window in self.track_windows]
        answers = [_expand_answer(len(tracks.ids), *result) for result in results]
        config: dict[str, Any] = {"ids": [*tracks.ids], "step": tracks.step, "frame": tracks.frame}
        config |= {"origin": tracks.origin.tolist()}
        config |= {end: [getattr(window, end) for window in self.windows] for end in ("start", "end")}
        source: dict[str, Any] = {"env_id": title, "detector": self.detector, "detector_seed": self.seed}
        return EpisodeRecord.from_rounds(windows, answers, config=config, **source)

    def write(self, folder: str | os.PathLike[str], title: str = "tracks", *, record: bool = False) -> list[Path]:
        """Write the files of ``usnet detect --out``: a page, tables, JSON, and pictures.

        They appear together, in place of those of an earlier run. A warning says which ones need an extra that is not
        installed.

        Args:
            folder: where to; it is created if it is missing.
            title: what the tracks are, in the page and the pictures.
            record: whether to write an episode file and a replay, too.

        Returns:
            The paths of the files.

        Raises:
            ArgumentError: the folder can't be written to, or the leaders are not those of :func:`find_leaders`.

        Example:
            >>> find_leaders("flock.csv").write("runs/flock", "flock.csv", record=True)  # doctest: +SKIP
        """
        target = reserve_folder(as_path("folder", folder), "folder")
        with replace_files(target, _OPTIONAL) as temporary:
            self._write_files(temporary, title, record)
            names = sorted(path.name for path in temporary.iterdir())
        return [target / name for name in names]

    def _write_files(self, folder: Path, title: str, record: bool) -> None:
        write_text(folder / "leaders.json", json.dumps(self.as_dict(), indent=2, allow_nan=False) + "\n")
        for name, table in self.tables().items():
            write_text(folder / f"{name}.csv", table.to_csv(index=False))
        writers: dict[str, Callable[[Path], Path]] = {
            "network.png": lambda path: write_figure(self.plot(), path),
            "timeline.png": lambda path: write_figure(self.plot_timeline(), path),
            "picture.png": lambda path: write_figure(self.plot_maps(title), path),
            "delays.png": lambda path: write_figure(self.plot_delays(), path),
        }
        if self.leaders and self.leaders[0].followers and self.tracks is not None:
            writers["evidence.png"] = lambda path: write_figure(self.plot_evidence(self.leaders[0].id), path)
        if any(self._probabilities):
            writers["probabilities.png"] = lambda path: write_figure(self.plot_probabilities(), path)
        if record:
            from usnet_env.replay import write_recording

            episode = self.to_episode(title)
            episode.save(folder / "episode.npz")
            writers["replay.rrd"] = lambda path: write_recording(episode, path)
        for name, write in writers.items():
            try:
                write(folder / name)
            except MissingExtraError as error:
                warnings.warn(f"{name} was not drawn: {error}", stacklevel=3)
        data, version = None, versions().get("usnet", "unknown")
        if self.tracks is not None and self.windows:
            results = (self.windows, self.track_windows, self.leaders, self.colors, self._probabilities)
            data = collect_data(self.tracks, *results, self._compute_lag_curves)
        facts = [*self.facts, f"Found by {self.detector}, seed {self.seed}, with usnet {version}."]
        write_page(folder / "page.html", title, str(self).splitlines(), data, self._repr_html_(), facts)


def _expand_answer(ids: int, track_window: TrackWindow, answer: Detection, detected: DetectedWindow) -> Detection:
    """The answer to a window, with confirmed leaders only, for all ids of the tracks."""
    rows, roots = track_window.rows, detected.roots(track_window.ids)
    leader, scores, probability = np.full(ids, -1), np.zeros(ids), np.zeros(ids)
    leader[rows], scores[rows] = np.where(roots >= 0, rows[roots], -1), answer.scores
    extras: dict[str, Any] = {"heads": [rows[track_window.ids.index(each.id)] for each in detected.leaders]}
    extras["reasons"] = [each.reason for each in detected.leaders]
    if "probability" in answer.extras:
        probability[rows] = answer.extras["probability"]
        extras["probability"] = probability
    return Detection(leader == np.arange(ids), scores, leader=leader, extras=extras)


def _join_names(value: Any) -> Any:
    return ";".join(re.sub(r"([;\\])", r"\\\1", str(name)) for name in value) if isinstance(value, tuple) else value

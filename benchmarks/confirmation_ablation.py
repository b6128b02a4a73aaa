"""What every part of the test of leaders is worth: each is left out or moved, on the same answers. Resumable.

    python benchmarks/confirmation_ablation.py --data data    # ants and cars beside simulated tracks
    python benchmarks/confirmation_ablation.py --list         # the changes

``large`` and ``small`` are files of ``tracks_speed.py`` with 500 and 60 ids, seeds below 10 and windows of 200 steps:
groups change, ids come and go. ``leaderless`` and ``shepherd`` are files of ``examples/make_tracks.py``, in which no id
leads. ``ants`` and ``cars`` are the recordings of ``real_tracks.py`` with a step of 0.5 s. All were used in the
development of the test. A row of ``results/confirmation_ablation.csv`` is a window, a detector and a change; the rows
without a change are the whole test. The detector answers a window once, and each change is applied to this answer.
"""

from __future__ import annotations

import csv
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from running import RESULTS, make_parser, parse_or_list, play_games
from tracks_speed import LENGTH, STEP, write_file

from usnet_env import Window, make_detector
from usnet_env.detection import fit_window
from usnet_env.objectives import find_roots, list_followers
from usnet_env.tracks import confirming, read_tracks

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
import make_tracks  # type: ignore[import-not-found]  # an example is no package

FILE = RESULTS / "confirmation_ablation.csv"
MAP, LAGS, MFLICA = "follow-mixture(policy='map')", "net-lag-regression", "mflica"
OFTEN = "lagged-regression", "directional-delays", LAGS  # they name ids where none leads
DETECTORS = {"large": (LAGS,), "small": (LAGS, MAP), "leaderless": OFTEN, "shepherd": OFTEN}
SIZES = {"large": (500, 25, range(3)), "small": (60, 10, range(6))}  # ids, groups, seeds
STEPS, WINDOWS = 3150, 15  # of a file of tracks_speed.py
REAL_LENGTH, MOST = 100, 12  # of the others: steps of a window, and windows of a recording
VALUES = ("named", "right", "confirmed", "confirmed_right", "missed", "followers", "followers_right")


@dataclass(frozen=True)
class Change:
    """A part of the test that is left out or moved.

    Args:
        what: it, and its new value.
        patches: attributes of ``usnet_env.tracks.confirming`` and their new values.
    """

    what: str
    patches: Mapping[str, Any]


def _keep_all(window: Window, leader: int, followers: Sequence[int]) -> list[int]:
    return list(followers)


def _follow_none(window: Window, leaders: Sequence[int], followers: Sequence[Sequence[int]]) -> NDArray[np.bool_]:
    return np.zeros(len(leaders), bool)


def _confirm_all(window: Window, leader: int, followers: Sequence[int]) -> bool:
    return bool(followers)


CHANGES = {
    "": Change("nothing", {}),
    "lead-never": Change("a leader need not be ahead of its followers", {"confirm_lead": _confirm_all}),
    "level-0.01": Change("the level of all tests is 0.01 instead of 0.05", {"LEVEL": 0.01}),
    "level-0.2": Change("the level of all tests is 0.2", {"LEVEL": 0.2}),
    "keep-all": Change("no follower is removed before the test", {"keep_group": _keep_all}),
    "deviations-2": Change("a follower stays from 2 standard deviations on instead of 3", {"_DEVIATIONS": 2.0}),
    "deviations-4": Change("a follower stays from 4 standard deviations on", {"_DEVIATIONS": 4.0}),
    "follows-never": Change("a leader may follow another id in half of the window", {"find_followers": _follow_none}),
    "nearest-1": Change("it is compared with 1 id in each half instead of 5", {"_NEAREST": 1}),
    "nearest-10": Change("it is compared with 10 ids", {"_NEAREST": 10}),
    "outside-as-inside": Change(
        "ids outside its group need as clear a lead over it as its followers", {"_LEVEL_OUTSIDE": 0.01}
    ),
    "shifts-5": Change("chance likeness is measured after 5 shifts in time instead of 9", {"_SHIFTS": 5}),
    "shifts-19": Change("it is measured after 19 shifts", {"_SHIFTS": 19}),
}


@dataclass(frozen=True, eq=False)
class Case:
    """A window of N ids and its truth.

    Args:
        window: the window.
        leads: ``(N,)`` whether an id leads another one.
        needed: ``(N,)`` whether a detector must name the id.
        follows: ``(N, N)`` whether id i follows id j.
    """

    window: Window
    leads: NDArray[np.bool_]
    needed: NDArray[np.bool_]
    follows: NDArray[np.bool_]


@lru_cache(maxsize=2)
def simulate(name: str, seed: int) -> tuple[Case, ...]:
    """The windows of one file of ``tracks_speed.py``."""
    ids, groups, _ = SIZES[name]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tracks.csv"
        leaders, seen = write_file(path, seed, ids, groups, STEPS)
        tracks = read_tracks(path).resample(STEP)
    cases = []
    for cut in tracks.windows(LENGTH):
        first = round(float(tracks.file_time(cut.start)) / STEP)
        led, rows = leaders[first : first + LENGTH], np.array([int(each[4:]) for each in cut.ids])
        present = seen[first : first + LENGTH].sum(axis=0) > LENGTH / 2
        counts = np.array([np.bincount(now[(now >= 0) & present], minlength=ids) for now in led])
        needed = ((counts >= 3).sum(axis=0) >= 0.8 * LENGTH) & present
        follows = (led[:, rows, None] == rows).mean(axis=0) > 0.5
        cases.append(Case(cut.window, (counts > 0).any(axis=0)[rows], needed[rows], follows))
    return tuple(cases)


@lru_cache(maxsize=2)
def make(name: str, seed: int) -> tuple[Case, ...]:
    """The windows of one file of ``examples/make_tracks.py`` in which no id leads."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tracks.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([["id", "t", "x", "y", "leader"], *getattr(make_tracks, name)(seed)])
        cuts = list(read_tracks(path).resample(STEP).windows(REAL_LENGTH))
    none = [(np.zeros(cut.window.uavs, bool), np.zeros((cut.window.uavs, cut.window.uavs), bool)) for cut in cuts]
    return tuple(Case(cut.window, one, one, pairs) for cut, (one, pairs) in zip(cuts, none, strict=True))


@lru_cache(maxsize=2)
def record(path: Path) -> tuple[Case, ...]:
    """At most 12 windows of a recording."""
    cuts = list(read_tracks(path).resample(STEP).windows(REAL_LENGTH))
    cases = []
    for k in np.unique(np.linspace(0, len(cuts) - 1, min(MOST, len(cuts))).astype(int)) if cuts else []:
        roots, every = find_roots(cuts[k].leader), np.arange(cuts[k].window.uavs)
        follows = (roots[:, None] == every) & (roots != every)[:, None]
        cases.append(Case(cuts[k].window, follows.any(axis=0), follows.any(axis=0), follows))
    return tuple(cases)


@lru_cache(maxsize=64)
def answer(case: Case, detector: str, number: int) -> tuple[NDArray[np.int64], list[list[int]]]:
    """The candidates of a detector, and the followers of each."""
    player = make_detector(detector)
    player.reset(number)
    found = player.detect(fit_window(player, case.window))
    named = np.flatnonzero(found.candidates)
    return named, [list_followers(found, int(head)) for head in named]


def confirm(case: Case, detector: str, number: int, change: str) -> dict[str, int]:
    """Count the candidates in a window, those confirmed under a change, their followers, and the right ones."""
    named, followers = answer(case, detector, number)
    with ExitStack() as stack:
        for name, value in CHANGES[change].patches.items():
            stack.enter_context(patch.object(confirming, name, value))
        sure, kept = confirming.confirm_leaders(case.window, named, followers)
    confirmed = named[sure]
    pairs = [(i, head) for head, led, good in zip(named, kept, sure, strict=True) if good for i in led]
    return {
        "named": len(named),
        "right": int(case.leads[named].sum()),
        "confirmed": len(confirmed),
        "confirmed_right": int(case.leads[confirmed].sum()),
        "missed": int(case.needed.sum() - case.needed[confirmed].sum()),
        "followers": len(pairs),
        "followers_right": sum(bool(case.follows[pair]) for pair in pairs),
    }


def main() -> None:
    """List the changes, or play."""
    parser = make_parser(__doc__)
    parser.add_argument("--data", type=Path, help="folder with a folder of CSV files for each set of recordings")
    parser.add_argument("--results", type=Path, default=FILE)
    if (arguments := parse_or_list(parser, CHANGES)) is None:
        return
    files = sorted(arguments.data.glob("*/*.csv")) if arguments.data else []
    paths = {(path.parent.name, path.stem): path for path in files}
    sources = [(name, str(seed)) for name, (_, _, seeds) in SIZES.items() for seed in seeds]
    sources += [(name, str(seed)) for name in ("leaderless", "shepherd") for seed in range(10)]

    def cases_of(name: str, recording: str) -> tuple[Case, ...]:
        if (name, recording) in paths:
            return record(paths[name, recording])
        return simulate(name, int(recording)) if name in SIZES else make(name, int(recording))

    def play_one(cell: Mapping[str, Any], number: int) -> dict[str, int]:
        case = cases_of(cell["set"], cell["recording"])[number]
        return confirm(case, cell["detector"], number, cell["change"])

    games = [
        ({"set": name, "recording": recording, "detector": detector, "change": change}, number)
        for name, recording in (*sources, *paths)
        for detector in DETECTORS.get(name, (MAP, MFLICA, LAGS))
        for number in range(WINDOWS if name in SIZES else len(cases_of(name, recording)))
        for change in CHANGES
    ]
    play_games(arguments.results, games, play_one, VALUES, "window")


if __name__ == "__main__":
    main()

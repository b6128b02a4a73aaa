"""Small files of tracks."""

import csv
import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from detectors import Detector
from usnet_env import ArgumentError, Detection
from usnet_env.tracks import Tracks, read_tracks

HEADER = ["id", "t", "x", "y"]


class Sure(Detector):
    """A detector that is sure of one UAV, which all others follow."""

    head: int

    def detect(self, window):
        candidates = np.arange(window.uavs) == self.head
        extras = {"probability": candidates}
        return Detection(candidates, candidates * 1.0, leader=np.full(window.uavs, self.head), extras=extras)


class Answers:
    """A detector whose answer is a function of the number of UAVs and the number of the window, from 0."""

    def __init__(self, answer):
        self.answer, self.number = answer, -1

    def reset(self, seed=None):
        self.number += 1

    def detect(self, window):
        return self.answer(window.uavs, self.number)


def answer_of(uavs, head, leader=None):
    """An answer with one candidate, or none if it is -1."""
    candidates = np.arange(uavs) == head
    return Detection(candidates, candidates * 1.0, leader=leader)


def straight(steps=20, uavs=3, height=False):
    """Positions ``(steps, uavs, 3)`` of straight flights from different places."""
    rng = np.random.default_rng(1)
    start, velocity = rng.normal(0, 100, (uavs, 3)), rng.normal(0, 5, (uavs, 3))
    place = start + np.arange(steps)[:, None, None] * velocity
    return np.round(place * (1, 1, bool(height)), 3)


def tracks_of(places, step=1.0, *, names=None, seen=None, times=None):
    """Tracks of positions ``(T, N, 2 or 3)``, where they are ``seen`` ``(T, N)``; of ids a0, a1, … without names."""
    owner, instant = np.nonzero((np.ones(places.shape[:2], bool) if seen is None else seen).T)
    names = [f"a{k}" for k in range(places.shape[1])] if names is None else names
    times = np.arange(len(places)) * step if times is None else times
    return Tracks.from_samples([names[k] for k in owner], times[instant], places[instant, owner])


def rows_of(places, step=0.5, first=0):
    """Rows id, t, x, y and, if it isn't 0, z, in the order of time."""
    axes = 3 if places[..., 2].any() else 2
    return [
        ["abcdefghijkl"[k], first + t * step, *map(float, place[:axes])]
        for t, now in enumerate(places)
        for k, place in enumerate(now)
    ]


def write_csv(path, rows, header=None, delimiter=","):
    """Write rows with a header; z and leader are added to it by the caller."""
    names = (header or HEADER) if header or len(rows[0]) == 4 else [*HEADER, "z"]
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file, delimiter=delimiter).writerows([names, *rows])
    return path


def example() -> ModuleType:
    path = Path(__file__).parents[2] / "examples" / "make_tracks.py"
    spec = importlib.util.spec_from_file_location("make_tracks", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write_parquet(path, rows, **columns):
    """Write rows id, t, x, y as Parquet, with some columns replaced."""
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    values = {name: [row[k] for row in rows] for k, name in enumerate(HEADER)} | columns
    parquet.write_table(pyarrow.table(values), path)
    return path


def write_gpx(path, north, *names, height=None):
    """Write tracks of four points each, some of them without a name."""
    ele = "" if height is None else "<ele>{}</ele>"
    points = "".join(
        f'<trkpt lat="{50 + north * 1e-4}" lon="{10 + 1e-5 * k}">{ele.format((height or 0) + k)}'
        f"<time>2024-05-01T00:00:0{k}Z</time></trkpt>"
        for k in range(4)
    )
    tracks = [f"<trk>{f'<name>{name}</name>' if name else ''}<trkseg>{points}</trkseg></trk>" for name in names]
    path.parent.mkdir(exist_ok=True)
    path.write_text(f'<?xml version="1.0"?><gpx xmlns="http://x">{"".join(tracks)}</gpx>')
    return path


def refusal(path, **options):
    """The sentence with which a file is refused."""
    with pytest.raises(ArgumentError) as caught:
        read_tracks(path, **options)
    sentence = str(caught.value)
    assert sentence.count("\n") == 0
    assert sentence.endswith(".")
    return sentence

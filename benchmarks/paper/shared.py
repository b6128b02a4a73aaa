"""What the programs of the paper's tables and figures share: rows that are measured once, intervals, pictures."""

from __future__ import annotations

import argparse
import gzip
import io
import textwrap
import time
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image

from usnet_env.evaluation.run import map_tasks
from usnet_env.evaluation.stats import Interval, mean_interval, rate_interval
from usnet_env.files import atomic_write
from usnet_env.progress import progress_bar

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results"
IMAGES = ROOT / "docs" / "images" / "paper"
SEED = 2022  # of all rows and scenes; no detector of the paper was tuned on it
FOLLOW = ("f1", "f2", "f3", "f4", "f5", "f6", "f7")
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c510a", "#000000")
MARKERS = "osD^vPX"
RATES = {"exact", "success", "hit"}  # metrics of 0 and 1
_DPI, _PALETTE = 110, 255  # pixels an inch and colours of a committed picture
_SAVED = 20.0  # seconds after which new rows are written

Game = dict[str, Hashable]


def parse(words: str | None, rows: Path | None = None) -> argparse.ArgumentParser:
    """A command line with the options of all programs; ``rows`` is the file of a program that measures."""
    parser = argparse.ArgumentParser(description=words, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, default=IMAGES, help="folder of the picture")
    parser.add_argument("--seed", type=int, default=SEED)
    if rows is not None:
        parser.add_argument("--rows", type=Path, default=rows, help="file of the rows; those that it holds are kept")
        parser.add_argument("--workers", type=int, default=1, help="number of processes")
        parser.add_argument("--draw", action="store_true", help="measure nothing, draw the picture of the rows")
    return parser


def read_rows(path: Path) -> pd.DataFrame:
    """The rows of a file; only empty cells and ``nan`` are missing numbers, so that ``none`` stays a name."""
    return pd.read_csv(path, keep_default_na=False, na_values=["nan", ""])


def write_rows(path: Path, rows: pd.DataFrame) -> None:
    """Replace a file as a whole; it is compressed if its name ends in ``.gz``, and equal rows give equal bytes."""
    content = rows.to_csv(index=False, lineterminator="\n").encode()
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as aside:
        aside.write_bytes(gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)


def measure(
    path: Path, tasks: Sequence[list[Game]], play: Callable[[list[Game]], list[dict[str, Any]]], workers: int
) -> pd.DataFrame:
    """Play the tasks of which a file lacks a game, and keep their rows in it, also after an interruption.

    Args:
        path: the file of the rows.
        tasks: each a list of games that are played together; a game is what its rows begin with.
        play: plays a task and returns its rows; a function of a module or a ``functools.partial`` of one.
        workers: number of processes.
    """
    rows, keys = read_rows(path) if path.exists() else pd.DataFrame(), list(tasks[0][0])
    known = list(rows[keys].itertuples(index=False, name=None)) if len(rows) else []
    missing = [task for task in tasks if not {tuple(game.values()) for game in task} <= set(known)]
    replaced = {tuple(game.values()) for task in missing for game in task}
    rows, made = rows[[key not in replaced for key in known]] if known else rows, []

    def save() -> None:
        whole = pd.concat([part for part in (rows, pd.DataFrame(made)) if len(part)])
        write_rows(path, whole.sort_values(keys, kind="stable").round(4))

    saved = time.monotonic()
    try:
        with progress_bar("tasks") as progress:
            for done, found in enumerate(map_tasks(play, missing, workers=workers), 1):
                made += found
                progress(done, len(missing))
                if time.monotonic() - saved > _SAVED:
                    save()
                    saved = time.monotonic()
    finally:
        if made:
            save()
    return read_rows(path)


def interval(rows: pd.DataFrame, metric: str, group: str = "episode") -> Interval:
    """The mean of a metric with its 95 % interval; rows with the same number of the episode are one group.

    Rows without a value, such as those of a detector without clusters, are left out.
    """
    known = rows.loc[rows[metric].notna(), [metric, group]]
    values, groups = known[metric].to_numpy(float), known[group].to_numpy()
    return rate_interval(values, groups=groups) if metric in RATES else mean_interval(values, groups=groups)


def describe_counts(rows: pd.DataFrame, keys: Sequence[str]) -> str:
    """How many rows the points of a picture are means of, in words."""
    counts = rows.groupby(list(keys)).size()
    return f"n = {counts.min()}" if counts.nunique() == 1 else f"n = {counts.min()} to {counts.max()}"


def panels(width: float, height: float, rows: int = 1, columns: int = 1, **how: Any) -> tuple[Figure, np.ndarray]:
    """A figure of so many inches, and its panels ``(rows, columns)``."""
    figure = Figure(figsize=(width, height), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, **how)
    for axes in grid.ravel():
        axes.grid(color="#e4e4e4", lw=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, grid


def draw_intervals(axes: Any, intervals: Mapping[float, Interval], scale: float = 1.0, **look: Any) -> None:
    """Draw means with error bars at their places on the first axis."""
    mean, low, high = scale * np.array([[one.mean, one.low, one.high] for one in intervals.values()]).reshape(-1, 3).T
    axes.errorbar(list(intervals), mean, [mean - low, high - mean], ls="none", lw=1.2, **look)


def add_legend(figure: Figure, axes: Iterable[Any], columns: int = 4) -> None:
    """Add a legend below all panels, which lists each label once."""
    found = {label: line for one in axes for line, label in zip(*one.get_legend_handles_labels(), strict=True)}
    figure.legend(found.values(), found.keys(), loc="outside lower center", ncols=columns, fontsize=9, frameon=False)


def save_figure(figure: Figure, path: Path, title: str, caption: str) -> None:
    """Write a picture with a title and a caption as a small PNG; the caption says what n and the bars are."""
    lines = textwrap.fill(caption, int(12.5 * figure.get_figwidth()))
    figure.suptitle(f"{title}\n{lines}", fontsize=10, x=0.01, ha="left")
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=_DPI)
    path.parent.mkdir(parents=True, exist_ok=True)
    with Image.open(content) as image, atomic_write(path) as aside:
        image.convert("RGB").quantize(_PALETTE).save(aside, format="png", optimize=True)

"""What the programs of the paper's tables and figures share: rows that are measured once, intervals, pictures."""

from __future__ import annotations

import argparse
import gzip
import io
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image

from usnet_env.evaluation import load_suite
from usnet_env.evaluation.environments import make_environment
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
#: The swarms of each study of P2, and its title.
STUDIES: dict[str, dict[str, Sequence[Any]]] = {
    "follow": {"follow": FOLLOW, "clusters": [5], "uavs": [82]},
    "clusters": {"follow": ["f1"], "clusters": [2, 3, 5, 8, 10], "uavs": [82]},
    "uavs": {"follow": ["f3"], "clusters": [5], "uavs": [40, 60, 82, 120, 160, 200]},
    "example": {"follow": ["f1"], "clusters": [8], "uavs": [185]},
}
TITLES = {
    "follow": "Against the follow strategy (M = 5, N = 82)",
    "clusters": "Against the number of clusters (f1, N = 82)",
    "uavs": "Against the number of UAVs (f3, M = 5)",
    "example": "The example (f1, M = 8, N = 185)",
}
RATES = {"exact", "success", "hit", "right"}  # metrics of 0 and 1
_DPI, _PALETTE = 110, 255  # pixels an inch and colours of a committed picture

Game = dict[str, Any]
Play = Callable[[Game], list[dict[str, Any]]]


def make_parser(description: str | None, rows: Path | None = None) -> argparse.ArgumentParser:
    """A command line with the options of all programs; ``rows`` is the file of a program that measures."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, default=IMAGES, help="folder of the picture")
    parser.add_argument("--seed", type=int, default=SEED)
    if rows is not None:
        parser.add_argument("--rows", type=Path, default=rows, help="file of the rows; those that it holds are kept")
        parser.add_argument("--workers", type=int, default=1, help="number of processes")
        parser.add_argument("--draw", action="store_true", help="measure nothing, show the tables of the rows")
    return parser


@lru_cache(maxsize=4)
def cached(function: Callable[..., Any], *arguments: Any) -> Any:
    """The result of a function, kept for further calls with the same arguments; other processes can have it, too."""
    return function(*arguments)


@lru_cache(maxsize=2)
def open_cell(suite: str, name: str) -> Any:
    """The environment of a cell of a suite."""
    cell = load_suite(suite).cells[name]
    return make_environment(cell.env, cell.arguments).unwrapped


def read_rows(path: Path) -> pd.DataFrame:
    """The rows of a file; only empty cells and ``nan`` are missing numbers, so that ``none`` stays a name."""
    return pd.read_csv(path, keep_default_na=False, na_values=["nan", ""])


def write_rows(path: Path, rows: pd.DataFrame) -> None:
    """Replace a file as a whole; it is compressed if its name ends in ``.gz``, and equal rows give equal bytes."""
    content = rows.to_csv(index=False, lineterminator="\n").encode()
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as aside:
        aside.write_bytes(gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)


def run_missing(options: argparse.Namespace, games: Sequence[Game], play: Play) -> pd.DataFrame:
    """Play the games that the file of rows lacks, unless rows are only drawn, and return all rows.

    The rows of each game are appended at once, and all are sorted at the end.

    Args:
        options: those of :func:`make_parser`: the file, whose columns stay, and the number of processes.
        games: what their rows begin with.
        play: plays a game and returns its rows; a function of a module or a ``functools.partial`` of one.
    """
    path: Path = options.rows
    if options.draw:
        return read_rows(path)
    keys, columns, played = list(games[0]), None, set()
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists():
        old = read_rows(path)
        columns, played = list(old), set(old[keys].itertuples(index=False, name=None))
    missing = [game for game in games if tuple(game.values()) not in played]
    with progress_bar("games") as progress:
        for count, new_rows in enumerate(map_tasks(play, missing, workers=options.workers), 1):
            if new_rows:
                rows = pd.DataFrame(new_rows, columns=columns)
                rows.to_csv(path, mode="a", header=columns is None, index=False, lineterminator="\n")
                columns = list(rows)
            progress(count, len(missing))
    if missing:
        write_rows(path, read_rows(path).sort_values(keys, kind="stable").round(4))
    return read_rows(path)


@contextmanager
def isolate_torch(seed: int) -> Iterator[None]:
    """Let PyTorch use one thread and draw by a seed; its global generator and threads are as before afterwards."""
    import torch
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1), torch.random.fork_rng(devices=[]):
        torch.random.set_rng_state(torch.Generator().manual_seed(seed).get_state())
        yield


def interval(rows: pd.DataFrame, metric: str, group: str = "episode") -> Interval:
    """The mean of a metric with its 95 % interval; rows with the same ``group`` are one value.

    Rows without a value, such as those of a detector without clusters, are left out.
    """
    rows_with_value = rows.loc[rows[metric].notna(), [metric, group]]
    values, groups = rows_with_value[metric].to_numpy(float), rows_with_value[group].to_numpy()
    return rate_interval(values, groups=groups) if metric in RATES else mean_interval(values, groups=groups)


def describe_counts(rows: pd.DataFrame, keys: Sequence[str]) -> str:
    """How many rows the points of a picture are means of, in words."""
    counts = rows.groupby(list(keys)).size()
    return f"n = {counts.min()}" if counts.nunique() == 1 else f"n = {counts.min()} to {counts.max()}"


def panels(width: float, height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, np.ndarray]:
    """A figure of so many inches, and its panels ``(rows, columns)``."""
    figure = Figure(figsize=(width, height), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, **options)
    for axes in grid.ravel():
        axes.grid(color="#e4e4e4", lw=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, grid


def make_styles(names: Sequence[str], size: float) -> dict[str, dict[str, Any]]:
    """Colour and marker of each detector in a picture."""
    pairs = zip(names, cycle(COLORS), cycle(MARKERS), strict=False)
    return {name: {"color": color, "marker": marker, "ms": size} for name, color, marker in pairs}


def draw_intervals(
    axes: Any, rows: pd.DataFrame, x: str, ticks: Sequence[Any], metric: str, styles: dict[str, Any], scale: float = 1
) -> None:
    """Draw the means of a metric with error bars over values ``ticks`` of a column ``x``, detectors side by side.

    ``styles`` has arguments of ``Axes.errorbar`` for each detector.
    """
    for number, (name, style) in enumerate(styles.items()):
        cells = rows[rows.detector == name].groupby(x)
        intervals = {ticks.index(value): interval(cell, metric) for value, cell in cells}
        mean, low, high = scale * np.array(list(intervals.values())).reshape(-1, 3).T
        position = np.array(list(intervals)) + 0.75 * ((number + 0.5) / len(styles) - 0.5)
        axes.errorbar(position, mean, [mean - low, high - mean], ls="none", lw=1.2, label=name, **style)
    axes.set_xticks(range(len(ticks)), ticks)


def save_figure(figure: Figure, path: Path, title: str, caption: str) -> None:
    """Write a picture as a small PNG, with a title, a caption, and a legend of all labels below the panels.

    The caption says what n and the bars are.
    """
    lines = textwrap.fill(caption, int(12.5 * figure.get_figwidth()))
    figure.suptitle(f"{title}\n{lines}", fontsize=10, x=0.01, ha="left")
    legends = [axes.get_legend_handles_labels() for axes in figure.axes]
    if labels := {label: line for legend in legends for line, label in zip(*legend, strict=True)}:
        options: dict[str, Any] = {"loc": "outside lower center", "ncols": 4, "fontsize": 9, "frameon": False}
        figure.legend(labels.values(), labels.keys(), **options)
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=_DPI)
    path.parent.mkdir(parents=True, exist_ok=True)
    with Image.open(content) as image, atomic_write(path) as aside:
        image.convert("RGB").quantize(_PALETTE).save(aside, format="png", optimize=True)

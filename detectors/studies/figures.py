"""All figures of the paper's results, made by one command as PNG and PDF."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from detectors.studies import attention, example, metric_learning, purity, rounds, table2
from detectors.studies.common import check_names
from usnet_env.config import ArgumentError, quote
from usnet_env.detection import Detection
from usnet_env.drawing import FORMATS, new_figure, write_figure
from usnet_env.evaluation.suite import read_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RowT = TypeVar("RowT")


@dataclass(frozen=True)
class Settings:
    """What the figures are made from."""

    results: Path = Path("benchmarks/results")  # folder of the committed rows, in the repository
    seed: int = 2022  # of the scenes, of the example, and of the committed rows
    detector_p1: str = "gassl"  # of the attention figures: the paper's Algorithm 1
    detector_p2: str = "mc-gassl"  # of the example: the paper's Algorithm 2

    def read(self, file: str, kind: type[RowT]) -> list[RowT]:
        """Read the rows of a file in ``results``.

        Raises:
            ArgumentError: the file is missing or holds other rows.
        """
        rows = read_rows(self.results / file, kind)
        if not rows:
            raise ArgumentError(f"results must be a folder with rows in {file}, got {quote(str(self.results))}.")
        return rows


def _draw_scene(settings: Settings, draw: Callable[[attention.Scene, Detection, str], Figure]) -> Figure:
    """Draw the cluster with m = 15, whose head is UAV 7."""
    scene = attention.find_scene("f1", 15, 6, settings.seed)
    return draw(scene, attention.detect_head(scene, settings.detector_p1), settings.detector_p1)


def _draw_attention_sizes(settings: Settings) -> Figure:
    scenes = [attention.find_scene("f7", followers, 1, settings.seed) for followers in (2, 5, 10, 25, 40, 50)]
    answers = [attention.detect_head(scene, settings.detector_p1) for scene in scenes]
    return attention.draw_attention_sizes(scenes, answers, settings.detector_p1)


def _draw_losses(settings: Settings) -> Figure:
    file = f"metric_learning/losses-F30-E1000-seed{settings.seed}.csv"
    return metric_learning.draw_losses(settings.read(file, metric_learning.Row))


def _draw_purity(settings: Settings) -> Figure:
    rows = settings.read(f"purity/purity-seed{settings.seed}.csv", purity.Row)
    return purity.draw_strategies(rows, f"Purity of clustering, M = {rows[0].clusters}, N = {rows[0].uavs}")


def _draw_rounds(settings: Settings) -> Figure:
    rows = settings.read(f"rounds/rounds-seed{settings.seed}.csv", rounds.Row)
    return rounds.draw_studies(rows, "P2: rounds, redundancy and J_m", with_paper=True)


def _draw_detection_rates(settings: Settings) -> Figure:
    rows = settings.read(f"table2/episodes-seed{settings.seed}.csv", table2.Row)
    return table2.draw_rates(table2.fill_table(rows), "Detection rate of P1, one cluster", with_paper=True)


#: The figures in the order of the paper, by name.
FIGURES: dict[str, Callable[[Settings], Figure]] = {
    "detection-rates": _draw_detection_rates,
    "attention-heads-f1-m15": partial(_draw_scene, draw=attention.draw_attention_heads),
    "hierarchy-f1-m15": partial(_draw_scene, draw=attention.draw_hierarchy),
    "meta-loss": _draw_losses,
    "purity": _draw_purity,
    "feature-space": lambda settings: metric_learning.draw_feature_spaces(settings.seed),
    "rounds": _draw_rounds,
    "example-m8-n185": lambda settings: example.draw_example(example.play_example(settings.detector_p2, settings.seed)),
    "attention-sizes-f7": _draw_attention_sizes,
}


def make_figures(
    folder: Path,
    *,
    only: Sequence[str] = (),
    formats: Sequence[str] = FORMATS,
    settings: Settings | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Path]:
    """Make the paper's figures, each as PNG and PDF by default.

    The tables and curves are drawn from committed rows; the attention, the feature space and the example are computed.
    A figure appears in ``folder`` as soon as it is made.

    Args:
        folder: gets the files of every figure.
        only: names of :data:`FIGURES`; empty: all of them.
        formats: as :func:`usnet_env.drawing.write_figure` takes them.
        settings: what the figures are made from; ``None``: the defaults.
        progress: called with the number of figures that are made, and of all figures.

    Returns:
        The files.

    Raises:
        ArgumentError: an unknown name, missing rows, or ``folder`` can't be written to.
        MissingExtraError: matplotlib is not installed.
    """
    check_names("only", only, FIGURES)
    new_figure(1, 1)  # a missing matplotlib is reported before anything is computed
    names = [name for name in FIGURES if not only or name in only]
    files: list[Path] = []
    for done, name in enumerate(names):
        progress(done, len(names))
        files += write_figure(FIGURES[name](settings or Settings()), folder / name, formats)
    progress(len(names), len(names))
    return files

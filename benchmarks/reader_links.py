"""The network that the reader gives: direct leaders, heads, links and delays in windows of the families of its prior.

    python benchmarks/reader_links.py --workers 2

A row is a window that the prior draws anew. ``below`` is of followers whose direct leader isn't the head.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
from paper import shared
from pivot import mean, pivot, size
from sklearn.metrics import average_precision_score, roc_auc_score

from detectors.reader.prior import FAMILIES, draw_examples
from usnet_env import Window, make_detector
from usnet_env.arrays import Mask

COLUMNS = {
    "direct leader": mean("direct"),
    "direct leader below the head": mean("below"),
    "head": mean("root"),
    "AUROC of links": mean("auroc"),
    "AUPRC of links": mean("auprc"),
    "error of delays, steps": mean("delay", 1),
}


def measure_window(game: shared.Game) -> list[dict[str, Any]]:
    """Read a window of a family in which some UAV leads."""
    rng = np.random.default_rng([shared.SEED, crc32(game["family"].encode()), game["episode"]])
    position, velocity, seen, head, leader, root, link, delay = (
        array[0] for array in draw_examples(rng, 1, family=game["family"])[:-1]
    )
    detector = shared.cached(make_detector, game["detector"])
    detector.reset(0)
    detection = detector.detect(Window(position, velocity, seen, np.ones(len(head), bool)))
    follows, is_right = leader != np.arange(len(head)), detection.leader == leader
    pairs = np.isfinite(link) & ~np.eye(len(head), dtype=bool)
    truth, score = link[pairs] > 0, detection.attention[pairs]
    has_both = 0 < truth.sum() < truth.size  # of windows with and without links
    error = np.abs(detection.extras["delay"] - delay)[follows & is_right & np.isfinite(delay)]
    return [
        game
        | {
            "direct": _mean(is_right[follows]),
            "below": _mean(is_right[follows & (leader != root)]),
            "root": _mean((detection.extras["root"] == root)[follows]),
            "auroc": roc_auc_score(truth, score) if has_both else np.nan,
            "auprc": average_precision_score(truth, score) if has_both else np.nan,
            "delay": _mean(error),
        }
    ]


def _mean(values: Mask | np.ndarray) -> float:
    return float(values.mean()) if values.size else np.nan


def report(rows: pd.DataFrame) -> str:
    """The table of the families in which some UAV follows."""
    return pivot(rows[rows.direct.notna()], {"family": "family"}, {"windows": size, **COLUMNS})


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, Path("out/reader/links.csv.gz"))
    parser.add_argument("--episodes", type=int, default=50, help="windows of each family")
    options = parser.parse_args(argv)
    games = [
        {"detector": "reader(policy='map')", "family": family, "episode": episode}
        for family in FAMILIES
        for episode in range(options.episodes)
    ]
    print(report(shared.run_missing(options, games, measure_window)))


if __name__ == "__main__":
    main()

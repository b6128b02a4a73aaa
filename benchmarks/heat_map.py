"""Draw the share of exact episodes of every detector in every suite, from the committed rows.

python benchmarks/heat_map.py    # writes docs/images/leaderboard.png
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from paper import shared
from tables import ABOUT, SOLVED, SUITES, read_suite, suite_file

PATH = shared.ROOT / "docs" / "images" / "leaderboard.png"
KINDS = ("learned", "baseline", "the paper", "blind", "trivial")  # blocks of lines, from the top


def gather_shares() -> pd.DataFrame:
    """The share of exact episodes in percent, a line for each detector and a column for each suite; NaN: no rows."""
    suites = {name: read_suite(name) for name in (*SUITES, *SOLVED) if suite_file(name).exists()}
    table = pd.DataFrame({name: 100 * rows.groupby("detector").exact.mean() for name, rows in suites.items()})
    blind = table.index.str.contains("untrained|blind")
    kind = table.index.str.partition("(").get_level_values(0).map(lambda name: ABOUT.get(name, "baseline"))
    order = pd.DataFrame(
        {"kind": [KINDS.index(k) for k in np.where(blind, "blind", kind)], "mean": -table.mean(axis=1)}
    )
    return table.loc[order.set_axis(table.index).sort_values(["kind", "mean"]).index]


def draw(table: pd.DataFrame) -> Figure:
    """A cell for each detector and suite, with its number."""
    lines, columns = table.shape
    figure = Figure(figsize=(2.6 + 0.72 * columns, 0.9 + 0.235 * lines), layout="constrained")
    axes = figure.subplots()
    axes.imshow(np.ma.masked_invalid(table), cmap="YlGnBu", vmin=0, vmax=100, aspect="auto")
    for (i, j), value in np.ndenumerate(table.to_numpy()):
        text = "–" if np.isnan(value) else f"{value:.0f}"
        axes.text(j, i, text, ha="center", va="center", fontsize=8, color="white" if value > 60 else "#222222")
    axes.set_yticks(range(lines), table.index, fontsize=8)
    axes.set_xticks(range(columns), table.columns, fontsize=8, rotation=30, ha="left")
    axes.tick_params(length=0, labeltop=True, labelbottom=False)
    axes.spines[:].set_visible(False)
    axes.set_xticks(np.arange(columns + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(lines + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", lw=1.5)
    axes.tick_params(which="minor", length=0)
    return figure


def main(argv: list[str] | None = None) -> None:
    shared.make_parser(__doc__).parse_args(argv)
    caption = "Percent of episodes in which round 1 names all heads and no other UAV; darker is better, –: not played"
    shared.save_figure(draw(gather_shares()), PATH, "Detectors in frozen suites", caption)


if __name__ == "__main__":
    main()

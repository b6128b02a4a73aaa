"""follow-mixture by tier, cell by cell, and its probabilities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from follow_mixture import EDGES, SEED
from numpy.typing import NDArray
from running import RESULTS, read_csv
from usnet_env.evaluation.report import add_legend, group_rows, make_panels
from usnet_env.evaluation.statistics import mean_interval

from result_pages.text import Row, cost_of, exact_of, number, page, table
from usnet_env.drawing import COLORS, caption_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OURS, MAP = "follow-mixture", "follow-mixture(policy='map')"
TIERS = ("paper", "sizes", "smooth", "straight", "short", "noise", "missed", "sampled")
EVERY_TIER = (*TIERS, "decoys", "strategies", "silence", "shifted", "P1")
PEERS = ("`lagged-regression`: n", "exact", "J_m", "`destroy-all`: J_m")
FIGURE = RESULTS / "follow_mixture" / "reliability.png"
_LEAST_UAVS = 20  # in a bin that counts for whether a tier is drawn


@cache
def tier_rows(tier: str, seed: int = SEED) -> tuple[Row, ...]:
    """The rows of a tier and seed, each with its strategy (``follow``) and the rest of its cell's name."""
    found = []
    for row in read_csv(RESULTS / "follow_mixture" / f"{tier}.csv"):
        if int(row["seed"]) == seed:
            follow, _, variant = row["cell"].partition("-")
            found.append({**row, "follow": follow, "variant": variant})
    return tuple(found)


def words(tier: str, variant: str) -> str:
    """What the swarms of a tier's variant are."""
    smooth = "Gauss–Markov heads with jitter"
    last = variant.removeprefix("gauss_markov-")
    return {
        "paper": "iid heads, M = 5, N = 82",
        "sizes": "iid heads, " + variant.replace("-", ", ").replace("M", "M = ").replace("N", "N = "),
        "smooth": f"{variant} heads with jitter",
        "straight": f"straight heads {'with' if variant == 'jitter' else 'without'} jitter",
        "short": f"window of {variant[1:]} steps",
        "noise": f"position noise of {last} m" + (f", {smooth}" if last != variant else ""),
        "missed": f"{float(variant) * 100:.0f} % of the samples missed" if tier == "missed" else "",
        "sampled": "every second sample",
    }[tier]


def of(rows: Iterable[Row], detector: str) -> list[Row]:
    """The rows of one detector."""
    return [row for row in rows if row["detector"] == detector]


def own_cells(rows: Sequence[Row]) -> tuple[str, str, str]:
    """n, the share of exact episodes and J_m of a detector's rows."""
    return f"{len(rows):,}", exact_of(rows), cost_of(rows)


def peer_cells(rows: Iterable[Row]) -> tuple[str, str, str, str]:
    """The columns :data:`PEERS`."""
    lagged, everything = (of(rows, name) for name in ("lagged-regression", "destroy-all"))
    destroyed = f"{cost_of(everything)}, n = {len(everything):,}"
    return f"{len(lagged):,}", exact_of(lagged), cost_of(lagged, 2), destroyed


def worst(rows: Iterable[Row]) -> str:
    """The strategy with the highest mean J, and that mean."""
    means = {
        follow: (np.mean([float(row["J"]) for row in own]), own)
        for follow, own in group_rows(rows, lambda row: row["follow"]).items()
    }
    name, (_, own) = max(means.items(), key=lambda one: one[1][0])
    return f"{name}: {cost_of(own)}, n = {len(own)}"


def by_variant() -> str:
    """A line for each variant of each tier."""
    lines = []
    for tier in TIERS:
        for variant, rows in group_rows(tier_rows(tier), lambda row: row["variant"]).items():
            ours = of(rows, OURS)
            lines.append((words(tier, variant), *own_cells(ours), worst(ours), *peer_cells(rows)))
    return table(("swarms, f1–f7", "n", "exact", "J_m", "worst strategy: J_m", *PEERS), lines)


def policies() -> str:
    """Both policies on the episodes that both played."""
    lines = []
    for tier in (*TIERS, "decoys", "strategies"):
        rows = tier_rows(tier)
        for variant, own in group_rows(rows, lambda row: row["variant"]).items():
            costs = [{(row["cell"], row["episode"]): float(row["J"]) for row in of(own, name)} for name in (OURS, MAP)]
            both = sorted(costs[0].keys() & costs[1].keys())
            if not both:
                continue
            default, most_likely = (np.array([cost[key] for key in both]) for cost in costs)
            gap = mean_interval(most_likely - default)
            lines.append(
                (
                    f"{tier} {variant}".strip(),
                    str(len(both)),
                    number(mean_interval(default), 3),
                    number(mean_interval(most_likely), 3),
                    f"{gap.mean:+.3f} ({gap.low:+.3f} to {gap.high:+.3f})",
                )
            )
    return table(("tier and variant", "n", "J_m, `cost`", "J_m, `map`", "`map` minus `cost`"), lines)


@dataclass(frozen=True)
class Reliability:
    """The first windows of a tier: the Brier score of each, and for each bin ``(bins,)`` its UAVs and heads."""

    brier: list[float]
    uavs: NDArray[np.int64]
    heads: NDArray[np.int64]


def reliability() -> dict[str, Reliability]:
    """By tier. The policy does not change a first window's probabilities, so each window counts once."""
    found = {}
    for tier in EVERY_TIER:
        counts = np.zeros((2, len(EDGES) - 1), np.int64)
        brier, known = [], set()
        for row in tier_rows(tier):
            window = row["cell"], row["episode"]
            # objective='P1' bounds the number of heads by one, so those probabilities are others.
            same = row["detector"] in ((f"{OURS}(objective='P1')",) if tier == "P1" else (OURS, MAP))
            if same and window not in known:
                known.add(window)
                brier.append(float(row["brier"]))
                for entry in row["reliability"].split():
                    number_of_bin, uavs, heads = map(int, entry.split(":"))
                    counts[:, number_of_bin] += uavs, heads
        found[tier] = Reliability(brier, counts[0], counts[1])
    return found


def reliability_tables(found: Mapping[str, Reliability]) -> str:
    """Brier scores by tier, and the share of heads among the UAVs of every bin."""
    scores = table(
        ("tier", "windows", "UAVs", "Brier score"),
        [
            (tier, f"{len(own.brier):,}", f"{own.uavs.sum():,}", number(mean_interval(own.brier), 4))
            for tier, own in found.items()
        ],
    )
    bins = table(
        ("probability", *found),
        [
            (
                f"{EDGES[place]}–{EDGES[place + 1]}",
                *(
                    f"{own.heads[place] / own.uavs[place]:.4f} of {own.uavs[place]:,}" if own.uavs[place] else ""
                    for own in found.values()
                ),
            )
            for place in range(len(EDGES) - 1)
        ],
    )
    return (
        f"{scores}\n\nShare of heads among the UAVs whose probability lies in a bin, and the number of UAVs:\n\n{bins}"
    )


def reliability_figure() -> Figure:
    """A panel for each tier that has UAVs in several bins: the share of heads in each bin, over the bin's edges."""
    found = reliability()
    doubtful = {tier: own for tier, own in found.items() if (own.uavs > _LEAST_UAVS).sum() > 3}
    across = min(4, len(doubtful))
    down = -(-len(doubtful) // across)
    figure, grid = make_panels(3.4 * across, 2.8 * down + 1.4, down, across, sharex=True, sharey=True)
    for axes in grid.ravel()[len(doubtful) :]:
        axes.set_visible(False)
    bins = np.arange(len(EDGES) - 1)
    low, high = np.array(EDGES[:-1], float), np.array(EDGES[1:], float)
    for place, (axes, (tier, own)) in enumerate(zip(grid.ravel(), doubtful.items(), strict=False)):
        some = own.uavs > 0
        sizes = 6 * np.log10(1 + own.uavs[some]) ** 2
        axes.bar(bins, high - low, bottom=low, width=0.9, color="#cccccc", label="a calibrated detector")
        axes.scatter(bins[some], own.heads[some] / own.uavs[some], s=sizes, color=COLORS[0], label="share of heads")
        axes.set_yscale("symlog", linthresh=1e-3)
        axes.set_ylim(0, 1.3)
        axes.set_yticks([0, 0.001, 0.01, 0.1, 1], ["0", "0.001", "0.01", "0.1", "1"])
        axes.set_xticks(bins[::3], [f"{edge}" for edge in EDGES[:-1:3]], fontsize=8)
        axes.set_title(f"{tier}: {len(own.brier):,} windows", fontsize=10)
        if place + across >= len(doubtful):
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("probability, lower edge of its bin", fontsize=9)
    for axes in grid[:, 0]:
        axes.set_ylabel("share of heads")
    add_legend(figure, [grid[0, 0]])
    others = ", ".join(tier for tier in found if tier not in doubtful)
    caption_figure(
        figure,
        "Probabilities of follow-mixture: are as many of the UAVs heads as it says?",
        "A point is the share of heads among the UAVs of all windows whose probability lies in a bin; its area grows "
        "with the logarithm of their number. In a calibrated detector it lies within the grey bar. No intervals; the "
        f"counts are in the table. Left out, as nearly all UAVs are in the first and the last bin: {others}.",
    )
    return figure


def text() -> str:
    files = [f"follow_mixture/{tier}.csv" for tier in TIERS]
    return page(
        "follow-mixture by tier",
        "`follow-mixture` with its default arguments, in groups of swarms (*tiers*). It is given neither M nor the "
        "follow strategy. *Exact* is the share of episodes in which round 1 names all heads and no other UAV. J_m is "
        "better when lower; the best value is 1. n counts the episodes over all seven strategies.",
        "The published seed is 7077. Rules of the detector were changed after looks at rows of this seed. "
        "[Another page](follow_mixture_cores.md) has a seed on which no rule was tuned.",
        by_variant(),
        "Straight heads without jitter fly a line that each of their followers repeats: the data do not show which of "
        "them is the head. The default policy then names all UAVs.",
        "Every cell, with more detectors, is on [its own page](follow_mixture_cells.md); decoys, swarms in which no "
        "UAV follows another, and P1 are on [the next](decoys.md).",
        "## Both policies",
        "`policy='cost'`, the default, names the set with the lowest expected cost, and at least one UAV. "
        "`policy='map'` names the UAVs that are more probably heads than not, and may name none. Means over the "
        "episodes that both played, and the mean of the paired difference (95 %).",
        policies(),
        "## Calibration of the probabilities",
        "The share of heads among UAVs to which the detector gives about the same probability, over all first windows. "
        "A calibrated detector has equal numbers in the first column and in the others.",
        "![Share of heads against their probability, a panel for each tier with UAVs in several bins]"
        "(../../benchmarks/results/follow_mixture/reliability.png)",
        reliability_tables(reliability()),
        files=[*files, "follow_mixture/reliability.png"],
    )


def cells_text() -> str:
    parts = []
    for tier in EVERY_TIER:
        rows = tier_rows(tier)
        unit = "UAVs named" if tier in ("silence", "shifted") else "J_s" if tier == "P1" else "J_m"
        names = list(dict.fromkeys(row["detector"] for row in rows))
        names.sort(key=lambda name: (not name.startswith(OURS), not name.startswith("learned"), name))
        lines = []
        for cell, own in group_rows(rows, lambda row: row["cell"]).items():
            by_name = (of(own, name) for name in names)
            lines.append((cell, *(f"{cost_of(some, 2)}; {len(some)}" if some else "" for some in by_name)))
        parts += [f"## {tier}: {unit}", table(("cell", *(f"`{name}`" for name in names)), lines)]
    return page(
        "All cells of the tiers",
        "Mean J with its 95 % interval, and after the semicolon n; a mean alone: all episodes were equal. J is J_m "
        "(lower is better), J_s in the tier P1 (0 is best), and the number of UAVs named in the tiers silence and "
        "shifted (0 is right). The name of a cell begins with the follow strategy; "
        "`python benchmarks/follow_mixture.py --list` prints the environment of each. Three episodes of a detector say "
        "little: look at n.",
        *parts,
    )

"""The paper's example with M = 8 and N = 185: the truth, the attention of each round, and the heads found.

    python benchmarks/paper/example.py                                 # mc-gassl; it is computed (minutes)
    python benchmarks/paper/example.py --detector lagged-regression    # has no attention to draw

It is the episode 0 of the study `example` of rounds.py.
"""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from attention import ATTENTION, HIT, REDUNDANT, draw_links, mark_candidates, mark_uavs
from shared import COLORS, panels, parse, save_figure

import usnet_env.envs  # noqa: F401  registers the environments
from usnet_env import make_detector
from usnet_env.evaluation.play import episode_seeds
from usnet_env.replay import EpisodeRecord, record_episode

LEAST_WEIGHT = 0.1  # lines of a smaller attention weight are not drawn
MOST_ROUNDS = 4
PAPER = {1: 75.0, 2: 100.0}  # percent of the heads that the paper's example has found after each round


def draw_round(axes: Any, record: EpisodeRecord, number: int) -> None:
    """Draw a round from above: clusters in colours, attention weights and candidates; 0 is the truth alone."""
    r = max(number - 1, 0)
    alive, head, candidates = record.alive[r], record.head, record.candidates[r]
    place = np.asarray(record.position[r][-1, :, :2])
    color_of = dict(zip(np.flatnonzero(head), cycle(COLORS), strict=False))
    colors = np.array([color_of.get(root, "#999999") for root in record.root[r]])
    mark_uavs(axes, place[alive], head[alive], colors[alive], 18)
    if number and record.attention is not None:
        draw_links(axes, place, record.attention[r] * np.outer(alive, alive), LEAST_WEIGHT, 3.0, ATTENTION)
    if number:
        mark_candidates(axes, place[alive], head[alive], candidates[alive], 250)
    words = f"Round {number}: {record.hits[r]} hit, {record.redundant[r]} redundant"
    axes.set_title(words if number else f"Truth: {head.sum()} clusters, {record.uavs} UAVs", fontsize=11, loc="left")
    axes.set(xlabel="x in m", ylabel="y in m")
    axes.set_aspect("equal", adjustable="datalim")


def draw_rates(axes: Any, record: EpisodeRecord) -> None:
    """Draw, after each round, the heads found in percent of M, and the redundant candidates in percent of N."""
    heads, uavs, rounds = int(record.head.sum()), record.uavs, range(record.rounds + 1)
    found, redundant = (100 * np.append(0, np.cumsum(counts)) for counts in (record.hits, record.redundant))
    axes.plot(rounds, found / heads, "o-", color=HIT, label=f"heads found, % of {heads}")
    axes.plot(rounds, redundant / uavs, "s-", color=REDUNDANT, label=f"redundant candidates, % of {uavs}")
    axes.plot(list(PAPER), list(PAPER.values()), "o", mfc="none", mec="black", ms=11, label="the paper")
    axes.set(xlabel="round", ylabel="percent", ylim=(-3, 106), title="After each round")
    axes.set_xticks(range(max(record.rounds, *PAPER) + 1))


def draw(record: EpisodeRecord, path: Path) -> None:
    """Draw an episode: the truth, its first rounds and the last one, and the share of heads found."""
    rounds = [0, *range(1, min(record.rounds, MOST_ROUNDS)), record.rounds]
    lines = -(-(len(rounds) + 1) // 3)
    figure, grid = panels(16.8, 5.3 * lines + 1.1, lines, 3)
    for axes, number in zip(grid.ravel(), rounds, strict=False):
        draw_round(axes, record, number)
    draw_rates(grid.ravel()[len(rounds)], record)
    for axes in grid.ravel()[len(rounds) + 1 :]:
        axes.set_visible(False)
    caption = (
        "One game (n = 1) of f1, seen from above; a cluster has one colour. "
        f"Lines are as wide as the attention weights above {LEAST_WEIGHT}."
    )
    save_figure(figure, path, f"Round by round: {record.detector}", caption)


def main(argv: list[str] | None = None) -> None:
    parser = parse(__doc__)
    parser.add_argument("--detector", default="mc-gassl")
    parser.add_argument("--clusters", type=int, default=8)
    parser.add_argument("--uavs", type=int, default=185)
    given = parser.parse_args(argv)
    env = gym.make("USNET/MultiCluster-v0", clusters=given.clusters, uavs=given.uavs, follow="f1")
    record = record_episode(env, make_detector(given.detector), *episode_seeds(given.seed, 0), label=given.detector)
    draw(record, given.images / f"example-m{given.clusters}-n{given.uavs}.png")


if __name__ == "__main__":
    main()

"""The paper's Table II: detection rates of one cluster (P1) for 7 follow strategies and 10 numbers of followers.

    python benchmarks/paper/table2.py --workers 2              # the paper's setting, all detectors
    python benchmarks/paper/table2.py --decoys 1 --detector neural-granger --episodes 50
    python benchmarks/paper/table2.py --draw                   # the picture of the rows

The rows are in benchmarks/results/paper/table2.csv.gz; the same command goes on where it stopped. A row is an episode:
`named` says whether there was a candidate, `hit` whether the head was the only candidate, `explained` which share of
the squared velocity the detector's fit explains. Rows with a `batch` are of a former detector that answered episodes
together: `42+21` is a batch of the 21 episodes from 42 on.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shared
from shared import FOLLOW, Game

from usnet_env import Window, make_detector
from usnet_env.detection import ask
from usnet_env.envs import SingleClusterEnv

FOLLOWERS = (2, 3, 5, 10, 15, 20, 25, 30, 40, 50)
DETECTORS = ("gassl", "gassl(steps=0)", "neural-granger", "lagged-regression(clusters=1)")
DETECTORS += ("central-most(reach=100)", "track-outlier(threshold=1000)")  # they name one UAV, and see no pairs
COMPARED = ("gassl", "gassl(steps=0)", "neural-granger")  # trained, untrained, and an attention that learns
PAPER = Path(__file__).parent / "data" / "table2_detection_rate.csv"  # percent of 1,000 runs
EPISODES, FEWER_EPISODES = 100, 30  # episodes of a cell with up to 15 followers, and with more


def make_seed(seed: int, game: Game, branch: int) -> int:
    """Seed of an episode's swarm (branch 0) or detector (branch 1); every detector gets the same swarms."""
    name = int.from_bytes(f"{game['follow']}/{game['mobility']}".encode(), "little")
    key = (name % 2**61, game["followers"], game["decoys"], int(game["head_jitter"]), game["episode"], branch)
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1)[0])


def play(game: Game, seed: int) -> list[dict[str, Any]]:
    """Play one episode."""
    env = SingleClusterEnv(**{name: value for name, value in game.items() if name not in ("detector", "episode")})
    observation, _ = env.reset(seed=make_seed(seed, game, 0))
    window, detector = Window.from_observation(observation), make_detector(game["detector"])
    detector.reset(make_seed(seed, game, 1))
    answer, seconds = ask(detector, window)
    metrics = {
        "named": int(answer.candidates.any()),
        "hit": int(np.array_equal(answer.candidates, env.swarm.head)),
        "explained": float(np.mean(answer.extras.get("explained", np.nan))),
    }
    return [{**game, **metrics, "seconds": seconds}]


def draw(rows: pd.DataFrame, folder: Path) -> None:
    """Draw what training adds, and the rates of the paper's setting against m, by follow strategy."""
    rows = rows[(rows.mobility == "iid") & ~rows.head_jitter]
    draw_training(rows[rows.detector.isin(COMPARED) & (rows.decoys <= 1)], folder)
    rows = rows[(rows.decoys == 0) & rows.detector.isin(DETECTORS)]
    paper, styles = pd.read_csv(PAPER), shared.make_styles(DETECTORS, 4)
    figure, grid = shared.panels(13.2, 7.2, 2, 4, sharey=True)
    grid[1, 3].set_visible(False)
    for axes, follow in zip(grid.ravel(), FOLLOW, strict=False):
        shared.draw_intervals(axes, rows[rows.follow == follow], "followers", FOLLOWERS, "hit", styles, 100)
        theirs = paper[paper.ifs == follow]
        ticks = [FOLLOWERS.index(size) for size in theirs.followers]
        axes.plot(ticks, theirs.detection_rate_percent, "o", mfc="none", mec="black", ms=9, label="the paper")
        axes.set(xlabel="followers m", ylabel="rate, %" if axes in grid[:, 0] else "", title=follow)
    count = shared.describe_counts(rows, ["detector", "follow", "followers"])
    caption = (
        "Percent of episodes in which the head is the only candidate. "
        f"{count} episodes a point; bars are 95 % Wilson intervals. Circles: 1,000 runs."
    )
    shared.save_figure(figure, folder / "detection-rates.png", "Detection rate of P1, one cluster", caption)


def draw_training(rows: pd.DataFrame, folder: Path) -> None:
    """Draw trained, untrained, ours and chance against m and, for m = 2, against f; without and with a decoy."""
    paper, styles = pd.read_csv(PAPER), shared.make_styles(COMPARED, 5)
    figure, grid = shared.panels(11, 6.4, 2, 2, sharey=True)
    for decoys, line in enumerate(grid):
        part = rows[rows.decoys == decoys]
        for axes, x, ticks, chosen in zip(
            line, ("followers", "follow"), (FOLLOWERS, FOLLOW), (part, part[part.followers == 2]), strict=True
        ):
            shared.draw_intervals(axes, chosen, x, ticks, "hit", styles, 100)
            sizes = np.array(FOLLOWERS if x == "followers" else [2] * len(FOLLOW))
            axes.plot(100 / (sizes + 1 + decoys), "_", ms=18, color="black", label="chance: one UAV at random")
            axes.set(xlabel="followers m, f1 to f7" if x == "followers" else "follow strategy, m = 2", ylim=(-3, 103))
            if decoys == 0:
                rates = (paper if x == "followers" else paper[paper.followers == 2]).rename(columns={"ifs": "follow"})
                means = rates.groupby(x).detection_rate_percent.mean().reindex(ticks)
                axes.plot(means.to_numpy(), "o", mfc="none", mec="black", ms=9, label="the paper")
        line[0].set(ylabel="head alone named, %", title=("no decoy", "one decoy")[decoys])
    count = shared.describe_counts(rows, ["detector", "decoys", "followers", "follow"])
    caption = f"iid heads, {count} episodes a cell; bars are 95 % intervals. The paper: 1,000 runs a cell."
    shared.save_figure(figure, folder / "training.png", "P1: what training adds", caption)


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, shared.RESULTS / "paper" / "table2.csv.gz")
    parser.add_argument("--detector", action="append", help="may repeat; by default those of the table")
    parser.add_argument("--cells", default=",".join(FOLLOW), help="such as f1:2,f4:15 or f1; by default all 70")
    episodes = f"{EPISODES} up to m = 15, else {FEWER_EPISODES}"
    parser.add_argument("--episodes", type=int, help=f"of each cell; by default {episodes}")
    parser.add_argument("--decoys", type=int, default=0)
    parser.add_argument("--mobility", default="iid")
    parser.add_argument("--head-jitter", action="store_true")
    options = parser.parse_args(argv)
    words = [word.partition(":") for word in options.cells.split(",")]
    cells = [(follow, int(size)) for follow, _, chosen in words for size in ([chosen] if chosen else FOLLOWERS)]
    games: list[Game] = [
        {"detector": name, "follow": follow, "followers": followers, "decoys": options.decoys}
        | {"mobility": options.mobility, "head_jitter": options.head_jitter, "episode": episode}
        for follow, followers in sorted(cells, key=lambda cell: cell[1])  # small swarms first
        for name in options.detector or DETECTORS
        for episode in range(options.episodes or (EPISODES if followers <= 15 else FEWER_EPISODES))
    ]
    draw(shared.run_missing(options, games, partial(play, seed=options.seed)), options.images)


if __name__ == "__main__":
    main()

"""Does the fast GASSL find the head as often as the literal loop of Algorithm 1? The same episodes for all.

    OMP_NUM_THREADS=1 python benchmarks/gassl_quality.py      # writes benchmarks/results/gassl_quality.csv

The loop (``tests/detectors/gassl/literal.py``) updates the shared Γ one UAV after another, with all 96 times in every
step; an episode with 50 followers takes it a minute and more, so there are few. Rows are written as they come, and a
run that was interrupted goes on.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch

import usnet_env
from detectors.gassl import Gassl
from detectors.gassl.agat import Agat, AgatSizes
from detectors.gassl.ifsn import Ifsn
from detectors.gassl.input_pooling import InputPooling, standardise
from detectors.gassl.inputs import samples_of
from detectors.gassl.votes import choices, probabilities, top
from usnet_env.evaluation.statistics import rate_interval
from usnet_env.reproduce.table2 import FOLLOW

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "detectors" / "gassl"))

import literal  # noqa: E402  lives beside the tests that hold the fast GASSL against it

CELLS = {2: (FOLLOW, 10), 5: (FOLLOW, 10), 50: (("f1", "f4", "f6"), 2)}  # m: strategies, episodes of each
SEED = 2022
MEMORY = 4
HEADER = ("detector", "follow", "followers", "episode", "hit")


def literal_choice(window: usnet_env.Window, seed: int) -> int:
    """The UAV that Algorithm 1 names, as the paper writes it, with our optimiser and scaling."""
    settings = InputPooling()
    rng = np.random.default_rng(seed)
    generator = torch.Generator().manual_seed(seed)
    samples = samples_of([window], [np.arange(window.uavs)], MEMORY, torch.device("cpu"))
    sizes = AgatSizes(MEMORY, settings.query_hidden, settings.query, settings.key, settings.similarity_hidden)
    agat = Agat(1, window.uavs, sizes, generator)
    ifsn = Ifsn(1, 6 * MEMORY + 6, settings.ifsn_hidden, generator)
    alpha = literal.train(agat, ifsn, standardise(samples), settings, settings.steps).double().numpy()
    choice, own = choices(alpha, False, rng), choices(alpha, True, rng)
    return int(top(probabilities("paper", alpha, np.zeros_like(alpha), choice, own), 1, rng)[0])


def fast_choice(window: usnet_env.Window, seed: int, preset: str) -> int:
    detector = Gassl(preset=preset)
    detector.reset(seed)
    return int(np.flatnonzero(detector.detect(window).candidates)[0])


PLAYERS = {
    "literal loop": literal_choice,
    "gassl(preset='paper')": lambda window, seed: fast_choice(window, seed, "paper"),
    "gassl": lambda window, seed: fast_choice(window, seed, "default"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "gassl_quality.csv")
    out = parser.parse_args().out
    rows: list[dict[str, str]] = []
    if out.exists():
        with out.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    known = {tuple(row[name] for name in HEADER[:4]) for row in rows}
    for followers, (strategies, episodes) in CELLS.items():
        for follow in strategies:
            env = gym.make("USNET/SingleCluster-v0", follow=follow, followers=followers).unwrapped
            for episode in range(episodes):
                observation, _ = env.reset(seed=SEED + episode)
                window = usnet_env.Window.from_observation(observation)
                for name, choose in PLAYERS.items():
                    key = (name, follow, str(followers), str(episode))
                    if key in known:
                        continue
                    hit = int(env.swarm.head[choose(window, episode)])
                    rows.append(dict(zip(HEADER, (*key, str(hit)), strict=True)))
                    aside = out.with_suffix(".part")
                    with aside.open("w", encoding="utf-8", newline="") as file:
                        writer = csv.DictWriter(file, HEADER, lineterminator="\n")
                        writer.writeheader()
                        writer.writerows(rows)
                    aside.replace(out)
    for followers in CELLS:
        for name in PLAYERS:
            hits = [float(row["hit"]) for row in rows if (row["detector"], row["followers"]) == (name, str(followers))]
            mean, low, high = rate_interval(hits)
            print(f"m={followers}, {name}: head named in {mean:.3f} ({low:.3f}-{high:.3f}), n={len(hits)}")


if __name__ == "__main__":
    main()

"""Measure how much evidence for its head a follower's flight holds, beyond its own history: the limit of all detectors.

    OMP_NUM_THREADS=1 python benchmarks/neural_granger_own_history.py

writes benchmarks/results/neural_granger_own_history.csv. For each follower it compares two errors: that of the null
model of ``neural-granger``, a cross-fitted ridge regression on the follower's own past, and that of the true strategy
applied to the flight of the true head, which no detector can surpass. The logarithm of their ratio is the evidence in
nats a sample that knowledge of the strategy and the head would give. Where it is near 0, as for f4 and f5 with a head
that flies nearly straight, a detector that has to learn the strategy from one window has little to learn from.
"""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import torch
from detectors.neural_granger.inputs import build_samples
from detectors.neural_granger.per_candidate import predict_from_own_history
from detectors.studies.common import FOLLOW
from running import RESULTS, answer_help, write_csv
from strategy_classes import MEMORY, follow_truly

import usnet_env
from usnet_env.swarm import follow_strategies

EPISODES = 20
SEED = 2022
CELLS = (("iid", False), ("gauss_markov", True), ("waypoint", True))
HEADER = ("follow", "mobility", "head_jitter", "episode", "follower", "own_history_error", "strategy_error")


def predict_with_truth(env: object, window: usnet_env.Window, follow: str, followers: np.ndarray) -> np.ndarray:
    """norm(f) of every follower at every time, ``(n, T_ob - T_0, 3)``."""
    strategy, swarm = follow_strategies()[follow], env.swarm
    wanted = follow_truly(strategy, window, followers, swarm.root[followers], swarm.parameters)
    return wanted / np.maximum(np.linalg.norm(wanted, axis=2, keepdims=True), 1e-6)


def main() -> None:
    rows = []
    for mobility, jitter in CELLS:
        for follow in FOLLOW:
            gains = []
            env = gym.make(
                "USNET/SingleCluster-v0", follow=follow, followers=5, mobility=mobility, head_jitter=jitter
            ).unwrapped
            for episode in range(EPISODES):
                observation, _ = env.reset(seed=SEED + episode)
                window = usnet_env.Window.from_observation(observation)
                followers = np.flatnonzero(~env.swarm.head)
                samples = build_samples([window], [followers], MEMORY, torch.device("cpu"))
                target = samples.target[0].numpy()
                null = ((predict_from_own_history(samples, 1.0)[0].numpy() - target) ** 2).sum(-1).mean(1)
                truth = ((predict_with_truth(env, window, follow, followers) - target) ** 2).sum(-1).mean(1)
                gains += list(np.log(null / truth))
                rows += [
                    dict(zip(HEADER, (follow, mobility, jitter, episode, i, f"{a:.6f}", f"{b:.6f}"), strict=True))
                    for i, a, b in zip(followers, null, truth, strict=True)
                ]
            low, middle, high = np.quantile(gains, [0.05, 0.5, 0.95])
            print(
                f"{mobility}{' with jitter' * jitter}, {follow}: {middle:.2f} nats a sample ({low:.2f} to {high:.2f})"
            )
    write_csv(RESULTS / "neural_granger_own_history.csv", rows)


if __name__ == "__main__":
    answer_help(__doc__)
    main()

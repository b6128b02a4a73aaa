"""Play the game that the README and the start page show, and write it as ``docs/images/game.gif``.

The detector is a simple one, on a window of 60 steps, so that it errs in round 1 and recovers: a game of three rounds.
"""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym

import usnet_env.envs  # noqa: F401  # registers the environments
from usnet_env import make_detector
from usnet_env.replay import play
from usnet_env.replay.animation import animate

TARGET = Path(__file__).parent / "images" / "game.gif"
SWARM_SEED, DETECTOR_SEED = 3, 7


def main() -> None:
    """Play and write."""
    env = gym.make(
        "USNET/MultiCluster-v0",
        clusters=5,
        uavs=60,
        follow="f3",
        mobility="gauss_markov",
        head_jitter=True,
        formation="around",
        observation_steps=60,
    )
    with env:
        record = play(env, make_detector("lagged-correlation"), SWARM_SEED, DETECTOR_SEED)
    path = animate(record, TARGET)
    print(f"{path}: {record.rounds} rounds, {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()

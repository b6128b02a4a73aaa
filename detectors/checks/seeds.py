"""A check that a detector doesn't rebuild the simulated swarm from seeds that can be guessed."""

from __future__ import annotations

from typing import Any

import numpy as np

from detectors.checks.harness import copy_detector, play_windows, require
from detectors.checks.windows import start_environment
from usnet_env.evaluation.episode import episode_seeds

SEEDS = (0, 2022)  # of an evaluation: the default of ``usnet evaluate``, and that of published tables
LARGE_SEED = 0x8C2F_51D7_E6A0_934B_27F9_1B6E_D05C_48A3  # far beyond what a program can search
# If both kinds of seeds are alike to a detector, it succeeds in all swarms of one kind and in none of the other with a
# probability of at most 1 / C(12, 6), or 0.1 %.
EPISODES = 6
# Few and short windows of a strategy that is hard to see: only a rebuilt swarm shows its heads without a mistake.
SWARM = {"clusters": 4, "uavs": 20, "observation_steps": 10, "follow": "f5"}


def check_seeds_reveal_no_heads(detector: Any) -> None:
    """The detector is no better at swarms whose seeds can be guessed than at swarms whose seeds cannot.

    The seeds of a swarm and of its detector follow from the seed of the evaluation and the number of the episode, as in
    :func:`usnet_env.evaluate`. A detector that searches them can simulate the swarm again, with its true heads.
    """
    for seed in SEEDS:
        if all(_names_heads_only(detector, seed, episode) for episode in range(EPISODES)):
            require(
                any(_names_heads_only(detector, LARGE_SEED, episode) for episode in range(EPISODES)),
                "the detector must not search the seed of the swarm, got no mistake in the first "
                f"{EPISODES} swarms of an evaluation with seed {seed}, and a mistake in each of {EPISODES} swarms "
                "whose seeds are too large to be searched.",
            )


def _names_heads_only(detector: Any, seed: int, episode: int) -> bool:
    """Whether the detector names at least one UAV of a swarm and all UAVs that it names are heads."""
    swarm_seed, detector_seed = episode_seeds(seed, episode)
    _, window = start_environment(seed=swarm_seed, **SWARM)
    try:
        (answer,) = play_windows(copy_detector(detector), [window], detector_seed)
    except Exception:  # a detector may refuse so short a window
        return False
    env, _ = start_environment(seed=swarm_seed, **SWARM)  # again, because no truth is within reach while it answers
    head = env.unwrapped.swarm.head  # type: ignore[attr-defined]  # all environments of USNET have it
    return bool(answer.candidates.any()) and not bool(np.any(answer.candidates & ~head))

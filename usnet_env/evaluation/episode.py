"""One episode between an environment and a player, scored."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.metrics import episode_metrics
from usnet_env.evaluation.players import Answer, Player

__all__ = ["Row", "episode_seeds", "play_episode", "warm_up"]

Row = dict[str, Any]


def episode_seeds(seed: int, episode: int) -> tuple[int, int]:
    """The swarm's and the detector's seed of one episode, from two separate branches of (seed, episode).

    Neither can be computed from the other, so no detector can rebuild its swarm from what it is given.
    """
    swarm, detector = (np.random.SeedSequence(seed, spawn_key=(episode, branch)) for branch in (0, 1))
    return int(swarm.generate_state(1, np.uint64)[0] >> np.uint64(1)), int(
        detector.generate_state(1)[0] >> np.uint32(1)
    )


def _failure(label: str, where: str, error: Exception) -> EvaluationError:
    text = " ".join(str(error).split())
    cause = text if isinstance(error, ArgumentError) else f"{type(error).__name__}: {text}".rstrip(": ")
    return EvaluationError(f"detector {label!r} failed in {where}: {cause.rstrip('.')}.")


def warm_up(env: gym.Env[Any, Any], player: Player, label: str, seed: int) -> None:
    """Let the player answer the first window of episode 0 once, untimed."""
    observation, _ = env.reset(seed=episode_seeds(seed, 0)[0])
    try:
        player.warm_up(observation)
    except Exception as error:
        raise _failure(label, "its warm-up", error) from error


def play_episode(env: gym.Env[Any, Any], player: Player, label: str, seed: int, episode: int) -> Row:
    """Play one episode to its end.

    Args:
        env: a USNET environment.
        player: who answers.
        label: its name in the row, and in errors.
        seed: of the evaluation.
        episode: number of the episode, from 0.

    Returns:
        The row: ``detector, episode, swarm_seed, detector_seed, uavs, heads`` and the metrics.

    Raises:
        EvaluationError: the player raised, or its answer does not fit.
    """
    swarm_seed, detector_seed = episode_seeds(seed, episode)
    observation, _ = env.reset(seed=swarm_seed)
    truth = env.unwrapped.swarm  # type: ignore[attr-defined]  # make_environment has seen it
    answers: list[Answer] = []
    fired: list[NDArray[np.bool_]] = []
    over = False
    try:
        player.reset(detector_seed)
    except Exception as error:
        raise _failure(label, f"the reset of episode {episode}", error) from error
    while not over:
        try:
            answer = player.answer(observation)
            if answer.candidates.shape != truth.head.shape:
                raise ArgumentError(f"the answer must be for {len(truth.head)} UAVs, got {len(answer.candidates)}.")
        except Exception as error:
            raise _failure(label, f"episode {episode}, round {len(answers) + 1}", error) from error
        observation, _, terminated, truncated, info = env.step(answer.candidates.astype(np.int8))
        answers.append(answer)
        fired.append(answer.candidates & (not info["over_budget"]))
        over = terminated or truncated
    problem = env.unwrapped.problem  # type: ignore[attr-defined]
    return {
        "detector": label,
        "episode": episode,
        "swarm_seed": swarm_seed,
        "detector_seed": detector_seed,
        "uavs": len(truth.head),
        "heads": int(truth.head.sum()),
        **episode_metrics(problem, truth, answers, np.array(fired)),
    }

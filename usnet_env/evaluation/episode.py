"""Play one episode with one agent, and score it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any

import gymnasium as gym
import numpy as np

from usnet_env.config import ArgumentError
from usnet_env.envs.play import PlayedRound, play_rounds
from usnet_env.evaluation.agents import Agent, Answer, RefusedArgumentError
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.metrics import episode_metrics
from usnet_env.processes import PlainError, ProcessDied, describe_place, limited
from usnet_env.swarm import SwarmState

Row = dict[str, Any]


def episode_seeds(seed: int, episode: int, secret: str | None = None) -> tuple[int, int]:
    """Derive the seeds of one episode: one for the swarm, one for the detector.

    They come from two separate branches of (``seed``, ``episode``), so that the random numbers of a detector are
    independent of those of its swarm. Without a secret, the detector's seed does not hide the swarm: ``seed`` and
    ``episode`` are small numbers, so a program that searches all pairs of them for its own seed can compute the swarm's
    seed as well. With a secret of 128 bits, neither seed can be searched.

    Args:
        seed: the seed of the evaluation.
        episode: number of the episode, from 0.
        secret: the secret of an isolated run, as hexadecimal digits.

    Returns:
        The swarm's seed, below 2^63, and the detector's seed, below 2^31.
    """
    entropy = seed if secret is None else (seed, int(secret, 16))
    swarm, detector = (np.random.SeedSequence(entropy, spawn_key=(episode, branch)) for branch in (0, 1))
    swarm_seed = int(swarm.generate_state(1, np.uint64)[0] >> np.uint64(1))
    return swarm_seed, int(detector.generate_state(1)[0] >> np.uint32(1))


def detector_error(label: str, where: str, error: BaseException) -> EvaluationError:
    """The error for a detector that failed; one sentence, with the line of the detector's code that failed."""
    if isinstance(error, ProcessDied):
        return EvaluationError(f"detector {label!r} failed in {error.during or where}: {error.reason}.")
    plain = isinstance(error, PlainError)
    text = " ".join(str(error).split())
    cause = text if plain or isinstance(error, ArgumentError) else f"{type(error).__name__}: {text}".rstrip(": ")
    place = error.place if isinstance(error, PlainError) else describe_place(error)
    shown = f" ({place})" if place else ""
    return EvaluationError(f"detector {label!r} failed in {where}: {cause.rstrip('.')}{shown}.")


@contextmanager
def detector_step(label: str, where: str) -> Iterator[None]:
    """Run a step of a detector with the limits of this process; whatever it raises becomes an EvaluationError.

    ``SystemExit`` is an error here as well: a detector must not end the program, least of all with status 0.
    """
    try:
        with limited(where):
            yield
    except (Exception, SystemExit) as error:
        raise detector_error(label, where, error) from error


def warm_up(env: gym.Env[Any, Any], agent: Agent, label: str, swarm_seed: int) -> None:
    """Let the agent answer the first window of an episode once, before anything is timed.

    Raises:
        RefusedArgumentError: the detector refused one of its arguments.
        EvaluationError: the detector failed.
    """
    observation, _ = env.reset(seed=swarm_seed)
    try:
        with detector_step(label, "its warm-up"):
            agent.warm_up(observation)
    except EvaluationError as error:
        if isinstance(error.__cause__, RefusedArgumentError):
            raise RefusedArgumentError(f"detector {label!r} refuses an argument: {error.__cause__}") from error
        raise


def play_agent(
    env: gym.Env[Any, Any], agent: Agent, label: str, episode: int, seeds: tuple[int, int]
) -> list[PlayedRound[Answer]]:
    """Play one episode to its end, with seeds of the swarm and of the agent; errors have the label and the number.

    Raises:
        EvaluationError: the agent raised an exception, or its answer has a wrong type or shape.
    """
    swarm_seed, detector_seed = seeds
    number = count(1)

    def answer(observation: Any, truth: SwarmState) -> Answer:
        with detector_step(label, f"episode {episode}, round {next(number)}"):
            answer = agent.answer(observation)
            if answer.candidates.shape != truth.head.shape:
                raise ArgumentError(
                    f"candidates must hold one value for each of {len(truth.head)} UAVs, got {len(answer.candidates)}."
                )
        return answer

    with detector_step(label, f"the reset of episode {episode}"):
        agent.reset(detector_seed)
    return list(play_rounds(env, answer, swarm_seed))


def play_episode(env: gym.Env[Any, Any], agent: Agent, label: str, episode: int, seeds: tuple[int, int]) -> Row:
    """Play one episode to its end, as :func:`play_agent` does, and score it.

    Returns:
        The row: ``detector, episode, swarm_seed, detector_seed, uavs, heads`` and the metrics.
    """
    rounds = play_agent(env, agent, label, episode, seeds)
    truth = rounds[0].truth
    game: Any = env.unwrapped
    return {
        "detector": label,
        "episode": episode,
        "swarm_seed": seeds[0],
        "detector_seed": seeds[1],
        "uavs": len(truth.head),
        "heads": int(truth.head.sum()),
        **episode_metrics(game.problem, rounds),
        **(game.score_answer(rounds[0].answer.scores) if hasattr(game, "score_answer") else {}),
    }

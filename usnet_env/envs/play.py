"""Play one episode, round by round: the loop of `evaluate` and of replays."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from usnet_env.config import ArgumentError
from usnet_env.detection import Detection
from usnet_env.envs.probing import ProbingEnv
from usnet_env.swarm import SwarmState


@dataclass(frozen=True)
class PlayedRound:
    """One round that has been played: what was answered how, the truth, and what the environment returned."""

    observation: Any
    truth: SwarmState  # in this window, before the destruction
    answer: Detection
    seconds: float  # that the answer took
    info: dict[str, Any]


def refuse_probing(env: gym.Env[Any, Any]) -> None:
    """Refuse an environment whose actions are no candidates, so that no detector can play it."""
    if isinstance(env.unwrapped, ProbingEnv):
        raise ArgumentError(
            f"env must be a game that detectors can play, got {env.unwrapped}, whose agent also steers intruders: "
            "usnet_env.envs.play.play_probe plays it with a prober."
        )


def play_rounds(
    env: gym.Env[Any, Any], answer: Callable[[Any], tuple[Detection, float]], seed: int | None
) -> Iterator[PlayedRound]:
    """Play an episode to its end, and yield each round after it has been played.

    ``answer`` gets an observation, and returns a detection and the seconds that it took.
    """
    game: Any = env.unwrapped
    observation, _ = env.reset(seed=seed)
    is_over = False
    while not is_over:
        truth = game.swarm
        detection, seconds = answer(observation)
        next_observation, _, terminated, truncated, info = env.step(detection.candidates.astype(np.int8))
        is_over = bool(terminated or truncated)
        yield PlayedRound(observation, truth, detection, seconds, info)
        observation = next_observation


def play_probe(env: gym.Env[Any, Any], prober: Any, seed: int) -> tuple[PlayedRound, float]:
    """Play an episode of probing: the round in which the prober names its candidate, and the sum of the rewards."""
    game: Any = env.unwrapped
    observation, _ = env.reset(seed=seed)
    prober.reset(game.arguments, seed + 1)
    total, is_over = 0.0, False
    while not is_over:
        truth, action, last_observation = game.swarm, prober.act(observation), observation
        observation, reward, is_over, _, info = env.step(action)
        total += float(reward)
    answer = Detection(np.arange(len(prober.belief)) == action["name"], prober.belief)
    return PlayedRound(last_observation, truth, answer, 0.0, info), total

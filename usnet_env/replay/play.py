"""Play one episode of an environment with a detector, and keep everything."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from pydantic import BaseModel

from usnet_env.config import ArgumentError, quote
from usnet_env.detection import Detection
from usnet_env.plugins import DetectorLike, detector_label
from usnet_env.provenance import versions
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.window import Window

__all__ = ["Round", "play"]


@dataclass(frozen=True)
class Round:
    """What is reported when a round is over.

    Args:
        number: from 1.
        named: candidates of this round.
        hits: heads among them.
        redundant: the others among them.
        heads_left: living heads after the round.
        objective: J after the round.
        over_budget: more candidates than the shot budget: nobody was destroyed.
        seconds: wall time of ``detect``.
    """

    number: int
    named: int
    hits: int
    redundant: int
    heads_left: int
    objective: float
    over_budget: bool
    seconds: float


def _plain_config(config: BaseModel) -> dict[str, Any]:
    """A config's values as JSON holds them; a part given as an object is kept as its text."""
    return {
        name: value if isinstance(value, str | int | float | tuple | None) else quote(value)
        for name, value in ((name, getattr(config, name)) for name in type(config).model_fields)
    }


def play(
    env: gym.Env[Any, Any],
    detector: DetectorLike,
    seed: int | None,
    detector_seed: int | None,
    on_round: Callable[[Round], None] | None = None,
    *,
    label: str | None = None,
) -> EpisodeRecord:
    """Play one episode to its end and record what was seen, true and answered.

    The detector gets windows only. The truth is read from ``env.unwrapped.swarm``, beside the game.

    Args:
        env: an environment of this project; wrappers are fine if they keep the form of observations and actions.
        detector: anything with ``reset(seed)`` and ``detect(window) -> Detection``.
        seed: seeds the environment; ``None`` goes on with its generator.
        detector_seed: seeds the detector.
        on_round: called after every round, for who wants to watch.
        label: name of the detector in the record; by default as in tables, see ``detector_label``.

    Returns:
        The record of the whole episode.

    Raises:
        ArgumentError: an environment of another kind, or a detector's answer of another kind or size.
    """
    game: Any = env.unwrapped
    if not all(hasattr(game, name) for name in ("config", "rules", "problem")):
        raise ArgumentError(f"env must be a USNET environment, got {quote(env)}.")
    observation, _ = env.reset(seed=seed)
    detector.reset(detector_seed)
    windows: list[Window] = []
    truths: list[Any] = []
    answers: list[Detection] = []
    reports: list[Round] = []
    over = False
    while not over:
        window = Window.from_observation(observation)
        truth = game.swarm
        began = time.perf_counter()
        detection = detector.detect(window)
        seconds = time.perf_counter() - began
        if not isinstance(detection, Detection) or detection.candidates.shape != (window.uavs,):
            raise ArgumentError(f"detector must answer a Detection for {window.uavs} UAVs, got {quote(detection)}.")
        observation, _, terminated, truncated, info = env.step(detection.candidates.astype(np.int8))
        over = bool(terminated or truncated)
        windows.append(window)
        truths.append(truth)
        answers.append(detection)
        reports.append(
            Round(
                number=len(windows),
                named=int(detection.candidates.sum()),
                hits=int(info["hits"]),
                redundant=int(info["redundant"]),
                heads_left=int(game.swarm.heads_left),
                objective=float(info["J"]),
                over_budget=bool(info["over_budget"]),
                seconds=seconds,
            )
        )
        if on_round is not None:
            on_round(reports[-1])

    def every(name: str) -> Any:
        """An optional part of the answers for all rounds, -1 where a round lacks it; ``None`` if all do."""
        values = [getattr(answer, name) for answer in answers]
        if all(value is None for value in values):
            return None
        return np.stack([np.full(windows[0].uavs, -1) if value is None else value for value in values])

    return EpisodeRecord(
        position=np.stack([window.position for window in windows]),
        velocity=np.stack([window.velocity for window in windows]),
        seen=np.stack([window.seen for window in windows]),
        alive=np.stack([truth.alive for truth in truths]),
        leader=np.stack([truth.leader for truth in truths]),
        candidates=np.stack([answer.candidates for answer in answers]),
        scores=np.stack([answer.scores for answer in answers]),
        objective=np.array([report.objective for report in reports]),
        head=truths[0].head,
        decoy=truths[0].decoy,
        over_budget=np.array([report.over_budget for report in reports]),
        seconds=np.array([report.seconds for report in reports]),
        clusters=every("clusters"),
        leader_estimate=every("leader"),
        problem=game.problem,
        env_id=env.spec.id if env.spec is not None else type(game).__name__,
        seed=seed,
        detector=label or detector_label(detector),
        detector_seed=detector_seed,
        config=_plain_config(game.config) | _plain_config(game.rules),
        versions=versions(),
    )

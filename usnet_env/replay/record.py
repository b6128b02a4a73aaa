"""Play an episode with a detector, and record it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from usnet_env.config import ArgumentError, describe_arguments, optional_seed, quote
from usnet_env.detection import ask
from usnet_env.envs.play import PlayedRound, play_probe, play_rounds, refuse_probing
from usnet_env.envs.probers import Prober
from usnet_env.plugins import DetectorLike, detector_label, find_detector
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.window import Window


def record_episode(
    env: gym.Env[Any, Any],
    detector: str | DetectorLike,
    seed: int | None,
    detector_seed: int | None,
    *,
    label: str | None = None,
) -> EpisodeRecord:
    """Play one episode to its end, and record the windows, the truth and the answers.

    Where the truth is unknown, as in recorded tracks without leaders, the record is not ``labelled`` and holds what the
    detector found.

    Args:
        env: an environment of this project; wrappers must keep the form of observations and actions.
        detector: a name, or any object with ``reset(seed)`` and ``detect(window) -> Detection``.
        seed: seed of the environment; ``None`` continues with its generator.
        detector_seed: seed of the detector.
        label: name of the detector in the record; by default its name in tables, see ``detector_label``.

    Raises:
        ArgumentError: ``env`` is no environment of this project, a seed is no whole number from 0, or an answer is no
            ``Detection`` for its N UAVs.

    >>> record = record_episode(gym.make("USNET/MultiCluster-v0"), "destroy-all", seed=0, detector_seed=0)
    >>> record.rounds
    1
    """
    _check_environment(env)
    refuse_probing(env)
    detector = find_detector(detector)
    seed, detector_seed = optional_seed("seed", seed), optional_seed("detector_seed", detector_seed)
    detector.reset(detector_seed)
    rounds = list(play_rounds(env, lambda seen: ask(detector, Window.from_observation(seen)), seed))
    return _make_record(env, rounds, seed, detector_seed, label or detector_label(detector))


def record_probe(env: gym.Env[Any, Any], prober: Prober, seed: int) -> EpisodeRecord:
    """Play an episode of ``USNET/Probing-v1`` with a scripted prober, and record its window when it names the head.

    Raises:
        ArgumentError: ``env`` is no such environment.
    """
    _check_environment(env)
    played, _ = play_probe(env, prober, seed)
    label = f"{'copies' if prober.detector is None else detector_label(prober.detector)}, target {prober.target}"
    return _make_record(env, [played], seed, None, label)


def _check_environment(env: Any) -> None:
    game: Any = env.unwrapped if isinstance(env, gym.Env) else None
    if not all(hasattr(game, name) for name in ("config", "rules", "problem")):
        raise ArgumentError(f"env must be a USNET environment, got {quote(env)}.")


def _make_record(
    env: gym.Env[Any, Any], rounds: Sequence[PlayedRound], seed: int | None, detector_seed: int | None, label: str
) -> EpisodeRecord:
    game: Any = env.unwrapped
    config = describe_arguments(game.config) | describe_arguments(game.rules)
    if tracks := getattr(game, "tracks", None):
        times = {name: [played.info[name] for played in rounds] for name in ("start", "end")}
        config |= {"ids": list(tracks.ids), "step": tracks.step, "frame": tracks.frame, **times}
    labelled, intruders = getattr(game, "labelled", True), [played.observation.get("intruders") for played in rounds]
    truth_arrays: dict[str, Any] = {}
    if labelled:
        truth_arrays["truths"] = [played.truth for played in rounds]
        truth_arrays["objective"] = [float(played.info["J"]) for played in rounds]
        truth_arrays["over_budget"] = [bool(played.info["over_budget"]) for played in rounds]
    return EpisodeRecord.from_rounds(
        [Window.from_observation(played.observation) for played in rounds],
        [played.answer for played in rounds],
        **truth_arrays,
        seconds=[played.seconds for played in rounds],
        intruders=None if intruders[0] is None else np.stack(intruders),
        problem=game.problem,
        env_id=env.spec.id if env.spec is not None else type(game).__name__,
        seed=seed,
        detector=label,
        detector_seed=detector_seed,
        config=config,
    )

"""Play an episode with a detector, and record it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike

from usnet_env.arrays import Indices
from usnet_env.config import ArgumentError, describe_arguments, optional_seed, quote
from usnet_env.detection import Detection, ask
from usnet_env.envs.play import PlayedRound, play_probe, play_rounds
from usnet_env.envs.probers import Prober
from usnet_env.objectives import list_followers
from usnet_env.plugins import DetectorLike, detector_label, find_detector
from usnet_env.provenance import versions
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
    """
    _check_environment(env)
    detector = find_detector(detector)
    seed, detector_seed = optional_seed("seed", seed), optional_seed("detector_seed", detector_seed)
    detector.reset(detector_seed)
    rounds = list(play_rounds(env, lambda seen: ask(detector, Window.from_observation(seen)), seed))
    return _make_record(env, rounds, seed, detector_seed, label or detector_label(detector))


def record_probe(env: gym.Env[Any, Any], prober: Prober, seed: int) -> EpisodeRecord:
    """Play an episode of ``USNET/Probing-v0`` with a scripted prober, and record its window when it names the head.

    Raises:
        ArgumentError: ``env`` is no such environment.
    """
    _check_environment(env)
    played, _ = play_probe(env, prober, seed)
    label = f"{detector_label(prober.detector)}, target {prober.target}"
    return _make_record(env, [played], seed, None, label)


def _check_environment(env: Any) -> None:
    game: Any = env.unwrapped if isinstance(env, gym.Env) else None
    if not all(hasattr(game, name) for name in ("config", "rules", "problem")):
        raise ArgumentError(f"env must be a USNET environment, got {quote(env)}.")


def _stack(values: Sequence[ArrayLike | None], absent: int = 0) -> Any:
    """Stack an optional part of the answers; it is full of ``absent`` where a round lacks it, ``None`` if all do."""
    given = [value for value in values if value is not None]
    return np.stack([np.full_like(given[0], absent) if value is None else value for value in values]) if given else None


def _list_reasons(answer: Detection) -> dict[str, str]:
    """The sentences of ``extras["reasons"]`` by the UAVs of ``extras["heads"]``."""
    named, given = answer.extras.get("heads", ()), answer.extras.get("reasons", ())
    return {str(int(i)): str(why) for i, why in zip(named, given, strict=False)}


def _find_roots(answer: Detection) -> Indices:
    """``(N,)``: the candidate that each UAV follows by the answer; a candidate has its own index, -1: none."""
    root = np.full(len(answer.candidates), -1, np.int64)
    heads = np.flatnonzero(answer.candidates)
    for head in heads.tolist():
        root[list_followers(answer, head)] = head
    root[heads] = heads
    return root


def _make_record(
    env: gym.Env[Any, Any],
    rounds: Sequence[PlayedRound],
    seed: int | None,
    detector_seed: int | None,
    label: str,
) -> EpisodeRecord:
    """The record of an episode; if the truth is unknown, its heads and roots are those of the answers."""
    truths, answers = [played.truth for played in rounds], [played.answer for played in rounds]
    windows = [Window.from_observation(played.observation) for played in rounds]
    game: Any = env.unwrapped
    labelled = bool(getattr(game, "labelled", True))
    candidates = np.stack([answer.candidates for answer in answers])
    reasons = [_list_reasons(answer) for answer in answers]
    config = describe_arguments(game.config) | describe_arguments(game.rules)
    if tracks := getattr(game, "tracks", None):
        times = {name: [played.info[name] for played in rounds] for name in ("start", "end")}
        config |= {"ids": list(tracks.ids), "step": tracks.step, "frame": tracks.frame, **times}
    return EpisodeRecord(
        position=np.stack([window.position for window in windows]),
        velocity=np.stack([window.velocity for window in windows]),
        seen=np.stack([window.seen for window in windows]),
        alive=np.stack([truth.alive for truth in truths]),
        root=np.stack([truth.root for truth in truths] if labelled else [_find_roots(each) for each in answers]),
        candidates=candidates,
        scores=np.stack([answer.scores for answer in answers]),
        objective=np.array([float(played.info["J"]) if labelled else 0.0 for played in rounds]),
        head=truths[0].head if labelled else np.asarray(candidates.any(axis=0)),
        decoy=truths[0].decoy if labelled else np.zeros(candidates.shape[1], bool),
        intruders=_stack([played.observation.get("intruders") for played in rounds]),
        over_budget=np.array([bool(played.info["over_budget"]) or not labelled for played in rounds]),
        seconds=np.array([played.seconds for played in rounds]),
        clusters=_stack([answer.clusters for answer in answers], absent=-1),
        leader_estimate=_stack([answer.leader for answer in answers], absent=-1),
        attention=_stack([answer.attention for answer in answers]),
        probability=_stack([answer.extras.get("probability") for answer in answers]),
        reasons=reasons if any(reasons) else None,
        problem=game.problem,
        env_id=env.spec.id if env.spec is not None else type(game).__name__,
        seed=seed,
        detector=label,
        detector_seed=detector_seed,
        config=config,
        versions=versions(),
        labelled=labelled,
    )

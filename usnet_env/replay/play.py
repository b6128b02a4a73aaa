"""Play one episode of an environment with a detector, and record all of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, describe_arguments, optional_seed, plain_text, quote
from usnet_env.detection import Detection, fit_window
from usnet_env.envs.play import PlayedRound, play_rounds
from usnet_env.objectives import list_followers
from usnet_env.plugins import DetectorLike, detector_label
from usnet_env.provenance import versions
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.swarm import SwarmState
from usnet_env.window import Window


@dataclass(frozen=True)
class Round:
    """The report of one round.

    Args:
        number: number of the round, from 1.
        candidates: number of candidates.
        hits: candidates that are heads.
        redundant: candidates that are not.
        heads_left: living heads after the round.
        objective: J after the round.
        over_budget: the round had more candidates than the shot budget, and no UAV was destroyed.
        seconds: wall time of ``detect``.
    """

    number: int
    candidates: int
    hits: int
    redundant: int
    heads_left: int
    objective: float
    over_budget: bool
    seconds: float


def _stack(values: Sequence[NDArray[Any] | None], absent: int = 0) -> Any:
    """Stack an optional part of the answers; it is full of ``absent`` where a round lacks it, ``None`` if all do."""
    given = [value for value in values if value is not None]
    if not given or len({value.shape for value in given}) > 1:
        return None
    return np.stack([np.full_like(given[0], absent) if value is None else value for value in values])


def _read_numbers(answer: Detection, name: str) -> NDArray[np.float64] | None:
    """An array of ``extras``; ``None`` if the answer has none of finite numbers."""
    try:
        values = np.asarray(answer.extras.get(name), np.float64)
    except (TypeError, ValueError):
        return None
    return values if np.isfinite(values).all() else None


def _read_heads(answer: Detection) -> NDArray[np.float64] | None:
    """``(H, N, N)``: the weights of each attention head, ``extras["attention_heads"]``; ``None`` without them."""
    values, uavs = _read_numbers(answer, "attention_heads"), len(answer.scores)
    return values if values is not None and values.ndim == 3 and values.shape[1:] == (uavs, uavs) else None


def _flatten_features(answer: Detection) -> NDArray[np.float64] | None:
    """``(N, 2)``: ``extras["features"]``, ``(N, …)``, in the plane of their principal axes; ``None`` without them."""
    values = _read_numbers(answer, "features")
    if values is None or values.ndim < 2 or len(values) != len(answer.scores):
        return None
    flat = values.reshape(len(values), -1)
    known: NDArray[np.bool_] = np.any(flat, axis=1)  # the features of destroyed UAVs are 0
    centred = np.where(known[:, None], flat - flat[known].mean(axis=0) if known.any() else flat, 0.0)
    axes = np.linalg.svd(centred, full_matrices=False)[2][:2]
    plane = centred @ (axes * np.sign(axes[:, np.abs(axes).argmax(axis=1)].diagonal())[:, None]).T
    return np.pad(plane, ((0, 0), (0, 2 - plane.shape[1])))


def _list_reasons(answers: Sequence[Detection]) -> list[dict[str, str]] | None:
    """The sentences of ``extras["reasons"]`` by the UAVs of ``extras["heads"]``; ``None`` if no answer has any."""
    rounds = []
    for answer in answers:
        named, given = answer.extras.get("heads", ()), answer.extras.get("reasons", ())
        rounds.append({str(int(i)): str(why) for i, why in zip(named, given, strict=False)})
    return rounds if any(rounds) else None


def _find_roots(answer: Detection) -> NDArray[np.int64]:
    """``(N,)``: the candidate that each UAV follows by the answer; a candidate has its own index, -1: none."""
    root = np.full(len(answer.candidates), -1, np.int64)
    heads = np.flatnonzero(answer.candidates)
    for head in heads.tolist():
        root[list_followers(answer, head)] = head
    root[heads] = heads
    return root


def record_episode(
    env: gym.Env[Any, Any],
    detector: DetectorLike,
    seed: int | None,
    detector_seed: int | None,
    on_round: Callable[[Round], None] | None = None,
    *,
    label: str | None = None,
    keep_attention: bool = True,
) -> EpisodeRecord:
    """Play one episode to its end, and record the windows, the truth and the answers.

    The detector receives windows only. The truth is read from ``env.unwrapped.swarm``. Where it is unknown, as in
    recorded tracks without leaders, the record is not ``labelled`` and holds what the detector found.

    Args:
        env: an environment of this project; wrappers must keep the form of observations and actions.
        detector: any object with ``reset(seed)`` and ``detect(window) -> Detection``.
        seed: seed of the environment; ``None`` continues with its generator.
        detector_seed: seed of the detector.
        on_round: called with the report of every round.
        label: name of the detector in the record; by default its name in tables, see ``detector_label``.
        keep_attention: record the attention, if the detector gives any: N² numbers a round, and N² for each of its
            attention heads.

    Returns:
        The record of the whole episode.

    Raises:
        ArgumentError: ``env`` is no environment of this project, another argument has another type, or an answer is no
            ``Detection`` for its N UAVs.
    """
    check_environment(env)
    if isinstance(detector, type) or not isinstance(detector, DetectorLike):
        raise ArgumentError(f"detector must have the methods detect(window) and reset(seed), got {quote(detector)}.")
    if on_round is not None and not callable(on_round):
        raise ArgumentError(f"on_round must be a function or None, got {quote(on_round)}.")
    if not isinstance(keep_attention, bool):
        raise ArgumentError(f"keep_attention must be true or false, got {quote(keep_attention)}.")
    label = None if label is None else plain_text("label", label)
    seed, detector_seed = optional_seed("seed", seed), optional_seed("detector_seed", detector_seed)
    detector.reset(detector_seed)
    windows: list[Window] = []
    seconds: list[float] = []

    def answer(observation: Any, truth: SwarmState) -> Detection:
        windows.append(Window.from_observation(observation))
        uavs, given = windows[-1].uavs, fit_window(detector, windows[-1])
        began = time.perf_counter()
        detection = detector.detect(given)
        seconds.append(time.perf_counter() - began)
        if not isinstance(detection, Detection) or detection.candidates.shape != (uavs,):
            raise ArgumentError(f"detector must answer a Detection for {uavs} UAVs, got {quote(detection)}.")
        return detection

    rounds: list[PlayedRound[Detection]] = []
    for played in play_rounds(env, answer, seed):
        rounds.append(played)
        if on_round is not None:
            info = played.info
            report = Round(
                number=len(rounds),
                candidates=int(played.answer.candidates.sum()),
                hits=int(info["hits"]),
                redundant=int(info["redundant"]),
                heads_left=int(played.left.heads_left),
                objective=float(info["J"]),
                over_budget=bool(info["over_budget"]),
                seconds=seconds[-1],
            )
            on_round(report)
    label = label or detector_label(detector)
    return make_record(env, rounds, seconds, seed, detector_seed, label, keep_attention=keep_attention)


def check_environment(env: Any) -> None:
    """Raise :class:`ArgumentError` if ``env`` is no environment of this project."""
    game: Any = env.unwrapped if isinstance(env, gym.Env) else None
    if not all(hasattr(game, name) for name in ("config", "rules", "problem")):
        raise ArgumentError(f"env must be a USNET environment, got {quote(env)}.")


def _describe_tracks(game: Any, rounds: Sequence[PlayedRound[Detection]]) -> dict[str, Any]:
    """What the record of recorded tracks has beside arguments: the ids, the step and the times of the windows."""
    tracks = getattr(game, "tracks", None)
    if tracks is None:
        return {}
    times = {name: [played.info[name] for played in rounds] for name in ("start", "end")}
    return {"ids": list(tracks.ids), "step": tracks.step, "frame": tracks.frame, **times}


def make_record(
    env: gym.Env[Any, Any],
    rounds: Sequence[PlayedRound[Detection]],
    seconds: Sequence[float],
    seed: int | None,
    detector_seed: int | None,
    label: str,
    *,
    keep_attention: bool = True,
) -> EpisodeRecord:
    """The record of the rounds of an episode; the arguments are those of :func:`record_episode`.

    If the truth is unknown, the heads and roots are those of the answers, there are no decoys, J is 0, and the record
    says of every round that no UAV was destroyed.
    """
    truths, answers = [played.truth for played in rounds], [played.answer for played in rounds]
    windows = [Window.from_observation(played.observation) for played in rounds]
    game: Any = env.unwrapped
    labelled = bool(getattr(game, "labelled", True))
    candidates = np.stack([answer.candidates for answer in answers])
    roots = [truth.root for truth in truths] if labelled else [_find_roots(answer) for answer in answers]
    return EpisodeRecord(
        position=np.stack([window.position for window in windows]),
        velocity=np.stack([window.velocity for window in windows]),
        seen=np.stack([window.seen for window in windows]),
        alive=np.stack([truth.alive for truth in truths]),
        root=np.stack(roots),
        candidates=candidates,
        scores=np.stack([answer.scores for answer in answers]),
        objective=np.array([float(played.info["J"]) if labelled else 0.0 for played in rounds]),
        head=truths[0].head if labelled else np.asarray(candidates.any(axis=0)),
        decoy=truths[0].decoy if labelled else np.zeros(candidates.shape[1], bool),
        over_budget=np.array([bool(played.info["over_budget"]) or not labelled for played in rounds]),
        seconds=np.array(seconds),
        clusters=_stack([answer.clusters for answer in answers], absent=-1),
        leader_estimate=_stack([answer.leader for answer in answers], absent=-1),
        attention=_stack([answer.attention for answer in answers]) if keep_attention else None,
        attention_heads=_stack([_read_heads(answer) for answer in answers]) if keep_attention else None,
        probability=_stack([_read_numbers(answer, "probability") for answer in answers]),
        features=_stack([_flatten_features(answer) for answer in answers]),
        reasons=_list_reasons(answers),
        problem=game.problem,
        env_id=env.spec.id if env.spec is not None else type(game).__name__,
        seed=seed,
        detector=label,
        detector_seed=detector_seed,
        config=describe_arguments(game.config) | describe_arguments(game.rules) | _describe_tracks(game, rounds),
        versions=versions(),
        labelled=labelled,
    )

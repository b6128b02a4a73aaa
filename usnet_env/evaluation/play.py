"""Play one episode with one agent, and score it: one episode is one row."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import gymnasium as gym
import numpy as np

from usnet_env import objectives
from usnet_env.arrays import Mask
from usnet_env.detection import Detection
from usnet_env.envs.play import play_rounds
from usnet_env.evaluation.agents import Agent
from usnet_env.evaluation.tasks import EvaluationError, describe_failure

Row = dict[str, Any]

#: Every metric of an episode and its meaning. The last two exist only for detectors that return clusters.
METRICS = {
    "J": "the objective: J_m for P2 (lower is better, at best 1), J_s for P1 (higher is better, at best 0)",
    "rounds": "number of detection rounds",
    "redundancy": "number of redundant candidates in all rounds, divided by N",
    "success": "1 if every head was hit within max_rounds, else 0",
    "exact": "1 if the candidates of round 1 are exactly the heads, else 0; for P1 its mean is the detection rate",
    "precision_first": "share of the candidates of round 1 that are heads (0 without a candidate)",
    "recall_first": "share of the heads that are candidates of round 1",
    "f1_first": "harmonic mean of precision_first and recall_first; 1 if no head is there and none is named",
    "ap_first": "average precision of the scores of round 1",
    "seconds_per_round": "wall time of one answer in seconds; the warm-up is not counted",
    "purity_first": "purity of the clusters of round 1, without decoys",
    "head_in_cluster_first": "share of the heads that are in the same cluster as most of their followers, round 1",
}
RATES = frozenset({"success", "exact"})
LOWER_IS_BETTER = frozenset({"rounds", "redundancy", "seconds_per_round"})  # J as well, for P2
#: The metric that only environments of recorded tracks have, with known groups.
TRACK_METRICS = {"group_leader_first": "share of the groups whose head has the highest score of its group, round 1"}
#: What a row says of its episode before the metrics.
KEYS = ("cell", "detector", "episode", "swarm_seed", "detector_seed", "uavs", "heads")


def episode_seeds(seed: int, episode: int) -> tuple[int, int]:
    """Derive the seeds of an episode, numbered from 0: one for the swarm, below 2^63, one for the detector, below 2^31.

    They come from two separate branches of (``seed``, ``episode``), so that the random numbers of a detector are
    independent of those of its swarm.
    """
    swarm, detector = (np.random.SeedSequence(seed, spawn_key=(episode, branch)) for branch in (0, 1))
    swarm_seed = int(swarm.generate_state(1, np.uint64)[0] >> np.uint64(1))
    return swarm_seed, int(detector.generate_state(1)[0] >> np.uint32(1))


@contextmanager
def detector_step(label: str, step: str) -> Iterator[None]:
    """Run a step of a detector; whatever it raises becomes an :class:`EvaluationError`."""
    try:
        yield
    except (Exception, SystemExit) as error:  # a detector must not end the program, least of all with status 0
        reason = f"{step}: {describe_failure(error)}"
        raise EvaluationError(f"detector {label!r} failed in {reason}.", reason) from error


class Task(NamedTuple):
    """An episode that is to be played; the ``seeds`` are those of :func:`episode_seeds`."""

    cell: str
    label: str
    episode: int
    seeds: tuple[int, int]


def play_episode(env: gym.Env[Any, Any], agent: Agent, task: Task) -> Row:
    """Play one episode to its end, and return its row: the values of :data:`KEYS`, the metrics, and an empty ``error``.

    An exception of the agent is raised as an :class:`EvaluationError`.
    """
    round_numbers = count(1)

    def answer_round(observation: Any) -> tuple[Detection, float]:
        with detector_step(task.label, f"round {next(round_numbers)}"):
            return agent.answer(observation)

    with detector_step(task.label, "its reset"):
        agent.reset(task.seeds[1])
    rounds = list(play_rounds(env, answer_round, task.seeds[0]))
    first, game = rounds[0], cast(Any, env.unwrapped)
    fired = np.array([played.answer.candidates & (not played.info["over_budget"]) for played in rounds])
    return {
        **row_keys(task, first.truth),
        **_episode_metrics(game.problem, first.truth, first.answer, fired, [played.seconds for played in rounds]),
        **(game.score_answer(first.answer.scores) if hasattr(game, "score_answer") else {}),
        "error": "",
    }


def row_keys(task: Task, truth: Any) -> Row:
    """What a row says of its episode, by the names of :data:`KEYS`; ``truth`` is that of round 1."""
    return dict(zip(KEYS, (*task[:3], *task.seeds, int(truth.alive.sum()), int(truth.head.sum())), strict=True))


def _episode_metrics(
    problem: str, truth: Any, answer: Detection, fired: Mask, seconds: Sequence[float]
) -> dict[str, float | int | None]:
    """A value for each name of :data:`METRICS`.

    ``truth`` and ``answer`` are those of round 1; ``fired`` ``(R, N)`` are the candidates of all rounds, none of one
    over the shot budget, and ``seconds`` the times of the answers.
    """
    head, uavs, first = truth.head, int(truth.alive.sum()), fired[0]
    if problem == "P1":
        objective = float(objectives.single_cluster_objective(head, first))
    else:
        objective = objectives.multi_cluster_objective(head, fired, uavs)
    purity = head_in_cluster = None
    if answer.clusters is not None:
        purity = objectives.purity(np.where(truth.decoy, -1, truth.root), answer.clusters)
        head_in_cluster = objectives.head_in_cluster(head, truth.root, answer.clusters)
    return {
        "J": objective,
        "rounds": len(fired),
        "redundancy": objectives.redundancy(head, fired, uavs),
        "success": int(objectives.found_all_heads(head, fired)),
        "exact": int(objectives.exact(head, first)),
        "precision_first": float(objectives.precision(head, first)),
        "recall_first": float(objectives.recall(head, first)),
        "f1_first": float(objectives.f1(head, first)),
        "ap_first": objectives.average_precision(head, answer.scores),
        "seconds_per_round": float(np.mean(seconds)),
        "purity_first": purity,
        "head_in_cluster_first": head_in_cluster,
    }


def record_metrics(record: Any) -> dict[str, float | int | None]:
    """Compute the metrics of an :class:`usnet_env.replay.EpisodeRecord`."""
    truth = SimpleNamespace(head=record.head, decoy=record.decoy, root=record.root[0], alive=record.alive[0])
    answer = Detection(record.candidates[0], record.scores[0], None if record.clusters is None else record.clusters[0])
    return _episode_metrics(record.problem, truth, answer, record.fired, record.seconds)

"""Compute the metrics of an episode."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from usnet_env import objectives
from usnet_env.envs.play import PlayedRound
from usnet_env.evaluation.agents import Answer

#: Every metric of an episode and its meaning. The last two exist only for detectors that return clusters.
METRICS = {
    "J": "the objective: J_m for P2 (lower is better, at best 1), J_s for P1 (higher is better, at best 0)",
    "rounds": "number of detection rounds",
    "redundancy": "number of redundant candidates in all rounds, divided by N",
    "success": "1 if every head was hit within max_rounds, else 0",
    "exact": "1 if the candidates of round 1 are exactly the heads, else 0; for P1 its mean is the detection rate",
    "precision_first": "share of the candidates of round 1 that are heads (0 without a candidate)",
    "recall_first": "share of the heads that are candidates of round 1",
    "f1_first": "harmonic mean of precision_first and recall_first",
    "ap_first": "average precision of the scores of round 1",
    "seconds_per_round": "wall time of one answer in seconds; the warm-up is not counted",
    "purity_first": "purity of the clusters of round 1, without decoys",
    "head_in_cluster_first": "share of the heads that are in the same cluster as most of their followers, round 1",
}
RATES = frozenset({"success", "exact"})
LOWER_IS_BETTER = frozenset({"rounds", "redundancy", "seconds_per_round"})  # J as well, for P2
CLUSTER_METRICS = frozenset({"purity_first", "head_in_cluster_first"})
#: The metric that only environments of recorded tracks have, with known groups.
TRACK_METRICS = {"group_leader_first": "share of the groups whose head has the highest score of its group, round 1"}
OPTIONAL_METRICS = CLUSTER_METRICS | set(TRACK_METRICS)


def episode_metrics(problem: str, rounds: Sequence[PlayedRound[Answer]]) -> dict[str, float | int | None]:
    """Compute all metrics of one episode.

    Args:
        problem: ``"P1"`` or ``"P2"``.
        rounds: the R rounds; no candidate of a round with more candidates than the shot budget counts.

    Returns:
        A value for each name of :data:`METRICS`; the cluster metrics are ``None`` if the detector returns no clusters.
    """
    truth, answer = rounds[0].truth, rounds[0].answer
    fired = np.array([each.answer.candidates & (not each.info["over_budget"]) for each in rounds])
    head, first = truth.head, fired[0]
    if problem == "P1":
        objective = float(objectives.single_cluster_objective(head, first))
    else:
        objective = objectives.multi_cluster_objective(head, fired)
    purity = together = None
    if answer.clusters is not None:
        purity = objectives.purity(np.where(truth.decoy, -1, truth.root), answer.clusters)
        together = objectives.head_in_cluster(head, truth.root, answer.clusters)
    values: dict[str, Any] = {
        "J": objective,
        "rounds": len(fired),
        "redundancy": objectives.redundancy(head, fired),
        "success": int(objectives.found_all_heads(head, fired)),
        "exact": int(objectives.exact(head, first)),
        "precision_first": float(objectives.precision(head, first)),
        "recall_first": float(objectives.recall(head, first)),
        "f1_first": float(objectives.f1(head, first)),
        "ap_first": objectives.average_precision(head, answer.scores),
        "seconds_per_round": float(np.mean([each.answer.seconds for each in rounds])),
        "purity_first": purity,
        "head_in_cluster_first": together,
    }
    return values


def record_metrics(record: Any) -> dict[str, float | int | None]:
    """Compute all metrics of an episode that was recorded.

    Args:
        record: an :class:`usnet_env.replay.EpisodeRecord`, or an object with the same arrays.
    """
    rounds: list[PlayedRound[Answer]] = []
    for number, candidates in enumerate(record.candidates):
        truth: Any = SimpleNamespace(head=record.head, decoy=record.decoy, root=record.root[number])
        clusters = None if record.clusters is None else record.clusters[number]
        answer = Answer(candidates, record.scores[number], clusters, float(record.seconds[number]))
        rounds.append(PlayedRound(None, truth, answer, {"over_budget": record.over_budget[number]}, truth))
    return episode_metrics(record.problem, rounds)

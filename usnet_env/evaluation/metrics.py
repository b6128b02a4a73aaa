"""Compute the metrics of an episode."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env import objectives
from usnet_env.evaluation.agents import Answer
from usnet_env.swarm import SwarmState

__all__ = ["CLUSTER_METRICS", "METRICS", "RATES", "episode_metrics"]

#: Every metric of an episode and its meaning. The last two exist only for detectors that return clusters.
METRICS = {
    "J": "the objective: J_m for P2 (lower is better, at best 1), J_s for P1 (higher is better, at best 0)",
    "rounds": "number of detection rounds",
    "redundancy": "number of redundant candidates in all rounds, divided by N",
    "success": "1 if every head was hit within max_rounds, else 0; for P1 its mean is the detection rate",
    "exact": "1 if the candidates of round 1 are exactly the heads, else 0",
    "precision_first": "share of the candidates of round 1 that are heads (0 without a candidate)",
    "recall_first": "share of the heads that are candidates of round 1",
    "f1_first": "harmonic mean of precision_first and recall_first",
    "ap_first": "average precision of the scores of round 1",
    "seconds_per_round": "wall time of one answer in seconds; the warm-up is not counted",
    "purity_first": "purity of the clusters of round 1, without decoys",
    "head_in_cluster_first": "share of the heads that are in the same cluster as most of their followers, round 1",
}
RATES = frozenset({"success", "exact"})
CLUSTER_METRICS = frozenset({"purity_first", "head_in_cluster_first"})


def episode_metrics(
    problem: str, truth: SwarmState, answers: list[Answer], fired: NDArray[np.bool_]
) -> dict[str, float | int | None]:
    """Compute all metrics of one episode.

    Args:
        problem: ``"P1"`` or ``"P2"``.
        truth: the swarm before round 1.
        answers: the answers of the R rounds.
        fired: ``(R, N)`` bool, the candidates that were fired at: none in a round with more candidates than the shot
            budget.

    Returns:
        A value for each name of :data:`METRICS`; the cluster metrics are ``None`` if the detector returns no clusters.
    """
    head, first, answer = truth.head, fired[0], answers[0]
    if problem == "P1":
        objective = float(objectives.single_cluster_objective(head, first))
    else:
        objective = objectives.multi_cluster_objective(head, fired)
    purity = together = None
    if answer.clusters is not None:
        purity = objectives.purity(np.where(truth.decoy, -1, truth.leader), answer.clusters)
        together = objectives.head_in_cluster(head, truth.leader, answer.clusters)
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
        "seconds_per_round": float(np.mean([each.seconds for each in answers])),
        "purity_first": purity,
        "head_in_cluster_first": together,
    }
    return values

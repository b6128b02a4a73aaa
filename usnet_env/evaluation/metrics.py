"""The metrics of an episode, by the names under which they are reported."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env import objectives
from usnet_env.evaluation.players import Answer
from usnet_env.swarm import SwarmState

__all__ = ["CLUSTER_METRICS", "METRICS", "RATES", "episode_metrics"]

#: Every metric of an episode and what it means; the last two only where a detector gives clusters.
METRICS = {
    "J": "the objective: J_m of P2 (lower is better, at best 1), J_s of P1 (higher is better, at best 0)",
    "rounds": "detection rounds played",
    "redundancy": "redundant candidates of all rounds, divided by N",
    "success": "1 if every head was hit within max_rounds; for P1 the detection rate",
    "exact": "1 if the candidates of round 1 are the heads, no more and no less",
    "precision_first": "share of the candidates of round 1 that are heads (0 without a candidate)",
    "recall_first": "share of the heads that are candidates of round 1",
    "f1_first": "harmonic mean of these two",
    "ap_first": "average precision of the scores of round 1",
    "seconds_per_round": "wall time of one answer, the first warm-up apart",
    "purity_first": "purity of the clusters of round 1, decoys left out",
    "head_in_cluster_first": "share of the heads in the cluster of most of their followers, round 1",
}
RATES = frozenset({"success", "exact"})
CLUSTER_METRICS = frozenset({"purity_first", "head_in_cluster_first"})


def episode_metrics(
    problem: str, truth: SwarmState, answers: list[Answer], fired: NDArray[np.bool_]
) -> dict[str, float | int | None]:
    """All metrics of one episode.

    Args:
        problem: ``"P1"`` or ``"P2"``.
        truth: the swarm as it was in round 1.
        answers: the R answers.
        fired: ``(R, N)`` bool, their candidates; empty in a round over the shot budget, which counts as no answer.

    Returns:
        A value for each name of :data:`METRICS`; the cluster metrics are ``None`` without clusters.
    """
    head, first, opening = truth.head, fired[0], answers[0]
    if problem == "P1":
        objective = float(objectives.single_cluster_objective(head, first))
    else:
        objective = objectives.multi_cluster_objective(head, fired)
    purity = together = None
    if opening.clusters is not None:
        purity = objectives.purity(np.where(truth.decoy, -1, truth.leader), opening.clusters)
        together = objectives.head_in_cluster(head, truth.leader, opening.clusters)
    values: dict[str, Any] = {
        "J": objective,
        "rounds": len(fired),
        "redundancy": objectives.redundancy(head, fired),
        "success": int(objectives.found_all_heads(head, fired)),
        "exact": int(objectives.exact(head, first)),
        "precision_first": float(objectives.precision(head, first)),
        "recall_first": float(objectives.recall(head, first)),
        "f1_first": float(objectives.f1(head, first)),
        "ap_first": objectives.average_precision(head, opening.scores),
        "seconds_per_round": float(np.mean([answer.seconds for answer in answers])),
        "purity_first": purity,
        "head_in_cluster_first": together,
    }
    return values

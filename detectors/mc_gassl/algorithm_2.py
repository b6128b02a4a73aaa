"""Algorithm 2 of the paper, the on-line executions: one detection round, to be read from top to bottom.

The off-line meta-learning, Algorithm 2's first part, is in :mod:`detectors.mc_gassl.training_steps`. Equation numbers
are those of the paper's LaTeX source.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from detectors.clustering import Clustering
from detectors.gassl import Gassl
from detectors.gassl.detector import answer_cluster
from detectors.gassl.ifsn import compute_pair_losses, list_ifsn_shapes, standardise
from detectors.gassl.layers import view_arrays
from detectors.gassl.topology_matrix import Inputs, build_batch
from detectors.mc_gassl.gru import GruParameters, make_inputs
from detectors.mc_gassl.training_steps import train_online
from detectors.mc_gassl.triplet import Metric
from detectors.series.votes import scatter_to_swarm, select_top, shows_evidence
from usnet_env.arrays import Indices, Singles
from usnet_env.detection import Detection
from usnet_env.window import Window


def run_round(
    window: Window,
    parameters: GruParameters,
    clusterer: Any,
    gassl: Gassl,
    online: tuple[int, float],
    rng: np.random.Generator,
) -> tuple[Detection, GruParameters]:
    """Lines 2 to 5 of the on-line executions: the answer of a detector, and W_r for the next round.

    The ``parameters`` are W_{r-1}, in round 1 the meta parameters; ``gassl`` has the settings of Algorithm 1, and
    ``online`` are the gradient steps of equation (39) and their rate.
    """
    clustering = clusterer.cluster(window, rng)  # lines 2, 3
    heads, gamma = detect_heads(window, clustering, gassl, rng)  # line 4
    living = np.flatnonzero(window.alive)  # line 5
    chosen = find_best_heads(build_batch(window, living, gassl.memory), gamma, gassl.ifsn_hidden)  # equation (37)
    score = np.bincount(chosen, minlength=len(chosen)).astype(np.float64)  # c_{i'}, equation (38)
    followed = scatter_to_swarm(score, living, window.uavs)
    labels = scatter_to_swarm(recluster(chosen, clustering.count, rng), living, window.uavs, fill=-1)
    generator = torch.Generator().manual_seed(int(rng.integers(2**63)))
    dataset = make_inputs(window, gassl.memory), torch.from_numpy(labels)
    updated, loss = train_online(parameters, *dataset, Metric(), *online, generator)  # equation (39)
    extras = {"count": clustering.count, "followed": followed, "online_loss": loss, "features": clustering.features}
    return replace(heads, clusters=clustering.labels, extras={**extras, **heads.extras}), updated


def detect_heads(
    window: Window, clustering: Clustering, gassl: Gassl, rng: np.random.Generator
) -> tuple[Detection, Singles]:
    """Line 4: Algorithm 1 in every cluster; one Γ is handed through all UAVs of all clusters (decision (z)).

    Returns:
        The candidates, with c_i of equation (20), leaders and attention within the clusters, and in ``extras`` the
        ``attention_heads`` ``(T_0 + 1, N, N)``, alpha_l within the clusters; and the trained Γ.
    """
    uavs = window.uavs
    candidates, scores = np.zeros(uavs, bool), np.zeros(uavs)
    attn_heads = np.zeros((gassl.memory + 1, uavs, uavs))
    leader, attention = np.full(uavs, -1, np.int64), np.zeros((uavs, uavs))
    gamma = gassl.draw_gamma(rng)
    for label in range(clustering.count):
        members = np.flatnonzero(clustering.labels == label)
        if not shows_evidence(window, members):
            candidates[rng.choice(members)] = True  # no evidence: one of them at random, decision (x)
            continue
        fit = gassl.fit_cluster(window, members, gamma, rng)
        gamma = fit.gamma
        detection: Any = answer_cluster(window, members, fit, gassl, rng)
        candidates |= detection.candidates
        scores += detection.scores
        leader[members] = detection.leader[members]
        attention += detection.attention
        attn_heads += detection.extras["attention_heads"]
    return Detection(candidates, scores, None, leader, attention, {"attention_heads": attn_heads}), gamma


def find_best_heads(inputs: Inputs, gamma: Singles, width: int) -> Indices:
    """i_H of every UAV, ``(n,)``: the other UAV from which the trained IFSN, Γ, predicts it best, equation (37).

    ``width`` are the units of its hidden layers.
    """
    own, source = inputs.own.copy(), inputs.history.copy()
    for values in (*own, *source):
        standardise(values)
    arrays = view_arrays(gamma, list_ifsn_shapes(inputs.entries, width))
    loss = compute_pair_losses(arrays, own, source, inputs.target, inputs.weight)
    np.fill_diagonal(loss, np.inf)
    return np.asarray(np.nan_to_num(loss, nan=np.inf).argmin(axis=1).astype(np.int64))


def recluster(chosen: Indices, count: int, rng: np.random.Generator) -> Indices:
    """Clusters ``(n,)``, or -1, of D_r: the M̂ (``count``) UAVs that most have ``chosen``, i_H, and their voters."""
    heads = select_top(np.bincount(chosen, minlength=len(chosen)), count, rng)
    labels = np.full(len(chosen), -1, np.int64)
    for label, head in enumerate(heads):
        labels[chosen == head] = label
    labels[heads] = np.arange(len(heads))
    return labels

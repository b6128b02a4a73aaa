"""GASSL, the graph attention self-supervised learning of §III, as a detector."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
from detectors.gassl.agat import draw_agat
from detectors.gassl.ifsn import draw_ifsn
from detectors.gassl.topology_matrix import build_batch
from detectors.gassl.training import Fit, train
from detectors.parameters import Count, Lags
from detectors.series import votes
from detectors.series.designs import check_steps
from usnet_env.arrays import Singles
from usnet_env.config import Positive
from usnet_env.detection import Detection, Tags
from usnet_env.window import Window

Width = Annotated[int, Field(ge=1, le=4096)]


class Gassl(Detector):
    """Graph attention self-supervised learning, the paper's Algorithm 1 as it is printed.

    Every UAV attends to all UAVs so that a shared network, the IFSN, can predict its next velocity. The networks are
    trained on the window that they judge, one UAV after another, with all times in every gradient step. The UAV that is
    attended to most by the largest number of other UAVs is the candidate. Made for one cluster (P1).

    Args:
        top_k: K, the number of candidates.
        times: how the times of a window give one c_i (decision (t)): ``"votes"``, the mean of the c_i of equation (20)
            at each time, or ``"mean"``, the c_i of the mean attention.
        steps: Ω, gradient steps for each UAV; with 0, the attention is that of the initial networks.
        learning_rate: β of equations (24) and (25).
        query_hidden, query, key: hidden units and outputs of L; K, rows of K_l.
        similarity_hidden, ifsn_hidden: units of the hidden layers of s_l and of the IFSN.
        gain: scale of the initial values of K_l and s_l, in units of 1 / sqrt(inputs of the layer): how sharp the
            attention is before training.
        memory: T_0.
        implementation: ``"compiled"``, or ``"printed"``: the readable loop of :mod:`detectors.gassl.algorithm_1`,
            much slower, the same to float rounding; it needs PyTorch.
    """

    tags = Tags(most_uavs=10_000, least_steps=5, needs_unit_speed=True)

    top_k: Count = 1
    times: Literal["mean", "votes"] = "votes"
    steps: Annotated[int, Field(ge=0, le=1_000_000)] = 100
    learning_rate: Positive = 3e-3
    query_hidden: Width = 16
    query: Width = 8
    key: Width = 8
    similarity_hidden: tuple[Width, Width] = (16, 8)
    ifsn_hidden: Width = 8
    gain: Positive = 3.0
    memory: Lags = 4
    implementation: Literal["compiled", "printed"] = "compiled"

    def detect(self, window: Window) -> Detection:
        """Train on one window and name the candidates.

        Returns:
            Candidates (``top_k`` of them), scores c_i, ``leader`` (the other UAV that each UAV attends to most),
            attention alpha ``(N, N)``, and in ``extras``: ``choice`` ``(N,)``, i_L^{(i)}, the most frequent one where
            times vote, a UAV's own index where it attends to itself most; ``attention_heads`` ``(T_0 + 1, N, N)``,
            alpha_l; ``explained`` ``(N,)``, the share of the squared velocity that the fit explains on the training
            times; ``loss`` ``(N, Ω)``. With fewer than 3 living UAVs, or where no velocity was seen, nothing can be
            learned: then ``top_k`` living UAVs are named at random and all scores are 0.
        """
        check_steps(window, self.memory)
        members = np.flatnonzero(window.alive)
        if not votes.shows_evidence(window, members):  # decision (x)
            candidates = votes.name_at_random(members, self.top_k, window.uavs, self.rng)
            return Detection(candidates=candidates, scores=np.zeros(window.uavs))
        fit = self.fit_cluster(window, members, None, self.rng)
        return answer_cluster(window, members, fit, self, self.rng)

    def draw_gamma(self, rng: np.random.Generator) -> Singles:
        """An initial Γ, ``(parameters,)``."""
        return draw_ifsn(6 * (self.memory + 1), self.ifsn_hidden, rng)

    def fit_cluster(
        self, window: Window, members: NDArray[np.intp], gamma: Singles | None, rng: np.random.Generator
    ) -> Fit:
        """Lines 1 to 7 of Algorithm 1 for the ``members`` ``(n,)`` of a cluster, at least 3.

        ``gamma`` is the Γ to begin with, such as the one that another cluster left; it is drawn for ``None``.
        """
        inputs, phi = build_batch(window, members, self.memory), draw_agat(self, len(members), rng)
        gamma = self.draw_gamma(rng) if gamma is None else gamma
        if self.implementation == "compiled":
            return train(inputs, phi, gamma, self)
        import torch  # an extra, which the compiled loops don't need

        from detectors.gassl.algorithm_1 import algorithm_1

        return algorithm_1(inputs, torch.from_numpy(phi), torch.from_numpy(gamma), self)


def answer_cluster(
    window: Window, members: NDArray[np.intp], fit: Fit, settings: Gassl, rng: np.random.Generator
) -> Detection:
    """Lines 6 to 8 of Algorithm 1: votes of the n UAVs of a cluster, written out for all N of the window."""
    attention = fit.attention.astype(np.float64)
    other_choice = votes.choose_heads(attention, True, rng)
    choice = votes.choose_heads(attention, False, rng)
    c = votes.count_votes(choice)
    if settings.times == "votes":
        choice = votes.choose_heads(fit.votes, False, rng)
        c = np.where(np.eye(len(members), dtype=bool), 0.0, fit.votes).sum(axis=0) / len(members)
    is_named = np.zeros(len(members), bool)
    is_named[votes.select_top(c, settings.top_k, rng)] = True
    wide = partial(votes.scatter_to_swarm, members=members, uavs=window.uavs)
    extras = {
        "choice": wide(members[choice], fill=-1),
        "attention_heads": wide(fit.attn_heads.swapaxes(0, 1), pairs=True),
        "explained": wide(fit.explained),
        "loss": wide(fit.loss),
    }
    leader = wide(members[other_choice], fill=-1)
    return Detection(wide(is_named), wide(c), leader=leader, attention=wide(attention, pairs=True), extras=extras)

"""Detectors without training: they measure how well one UAV's past velocities predict another UAV's velocity."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
from detectors.parameters import Count, Lags
from detectors.series.designs import centre_past, count_lags, shift_in_time
from detectors.series.regressions import explain_beyond_own_past, explain_pairs, whiten
from detectors.series.votes import Evidence, adjust_shares, cover_voters, rank_uavs
from usnet_env.arrays import Mask
from usnet_env.config import ArgumentError
from usnet_env.detection import Detection, Tags
from usnet_env.series import centre_columns, correlate_over_lags, scale_to_unit
from usnet_env.window import Window

_LEAST_ROWS = 6
_ROWS_PER_FEATURE = 1.5  # measured: down to this ratio, more lags help more than more samples per feature
_ROWS_PER_FEATURE_BEYOND = 2.5  # of a regression that also has the own past


class EvidenceDetector(Detector):
    """Base class of detectors that measure pairwise evidence; it derives votes, heads and clusters from the evidence.

    A subclass declares its further arguments and defines :meth:`evidence`.

    Args:
        clusters: M, the number of heads at the start of the episode. Round 1 names exactly M UAVs, later rounds at most
            M. ``None``: the number is estimated in every round (:func:`detectors.series.votes.cover_voters`).
    """

    tags = Tags(most_uavs=10_000, uses_positions=False, takes_clusters=True)

    clusters: Count | None = None

    @abstractmethod
    def evidence(self, velocity: NDArray[np.floating], seen: Mask) -> Evidence | None:
        """Compute the evidence from ``velocity`` ``(T_ob, n, 3)`` and ``seen`` ``(T_ob, n)``.

        An unseen feature is replaced by its mean, an unseen target is left out. ``None``: there are fewer than 2 UAVs,
        or the window is too short.
        """

    def detect(self, window: Window) -> Detection:
        """Name the heads of one window.

        Each UAV votes for the UAV with the highest evidence in its row; the weight is the difference from its value by
        chance, at least 0, so that of a head is about 0.

        Returns:
            Candidates: in round 1 the UAVs with the M highest scores, if M is known; otherwise the heads of
            :func:`detectors.series.votes.cover_voters`, or the UAV with the highest score if there are none. Scores are
            the sums of the weights of the votes, clusters are numbered in the order of the heads' indices, and
            attention is the evidence, clipped at 0.
        """
        if self.clusters is not None and self.clusters > window.uavs:
            raise ArgumentError(f"clusters must be at most the number of UAVs, {window.uavs}, got {self.clusters}.")
        uavs, living = window.uavs, np.flatnonzero(window.alive)
        evidence = self.evidence(window.velocity[:, living], window.velocity_seen[:, living])
        scores, attention = np.zeros(uavs), np.zeros((uavs, uavs))
        label, leader = np.full((2, uavs), -1, np.int64)
        cover: list[int] = []
        if evidence is not None:
            weight = np.maximum(evidence.pairs.max(axis=1) - evidence.chance, 0.0)
            scores += np.bincount(living[evidence.pairs.argmax(axis=1)], weight, uavs)
            attention[np.ix_(living, living)] = np.maximum(evidence.pairs, 0.0)
            cover = cover_voters(evidence, self.clusters)
        ranking = rank_uavs(scores, window.alive, self.rng)
        heads = living[cover] if cover else ranking[:1]
        if self.clusters is not None and window.round == 1:
            heads = ranking[: self.clusters]
        heads = np.sort(heads)
        if len(heads):
            label[living] = attention[np.ix_(living, heads)].argmax(axis=1)
            label[heads] = np.arange(len(heads))
            leader[living] = heads[label[living]]
        return Detection(np.isin(np.arange(uavs), heads), scores, label, leader, attention)


class LaggedCorrelation(EvidenceDetector):
    """Votes for heads by net lead in lagged velocity correlation, for strategies that copy the head's direction.

    The lagged correlation is C_ij(τ) = mean_t v_i(t + τ) · v_j(t), with centred and normalised velocities (Nagy et al.,
    Nature 464, 2010). The net lead of UAV j over UAV i is max_τ C_ij(τ) - max_τ C_ji(τ) over τ = 1, ..., ``max_lag``.
    Each UAV votes for the UAV with the highest net lead over it. The method suits f1, f2, f3 and f6. In f4 and f5 a
    follower's velocity is an even function of its head's, so the two are uncorrelated.

    Args:
        max_lag: the largest lag in samples, at least 1; smaller in short windows.
    """

    tags = Tags(most_uavs=10_000, uses_positions=False, takes_clusters=True, false_leaders=True)

    max_lag: Lags = 4

    def evidence(self, velocity: NDArray[np.floating], seen: Mask) -> Evidence | None:
        """Compute the net lead ``(n, n)`` of j over i."""
        steps, uavs = velocity.shape[:2]
        max_lag = min(self.max_lag, steps - _LEAST_ROWS)
        if uavs < 2 or max_lag < 1:
            return None
        unit = scale_to_unit(centre_columns(velocity.astype(np.float64), seen))
        pairs, surrogate = (
            correlate_over_lags(voter, unit, max_lag) - correlate_over_lags(unit, voter, max_lag).T
            for voter in (unit, shift_in_time(unit))
        )
        return Evidence(pairs, surrogate, 1.0 / float(np.sqrt(3.0 * steps)))


class LaggedRegression(EvidenceDetector):
    """Votes for heads by ridge regression of each UAV's velocity on another UAV's lagged velocities.

    For every ordered pair (i, j), v_i(t+1) is regressed on v_j(t), ..., v_j(t - lags + 1), their axis-wise squares and
    an intercept. Each UAV votes for the j with the highest adjusted R²; :mod:`detectors.series.votes` defines the
    weight of a vote and the number of heads. Up to the normalisation norm(·), f1 to f6 are linear in these features.
    Short windows have fewer lags and then no squares; with fewer than 7 velocities one UAV is named at random.

    Args:
        lags: the number of past velocities of j among the features, at least 1.
        squares: whether the features include axis-wise squares; f4 and f5 need them.
        ridge: the penalty, in units of the features' mean squared singular value, at least 0.
    """

    tags = Tags(most_uavs=10_000, uses_positions=False, takes_clusters=True, needs_unit_speed=True, false_leaders=True)

    lags: Lags = 4
    squares: bool = True
    ridge: Annotated[float, Field(ge=0)] = 1e-3

    def evidence(self, velocity: NDArray[np.floating], seen: Mask) -> Evidence | None:
        """Compute the adjusted R² ``(n, n)`` of the regression of i's velocity on j's past."""
        steps, uavs = velocity.shape[:2]
        square_lags = count_lags(steps, self.lags, 6, _ROWS_PER_FEATURE) if self.squares else 0
        lags = square_lags or max(1, count_lags(steps, self.lags, 3, _ROWS_PER_FEATURE))
        rows = steps - lags
        if uavs < 2 or rows < _LEAST_ROWS:
            return None
        values = velocity.astype(np.float64)
        target = centre_columns(values[lags:], seen[lags:])
        past = centre_past(np.concatenate([values, values**2], axis=2) if square_lags else values, seen, lags)
        shares, freedom = explain_pairs(past, (target, shift_in_time(target)), self.ridge)
        return adjust_shares(shares, rows, freedom)


class Granger(EvidenceDetector):
    """Votes for heads by pairwise Granger causality.

    For every ordered pair (i, j), v_i(t+1) is regressed on i's own last velocities, and then on these and j's last
    velocities. The evidence is the share of the first residual's variance that the second regression explains, adjusted
    for the number of parameters. Votes and heads follow from it by :mod:`detectors.series.votes`.

    Args:
        lags: the number of past velocities of j, at least 1; fewer in short windows.
        own_lags: the number of past velocities of i, at least 0.
    """

    tags = Tags(most_uavs=10_000, uses_positions=False, takes_clusters=True, false_leaders=True)

    lags: Lags = 3
    own_lags: Annotated[int, Field(ge=0, le=1000)] = 2

    def evidence(self, velocity: NDArray[np.floating], seen: Mask) -> Evidence | None:
        """Compute the adjusted share ``(n, n)`` of i's residual on its own past that j's past explains."""
        steps, uavs = velocity.shape[:2]
        lags = max(1, count_lags(steps, self.lags, 3, _ROWS_PER_FEATURE_BEYOND))
        own_lags = min(self.own_lags, lags)
        rows = steps - lags
        if uavs < 2 or rows < _LEAST_ROWS:
            return None
        values = velocity.astype(np.float64)
        target = centre_columns(values[lags:], seen[lags:]).transpose(1, 0, 2)
        past = centre_past(values, seen, lags)
        other_past, _ = whiten(past)
        own_past = whiten(past[:, :, : 3 * own_lags])[0] if own_lags else past[:, :, :0]
        shares = [
            explain_beyond_own_past(target, own_past, other_past),
            explain_beyond_own_past(shift_in_time(target, axis=1), shift_in_time(own_past, axis=1), other_past),
        ]
        return adjust_shares(np.array(shares), rows, np.full(uavs, 3.0 * lags), 3.0 * own_lags)


class OnePerRound(Detector):
    """Names the UAV with the highest score of lagged regression in each round, without clustering.

    With a perfect ranking an episode takes M rounds and has no redundant candidate, so J_m = M.
    """

    tags = Tags(most_uavs=10_000, uses_positions=False, needs_unit_speed=True)

    def detect(self, window: Window) -> Detection:
        """Name the UAV with the highest score of :class:`LaggedRegression`; scores and attention are from there."""
        detection = LaggedRegression().detect(window)
        candidates = np.isin(np.arange(window.uavs), rank_uavs(detection.scores, window.alive, self.rng)[:1])
        return Detection(candidates=candidates, scores=detection.scores, attention=detection.attention)

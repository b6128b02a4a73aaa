"""Derives heads from pairwise evidence: votes, the number of heads, and the head of each follower.

Each lagged detector computes an evidence matrix: entry (i, j) measures how well UAV j's past predicts UAV i's velocity.
It computes the same matrix for a *time-shift surrogate*, in which UAV i is shifted in time by half a window against all
other UAVs. The surrogate keeps the statistics of each UAV, such as its autocorrelation, but no UAV follows another one
in it. Its row maxima estimate, without a model of the motion, how high the best of N entries rises by chance.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
from detectors.series.pairs import check_pairs
from usnet_env.config import ArgumentError, Config
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = [
    "Evidence",
    "LaggedArguments",
    "LaggedDetector",
    "centre_columns",
    "compute_votes",
    "cover_voters",
    "detection_from_evidence",
    "rank_uavs",
]

Floats = NDArray[np.float64]

SIGNIFICANT_SPREADS = 3.0  # robust standard deviations between the surrogate's median row maximum and the threshold
LEAST_VOTERS = 1.5  # voters that a head must add: m_j >= 2 followers, of which a noisy one may count for half
_MAD_TO_SPREAD = 1.4826  # median absolute deviation to standard deviation, for a normal variable


def centre_columns(values: Floats, seen: NDArray[np.bool_]) -> Floats:
    """Subtract the mean over the ``seen`` rows ``(n, N)`` from ``values`` ``(n, N, d)``; unseen rows become 0."""
    weight = seen[..., None].astype(np.float64)
    mean = (values * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), 1.0)
    moved: Floats = (values - mean) * weight
    return moved


@dataclass(frozen=True, eq=False)
class Evidence:
    """Pairwise evidence among the n living UAVs.

    Args:
        pairs: ``(n, n)``; entry (i, j) is the evidence that i follows j, about 0 or below if it doesn't. The
            diagonal is -inf.
        surrogate: ``(n, n)``, the same with the voters (rows) shifted in time.
        spread: lower bound of the standard deviation of an entry by chance; the surrogate of very few UAVs would
            underestimate it.
    """

    pairs: Floats
    surrogate: Floats
    spread: float

    @property
    def chance(self) -> float:
        """Expected row maximum of a UAV that follows no UAV: the median of the surrogate's row maxima."""
        return float(np.median(self.surrogate.max(axis=1)))

    @property
    def threshold(self) -> float:
        """A voter is significant if its row maximum is above this value."""
        best = self.surrogate.max(axis=1)
        spread = _MAD_TO_SPREAD * float(np.median(np.abs(best - self.chance)))
        return self.chance + SIGNIFICANT_SPREADS * max(spread, self.spread)


def compute_votes(evidence: Evidence) -> tuple[NDArray[np.int64], Floats]:
    """Compute the vote of each UAV and its weight.

    A UAV votes for the UAV with the highest evidence in its row. The weight is the difference between this evidence and
    its value by chance, at least 0. So the vote of a head, which follows no UAV, has nearly no weight.

    Returns:
        ``(n,)`` int64 votes and ``(n,)`` float64 weights.
    """
    vote = evidence.pairs.argmax(axis=1)
    best = evidence.pairs.max(axis=1)
    return vote.astype(np.int64), np.maximum(best - evidence.chance, 0.0)


def cover_voters(evidence: Evidence, most: int | None = None) -> list[int]:
    """Choose heads for unknown M by a greedy cover of the significant voters.

    Let e_ij be the evidence above the threshold. Head j explains the share e_ij / max_k e_ik of a significant voter i;
    several heads explain the largest of their shares. The algorithm repeatedly adds the head that raises the sum of
    these shares the most, as long as it raises it by at least ``LEAST_VOTERS``. A follower that votes for another
    follower of the same head doesn't add a head, since the true head explains it nearly as well.

    Args:
        evidence: the evidence among the n living UAVs.
        most: the largest number of heads; ``None``: no limit.

    Returns:
        Indices of the heads in the order of choice; empty if no UAV follows another one.
    """
    threshold = evidence.threshold
    above = np.maximum(evidence.pairs - threshold, 0.0)
    best = above.max(axis=1)
    voters = np.flatnonzero(best > 0)
    share = above[voters] / best[voters, None]
    explained = np.zeros(len(voters))
    heads: list[int] = []
    while len(heads) < (len(evidence.pairs) if most is None else most):
        added = np.maximum(share - explained[:, None], 0.0).sum(axis=0)
        head = int(added.argmax())
        if added[head] < LEAST_VOTERS:
            break
        heads.append(head)
        explained = np.maximum(explained, share[:, head])
    return heads


def rank_uavs(scores: Floats, alive: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.int64]:
    """Sort the indices of the living UAVs by decreasing score; ``rng`` breaks ties."""
    living = np.flatnonzero(alive)
    order: NDArray[np.int64] = living[np.lexsort((rng.random(len(living)), -scores[living]))]
    return order


def detection_from_evidence(
    evidence: Evidence | None,
    alive: NDArray[np.bool_],
    clusters: int | None,
    first_round: bool,
    rng: np.random.Generator,
) -> Detection:
    """Derive a detection from pairwise evidence.

    Args:
        evidence: the evidence among the living UAVs in index order; ``None``: the window is too short.
        alive: ``(N,)`` bool.
        clusters: M, the number of heads at the start of the episode, or ``None`` if it is unknown.
        first_round: whether this is round 1, in which all M heads are alive.
        rng: breaks ties, so that low indices have no advantage.

    Returns:
        Candidates: in the first round the UAVs with the ``clusters`` highest scores; otherwise the heads of
        :func:`cover_voters` (at most ``clusters``), or the UAV with the highest score if there are none. There is at
        least one candidate if a UAV is alive. A score is the sum of the weights of a UAV's votes; clusters are numbered
        in the order of the heads' indices; attention is the evidence, clipped at 0.
    """
    uavs = len(alive)
    living = np.flatnonzero(alive)
    scores = np.zeros(uavs)
    attention = np.zeros((uavs, uavs))
    vote = np.full(uavs, -1, np.int64)
    weight = np.zeros(uavs)
    found: list[int] = []
    if evidence is not None:
        chosen, weight[living] = compute_votes(evidence)
        vote[living] = living[chosen]
        np.add.at(scores, vote[living], weight[living])
        attention[np.ix_(living, living)] = np.maximum(evidence.pairs, 0.0)
        found = cover_voters(evidence, clusters)

    order = rank_uavs(scores, alive, rng)
    heads = living[found] if found else order[:1]
    if clusters is not None and first_round:
        heads = order[:clusters]
    heads = np.sort(heads)
    candidates = np.zeros(uavs, bool)
    candidates[heads] = True

    label = np.full(uavs, -1, np.int64)
    leader = np.full(uavs, -1, np.int64)
    if len(heads):
        label[living] = attention[np.ix_(living, heads)].argmax(axis=1)
        label[heads] = np.arange(len(heads))
        leader[living] = heads[label[living]]
    return Detection(
        candidates=candidates,
        scores=scores,
        clusters=label,
        leader=leader,
        attention=attention,
        extras={
            "vote": vote,
            "weight": weight,
            "threshold": np.inf if evidence is None else evidence.threshold,
            "heads_found": len(found),
        },
    )


class LaggedArguments(Config):
    """The checked arguments that all lagged detectors share."""

    clusters: Annotated[int, Field(ge=1, le=100_000)] | None


class LaggedDetector(Detector):
    """Base class of detectors that measure pairwise evidence; it derives votes, heads and clusters from the evidence.

    A subclass stores its arguments, including ``clusters``, and defines :meth:`check_arguments` and :meth:`evidence`.
    """

    clusters: int | None

    @abstractmethod
    def check_arguments(self) -> Any:
        """Return the arguments as a :class:`LaggedArguments`; raises ``ArgumentError``."""

    @abstractmethod
    def evidence(self, velocity: NDArray[np.floating], seen: NDArray[np.bool_]) -> Evidence | None:
        """Compute the evidence from ``velocity`` ``(T_ob, n, 3)`` and ``seen`` ``(T_ob, n)``; ``None``: no evidence."""

    def reset(self, seed: int | None = None) -> None:
        """Start an episode; the generator only breaks ties.

        Raises:
            ArgumentError: an argument of the constructor is refused.
        """
        self.check_arguments()
        super().reset(seed)

    def detect(self, window: Window) -> Detection:
        """Name the heads of one window.

        Returns:
            Candidates (at least one if a UAV is alive), scores (sums of weighted votes), clusters, leader, attention
            (the evidence, clipped at 0) and in ``extras``: ``vote`` and ``weight`` ``(N,)``, the vote of each UAV and
            its weight; ``threshold``, above which a vote is significant; ``heads_found``, the number of heads that the
            rule for unknown M found (0: no UAV seems to follow another one).

        Raises:
            ArgumentError: an argument of the constructor is refused, ``clusters`` exceeds the window's N, or N is above
                10,000.
        """
        self.check_arguments()
        check_pairs(window.uavs)
        if self.clusters is not None and self.clusters > window.uavs:
            raise ArgumentError(
                f"clusters must be at most the number of UAVs in the window ({window.uavs}), got {self.clusters}."
            )
        living = np.flatnonzero(window.alive)
        evidence = self.evidence(window.velocity[:, living], window.velocity_seen[:, living])
        rng = getattr(self, "rng", None) or np.random.default_rng()
        return detection_from_evidence(evidence, window.alive, self.clusters, window.round == 1, rng)

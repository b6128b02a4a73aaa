"""From pairwise evidence to heads: votes, the number of heads, and who follows whom.

Every lagged detector measures an evidence matrix, entry (i, j): how well UAV j's past tells UAV i's present, and the
same matrix for a *time-shift surrogate* in which UAV i is moved by half a window against all others. The surrogate
keeps each UAV's own statistics (its autocorrelation above all) and destroys every following; it says how high the best
of N columns rises by chance, with no model of flight.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
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

SIGNIFICANT_SPREADS = 3.0  # a voter is significant this many robust spreads above the surrogate's median best
LEAST_VOTERS = 1.5  # voters that a head must add: m_j >= 2, less what a noisy second follower may fall short of
_MAD_TO_SPREAD = 1.4826  # median absolute deviation to standard deviation, for a normal variable


def centre_columns(values: Floats, seen: NDArray[np.bool_]) -> Floats:
    """``values`` ``(n, N, d)`` less each column's mean over the ``seen`` rows ``(n, N)``; unseen rows are 0."""
    weight = seen[..., None].astype(np.float64)
    mean = (values * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), 1.0)
    moved: Floats = (values - mean) * weight
    return moved


@dataclass(frozen=True, eq=False)
class Evidence:
    """Pairwise evidence among the n living UAVs.

    Args:
        pairs: ``(n, n)``, entry (i, j): evidence that i follows j; about 0 or below where it doesn't. The diagonal
            is -inf.
        surrogate: ``(n, n)``, the same for the time-shifted voters.
        spread: the smallest standard deviation that a chance entry can be trusted to have, so that a surrogate of
            very few UAVs is not taken as exact.
    """

    pairs: Floats
    surrogate: Floats
    spread: float

    @property
    def chance(self) -> float:
        """The best evidence that a UAV that follows nobody has: the median over the surrogate's rows."""
        return float(np.median(self.surrogate.max(axis=1)))

    @property
    def threshold(self) -> float:
        """Evidence above this makes a voter significant."""
        best = self.surrogate.max(axis=1)
        spread = _MAD_TO_SPREAD * float(np.median(np.abs(best - self.chance)))
        return self.chance + SIGNIFICANT_SPREADS * max(spread, self.spread)


def compute_votes(evidence: Evidence) -> tuple[NDArray[np.int64], Floats]:
    """Whom every UAV votes for, and with which weight.

    A UAV votes for the one with the best evidence; its weight is what that exceeds the best that chance gives, at
    least 0. So a head's own stray vote, the best of n chance entries, counts for next to nothing.

    Returns:
        ``(n,)`` int64 votes and ``(n,)`` float64 weights.
    """
    vote = evidence.pairs.argmax(axis=1)
    best = evidence.pairs.max(axis=1)
    return vote.astype(np.int64), np.maximum(best - evidence.chance, 0.0)


def cover_voters(evidence: Evidence, most: int | None = None) -> list[int]:
    """Heads and their number where M is unknown: a greedy cover of the significant voters.

    A significant voter is explained by head j to the share of its best evidence, counted from the threshold, that j
    gives it. The head that adds the most explained voters is named, again and again, as long as it adds at least
    ``LEAST_VOTERS``. So a follower that happens to vote for a fellow follower doesn't make a head of it, since its
    true head explains it nearly as well.

    Args:
        evidence: of the n living UAVs.
        most: the highest number of heads to name; ``None``: no limit.

    Returns:
        Indices of the heads, the best first; empty where nobody follows anybody.
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
    """Indices of the living UAVs, the highest score first; ties in an order that ``rng`` draws."""
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
    """The detection that follows from pairwise evidence.

    Args:
        evidence: among the living UAVs in index order; ``None``: the window is too short for any.
        alive: ``(N,)`` bool.
        clusters: M, the number of heads at the start of the episode, or ``None`` where it is unknown.
        first_round: whether all M heads must still be there.
        rng: breaks ties, so that they don't favour low indices.

    Returns:
        Candidates: the ``clusters`` best scores in the first round; otherwise the heads of :func:`cover_voters` (at
        most ``clusters``), or the best score alone where that names nobody. At least one, if anybody lives. Scores are
        the summed weights of the votes; the clusters are numbered in the order of the heads' indices; attention is the
        evidence, at least 0.
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
    """The arguments that all lagged detectors have, checked."""

    clusters: Annotated[int, Field(ge=1)] | None


class LaggedDetector(Detector):
    """A detector that is a measure of pairwise evidence; votes, heads and clusters follow from it here.

    A subclass stores its arguments, ``clusters`` among them, and defines :meth:`check_arguments` and
    :meth:`evidence`.
    """

    clusters: int | None

    @abstractmethod
    def check_arguments(self) -> Any:
        """The arguments as a :class:`LaggedArguments`, or ``ArgumentError``."""

    @abstractmethod
    def evidence(self, velocity: NDArray[np.floating], seen: NDArray[np.bool_]) -> Evidence | None:
        """Evidence among n UAVs from ``velocity`` ``(T_ob, n, 3)`` and ``seen`` ``(T_ob, n)``; ``None``: none."""

    def reset(self, seed: int | None = None) -> None:
        """Start an episode; the generator serves to break ties only.

        Raises:
            ArgumentError: an argument of the constructor is refused.
        """
        self.check_arguments()
        super().reset(seed)

    def detect(self, window: Window) -> Detection:
        """Name the heads of one window.

        Returns:
            Candidates (at least one, if anybody lives), scores (summed votes), clusters, leader, attention (the
            evidence, at least 0) and in ``extras``: ``vote`` and ``weight`` ``(N,)`` of every UAV, ``threshold``, the
            evidence above which a vote is significant, and ``heads_found``, how many heads the rule for an unknown
            number found (0: nobody seems to follow anybody).

        Raises:
            ArgumentError: an argument of the constructor is refused, or ``clusters`` exceeds the window's N.
        """
        self.check_arguments()
        if self.clusters is not None and self.clusters > window.uavs:
            raise ArgumentError(
                f"clusters must be at most the number of UAVs in the window ({window.uavs}), got {self.clusters}."
            )
        living = np.flatnonzero(window.alive)
        evidence = self.evidence(window.velocity[:, living], window.velocity_seen[:, living])
        rng = getattr(self, "rng", None) or np.random.default_rng()
        return detection_from_evidence(evidence, window.alive, self.clusters, window.round == 1, rng)

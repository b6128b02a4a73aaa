"""From evidence or attention to heads: votes, the number of heads, and the head of each follower.

Evidence says how well UAV j's past predicts UAV i's velocity. It is computed a second time for a surrogate, in which
UAV i is shifted in time by half a window against all other UAVs (:func:`detectors.series.designs.shift_in_time`). The
surrogate's row maxima estimate, without a model of the motion, how high the best of N entries rises by chance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detectors.series.designs import compute_chance
from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.series import find_middle
from usnet_env.window import Window

LEAST_UAVS = 3  # among which a head can be found: it and two followers
LEAST_VOTERS = 1.5  # voters that a head must add: m_j >= 2 followers, of which a noisy one may count for half
_SIGNIFICANT_SPREADS = 3.0  # robust standard deviations between the surrogate's median row maximum and the threshold


@dataclass(frozen=True, eq=False)
class Evidence:
    """Pairwise evidence among the n living UAVs.

    Entry (i, j) of ``pairs`` ``(n, n)`` is the evidence that i follows j, about 0 or below if not; -inf for i = j.
    ``surrogate`` ``(n, n)`` is the same with the voters (rows) shifted in time, and ``spread`` a lower bound of the
    standard deviation of an entry by chance, for very few UAVs.
    """

    pairs: Floats
    surrogate: Floats
    spread: float

    def __post_init__(self) -> None:
        np.fill_diagonal(self.pairs, -np.inf)
        np.fill_diagonal(self.surrogate, -np.inf)

    @property
    def chance(self) -> float:
        """Expected row maximum of a UAV that follows no UAV."""
        return compute_chance(self.surrogate)

    @property
    def threshold(self) -> float:
        """A voter is significant if its row maximum is above this value."""
        chance, spread = find_middle(self.surrogate.max(axis=1))
        return chance + _SIGNIFICANT_SPREADS * max(spread, self.spread)


def adjust_shares(shares: Floats, rows: int, freedom: Floats, own: float = 0.0) -> Evidence:
    """Adjust the shares ``(2, n, n)``, of the pairs and of their surrogate, for the number of parameters.

    ``freedom`` ``(n,)`` are the degrees of freedom of j's features, ``own`` those of i's own past.
    """
    pairs, surrogate = 1.0 - (1.0 - shares) * (rows - 1) / np.maximum(rows - 1 - freedom - own, 1.0)
    # The standard deviation of R² over three axes for independent samples of which nothing is explained.
    return Evidence(pairs, surrogate, float(np.sqrt(2.0 * max(freedom.mean(), 1.0) / 3.0) / rows))


def choose_heads(attention: NDArray[np.floating[Any]], exclude_self: bool, rng: np.random.Generator) -> Indices:
    """Choose the UAV that each UAV attends to most, ``(n,)``: i_L^{(i)} of equation (19).

    ``attention`` ``(n, n)`` is alpha_{i,i'}; with ``exclude_self``, no UAV chooses itself; ``rng`` breaks ties.
    """
    weight = attention.copy()
    if exclude_self:
        np.fill_diagonal(weight, -np.inf)
    ties = weight == weight.max(axis=1, keepdims=True)
    return np.where(ties, rng.random(weight.shape), -1.0).argmax(axis=1).astype(np.int64)


def count_votes(chosen: Indices) -> Floats:
    """Count the votes c_i = (1/n) sum_{i' != i} 1{i_L^{(i')} = i} of every UAV, ``(n,)``: equation (20).

    ``chosen`` ``(n,)`` is from :func:`choose_heads`. A UAV that chose itself counts for no UAV.
    """
    uavs = len(chosen)
    other_choices = chosen[chosen != np.arange(uavs)]
    return np.asarray(np.bincount(other_choices, minlength=uavs) / uavs)


def select_top(scores: NDArray[Any], count: int | None, rng: np.random.Generator) -> NDArray[np.intp]:
    """Indices of the ``count`` highest scores (all for ``None``), ties broken at random: equations (21), (22)."""
    return np.lexsort((rng.random(len(scores)), -scores))[:count]


def rank_uavs(scores: Floats, alive: Mask, rng: np.random.Generator) -> NDArray[np.intp]:
    """Sort the indices of the living UAVs by decreasing score ``(N,)``; ``rng`` breaks ties."""
    living = np.flatnonzero(alive)
    return living[select_top(scores[living], None, rng)]


def shows_evidence(window: Window, members: NDArray[np.intp]) -> bool:
    """Whether a head can be found among the ``members`` ``(n,)``: at least 3 UAVs, with any velocity seen."""
    return len(members) >= LEAST_UAVS and bool(window.velocity_seen[:, members].any())


def name_at_random(members: NDArray[np.intp], count: int, uavs: int, rng: np.random.Generator) -> Mask:
    """Candidates ``(N,)``: ``count`` of the members, for a window that shows no evidence (decision (x))."""
    return np.isin(np.arange(uavs), rng.permutation(members)[:count])


def scatter_to_swarm(
    values: NDArray[Any], members: NDArray[np.intp], uavs: int, fill: float = 0, pairs: bool = False
) -> NDArray[Any]:
    """What holds for n members of a swarm, for all of its N UAVs, with ``fill`` for the others; floats become float64.

    ``values`` are ``(n, ...)``, or ``(..., n, n)`` for ``pairs``; ``members`` ``(n,)`` are indices.
    """
    shape = (*values.shape[:-2], uavs, uavs) if pairs else (uavs, *values.shape[1:])
    wide = np.full(shape, fill, np.float64 if values.dtype.kind == "f" else values.dtype)
    wide[(..., members[:, None], members) if pairs else members] = values
    return wide


def cover_voters(evidence: Evidence, most: int | None = None) -> list[int]:
    """Choose heads for unknown M by a greedy cover of the significant voters.

    Let e_ij be the evidence above the threshold. Head j explains the share e_ij / max_k e_ik of a significant voter i;
    several heads explain the largest of their shares. The head that raises the sum of these shares the most is added as
    long as it raises it by at least ``LEAST_VOTERS``. The result has at most ``most`` indices, in the order of choice.
    """
    threshold = evidence.threshold
    excess = np.maximum(evidence.pairs - threshold, 0.0)
    best = excess.max(axis=1)
    voters = np.flatnonzero(best > 0)
    share = excess[voters] / best[voters, None]
    explained = np.zeros(len(voters))
    heads: list[int] = []
    while len(heads) < (len(evidence.pairs) if most is None else most):
        gain = np.maximum(share - explained[:, None], 0.0).sum(axis=0)
        head = int(gain.argmax())
        if gain[head] < LEAST_VOTERS:
            break
        heads.append(head)
        explained = np.maximum(explained, share[:, head])
    return heads


def find_trees(lead: Floats, strength: Floats, threshold: float) -> tuple[Indices, Indices]:
    """Give each follower its direct leader so that no cycle closes.

    The ``lead`` ``(n, n)``, how much better j predicts i than i predicts j, counts above the ``threshold``. Of those
    that lead i, the one that i follows most closely, by ``strength`` ``(n, n)``, is its direct leader.

    Returns:
        ``(n,)`` direct leader, -1 for none, and ``(n,)`` root of the tree, the own index of a UAV that follows none.
    """
    follows = lead > threshold
    leader, root = np.full(len(lead), -1), np.arange(len(lead))
    best_lead = np.where(follows, lead, -np.inf).max(axis=1, initial=-np.inf)
    for i in np.argsort(-best_lead, kind="stable")[: int((best_lead > -np.inf).sum())]:
        leaders = np.flatnonzero(follows[i] & (root != i))
        if len(leaders):
            leader[i] = leaders[strength[i, leaders].argmax()]
            root[root == i] = root[leader[i]]
    return leader, root

"""From head probabilities to candidates: the set that costs least under the objective that is played."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from usnet_env.config import Config

__all__ = ["Policy", "choose"]

Floats = NDArray[np.float64]


_GUESS = 0.2  # nobody is more likely a head than this: rounds of guessing lie ahead


class Policy(Config):
    """What is played and how candidates follow from probabilities.

    Args:
        policy: ``"cost"`` names the set that costs least and so at least one UAV, as a game only goes on while a head
            is left; ``"map"`` names those who are more likely heads than not, and may name nobody.
        objective: ``"P2"`` (all heads, few rounds) or ``"P1"`` (the one head, one round).
        shot_budget: the most candidates of a round; ``None``: no limit.
        redundancy_price: of a redundant candidate, in the objective's own unit (1/N of a round in P2).
        round_price: what one more round is expected to cost: V of P2. ``None``: 1 where the swarm is explained, and
            N / 4, the rounds of guessing, where nobody seems to follow anybody.
    """

    policy: Literal["cost", "map"] = "cost"
    objective: Literal["P1", "P2"] = "P2"
    shot_budget: Annotated[int, Field(ge=1)] | None = None
    redundancy_price: Annotated[float, Field(ge=0)] = 1.0
    round_price: Annotated[float, Field(gt=0)] | None = None


def choose(
    probability: Floats, alive: NDArray[np.bool_], policy: Policy, tie: Floats, doubt: float = 0.0
) -> NDArray[np.bool_]:
    """The candidates.

    P2: every further round costs ``round_price`` and every redundant candidate ``redundancy_price`` / N. A head that
    is not named costs a round, unless another one that is missed costs it anyway: with the most probable named first,
    naming k costs (1 - prod of (1 - p) over the rest) rounds and the sum of (1 - p) over the named. The k with the
    least expected cost is exact where heads are independent. Mistakes are not: an explanation that is wrong misses
    many heads at once. So with probability ``doubt`` it counts as wrong, and every UAV as likely a head as any other.

    P1: one head; naming k > 1 costs ``redundancy_price`` (k - 1) for certain, and finds it with their summed p.

    Args:
        probability: ``(N,)`` of being a head, if the explanation is right.
        alive: ``(N,)`` bool.
        policy: what is played.
        tie: ``(N,)`` random numbers that order equal probabilities.
        doubt: probability that the explanation is wrong, from 0 to 1.

    Returns:
        ``(N,)`` bool, living UAVs only.
    """
    named = np.zeros(len(alive), bool)
    living = np.flatnonzero(alive)
    if not len(living):
        return named
    order = living[np.lexsort((tie[living], -probability[living]))]
    sure = np.clip(probability[order], 0.0, 1.0)
    anybody = np.full(len(order), sure.mean())
    p = (1.0 - doubt) * sure + doubt * anybody
    budget = len(order) if policy.shot_budget is None else min(policy.shot_budget, len(order))
    if policy.policy == "map":
        count = int((p > 0.5).sum())
        if policy.objective == "P1":
            count = min(count, 1)
        named[order[: min(count, budget)]] = True
        return named
    sizes = np.arange(1, budget + 1)
    if policy.objective == "P1":
        total = max(float(p.sum()), 1e-12)
        cost = policy.redundancy_price * (sizes - 1) - np.cumsum(p / total)[:budget]
    else:
        nobody_left = ((1.0 - doubt) * _no_head_after(sure) + doubt * _no_head_after(anybody))[:budget]
        redundant = np.cumsum(1.0 - p)[:budget]
        guessing = bool(p[0] < _GUESS)
        price = policy.round_price if policy.round_price is not None else (len(alive) / 4.0 if guessing else 1.0)
        cost = price * (1.0 - nobody_left) + policy.redundancy_price * redundant / len(alive)
    named[order[: int(cost.argmin()) + 1]] = True
    return named


def _no_head_after(p: Floats) -> Floats:
    """``(n,)`` the chance that none of those behind each place is a head."""
    return np.append(np.cumprod((1.0 - p)[::-1])[::-1][1:], 1.0)

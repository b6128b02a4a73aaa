"""Chooses candidates from the probabilities of being a head, for one of the objectives P1 and P2."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from usnet_env.arrays import Floats, Mask
from usnet_env.config import Config

_GUESS = 0.2  # if no probability reaches this value, heads can only be guessed


class Policy(Config):
    """The objective, and the rule that chooses candidates.

    Args:
        policy: ``"cost"`` names the set with the least expected cost, and at least one UAV, since an episode only
            continues while a head is alive (none, where :func:`choose` is told that nobody leads); ``"map"`` names the
            UAVs with a probability above 1/2, possibly none.
        objective: ``"P2"`` (all heads, few rounds) or ``"P1"`` (one head, one round).
        shot_budget: the largest number of candidates per round; ``None``: no limit.
        redundancy_price: the cost of a redundant candidate, in units of the objective (1/N of a round in P2).
        round_price: the expected cost of one more round in P2. ``None``: 1 if a UAV is a probable head, and N / 4, the
            number of rounds that guessing takes, if no UAV seems to follow another one.
    """

    policy: Literal["cost", "map"] = "cost"
    objective: Literal["P1", "P2"] = "P2"
    shot_budget: Annotated[int, Field(ge=1, le=100_000)] | None = None
    redundancy_price: Annotated[float, Field(ge=0)] = 1.0
    round_price: Annotated[float, Field(gt=0)] | None = None


def choose(probability: Floats, alive: Mask, policy: Policy, tie: Floats, silent: float | None = None) -> Mask:
    """Choose the candidates.

    P2: another round costs ``round_price`` and a redundant candidate ``redundancy_price`` / N. Another round is needed
    if at least one head is missed. So naming the k most probable UAVs has the expected cost (1 - prod of (1 - p) over
    the other UAVs) rounds plus the sum of (1 - p) over the named ones, and the best k is exact if the events are
    independent.

    P1: there is one head; naming k > 1 UAVs costs ``redundancy_price`` (k - 1) and hits it with the sum of their p.

    With probability ``silent`` no UAV leads, so that another round costs nothing and each named UAV is redundant. Else
    the heads are independent with p / (1 - ``silent``), and naming nobody misses them. So the best set may be empty;
    if ``silent`` is ``None``, at least one UAV is named.

    The result are living UAVs, ``(N,)``. The numbers ``tie`` ``(N,)`` order UAVs with equal
    ``probability`` ``(N,)``.
    """
    named = np.zeros(len(alive), bool)
    living = np.flatnonzero(alive)
    if not len(living):
        return named
    order = living[np.lexsort((tie[living], -probability[living]))]
    p = np.clip(probability[order], 0.0, 1.0)
    budget = min(len(order), policy.shot_budget or len(order))
    if policy.policy == "map":
        count = min(int((p > 0.5).sum()), 1 if policy.objective == "P1" else budget, budget)
        named[order[:count]] = True
        return named
    led = 1.0 if silent is None else 1.0 - min(max(silent, 0.0), 1.0 - 1e-9)
    p = np.minimum(p / led, 1.0)
    sizes = np.arange(1, budget + 1)
    if policy.objective == "P1":
        total = max(float(p.sum()), 1e-12)
        cost = policy.redundancy_price * (sizes - 1) - led * np.cumsum(p / total)[:budget]
        nobody = led - 1.0
    else:
        none_left = _no_head_after(p)[:budget]
        redundant = np.cumsum(1.0 - led * p)[:budget]
        guessing = bool(led * p[0] < _GUESS)
        price = policy.round_price if policy.round_price is not None else (len(alive) / 4.0 if guessing else 1.0)
        cost = led * price * (1.0 - none_left) + policy.redundancy_price * redundant / len(alive)
        nobody = led * price
    if silent is None or cost.min() < nobody:
        named[order[: int(cost.argmin()) + 1]] = True
    return named


def _no_head_after(p: Floats) -> Floats:
    """``(n,)``: the probability that no UAV after each place in the order is a head."""
    return np.append(np.cumprod((1.0 - p)[::-1])[::-1][1:], 1.0)

"""Chooses candidates from the probabilities of being a head, for one of the objectives P1 and P2."""

from __future__ import annotations

from typing import Literal

import numpy as np

from usnet_env.arrays import Floats, Mask


def choose_candidates(
    probability: Floats,
    alive: Mask,
    tie: Floats,
    p_no_leader: float,
    *,
    policy: Literal["cost", "map"] = "cost",
    objective: Literal["P1", "P2"] = "P2",
    round_price: float = 1.0,
) -> Mask:
    """Choose the candidates, living UAVs ``(N,)``: the set with the least expected cost, or by ``"map"`` all above 1/2.

    P2: another round costs ``round_price`` and a redundant candidate 1 / N. Another round is needed if at least one
    head is missed. So naming the k most probable UAVs has the expected cost (1 - prod of (1 - p) over the other UAVs)
    rounds plus the sum of (1 - p) over the named ones, and the best k is exact if the events are independent.

    P1: there is one head; naming k > 1 UAVs costs k - 1 and hits it with the sum of their p.

    With ``p_no_leader`` no UAV leads, so that another round costs nothing and each named UAV is redundant. Else the
    heads are independent with p / (1 - ``p_no_leader``), and an empty set misses them. The best set may be empty. The
    numbers ``tie`` ``(N,)`` order UAVs with equal ``probability`` ``(N,)``.

    >>> probability = np.array([0.9, 0.6, 0.01, 0.01])
    >>> choose_candidates(probability, np.ones(4, bool), np.zeros(4), p_no_leader=0.0, policy="map").tolist()
    [True, True, False, False]
    """
    named = np.zeros(len(alive), bool)
    living = np.flatnonzero(alive)
    if not len(living):
        return named
    order = living[np.lexsort((tie[living], -probability[living]))]
    p = np.clip(probability[order], 0.0, 1.0)
    if policy == "map":
        named[order[: min(int((p > 0.5).sum()), 1 if objective == "P1" else len(p))]] = True
        return named
    p_led = 1.0 - min(max(p_no_leader, 0.0), 1.0 - 1e-9)
    p = np.minimum(p / p_led, 1.0)
    if objective == "P1":
        cost, empty_cost = np.arange(len(p)) - p_led * np.cumsum(p / max(float(p.sum()), 1e-12)), p_led - 1.0
    else:
        none_missed = np.append(np.cumprod((1.0 - p)[::-1])[::-1][1:], 1.0)  # after each place in the order
        cost = p_led * round_price * (1.0 - none_missed) + np.cumsum(1.0 - p_led * p) / len(alive)
        empty_cost = p_led * round_price
    if cost.min() < empty_cost:
        named[order[: int(cost.argmin()) + 1]] = True
    return named

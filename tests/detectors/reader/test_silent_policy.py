"""The policy that knows how probably nobody leads: the least expected cost of all sets, the empty one included."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from detectors.policy import Policy, choose

ALIVE = np.ones(8, bool)
SETS = np.array(list(itertools.product([False, True], repeat=8)))


def cost_sets(heads, chance, silent, price, waste):
    """The expected cost of naming each of all sets ``(256,)``, by going through all sets of heads."""
    cost = np.zeros(256)
    for head, often in zip(heads, chance, strict=True):
        missed = (head & ~SETS).any(axis=1) | ~SETS.any(axis=1)
        cost += (1 - silent) * often * (price * missed + waste / 8 * (SETS & ~head).sum(axis=1))
    return cost + silent * waste / 8 * SETS.sum(axis=1)


@given(st.integers(0, 10_000), st.floats(0, 1), st.floats(0.1, 3.0), st.floats(0.0, 3.0))
def test_no_set_of_eight_uavs_has_a_lower_expected_cost(seed, silent, price, waste):
    rng = np.random.default_rng(seed)
    lone = rng.beta(0.3, 0.6, 8)  # of being a head if somebody leads
    policy = Policy(round_price=price, redundancy_price=waste)
    named = choose(lone * (1 - silent), ALIVE, policy, rng.random(8), silent=silent)
    chance = np.where(SETS, lone, 1 - lone).prod(axis=1)
    cost = cost_sets(SETS, chance, silent, price, waste)
    assert cost[(named == SETS).all(axis=1)][0] == pytest.approx(cost.min(), abs=1e-6)


def test_nobody_is_named_where_nobody_leads():
    none, one, tie = np.full(8, 0.01), np.append(0.9, np.full(7, 0.01)), np.arange(8.0)
    for policy in (Policy(round_price=1.0), Policy(objective="P1")):
        assert not choose(none, ALIVE, policy, tie, silent=0.99).any()
        assert choose(none, ALIVE, policy, tie).any()
        assert choose(one, ALIVE, policy, tie, silent=0.05).tolist() == [True] + 7 * [False]

"""The policy that chooses candidates from probabilities: the least expected cost of all sets, and the living only."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from detectors.policy import choose_candidates

ALIVE = np.ones(8, bool)
SETS = np.array(list(itertools.product([False, True], repeat=8)))


def cost_sets(heads, chance, silent, price):
    """The expected cost of naming each of all sets ``(256,)``, by going through all sets of heads."""
    cost = np.zeros(256)
    for head, often in zip(heads, chance, strict=True):
        missed = (head & ~SETS).any(axis=1) | ~SETS.any(axis=1)
        cost += (1 - silent) * often * (price * missed + (SETS & ~head).sum(axis=1) / 8)
    return cost + silent / 8 * SETS.sum(axis=1)


@given(st.integers(0, 10_000), st.floats(0, 1), st.floats(0.1, 3.0))
def test_no_set_of_eight_uavs_has_a_lower_expected_cost(seed, silent, price):
    rng = np.random.default_rng(seed)
    lone = rng.beta(0.3, 0.6, 8)  # of being a head if somebody leads
    named = choose_candidates(lone * (1 - silent), ALIVE, rng.random(8), silent, round_price=price)
    chance = np.where(SETS, lone, 1 - lone).prod(axis=1)
    cost = cost_sets(SETS, chance, silent, price)
    assert cost[(named == SETS).all(axis=1)][0] == pytest.approx(cost.min(), abs=1e-6)


@pytest.mark.parametrize("objective", ["P1", "P2"])
def test_nobody_is_named_where_nobody_leads(objective):
    none, one, tie = np.full(8, 0.01), np.append(0.9, np.full(7, 0.01)), np.arange(8.0)
    assert not choose_candidates(none, ALIVE, tie, 0.99, objective=objective).any()
    assert choose_candidates(none, ALIVE, tie, 0.0, objective=objective).any()
    assert choose_candidates(one, ALIVE, tie, 0.05, objective=objective).tolist() == [True] + 7 * [False]


def test_only_the_living_are_named():
    p, alive = np.array([0.9, 0.8, 0.7, 0.2]), np.array([True, False, True, True])
    tie, first = np.zeros(4), [True, False, False, False]
    assert choose_candidates(p, alive, tie, 0.0, policy="map").tolist() == [True, False, True, False]
    assert choose_candidates(p, alive, tie, 0.0, policy="map", objective="P1").tolist() == first
    assert choose_candidates(p, alive, tie, 0.0, objective="P1").tolist() == first
    near = np.array([0.51, 0.49, 0.5, 0.49])
    assert choose_candidates(near, np.ones(4, bool), tie, 0.0, policy="map").tolist() == first
    assert not choose_candidates(p, np.zeros(4, bool), tie, 0.0).any()

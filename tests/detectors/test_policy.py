"""The policy that chooses candidates from probabilities: the least expected cost, its budget, the living only."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detectors.policy import Policy, choose


@given(st.integers(0, 10_000), st.floats(0.0, 3.0))
@settings(max_examples=30)
def test_the_policy_has_the_least_expected_cost(seed, price):
    rng = np.random.default_rng(seed)
    probability = rng.beta(0.3, 0.5, 6)
    alive = np.ones(6, bool)
    named = choose(probability, alive, Policy(redundancy_price=price, round_price=1.0), rng.random(6))

    def cost(some):
        rest = np.setdiff1d(np.arange(6), some)
        return 1.0 - np.prod(1.0 - probability[rest]) + price / 6 * (1.0 - probability[list(some)]).sum()

    costs = [cost(some) for count in range(1, 7) for some in itertools.combinations(range(6), count)]
    assert cost(np.flatnonzero(named)) == pytest.approx(min(costs), abs=1e-9)


def test_the_policy_keeps_to_its_budget_and_to_the_living():
    probability = np.array([0.9, 0.8, 0.7, 0.2])
    alive = np.array([True, False, True, True])
    tie = np.zeros(4)
    assert choose(probability, alive, Policy(shot_budget=1), tie).tolist() == [True, False, False, False]
    assert choose(probability, alive, Policy(policy="map"), tie).tolist() == [True, False, True, False]
    assert choose(probability, alive, Policy(objective="P1"), tie).tolist() == [True, False, False, False]
    assert not choose(np.full(4, 0.1), alive, Policy(policy="map"), tie).any()
    assert choose(np.full(4, 0.001), alive, Policy(), tie).sum() >= 1
    assert not choose(probability, np.zeros(4, bool), Policy(), tie).any()

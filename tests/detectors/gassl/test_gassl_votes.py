"""Vote rules, each against a literal reading, and ties."""

import numpy as np
import pytest

from detectors.gassl.votes import RULES, choices, probabilities, top


def matrices(uavs=6, seed=0):
    rng = np.random.default_rng(seed)
    attention = rng.random((uavs, uavs))
    attention /= attention.sum(axis=1, keepdims=True)
    return attention, rng.standard_normal((uavs, uavs))


def of_rule(rule, attention, rise, rng):
    return probabilities(rule, attention, rise, choices(attention, False, rng), choices(attention, True, rng))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("exclude_self", [False, True])
def test_choices_are_the_argmax(seed, exclude_self):
    attention, _ = matrices(seed=seed)
    chosen = choices(attention, exclude_self, np.random.default_rng(0))
    for i, row in enumerate(attention):
        allowed = [j for j in range(len(row)) if not (exclude_self and j == i)]
        assert chosen[i] == max(allowed, key=lambda j: row[j])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rule", RULES)
def test_each_rule_read_literally(rule, seed):
    attention, rise = matrices(seed=seed)
    uavs = len(attention)
    expected = np.zeros(uavs)
    for i in range(uavs):
        for other in range(uavs):
            if other == i:
                continue
            row = attention[other]
            if rule == "paper":  # c_i = 1/N sum_{i' != i} 1{argmax_j alpha_{i',j} = i}
                vote = float(max(range(uavs), key=lambda j: row[j]) == i)
            elif rule == "exclude-self":
                vote = float(max((j for j in range(uavs) if j != other), key=lambda j: row[j]) == i)
            elif rule == "occlusion":
                positive = {j: max(0.0, rise[other, j]) for j in range(uavs) if j != other}
                vote = positive[i] / (sum(positive.values()) or 1.0)
            else:
                vote = row[i]
            expected[i] += vote / uavs
    np.testing.assert_allclose(of_rule(rule, attention, rise, np.random.default_rng(0)), expected, atol=1e-12)


def test_a_uav_that_chooses_itself_gives_no_vote_under_the_papers_rule():
    attention = np.eye(4)
    rise = np.zeros((4, 4))
    rng = np.random.default_rng(0)
    for rule in ("paper", "mass", "occlusion"):
        np.testing.assert_array_equal(of_rule(rule, attention, rise, rng), 0.0)
    assert of_rule("exclude-self", attention, rise, rng).sum() == pytest.approx(1.0)


def test_rows_without_any_rise_give_no_vote():
    attention, rise = matrices()
    rise[2] = -1.0
    votes = of_rule("occlusion", attention, rise, np.random.default_rng(0))
    assert votes.sum() == pytest.approx(5 / 6)


def test_inputs_are_left_as_they_are():
    attention, rise = matrices()
    kept = attention.copy(), rise.copy()
    for rule in RULES:
        of_rule(rule, attention, rise, np.random.default_rng(0))
    np.testing.assert_array_equal(attention, kept[0])
    np.testing.assert_array_equal(rise, kept[1])


@pytest.mark.parametrize("exclude_self", [False, True])
def test_ties_of_attention_favour_nobody(exclude_self):
    rng = np.random.default_rng(0)
    even = np.full((5, 5), 0.2)
    counts = np.zeros((5, 5))
    for _ in range(1000):
        counts[np.arange(5), choices(even, exclude_self, rng)] += 1
    if exclude_self:
        assert (np.diag(counts) == 0).all()
        counts = counts[~np.eye(5, dtype=bool)]
    expected = 1000 / (4 if exclude_self else 5)
    assert (np.abs(counts - expected) < 5 * np.sqrt(expected)).all()


def test_ties_of_scores_favour_nobody():
    rng = np.random.default_rng(0)
    counts = np.zeros(5)
    for _ in range(2000):
        counts[top(np.array([0.0, 1.0, 1.0, 0.0, 1.0]), 1, rng)] += 1
    assert counts[[0, 3]].sum() == 0
    assert (np.abs(counts[[1, 2, 4]] - 2000 / 3) < 5 * np.sqrt(2000 / 3)).all()


def test_top_takes_the_highest_in_order():
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(top(np.array([0.1, 0.5, 0.3, 0.4]), 3, rng), [1, 3, 2])
    assert len(top(np.array([0.1, 0.5]), 7, rng)) == 2

"""Heads by facility location against brute force, and properties of the answer."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detectors.follow_mixture.assignment import assign_groups

seeds = st.integers(0, 10_000)


def worth(gain, chosen, itself, sizes):
    """The value of a set of candidates by definition, and the number of UAVs that follow each of them."""
    value, followers = -np.log(sizes.sum()) * len(chosen), dict.fromkeys(chosen, 0)
    for group in range(len(gain)):
        best = max(chosen, key=lambda head: gain[group, head], default=None)
        if best is None or group in [itself[head] for head in chosen]:
            continue
        follows = gain[group, best] > 0
        if sizes[group] == 1:  # names one of the heads, or none
            value -= np.log(len(chosen) + 1)
        elif follows:
            value -= np.log(len(chosen))
        if follows:
            value += gain[group, best]
            followers[best] += int(sizes[group])
    return float(value), followers


def try_all(gain, itself, sizes, most=None):
    """The best value over all sets, and the set."""
    candidates = range(gain.shape[1])
    counts = range(1, (most or len(candidates)) + 1)
    best, found = 0.0, ()
    for some in itertools.chain.from_iterable(itertools.combinations(candidates, count) for count in counts):
        value, _ = worth(gain, some, itself, sizes)
        if value > best:
            best, found = value, some
    return best, found


def make_problem(seed):
    """Gains of 8 groups by 7 candidates: 5 single UAVs, which are groups 0 to 4, and 2 members of groups 5 and 6."""
    rng = np.random.default_rng(seed)
    sizes = np.array([1, 1, 1, 1, 1, 3, 2, 4])
    itself = np.array([0, 1, 2, 3, 4, -1, -1])
    gain = rng.normal(-2.0, 2.0, (8, 7))
    gain[[1, 2, 5], 0] += 12.0
    gain[[6, 7], rng.integers(3, 7)] += 12.0
    gain[itself[:5], np.arange(5)] = -np.inf
    return gain, itself, sizes


def assign(gain, itself, sizes, most=None):
    return assign_groups(gain, np.arange(10, 10 + gain.shape[1]), itself, sizes, most)


def check_definition(found, gain, itself, sizes):
    """The value and the heads of the groups are those of the set of heads."""
    chosen = tuple(int(head) - 10 for head in found.heads)
    value, followers = worth(gain, chosen, itself, sizes)
    assert found.value == pytest.approx(value, abs=1e-9)
    assert min(followers.values(), default=1) >= 1
    for group, head in enumerate(found.head):
        if head >= 0:
            assert gain[group, head - 10] == max(gain[group, list(chosen)]) > 0
            assert group not in itself[list(chosen)]


@given(seeds)
@settings(max_examples=25)
def test_planted_heads_are_found_as_by_trying_all_sets(seed):
    gain, itself, sizes = make_problem(seed)
    found = assign(gain, itself, sizes)
    value, heads = try_all(gain, itself, sizes)
    check_definition(found, gain, itself, sizes)
    assert found.value == pytest.approx(value, abs=1e-9)
    assert tuple(found.heads - 10) == heads


def test_without_gain_or_candidates_there_are_no_heads():
    sizes = np.array([2, 3])
    for gain in (np.zeros((2, 4)), np.full((2, 4), -np.inf), np.zeros((2, 0))):
        found = assign(gain, np.full(gain.shape[1], -1), sizes)
        assert found.head.tolist() == [-1, -1]
        assert found.value == 0
